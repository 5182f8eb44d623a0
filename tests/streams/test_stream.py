"""Streams: numbers and division of messages, the begin of an epoch, kept messages."""

import logging
import re
import tracemalloc
from collections.abc import Callable
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.builders import S, at
from tests.buses import DEADLINE_S, eventually, send_until
from tests.fakes import Lines
from tests.simulated_bus import Bus
from tfbus import (
    Buffer,
    InvalidArgumentException,
    LookupException,
    Node,
    StaticTransformBroadcaster,
    Transform,
    TransformBatch,
    TransformBroadcaster,
    TransformListener,
    TransformStamped,
)
from tfbus.base import scheduler
from tfbus.bus.retained import ask_retained, declare_retained_subscriber
from tfbus.bus.settings import NETWORKS
from tfbus.geometry.columns import Columns, columns_of_batch
from tfbus.streams import sender
from tfbus.streams.info import StreamState
from tfbus.streams.retained import FrameAnnouncer
from tfbus.streams.sender import (
    MOST_BACK_NS,
    NewestStamps,
    RowsOfKey,
    StreamOptions,
    TransformSender,
)
from tfbus.streams.stream import NodeStreams
from tfbus.streams.watch import StreamWatch
from tfbus.wire.codec import encode_message
from tfbus.wire.descriptions import FramesAsked, StreamDescription
from tfbus.wire.transforms import TransformMessage, decode_transforms, encode_transforms

# Without a bus

# How a transform is sent.
ALONE, BATCH = "as it is", "in a batch"


class Sent:
    """Stands in for a session and an executor; remembers what is sent where."""

    def __init__(self, network: str = "lan") -> None:
        self.network = NETWORKS[network]
        self.messages: list[tuple[str, TransformMessage]] = []
        self.epoch_ns = 0
        self.back_ns: list[tuple[str, int]] = []
        self.declared: list[Any] = []
        self.later: list[Callable[[], None]] = []

    def publisher(self, key: str, *, urgent: bool = False) -> Any:
        """A publisher of the key."""
        self.declared.append(self._publisher(key))
        return self.declared[-1]

    def _publisher(self, key: str) -> "_Publisher":
        return _Publisher(lambda payload: self.messages.append((key, decode_transforms(payload))))

    def publishers_within(self, expression: str, *, urgent: bool = False) -> Any:
        """Publishers of keys within."""
        self.declared.append(_Publisher(lambda payload: None))
        self.declared[-1].publisher = self._publisher
        return self.declared[-1]

    def queryable(self, key: str, callback: object, *, long: bool) -> Any:
        """It gets no queries."""
        return self.publishers_within(key)

    def after(self, delay_s: float, callback: Callable[[], None]) -> None:
        """It happens when the test says so."""
        self.later.append(callback)

    def run(self) -> None:
        """Do what is due later."""
        while self.later:
            self.later.pop()()

    def begin_epoch(self, child: str, back_ns: int) -> int:
        """Epochs are 0, 1, 2 ..."""
        self.back_ns.append((child, back_ns))
        self.epoch_ns += 1
        return self.epoch_ns

    def sender(self, **options: Any) -> TransformSender:
        """A sender of stream `sim`."""
        here: Any = self
        frames = FrameAnnouncer("sim", _Publisher(lambda payload: None), lambda rows: b"", here)
        return TransformSender(
            "sim", StreamOptions(**options), 0, here, frames, frames.add, self.begin_epoch
        )


class _Publisher:
    publisher: Any
    is_closed = False

    def __init__(self, put: Callable[[bytes], None]) -> None:
        self.put = put

    def close(self) -> None:
        self.is_closed = True


def numbers_of(sent: Sent) -> list[tuple[str, int, int | None]]:
    """Key, epoch and number of each message."""
    return [(key, message.epoch_ns, message.seq) for key, message in sent.messages]


def test_the_messages_of_a_stream_are_numbered() -> None:
    """The messages of a key are numbered from 0, so that a listener knows which it missed."""
    sent = Sent()
    sender = sent.sender()
    for frames in (["a"], ["a"], ["a", "b"], []):
        sender.send(Columns.of_transforms(at(child=child) for child in frames))
    assert numbers_of(sent) == [
        ("tf/sim", 0, 0),
        ("tf/sim", 0, 1),
        ("tf/sim", 0, 2),
        ("tf/sim", 0, 3),
    ]


def test_messages_are_small_on_a_network_that_loses_packets() -> None:
    """There a send of many rows goes out in numbered messages that fit into a packet, each of which
    a listener can read alone; a row is in one of them, in order.
    """
    sent = Sent("wifi")
    rows = [at(child=f"part{number}", parent=f"arm{number // 7}") for number in range(60)]
    sent.sender().send(Columns.of_transforms(rows))
    assert [message.seq for _, message in sent.messages] == [*range(len(sent.messages))]
    sizes = [len(encode_transforms(message)) for _, message in sent.messages]
    most = NETWORKS["wifi"].message_bytes
    assert max(sizes) <= most and all(size > most / 2 for size in sizes[:-1])
    children = [
        message.rows.frames[child]
        for _, message in sent.messages
        for _, child in message.rows.pairs()
    ]
    assert children == [each.child_frame_id for each in rows]


def test_messages_of_a_send_take_turns_on_a_network_that_loses_packets() -> None:
    """Each goes first in its turn: a link that is too narrow takes the first ones."""
    sent = Sent("mobile")
    rows = Columns.of_transforms([at(child=f"part{number}") for number in range(40)])
    sender = sent.sender()
    sender.send(rows)
    count = len(sent.messages)
    for _ in range(count):
        sender.send(rows)
    first = [message.rows.frames for _, message in sent.messages[::count]]
    assert count > 1 and len({*first[:-1]}) == count and first[-1] == first[0]
    assert [message.seq for _, message in sent.messages] == [*range(len(sent.messages))]


def test_a_split_stream_has_a_key_a_frame() -> None:
    """In a split stream each frame has its own key, and one message a send with its rows."""
    sent = Sent()
    sender = sent.sender(split=True)
    sender.send(Columns.of_transforms([at(1, "a"), at(2, "b/c"), at(3, "a")]))
    sender.send(Columns.of_transforms([at(4, "a", parent="map")]))
    assert numbers_of(sent) == [("tf/sim/a", 0, 0), ("tf/sim/b%2Fc", 0, 0), ("tf/sim/a", 0, 1)]
    rows = [
        [(ts.frame_id, ts.child_frame_id, ts.transform.x) for ts in message.batch]
        for _, message in sent.messages
    ]
    assert rows == [
        [("world", "a", 1), ("world", "a", 3)],
        [("world", "b/c", 2)],
        [("map", "a", 4)],
    ]


@pytest.mark.parametrize("split", [False, True])
def test_a_closed_stream_leaves_nothing_declared(split: bool) -> None:
    """Neither what it sends on nor what answers for its history; twice is fine."""
    sent = Sent()
    sender = sent.sender(split=split)
    assert [each.is_closed for each in sent.declared] == [False, False]
    for _ in range(2):
        sender.close()
    assert [each.is_closed for each in sent.declared] == [True, True]


@pytest.mark.parametrize("split", [False, True])
def test_a_frame_that_was_taken_out_leaves_nothing(split: bool) -> None:
    """A stream of frames that come and go for months does not grow, and forgets their stamps."""
    sent = Sent()
    sender = sent.sender(split=split, history_s=0)

    def detect(number: int) -> None:
        name = f"person{number}"
        sender.send(Columns.of_transforms([at(child=name, stamp_ns=-number * 10 * S)]))
        sender.remove(name)
        sent.later.clear()

    def detect_all(numbers: range) -> None:
        for number in numbers:
            detect(number)
            sent.messages.clear()

    # Python keeps up to 2,000 tuples of a length for the next ones, and a table grows at times: a
    # leak is there in each round.
    detect_all(range(2000))
    grown_by = []
    tracemalloc.start()
    for begin in (2000, 2100, 2200):
        before, _ = tracemalloc.get_traced_memory()
        detect_all(range(begin, begin + 100))
        grown_by.append(tracemalloc.get_traced_memory()[0] - before)
    tracemalloc.stop()
    assert min(grown_by) / 100 < 30  # bytes a frame, less than its name takes
    assert sent.epoch_ns == 0


sends = st.lists(
    st.dictionaries(
        st.sampled_from("abc"), st.integers(-3, 6).map(lambda s: s * S // 2), max_size=3
    ),
    max_size=12,
)


@settings(deadline=None)
@given(sends, st.booleans())
def test_an_epoch_ends_where_a_frame_goes_back_more_than_a_second(
    sends: list[dict[str, int]], split: bool
) -> None:
    """Whatever is sent: a frame whose stamp is more than a second before its newest begins a new
    epoch with that send, in which nothing is known of any frame and numbers begin at 0.
    """
    sent = Sent()
    sender = sent.sender(split=split)
    expected: list[tuple[str, int, int | None]] = []
    newest: dict[str, int] = {}
    numbers: dict[str, int] = {}
    epoch = 0
    for stamps in sends:
        sender.send(Columns.of_transforms(at(child=f, stamp_ns=t) for f, t in stamps.items()))
        if any(t < newest.get(f, t) - S for f, t in stamps.items()):
            epoch, newest, numbers = epoch + 1, {}, {}
        newest |= {f: max(t, newest.get(f, t)) for f, t in stamps.items()}
        for key in [f"tf/sim/{f}" for f in stamps] if split else ["tf/sim"]:
            expected.append((key, epoch, numbers.get(key, 0)))
            numbers[key] = numbers.get(key, 0) + 1
    assert numbers_of(sent) == expected


def test_a_new_epoch_is_due_to_the_first_frame_that_went_back() -> None:
    """Of a batch it is said which frame went back, and by how much."""
    sent = Sent()
    sender = sent.sender()
    for stamps in ((100, 100, 100), (101, 97, 50)):
        sender.send(
            Columns.of_transforms(
                at(child=child, stamp_ns=s * S) for child, s in zip("abc", stamps, strict=True)
            )
        )
    assert sent.back_ns == [("b", 3 * S)]


@settings(deadline=None)
@given(
    st.lists(
        st.tuples(
            st.sampled_from([ALONE, "by its pose", BATCH]),
            st.sampled_from(["a", "b"]),
            st.sampled_from(["world", "map"]),
            st.integers(0, 5).map(lambda s: s * S // 2),
        ),
        max_size=12,
    ),
    st.booleans(),
)
# A batch is later than what was sent alone before it; another frame begins an epoch.
@example([(ALONE, "a", "world", 0), (BATCH, "a", "world", 2 * S), (ALONE, "a", "world", 0)], False)
@example(
    [
        (ALONE, "a", "world", S),
        (BATCH, "b", "world", 2 * S),
        (BATCH, "b", "world", 0),
        (ALONE, "a", "world", S),
    ],
    False,
)
def test_a_transform_that_is_sent_alone_goes_as_a_batch_of_one(
    sends: list[tuple[str, str, str, int]], split: bool
) -> None:
    """Whatever is sent alone and whatever in batches, the messages are the same."""
    mixed, batches = Sent(), Sent()
    senders = mixed.sender(split=split), batches.sender(split=split)
    for number, (how, child, parent, stamp_ns) in enumerate(sends):
        transform = at(number, child, parent=parent, stamp_ns=stamp_ns)
        columns = Columns.of_transforms([transform])
        if how == ALONE:
            senders[0].send_one(transform)
        elif how == "by its pose":
            senders[0].send_pose((parent, child), stamp_ns, columns.poses_bytes())
        else:
            senders[0].send(columns)
        senders[1].send(columns)
    assert numbers_of(mixed) == numbers_of(batches)
    assert [list(message.batch) for _, message in mixed.messages] == [
        list(message.batch) for _, message in batches.messages
    ]


@pytest.mark.parametrize("many", [1, 50])
@settings(deadline=None)
@given(st.lists(st.tuples(st.lists(st.sampled_from("abcd"), max_size=4), st.integers(0, 5))))
def test_newest_stamps_are_those_of_a_dictionary(
    many: int, sends: list[tuple[list[str], int]]
) -> None:
    """Of each frame the newest stamp is known, also where a send has a frame twice; one by one and
    by numpy.
    """
    with patch.object(sender, "_MANY", many):
        judge_as_a_dictionary(sends)


def judge_as_a_dictionary(sends: list[tuple[list[str], int]]) -> None:
    newest = NewestStamps()
    known: dict[str, int] = {}
    for number, (children, seconds) in enumerate(sends):
        if number % 5 == 4:
            newest.forget("a")
            known.pop("a", None)
        stamps = [seconds * S + i for i in range(len(children))]
        late = [i for i, f in enumerate(children) if stamps[i] < known.get(f, 0) - MOST_BACK_NS]
        rows = newest.rows(children)
        assert newest.advance(rows, np.array(stamps, dtype=np.int64)) == (late[0] if late else None)
        if not late:
            for child, stamp in zip(children, stamps, strict=True):
                known[child] = max(stamp, known.get(child, 0))
            assert [newest.newest_ns(row) for row in rows] == [known[f] for f in children]


def rows_of(count: int, stamp_ns: int) -> TransformBatch:
    """Frames below the world, all at its origin."""
    edges = np.zeros((count, 2), dtype=np.uint32)
    edges[:, 1] = np.arange(count) + 1
    poses = np.tile([0, 0, 0, 0, 0, 0, 1.0], (count, 1))
    names = ("world", *map(str, range(count)))
    return TransformBatch(names, edges, np.full(count, stamp_ns), poses)


@pytest.mark.parametrize("stamp_ns", [-(2**63), 2**63 - 1])
def test_stamps_at_the_end_of_time_begin_no_epoch(stamp_ns: int) -> None:
    """A batch may have any stamp that 64 bits hold; buffers judge whether it makes sense."""
    sent = Sent()
    sender = sent.sender()
    for count in (1, 2, 1):
        sender.send(columns_of_batch(rows_of(count, stamp_ns)))
    assert [message.epoch_ns for _, message in sent.messages] == [0, 0, 0]


def test_sends_of_ever_other_frames_are_sent_all_the_same() -> None:
    """What sends have in common is remembered within bounds, and forgotten without harm."""
    sent = Sent()
    sender = sent.sender()
    for count in (30_000, 29_999, 30_000):
        sender.send(columns_of_batch(rows_of(count, 100 * S)))
        assert sum(len(table.by_child) for table in sender._tables.values()) <= 50_000
    assert [len(message.batch) for _, message in sent.messages] == [30_000, 29_999, 30_000]
    assert numbers_of(sent)[-1] == ("tf/sim", 0, 2)


# On a bus


def answers(node: Node, selector: str) -> list[tuple[str, str, float]]:
    """What the streams have kept: key, child and x of each first transform."""
    found = []
    for answer in node.session.ask(selector):
        assert answer.refusal is None, answer.refusal
        first = next(iter(decode_transforms(answer.payload).batch))
        found.append((answer.key, first.child_frame_id, first.transform.x))
    return found


def test_a_stream_answers_what_it_sent_last(sender: Node, receiver: Node) -> None:
    """A query returns what a stream sent in the last seconds, oldest first."""
    broadcaster = TransformBroadcaster(sender)
    for x in range(300):
        broadcaster.send_transform(at(x))
    wanted = [("tf/sender", "turtle1", x) for x in range(300)]
    eventually(lambda: answers(receiver, "tf/**?last_s=60") == wanted)
    assert answers(receiver, "tf/sender") == wanted
    assert answers(receiver, "tf/sender?last_s=0") == []


def test_a_stream_answers_nothing_of_what_it_removed(sender: Node, receiver: Node) -> None:
    """A frame that was removed is not in what the stream has kept, unless it was sent again."""
    broadcaster = TransformBroadcaster(sender)
    broadcaster.send_transform([at(1, "robot"), at(2, "arm")])
    broadcaster.remove("robot")
    broadcaster.send_transform([at(3, "robot"), at(4, "arm")])
    eventually(lambda: answers(receiver, "tf/sender"))
    assert answers(receiver, "tf/sender") == [("tf/sender", "arm", 2), ("tf/sender", "robot", 3)]


def test_a_split_stream_answers_for_one_frame(sender: Node, receiver: Node) -> None:
    """Of a split stream the history of one frame can be asked for, or of all."""
    broadcaster = TransformBroadcaster(sender, split=True)
    for x in (1, 2):
        broadcaster.send_transform([at(x, "a"), at(x, "b")])
    wanted = [("tf/sender/b", "b", 1), ("tf/sender/b", "b", 2)]
    eventually(lambda: answers(receiver, "tf/sender/b?last_s=60") == wanted)
    assert len(answers(receiver, "tf/sender/**?last_s=60")) == 4


@pytest.mark.parametrize("last_s", ["x", "-1", "nan", ""])
def test_an_invalid_last_s_is_refused(last_s: str, sender: Node, receiver: Node) -> None:
    """A query for the history with an invalid `last_s` is refused with what is valid."""
    TransformBroadcaster(sender).send_transform(at())
    refused = eventually(lambda: list(receiver.session.ask(f"tf/sender?last_s={last_s}")))
    (answer,) = refused
    assert re.fullmatch(f"last_s .*number .*not {last_s!r}", answer.refusal or "")


def test_a_stream_without_a_history_keeps_nothing(sender: Node, receiver: Node) -> None:
    """With `history_s=0` a stream keeps nothing, and answers no queries."""
    TransformBroadcaster(sender, history_s=0).send_transform(at(1))
    TransformBroadcaster(sender, stream="other").send_transform(at(2))
    eventually(lambda: answers(receiver, "tf/**?last_s=60") == [("tf/other", "turtle1", 2)])


def test_one_frame_of_a_split_stream_can_be_heard_alone(sender: Node, receiver: Node) -> None:
    """A subscriber of one frame's key receives no other frame."""
    heard: list[str] = []
    receiver.session.subscriber("tf/sender/b", lambda key, payload: heard.append(key))
    broadcaster = TransformBroadcaster(sender, split=True)
    send_until(
        lambda: broadcaster.send_transform([at(1, "a"), at(2, "b")]), lambda: len(heard) >= 3
    )
    assert set(heard) == {"tf/sender/b"}


def test_ten_thousand_frames_go_in_one_send(sender: Node, receiver: Node) -> None:
    """One call sends ten thousand transforms in one message, which arrives as a whole or not."""
    counts: set[int] = set()
    receiver.session.subscriber(
        "tf/sender", lambda key, payload: counts.add(len(decode_transforms(payload).batch))
    )
    broadcaster = TransformBroadcaster(sender)
    batch = rows_of(10_000, 100 * S)
    send_until(lambda: broadcaster.send_transform(batch), lambda: bool(counts))
    assert counts == {10_000}


def test_thousands_of_frames_have_a_key_each(sender: Node, receiver: Node) -> None:
    """A split stream of thousands of frames is made at once, and all of its keys are heard."""
    heard: set[str] = set()
    receiver.session.subscriber("tf/sender/*", lambda key, payload: heard.add(key))
    broadcaster = TransformBroadcaster(sender, split=True)
    batch = rows_of(3_000, 100 * S)
    send_until(lambda: broadcaster.send_transform(batch), lambda: len(heard) == 3_000)


def test_a_split_stream_fills_a_buffer(sender: Node, buffer: Buffer) -> None:
    """A listener receives all frames of a split stream, with one authority."""
    broadcaster = TransformBroadcaster(sender, split=True)
    send_until(
        lambda: broadcaster.send_transform([at(1, "arm"), at(2, "hand/left", parent="arm")]),
        lambda: buffer.can_transform("world", "hand/left"),
    )
    assert buffer.lookup_transform("world", "hand/left").transform.x == 3
    assert buffer.frame("hand/left").authority == "sender"


def test_a_clock_that_goes_back_begins_a_new_epoch(sender: Node, buffer: Buffer) -> None:
    """Where stamps go back by more than a second listeners forget what was; statics stay."""
    StaticTransformBroadcaster(sender).send_transform(at(5, "camera"))
    broadcaster = TransformBroadcaster(sender)
    send_until(
        lambda: broadcaster.send_transform(at(1, stamp_ns=100 * S)),
        lambda: buffer.can_transform("camera", "turtle1", 100 * S),
    )
    send_until(
        lambda: broadcaster.send_transform(at(2, stamp_ns=98 * S)),
        lambda: buffer.can_transform("camera", "turtle1", 98 * S),
    )
    assert not buffer.can_transform("camera", "turtle1", 100 * S)


def test_a_new_epoch_is_described_and_its_statics_are_sent_with_it(
    sender: Node, receiver: Node
) -> None:
    """Description and static transforms have the new epoch, and the history is empty."""
    descriptions = describe_to(receiver)
    statics: list[TransformMessage] = []
    declare_retained_subscriber(
        receiver.session, "tf_static/*", lambda key, data: statics.append(decode_transforms(data))
    )
    StaticTransformBroadcaster(sender).send_transform(at(5, "camera"))
    broadcaster = TransformBroadcaster(sender)
    for x, seconds in enumerate((100, 101, 98)):
        broadcaster.send_transform(at(x, stamp_ns=seconds * S))
    eventually(lambda: statics and statics[-1].epoch_ns > sender.started_ns)
    epoch_ns = statics[-1].epoch_ns
    eventually(lambda: descriptions and descriptions[-1].epoch == epoch_ns)
    assert descriptions[-1].started_ns == sender.started_ns
    assert statics[-1].seq == 0
    assert answers(receiver, "tf/**?last_s=60") == [("tf/sender", "turtle1", 2)]


def test_a_new_epoch_is_logged_in_one_line(sender: Node) -> None:
    """One line of the log says which frame went back, and by how much; repetitions are not."""
    log = Lines(sender.log)
    broadcaster = TransformBroadcaster(sender)
    for seconds in (100, 97, 94):
        broadcaster.send_transform(at(stamp_ns=seconds * S))
    (line,) = log.lines
    assert re.search(r"'sender' restarted: .*'turtle1' .*by 3\.000 s", line)


def test_a_stream_of_two_clocks_is_warned_of_once(sender: Node) -> None:
    """Where a frame goes back again and again, one warning names it and says what to do."""
    log = Lines(sender.log, logging.WARNING)
    broadcaster = TransformBroadcaster(sender)
    for number in range(30):
        # The arm's stamps come in disorder, far apart.
        broadcaster.send_transform(at(child="arm", stamp_ns=(100 - 5 * (number % 2)) * S))
    (line,) = log.lines
    assert re.match("Stream 'sender' .* 10 times, .*'arm': ", line)
    assert line.endswith("separate stream (stream=...)")


def describe_to(node: Node) -> list[StreamDescription]:
    """The descriptions that the node receives from now on."""
    heard: list[StreamDescription] = []

    def on_change(state: StreamState) -> None:
        if state.description is not None:
            heard.append(state.description)

    StreamWatch(node.session, on_change)
    return heard


def test_a_description_has_the_options_of_a_stream(sender: Node, receiver: Node) -> None:
    """Priority, split and the seconds kept are in the description, also before anything is sent."""
    descriptions = describe_to(receiver)
    TransformBroadcaster(sender, stream="arm", split=True, priority=-3, history_s=2.5)
    eventually(lambda: bool(descriptions))
    last = descriptions[-1]
    assert (last.frames, last.split, last.priority, last.history_s) == ((), True, -3, 2.5)


def test_a_description_has_the_last_parent_of_each_frame(sender: Node, receiver: Node) -> None:
    """The description has the current parent of each frame, however often it changes."""
    descriptions = describe_to(receiver)
    broadcaster = TransformBroadcaster(sender)
    for parent in ("table", "hand", "table", "hand", "table"):
        broadcaster.send_transform(at(child="box", parent=parent))
        wanted = ((parent, "box", False),)
        eventually(lambda wanted=wanted: descriptions and descriptions[-1].frames == wanted)


def test_a_description_has_the_last_kind_of_each_frame(sender: Node, receiver: Node) -> None:
    """A frame is static or dynamic as it was sent last, however often that changes."""
    descriptions = describe_to(receiver)
    static, dynamic = StaticTransformBroadcaster(sender), TransformBroadcaster(sender)
    for kind in (False, False, True, False, True, False, False):
        (static if kind else dynamic).send_transform(at(child="box"))
        wanted = (("world", "box", kind),)
        eventually(lambda wanted=wanted: descriptions and descriptions[-1].frames == wanted)


def test_a_stream_of_statics_only_keeps_no_history(sender: Node, receiver: Node) -> None:
    """A stream without dynamic transforms has no history."""
    descriptions = describe_to(receiver)
    StaticTransformBroadcaster(sender).send_transform(at(1, "camera"))
    eventually(lambda: descriptions and descriptions[-1].frames)
    assert descriptions[-1].history_s == 0.0


def test_frames_that_come_one_by_one_are_described_together(sender: Node, receiver: Node) -> None:
    """A thousand new frames, sent one after the other, take a few descriptions."""
    descriptions = describe_to(receiver)
    broadcaster = TransformBroadcaster(sender)
    broadcaster.send_transform(at(child="first"))
    eventually(lambda: bool(descriptions))
    for number in range(1000):
        broadcaster.send_transform(at(child=str(number)))
    eventually(lambda: len(descriptions[-1].frames) == 1001)
    assert len(descriptions) < 100


def test_a_frame_can_be_taken_out(sender: Node, buffer: Buffer) -> None:
    """A frame that is removed goes from every listener's buffer; the others stay."""
    broadcaster = TransformBroadcaster(sender)
    send_until(
        lambda: broadcaster.send_transform([at(1, "arm"), at(2, "leg")]),
        lambda: buffer.can_transform("arm", "leg"),
    )
    broadcaster.remove("arm")
    eventually(lambda: "arm" not in buffer.frames())
    assert buffer.can_transform("world", "leg")
    send_until(
        lambda: broadcaster.send_transform(at(3, "arm")), lambda: buffer.can_transform("arm", "leg")
    )


def test_a_static_frame_can_be_taken_out(sender: Node, buffer: Buffer) -> None:
    """A static frame that is removed goes from every listener's buffer, and late ones too."""
    broadcaster = StaticTransformBroadcaster(sender)
    broadcaster.send_transform([at(1, "camera"), at(2, "lidar")])
    eventually(lambda: buffer.can_transform("camera", "lidar"))
    broadcaster.remove("camera")
    eventually(lambda: "camera" not in buffer.frames())
    assert buffer.can_transform("world", "lidar")


def test_many_frames_can_be_taken_out_at_once(sender: Node, buffer: Buffer) -> None:
    """Frames that are removed together go together; where one is not there, none does."""
    static, dynamic = StaticTransformBroadcaster(sender), TransformBroadcaster(sender)
    static.send_transform([at(1, f"post{count}") for count in range(2_000)])
    send_until(
        lambda: dynamic.send_transform([at(2, "arm"), at(2, "leg")]),
        lambda: buffer.can_transform("arm", "post1999"),
    )
    for broadcaster in (static, dynamic):
        with pytest.raises(LookupException, match="'nose'"):
            broadcaster.remove("nose", "arm", "post1")
    static.remove(*(f"post{count}" for count in range(1, 2_000)))
    dynamic.remove("arm", "leg")
    eventually(lambda: buffer.frames() == ["post0", "world"])


def test_a_closed_stream_retains_nothing(sender: Node, receiver: Node) -> None:
    """Neither its static transforms nor its description."""
    StaticTransformBroadcaster(sender).send_transform(at(1, "arm"))

    def retained() -> list[str]:
        within = ("tf_static/*", "@tfbus/stream/*")
        return [answer.key for key in within for answer in ask_retained(receiver.session, key)]

    eventually(lambda: sorted(set(retained())) == ["@tfbus/stream/sender", "tf_static/sender"])
    NodeStreams.of_node(sender).close(sender.name)
    assert retained() == []


def test_frames_that_are_described_are_not_described_again() -> None:
    """In whatever order and company they are sent."""
    sent = Sent()
    sender = sent.sender()
    sender.send(Columns.of_transforms([at(child="a"), at(child="b")]))
    sent.run()
    for children in ("ba", "a", "b"):
        sender.send(Columns.of_transforms(at(child=child) for child in children))
        assert not sent.later
    sender.send(Columns.of_transforms([at(child="c")]))
    assert len(sent.later) == 1


def test_a_static_frame_can_become_dynamic(sender: Node, receiver: Node, buffer: Buffer) -> None:
    """A static frame that is sent as dynamic can be taken out, for late listeners too."""
    static, dynamic = StaticTransformBroadcaster(sender), TransformBroadcaster(sender)
    static.send_transform([at(1, "arm"), at(2, "lamp")])
    eventually(lambda: buffer.can_transform("arm", "lamp"))
    send_until(
        lambda: dynamic.send_transform(at(3, "arm")),
        lambda: buffer.lookup_transform("world", "arm").transform.x == 3,
    )
    dynamic.remove("arm")
    eventually(lambda: "arm" not in buffer.frames())
    static.send_transform(at(4, "post"))
    late = Buffer()
    with TransformListener(late, receiver):
        for each in (buffer, late):
            eventually(lambda each=each: each.frames() == ["lamp", "post", "world"])


def test_a_dynamic_send_does_not_wait_for_a_static_one(sender: Node) -> None:
    """Retained messages wait for a full link; new frames and a new epoch are sent meanwhile."""
    broadcaster, statics = TransformBroadcaster(sender), StaticTransformBroadcaster(sender)
    broadcaster.send_transform(at(1.0, "base", stamp_ns=10 * S))
    waits, has_room, sent = scheduler.Event(), scheduler.Event(), list[str]()

    def put_on_a_full_link(_: bytes) -> None:
        waits.set()
        assert has_room.wait(DEADLINE_S)
        sent.append("static")

    with patch.object(statics._stream._static_publisher, "put", put_on_a_full_link):
        thread = scheduler.Thread(
            target=lambda: statics.send_transform(at(1.0, "mount")), daemon=True
        )
        thread.start()
        assert waits.wait(DEADLINE_S)
        broadcaster.send_transform(at(1.0, "arm", stamp_ns=10 * S))
        broadcaster.send_transform(at(1.0, "base", stamp_ns=S))
        sent.append("dynamic")
        has_room.set()
        thread.join(DEADLINE_S)
        eventually(lambda: sent.count("static") == 2)
    assert sent == ["dynamic", "static", "static"]


def test_sets_of_static_transforms_are_numbered(sender: Node, receiver: Node) -> None:
    """The later one has the higher number, so that listeners tell them apart in any order."""
    numbers: list[int | None] = []
    declare_retained_subscriber(
        receiver.session,
        "tf_static/*",
        lambda key, data: numbers.append(decode_transforms(data).seq),
    )
    static = StaticTransformBroadcaster(sender)
    for number in range(4):
        static.send_transform(at(number, f"post{number}"))
        eventually(lambda number=number: numbers == list(range(number + 1)))


def test_a_set_without_a_static_frame_follows_its_dynamic_transform(
    sender: Node, receiver: Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However long that takes to be sent: the frame is never missing."""
    heard: list[str] = []
    session = receiver.session
    declare_retained_subscriber(session, "tf_static/*", lambda key, data: heard.append("set"))
    subscriber = session.subscriber("tf/*", lambda key, data: heard.append("dynamic"))
    static, dynamic = StaticTransformBroadcaster(sender), TransformBroadcaster(sender)
    static.send_transform([at(1, "arm"), at(2, "lamp")])
    eventually(lambda: heard == ["set"])
    assert sender.session.watch_heard("tf/sender").wait(DEADLINE_S)
    encode = RowsOfKey.encode

    def encode_slowly(self: RowsOfKey, columns: Columns) -> bytes:
        scheduler.sleep(1.0)
        return encode(self, columns)

    monkeypatch.setattr(RowsOfKey, "encode", encode_slowly)
    dynamic.send_transform(at(3, "arm"))
    eventually(lambda: len(heard) == 3)
    assert heard == ["set", "dynamic", "set"]
    subscriber.close()


def test_a_static_frame_that_becomes_dynamic_is_never_missing(
    sender: Node, receiver: Node, buffer: Buffer
) -> None:
    """The set of static frames is sent without it, and it stays where it was sent to last."""
    changes: list[str] = []
    buffer.on_change(lambda change: changes.append(change.kind))
    sets: list[list[str]] = []
    declare_retained_subscriber(
        receiver.session,
        "tf_static/*",
        lambda key, data: sets.append([ts.child_frame_id for ts in decode_transforms(data).batch]),
    )
    StaticTransformBroadcaster(sender).send_transform([at(1, "arm"), at(2, "lamp")])
    eventually(lambda: buffer.can_transform("arm", "lamp"))
    broadcaster = TransformBroadcaster(sender)
    send_until(
        lambda: broadcaster.send_transform(at(3, "arm")), lambda: sets and sets[-1] == ["lamp"]
    )
    eventually(lambda: buffer.lookup_transform("world", "arm").transform.x == 3)
    assert "removed" not in changes


def test_a_frame_that_was_just_sent_can_be_taken_out(sender: Node, receiver: Node) -> None:
    """However short a frame was there, a description has it, and a later one does not."""
    descriptions = describe_to(receiver)
    broadcaster = TransformBroadcaster(sender)

    def is_described() -> bool:
        children = [[child for _, child, _ in each.frames] for each in descriptions]
        at = children.index(["leg", "arm"]) if ["leg", "arm"] in children else len(children)
        return ["leg"] in children[at:]

    def send_and_remove() -> None:
        broadcaster.send_transform([at(1, "leg"), at(2, "arm")])
        broadcaster.remove("arm")

    send_until(send_and_remove, is_described)


def test_only_a_frame_that_is_sent_can_be_taken_out(sender: Node) -> None:
    """Removing what the stream does not send is an error that says what it sends."""
    broadcaster, static = TransformBroadcaster(sender), StaticTransformBroadcaster(sender)
    with pytest.raises(LookupException, match="'leg'; it sends none"):
        broadcaster.remove("leg")
    broadcaster.send_transform([at(child=f"leg{number}") for number in range(7)])
    static.send_transform(at(child="camera"))
    with pytest.raises(LookupException) as caught:
        broadcaster.remove("leg")
    assert re.search("'sender' .*'leg'; .*'leg4' and 2 more$", str(caught.value))
    assert (caught.value.frame, len(caught.value.nearest)) == ("leg", 3)
    with pytest.raises(LookupException, match=r"static frame 'leg'; .*'camera'"):
        static.remove("leg")
    with pytest.raises(InvalidArgumentException, match="with a StaticTransformBroadcaster"):
        broadcaster.remove("camera")
    with pytest.raises(InvalidArgumentException, match="with a TransformBroadcaster"):
        static.remove("leg1")


def test_broadcasters_of_one_stream_agree(sender: Node) -> None:
    """Broadcasters of one stream have the same options; others are refused."""
    TransformBroadcaster(sender, split=True, priority=1)
    TransformBroadcaster(sender, split=True, priority=1)
    TransformBroadcaster(sender, stream="other")
    with pytest.raises(InvalidArgumentException, match=r"'sender' .*\(stream=\.\.\.\)$") as caught:
        TransformBroadcaster(sender)
    assert "has split=True, priority=1" in caught.value.fact
    assert "not split=False, priority=0" in caught.value.fact


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"history_s": -1}, "history_s must be a number of seconds, 0 or more, not -1"),
        ({"history_s": float("inf")}, "history_s must be a number of seconds, 0 or more, not inf"),
        ({"history_s": float("nan")}, "history_s must be a number of seconds, 0 or more, not nan"),
        ({"priority": 2**31}, "priority must be a 32-bit integer, not 2147483648"),
    ],
)
def test_invalid_options_are_refused(options: dict[str, Any], reason: str, sender: Node) -> None:
    """Invalid options are refused where the broadcaster is made."""
    with pytest.raises(InvalidArgumentException) as caught:
        TransformBroadcaster(sender, **options)
    assert str(caught.value) == reason


@pytest.mark.parametrize("name", ["", "/leg"])
def test_a_batch_with_an_invalid_frame_name_is_refused(name: str, sender: Node) -> None:
    """What no buffer would take is refused where it is sent."""
    poses = np.array([[0, 0, 0, 0, 0, 0, 1.0]])
    batch = TransformBatch(("world", name), np.uint32([[0, 1]]), np.array([100 * S]), poses)
    with pytest.raises(InvalidArgumentException):
        TransformBroadcaster(sender).send_transform(batch)


def test_two_streams_of_a_node_may_send_one_frame(sender: Node, receiver: Node) -> None:
    """Listeners decide which of two streams counts for a frame."""
    heard: set[str] = set()
    receiver.session.subscriber("tf/*", lambda key, payload: heard.add(key))
    broadcasters = [TransformBroadcaster(sender, stream=stream) for stream in ("left", "right")]

    def send_both() -> None:
        for broadcaster in broadcasters:
            broadcaster.send_transform(at())

    send_until(send_both, lambda: heard == {"tf/left", "tf/right"})


def publish_three() -> None:
    """A program that sends three poses, then waits."""
    with Node("robot") as node:
        broadcaster = TransformBroadcaster(node, split=True)
        for number in range(3):
            pose = Transform((number, 0, 0))
            broadcaster.send_transform(TransformStamped(number * S, "world", "base", pose))
        node.spin()


def test_a_listener_of_another_process_has_what_was_sent_before_it(bus: Bus) -> None:
    """A listener that asks for history knows what another process sent before it was there."""
    bus.start_main(publish_three).wait_for_line("ready")
    buffer = Buffer()
    with TransformListener(buffer, bus.node("late"), history_s=60.0):
        eventually(lambda: buffer.can_transform("world", "base", 500_000_000))
    assert buffer.lookup_transform("world", "base", 500_000_000).transform.x == 0.5
    assert buffer.lookup_transform("world", "base").transform.x == 2


@pytest.mark.parametrize("name", ["a\nb", "a\udc80", "a" * 256, "a\x1b[31m"])
def test_a_stream_has_a_name_that_can_be_shown(bus: Bus, name: str) -> None:
    """Listeners ignore others."""
    with pytest.raises(InvalidArgumentException, match="use 1 to 255 letters"):
        TransformBroadcaster(bus.node("sim"), stream=name)


def test_a_frame_that_cannot_be_encoded_does_not_stop_the_description(bus: Bus) -> None:
    """It is refused where it is sent, and what is sent later is described."""
    broadcaster = TransformBroadcaster(bus.node("sim"))
    watching = TransformListener(Buffer(), bus.node("listener"))
    good = at(1, "robot")
    batch = TransformBatch.from_transforms([good])
    for name in ("a\udc80", "a\nb"):
        with pytest.raises(InvalidArgumentException, match="cannot be printed"):
            broadcaster.send_transform(batch.with_frames(("world", name)))
    broadcaster.send_transform(good)

    def listed() -> list[tuple[str, str, bool]]:
        return [row for info in watching.streams() for row in info.frames]

    eventually(lambda: listed() == [("world", "robot", False)])
    watching.close()


def test_a_question_for_frames_is_answered_by_streams_that_list_one(
    sender: Node, receiver: Node
) -> None:
    """A question for descriptions may name child frames: then other streams do not answer, and a
    question that cannot be read is refused.
    """
    for child in ("base", "arm"):
        TransformBroadcaster(sender, stream=child).send_transform(at(child=child))

    def answers(payload: bytes | None) -> list[tuple[str, str | None]]:
        key = "tf_static/*?description=1"
        found = receiver.session.ask(key, payload, answers_at="@tfbus/stream/*")
        return sorted((each.key, each.refusal) for each in found)

    eventually(lambda: len(answers(None)) == 2)
    asked = encode_message(FramesAsked(("arm", "hand")))
    eventually(lambda: answers(asked) == [("@tfbus/stream/arm", None)])
    assert answers(encode_message(FramesAsked(("world",)))) == []
    assert all("children" in (refusal or "") for _, refusal in answers(b"\x80"))
