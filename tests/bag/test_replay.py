"""Recordings on a bus again: streams, statics, topics and the simulated time."""

import logging
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Any

import msgpack
import pytest

from tests.builders import S, at, x_of
from tests.buses import eventually
from tests.fakes import InAThread, Lines, StandingClock
from tests.simulated_bus import Bus
from tests.streams.received import registry_of
from tfbus import (
    Buffer,
    InvalidNameError,
    Node,
    TransformBroadcaster,
    TransformException,
    TransformListener,
)
from tfbus.bag.player import Player
from tfbus.bag.replay import Republisher, serve
from tfbus.bag.replayed_stream import ReplayedNames, ReplayedStream, StreamEpochs
from tfbus.bag.replayed_time import moved
from tfbus.geometry.columns import Columns
from tfbus.geometry.transform import TransformStamped
from tfbus.messages import (
    Clock,
    Empty,
    JointState,
    PlayNext,
    PlayProgress,
    RobotDescription,
    Seek,
    SetRate,
)
from tfbus.recording.items import (
    EventItem,
    Item,
    RecordedStream,
    Selection,
    TopicItem,
    TransformItem,
)
from tfbus.recording.playhead import Pace, PausableClock
from tfbus.recording.reader import RecordingReader
from tfbus.recording.writer import RecordingWriter
from tfbus.streams.info import StreamState
from tfbus.streams.watch import StreamWatch
from tfbus.wire.codec import as_map

pytest.importorskip("mcap")

BEGAN_NS = 1_700_000_000 * S
MS = 1_000_000
SIM = RecordedStream("sim", "/sim", epoch_ns=BEGAN_NS)


def moving(s: float, x: float, child: str = "turtle1", stream: RecordedStream = SIM) -> Item:
    """A dynamic transform that came `s` seconds after the beginning, with a stamp of then."""
    log_ns = BEGAN_NS + round(s * S)
    rows = Columns.of_transforms([at(x, child, log_ns)])
    return TransformItem(log_ns, stream, rows, seq=None)


def static(s: float, *frames: TransformStamped, stream: RecordedStream = SIM) -> Item:
    """The whole set of static transforms of a stream."""
    log_ns = BEGAN_NS + round(s * S)
    return TransformItem(log_ns, stream, Columns.of_transforms(frames), static=True)


def described(
    s: float, *frames: tuple[str, bool], stream: RecordedStream = SIM, **more: Any
) -> EventItem:
    """A description of a stream with these child frames of `world`, and whether each is static."""
    facts = {
        "v": 1,
        "node": stream.node,
        "epoch": stream.epoch_ns,
        "frames": [["world", child, is_static] for child, is_static in frames],
        "host": "robot",
        "pid": 7,
        "session": "abc",
        "split": stream.split,
        "history_s": 10.0,
        "started_ns": stream.epoch_ns,
        **more,
    }
    return EventItem(BEGAN_NS + round(s * S), "stream", stream.name, facts)


def gone(s: float, stream: RecordedStream = SIM) -> EventItem:
    """The token of the stream was lost."""
    return EventItem(BEGAN_NS + round(s * S), "stream gone", stream.name)


class NotedRepublisher(Republisher):
    """A replay that says whether it has begun: what is in force at the beginning is sent."""

    has_begun = False

    def begin(self, *given: Any, **more: Any) -> None:
        super().begin(*given, **more)
        self.has_begun = True


class Played:
    """A recording of these items that is played on the bus, to this listener among others; paused
    at first, so that the test says how far.
    """

    def __init__(
        self,
        bus: Bus,
        path: Path,
        items: Iterable[Item],
        listener: TransformListener,
        *,
        node: Node | None = None,
        at_end: Any = "wait",
        selection: Selection | None = None,
        lasting: Sequence[str] = (),
        look_back_s: float = 0.0,
        **given: Any,
    ) -> None:
        with RecordingWriter(path) as writer:
            for item in items:
                writer.write(item)
        self.node = node or bus.node("player")
        self._listener = listener
        self._reader = RecordingReader(path)
        chosen = {} if selection is None else {"selection": selection}
        self.player = Player(
            self._reader,
            paused=True,
            at_end=at_end,
            lasting=lasting,
            look_back_s=look_back_s,
            **chosen,
        )
        self.replay = NotedRepublisher(self.node, self._reader, self.player, **chosen, **given)
        self._run = InAThread(lambda: self.player.run(self.replay))

    def step(self, messages: int = 1) -> None:
        """Play the next messages, once all streams are listened to."""
        self.wait_for_listener()
        self.player.step(messages)

    def seek(self, log_ns: int) -> None:
        """Jump to a moment, once all streams are listened to."""
        self.wait_for_listener()
        self.player.seek(log_ns)

    def wait_for_listener(self) -> None:
        """Wait until the listener subscribes to all streams and knows their epochs.

        A listener that learns of an epoch later than it gets messages of the next one drops those.
        A robot sends others soon; what is paused sends none.
        """
        streams = self.replay._streams.values()
        eventually(lambda: self.replay.has_begun)
        eventually(lambda: all(each.heard for each in streams))
        eventually(lambda: all(self._is_known(each) for each in streams if each.is_there))

    def _is_known(self, stream: ReplayedStream) -> bool:
        known = registry_of(self._listener).get(stream.name)
        return known is not None and (
            known.reception.facts.epochs.confirmed_ns == stream._description.epoch
        )

    def close(self) -> None:
        """End it, and raise what ended it before."""
        self.player.stop()
        error = self._run.result()
        self._reader.close()
        if error is not None:
            raise error


@pytest.fixture
def played(bus: Bus, tmp_path: Path, listener: TransformListener) -> Iterator[Any]:
    """Plays items on the bus, until the test ends."""
    all_played: list[Played] = []

    def play(items: Sequence[Item], **given: Any) -> Played:
        path = tmp_path / f"{len(all_played)}.mcap"
        all_played.append(Played(bus, path, items, listener, **given))
        return all_played[-1]

    yield play
    for each in all_played:
        each.close()


@pytest.fixture
def states(receiver: Node) -> Iterator[dict[str, Any]]:
    """What the streams on the bus say of themselves, by name, always the last."""
    found: dict[str, Any] = {}

    def note(state: StreamState) -> None:
        found[state.name] = state

    watch = StreamWatch(receiver.session, note, everywhere=True)
    yield found
    watch.close()


# Streams


def test_a_stream_has_its_name_and_node_again(played: Any, states: dict[str, Any]) -> None:
    """The description is the recorded one but for host, session and epoch."""
    played([described(0, ("turtle1", False), priority=3), moving(0, 1.0), moving(1, 2.0)])
    description = eventually(lambda: "sim" in states and states["sim"].description)
    assert description.node == "/sim"
    assert description.host == "recorded"
    assert description.pid == 7
    assert description.priority == 3
    assert description.frames == (("world", "turtle1", False),)
    assert description.epoch > BEGAN_NS
    assert eventually(lambda: states["sim"].confirmed)


def test_lookups_are_the_same_at_the_same_stamps(played: Any, buffer: Buffer) -> None:
    """With recorded stamps a lookup between two of them gives what it gave."""
    items = [described(0, ("turtle1", False)), moving(0, 1.0), moving(1, 2.0), moving(2, 4.0)]
    run = played(items, stamps="recorded")
    run.step(3)
    middle_ns = BEGAN_NS + 3 * S // 2
    eventually(lambda: buffer.can_transform("world", "turtle1", middle_ns))
    assert buffer.lookup_transform("world", "turtle1", middle_ns).transform.x == 3.0


def test_stamps_of_now_are_moved_by_one_number(played: Any, buffer: Buffer, receiver: Node) -> None:
    """At rate 1 the time between two stamps stays to the nanosecond, and the last is of now."""
    run = played([described(0, ("turtle1", False)), moving(0, 1.0), moving(0.123456789, 2.0)])
    run.step(0)
    before_ns = receiver.now_ns()
    run.player.resume()
    eventually(lambda: x_of(buffer) == 2.0)
    last_ns = buffer.lookup_transform("world", "turtle1").stamp_ns
    assert before_ns < last_ns <= receiver.now_ns() + 10 * MS
    first = buffer.lookup_transform("world", "turtle1", last_ns - 123_456_789)
    assert first.transform.x == 1.0


def test_static_transforms_reach_who_comes_late(
    played: Any, bus: Bus, states: dict[str, Any]
) -> None:
    """They are retained, as those of a broadcaster."""
    items = [described(0, ("drone", True)), static(0, at(5.0, "drone")), moving(1, 1.0)]
    played(items)
    eventually(lambda: "sim" in states and states["sim"].alive)
    buffer = Buffer()
    with TransformListener(buffer, bus.node("late")):
        eventually(lambda: x_of(buffer, source="drone") == 5.0)


def test_the_last_messages_reach_who_comes_late(played: Any, bus: Bus) -> None:
    """A listener that joins later queries what was sent before."""
    run = played([described(0, ("turtle1", False)), moving(0, 1.0), moving(1, 2.0)])
    run.player.step(2)
    eventually(lambda: run.player.progress.sent == 2)
    buffer = Buffer()
    with TransformListener(buffer, bus.node("late"), history_s=5.0):
        eventually(lambda: x_of(buffer) == 2.0)


def test_a_stream_goes_as_it_went(played: Any, buffer: Buffer) -> None:
    """Where the publisher was gone, its frames are marked as gone, and stay."""
    items = [described(0, ("turtle1", False)), moving(0, 1.0), gone(1), moving(2, 9.0, "other")]
    run = played(items)
    run.step()
    eventually(lambda: x_of(buffer) == 1.0)
    run.seek(BEGAN_NS + 3 * S // 2)
    eventually(lambda: buffer.frame("turtle1").gone)
    assert x_of(buffer) == 1.0


def test_a_frame_is_removed_as_it_was(played: Any, buffer: Buffer) -> None:
    """A frame that the next description does not list leaves the buffers."""
    items = [
        described(0, ("turtle1", False), ("drone", False)),
        moving(0, 1.0),
        moving(0, 2.0, "drone"),
        described(1, ("drone", False)),
        moving(1, 3.0, "drone"),
    ]
    run = played(items)
    run.step(2)
    eventually(lambda: x_of(buffer) == 1.0 and x_of(buffer, source="drone") == 2.0)
    run.step()
    eventually(lambda: x_of(buffer, source="drone") == 3.0)
    eventually(lambda: x_of(buffer) is None)


def test_conflicts_are_as_they_were(played: Any, bus: Bus) -> None:
    """Of two recorded publishers of a frame the one that was first then is first now."""
    other = RecordedStream("late", "/late", epoch_ns=BEGAN_NS + S)
    items: list[Item] = [
        described(0, ("turtle1", False), stream=other),
        described(0, ("turtle1", False)),
    ]
    for n in range(300):
        items += [moving(n / 10, 9.0, stream=other), moving(n / 10, 1.0)]
    run = played(items)
    buffer = Buffer()
    with TransformListener(buffer, bus.node("listener"), conflicts="first") as listener:
        run.player.resume()
        eventually(lambda: {each.name: each.excluded for each in listener.streams()}.get("late"))
        eventually(lambda: x_of(buffer) == 1.0)


def test_a_restart_is_one_again(played: Any, buffer: Buffer, states: dict[str, Any]) -> None:
    """A later epoch of the recording is a later one now: what was sent before is forgotten."""
    again = RecordedStream("sim", "/sim", epoch_ns=BEGAN_NS + 5 * S)
    items = [
        described(0, ("turtle1", False)),
        moving(0, 1.0),
        described(5, ("drone", False), stream=again, pid=8),
        moving(5, 2.0, "drone", stream=again),
    ]
    run = played(items)
    run.step()
    eventually(lambda: x_of(buffer) == 1.0)
    first_ns = eventually(lambda: "sim" in states and states["sim"].description).epoch
    run.step()
    eventually(lambda: x_of(buffer, source="drone") == 2.0)
    eventually(lambda: states["sim"].description.epoch > first_ns)
    assert x_of(buffer) is None


def test_a_split_stream_has_a_key_for_each_frame(played: Any, receiver: Node) -> None:
    """A program can subscribe to one frame of it."""
    keys: list[str] = []
    receiver.session.subscriber("tf/**", lambda key, payload: keys.append(key))
    split = RecordedStream("sim", "/sim", epoch_ns=BEGAN_NS, split=True)
    items = [
        described(0, ("turtle1", False), ("drone", False), stream=split),
        moving(0, 1.0, stream=split),
        moving(0, 2.0, "drone", stream=split),
    ]
    run = played(items)
    run.step(2)
    eventually(lambda: sorted(keys) == ["tf/sim/drone", "tf/sim/turtle1"])


def test_a_stream_without_a_description_gets_one(played: Any, states: dict[str, Any]) -> None:
    """Recordings of other programs have no descriptions: it lists what was sent."""
    run = played([moving(0, 1.0), moving(1, 2.0, "drone")])
    run.player.step(2)
    rows = {("world", "turtle1", False), ("world", "drone", False)}
    eventually(lambda: "sim" in states and states["sim"].description)
    eventually(lambda: {*states["sim"].description.frames} == rows)
    assert states["sim"].description.node == "/sim"


def test_streams_of_robots_stay_in_their_namespaces(played: Any, states: dict[str, Any]) -> None:
    """A stream of robot7 is one of robot7 again."""
    robot = RecordedStream("robot7/sim", "/robot7/sim", "robot7", BEGAN_NS)
    played([described(0, ("turtle1", False), stream=robot), moving(0, 1.0, stream=robot)])
    assert eventually(lambda: states.get("robot7/sim")).key == "robot7/@tfbus/stream/sim"


def test_a_prefix_puts_all_names_below_it(played: Any, states: dict[str, Any]) -> None:
    """With a prefix a recording does not meet the live streams of the same names."""
    run = played(
        [described(0, ("turtle1", False)), moving(0, 1.0), topic(1, "turtle1/pose")],
        names=ReplayedNames("old/run"),
    )
    assert eventually(lambda: states.get("old/run/sim")).key == "old/run/@tfbus/stream/sim"
    assert run.replay.topics == ["old/run/turtle1/pose"]


def test_streams_and_topics_can_be_renamed(played: Any, states: dict[str, Any]) -> None:
    """A name given by hand gets no prefix."""
    names = ReplayedNames("old", {"/sim": "robot7/other", "turtle1/pose": "/pose"})
    run = played([described(0), moving(0, 1.0), topic(1, "turtle1/pose")], names=names)
    assert eventually(lambda: states.get("robot7/other")).key == "robot7/@tfbus/stream/other"
    assert run.replay.topics == ["pose"]


def test_two_streams_cannot_get_one_name(
    bus: Bus, tmp_path: Path, listener: TransformListener
) -> None:
    """Their messages would be taken for those of one."""
    other = RecordedStream("other", "/other", epoch_ns=BEGAN_NS)
    items = [moving(0, 1.0), moving(0, 1.0, stream=other)]
    with pytest.raises(InvalidNameError, match="'other' and 'sim'"):
        Played(
            bus, tmp_path / "two.mcap", items, listener, names=ReplayedNames("", {"other": "sim"})
        )


def test_frames_can_be_chosen(played: Any, buffer: Buffer, states: dict[str, Any]) -> None:
    """With some frames only, descriptions list no others."""
    items = [
        described(0, ("turtle1", False), ("drone", False)),
        moving(0, 1.0),
        moving(0, 2.0, "drone"),
        moving(1, 3.0, "drone"),
    ]
    run = played(items, selection=Selection(frames=("drone",)))
    run.step(2)
    eventually(lambda: x_of(buffer, source="drone") == 3.0)
    assert x_of(buffer) is None
    description = eventually(lambda: "sim" in states and states["sim"].description)
    assert description.frames == (("world", "drone", False),)


# Seeking


def test_a_seek_back_is_a_new_epoch(played: Any, buffer: Buffer, states: dict[str, Any]) -> None:
    """Listeners forget what comes later in the recording; static transforms stay."""
    items = [
        described(0, ("turtle1", False), ("drone", True)),
        static(0, at(5.0, "drone")),
        *(moving(s, float(s)) for s in range(6)),
    ]
    run = played(items, stamps="recorded")
    run.step(7)
    eventually(lambda: x_of(buffer) == 5.0)
    epoch_ns = eventually(lambda: "sim" in states and states["sim"].description).epoch
    run.seek(BEGAN_NS + 2 * S)
    eventually(lambda: states["sim"].description.epoch > epoch_ns)
    run.step()
    eventually(lambda: x_of(buffer) == 2.0)
    assert not buffer.can_transform("world", "turtle1", BEGAN_NS + 4 * S)
    assert x_of(buffer, source="drone") == 5.0


def test_a_seek_back_before_a_stream_takes_it_away(played: Any, buffer: Buffer) -> None:
    """Its frames are not marked as gone: they have not been there yet."""
    other = RecordedStream("other", "/other", epoch_ns=BEGAN_NS)
    items = [
        described(0, ("turtle1", False)),
        moving(0, 1.0),
        described(5, ("drone", False), ("camera", True), stream=other),
        static(5, at(4.0, "camera"), stream=other),
        moving(5, 2.0, "drone", stream=other),
    ]
    run = played(items)
    run.step(3)
    eventually(lambda: x_of(buffer, source="drone") == 2.0)
    eventually(lambda: x_of(buffer, source="camera") == 4.0)
    run.seek(BEGAN_NS)
    eventually(lambda: "drone" not in buffer.frames())
    eventually(lambda: "camera" not in buffer.frames())


def test_a_seek_ahead_has_what_is_in_force_there(played: Any, buffer: Buffer) -> None:
    """Static transforms that were sent in between are there."""
    items = [
        described(0, ("drone", True)),
        static(0, at(5.0, "drone")),
        described(3, ("drone", True), ("camera", True)),
        static(3, at(6.0, "drone"), at(7.0, "camera")),
        moving(9, 1.0),
    ]
    run = played(items)
    eventually(lambda: x_of(buffer, source="drone") == 5.0)
    run.seek(BEGAN_NS + 6 * S)
    eventually(lambda: x_of(buffer, source="drone") == 6.0)
    eventually(lambda: x_of(buffer, source="camera") == 7.0)


def test_after_a_seek_frames_are_where_they_were(
    played: Any, buffer: Buffer, states: dict[str, Any]
) -> None:
    """Also while it is paused, by their last messages before; not those of a former epoch, of
    frames that were removed, or that came too long before.
    """
    later = replace(SIM, epoch_ns=BEGAN_NS + 3 * S)
    items = [
        described(0, ("turtle1", False), ("drone", False), ("lamp", False), ("old", False)),
        moving(1, 7.0, "old"),
        moving(2.9, 8.0, "lamp"),
        moving(2.9, 1.0, "turtle1"),
        described(3, ("turtle1", False), ("drone", False), stream=later),
        *(moving(3 + s / 10, float(s), "turtle1", later) for s in range(10)),
        moving(3.5, 5.0, "drone", later),
        moving(9, 9.0, "turtle1", later),
    ]
    run = played(items, stamps="recorded", look_back_s=2.0)
    run.seek(BEGAN_NS + 4 * S)
    eventually(lambda: x_of(buffer) == 9.0 and x_of(buffer, source="drone") == 5.0)
    assert buffer.frame("turtle1").newest_ns == BEGAN_NS + 39 * S // 10
    assert not {"lamp", "old"} & set(buffer.frames())
    run.seek(BEGAN_NS + 295 * S // 100)
    eventually(lambda: x_of(buffer) == 1.0 and x_of(buffer, source="old") == 7.0)


def test_with_stamps_of_now_frames_are_there_now_after_a_seek(
    played: Any, buffer: Buffer, receiver: Node
) -> None:
    """Their own stamps may lie among those that were sent before."""
    run = played([*(moving(s / 10, float(s)) for s in range(90))], look_back_s=2.0)
    run.wait_for_listener()
    before_ns = receiver.now_ns()
    run.player.seek(BEGAN_NS + 55 * S // 10)
    eventually(lambda: x_of(buffer) == 54.0)
    assert buffer.frame("turtle1").newest_ns >= before_ns


def test_a_stream_that_left_before_a_seek_is_gone_after_it(played: Any, buffer: Buffer) -> None:
    """Its frames are where they were when it left."""
    other = RecordedStream("other", "/other", epoch_ns=BEGAN_NS)
    items = [
        described(0, ("turtle1", False)),
        described(0, ("drone", False), stream=other),
        moving(1, 1.0),
        moving(1, 2.0, "drone", stream=other),
        gone(1.5, stream=other),
        moving(5, 3.0),
    ]
    run = played(items, stamps="recorded", look_back_s=2.0)
    run.seek(BEGAN_NS + 2 * S)
    eventually(lambda: x_of(buffer, source="drone") == 2.0 and buffer.frame("drone").gone)
    assert x_of(buffer) == 1.0


def test_a_pause_takes_no_time() -> None:
    """What was sent before it is kept as long as if there were none."""
    clock = StandingClock()
    played = PausableClock(clock)
    clock.at_ns = 5
    assert played() == 5
    for is_paused in (True, True):
        played.pause(is_paused)
        clock.at_ns += 100
        assert played() == 5
    played.pause(False)
    clock.at_ns += 1
    assert played() == 6


def test_a_loop_goes_on_with_stamps_of_now(played: Any, buffer: Buffer, receiver: Node) -> None:
    """Each round begins new epochs, and its stamps are later than those before."""
    items = [described(0, ("turtle1", False)), *(moving(n / 50, float(n)) for n in range(10))]
    run = played(items, at_end="loop")
    run.player.resume()
    eventually(lambda: run.player.progress.loops >= 3)
    later_ns = receiver.now_ns() + S

    def newest_ns() -> int:
        # A round drops the samples of the one before.
        with suppress(TransformException):
            return buffer.latest_common_time("world", "turtle1") or 0
        return 0

    eventually(lambda: newest_ns() > later_ns)


def test_epochs_keep_their_order_and_grow_from_run_to_run() -> None:
    """Also where the clock stands still between two runs, and for epochs of a moment."""
    epochs = StreamEpochs([("sim", 30), ("sim", 10), ("sim", 20)], lambda: 1000 * S)
    epochs.begin_run()
    first = [epochs.of("sim", epoch_ns) for epoch_ns in (10, 20, 30)]
    assert first == sorted(set(first))
    epochs.begin_run()
    assert epochs.of("sim", 10) > first[-1]


# Topics


def topic(s: float, name: str, values: dict[str, Any] | None = None) -> TopicItem:
    """A message of a topic."""
    return TopicItem(BEGAN_NS + round(s * S), name, "Pose", values or {"x": 1.0})


def test_messages_of_topics_are_the_same_bytes(played: Any, receiver: Node) -> None:
    """Integers stay integers, floats floats, in the same order."""
    values = {"stamp_ns": 5, "x": 1.5, "name": "a", "flag": True, "rows": [1.0, 2.0], "raw": b"\0"}
    payloads: list[bytes] = []
    receiver.create_raw_subscription("turtle1/pose", payloads.append)
    items = [topic(n / 50, "turtle1/pose", values) for n in range(3)]
    run = played(items, at_end="loop", stamps="recorded")
    run.player.resume()
    eventually(lambda: payloads)
    assert payloads[0] == msgpack.packb(values)
    assert run.node.describe()["publishes"]["turtle1/pose"] == "Pose"


def test_joint_states_get_stamps_of_now(played: Any, receiver: Node) -> None:
    """The stamps of joint states are moved as those of transforms, which they become."""
    stamps: list[int] = []
    receiver.create_subscription(
        JointState, "joint_states", lambda state: stamps.append(state.stamp_ns)
    )
    items = [
        TopicItem(
            BEGAN_NS + n * S,
            "joint_states",
            "JointState",
            as_map(JointState(BEGAN_NS + n * S - 5)),
        )
        for n in range(3)
    ]
    run = played(items, at_end="loop")
    run.player.resume()
    eventually(lambda: stamps)
    assert abs(stamps[0] - time.time_ns()) < 60 * S


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("rate", [0.001, 1.0, 10_000.0])
def test_stamps_that_do_not_fit_are_the_last_that_do(rate: float) -> None:
    """Recorded times may be any: what would be beyond 64 bits is at their end, in order."""
    first, last = -(2**31) * S, 2**31 * S - 1
    rows = Columns.of_transforms([at(1, "early", first), at(1, "late", last)])
    for log_ns in (0, 2**63 - 1):
        for ahead_ns in (first, 0, last):
            found = moved(rows, Pace(log_ns, 0, last, rate), ahead_ns).stamps_as_ints()
            assert found == sorted(found)
            exact = [last + each - log_ns - ahead_ns for each in (first, last)]
            if rate == 1.0:
                assert found == [min(max(each, -(2**63)), 2**63 - 1) for each in exact]


def test_what_cannot_be_sent_is_left_out(played: Any, receiver: Node) -> None:
    """A message that is nested too deeply, and a description with a number that no message holds:
    the rest is played.
    """
    deep: dict[str, Any] = {}
    for _ in range(400):
        deep = {"a": deep}
    came: list[bytes] = []
    receiver.create_raw_subscription("pose", came.append)
    wrong = described(0, ("turtle1", False))
    wrong = replace(wrong, facts={**wrong.facts, "pid": 2**70})
    items = [wrong, topic(0.1, "deep", deep), *(topic(n / 5, "pose") for n in range(1, 9))]
    run = played(items, at_end="loop")
    lines = Lines(run.node.log, logging.WARNING)
    run.player.resume()
    eventually(lambda: came and len(lines.lines) >= 2)
    assert "description of stream 'sim'" in lines.lines[0]
    assert "nested too deep" in lines.lines[1]


def header(s: float, frame: str = "laser") -> dict[str, Any]:
    """A header of ROS's with a stamp of `s` seconds after the beginning."""
    sec, nanosec = divmod(BEGAN_NS + round(s * S), S)
    return {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": frame}


def stamp_of(header: dict[str, Any]) -> int:
    """The stamp of a header in nanoseconds."""
    return int(header["stamp"]["sec"]) * S + int(header["stamp"]["nanosec"])


def test_messages_fit_the_transforms_they_were_recorded_with(
    played: Any, receiver: Node, buffer: Buffer
) -> None:
    """Headers of ROS's messages are moved by what transforms are moved by, wherever they stand; a
    stamp of 0 stays.
    """
    path = {
        "header": header(1),
        "poses": [{"header": header(0.25), "x": 1.0}, {"header": header(0.5), "x": 2.0}],
        "none": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "map"},
        "own": {"stamp_ns": BEGAN_NS + S, "list": [{"stamp_ns": 0}]},
    }
    came: list[dict[str, Any]] = []
    receiver.create_raw_subscription("path", lambda data: came.append(msgpack.unpackb(data)))
    items: list[Item] = [described(0, ("turtle1", False))]
    items += [moving(0, 1.0), TopicItem(BEGAN_NS + 1, "path", "nav_msgs/Path", path)]
    run = played([*items, moving(0.1, 2.0)])
    run.step(0)
    run.player.resume()
    eventually(lambda: came and x_of(buffer) == 2.0)
    moved_by = buffer.lookup_transform("world", "turtle1").stamp_ns - (BEGAN_NS + S // 10)
    [first] = came
    assert stamp_of(first["header"]) == BEGAN_NS + S + moved_by
    assert [stamp_of(each["header"]) for each in first["poses"]] == [
        BEGAN_NS + S // 4 + moved_by,
        BEGAN_NS + S // 2 + moved_by,
    ]
    assert first["none"] == path["none"]
    assert first["own"] == {"stamp_ns": BEGAN_NS + S + moved_by, "list": [{"stamp_ns": 0}]}


def test_messages_without_a_known_stamp_are_told_of(played: Any) -> None:
    """Once for a topic, with the remedy; not of types that are known to have none."""
    run = played(
        [
            item
            for n in range(3)
            for item in (
                TopicItem(BEGAN_NS + n * S, "battery", "Battery", {"time_s": 5.0}),
                TopicItem(BEGAN_NS + n * S, "cmd_vel", "Twist", {"linear": {"x": 1.0}}),
            )
        ]
    )
    lines = Lines(run.node.log, logging.INFO)
    run.player.step(4)
    eventually(lambda: run.player.progress.sent == 4)
    said = [line for line in lines.lines if "no stamp is known" in line]
    assert len(said) == 1
    assert "battery" in said[0] and "--clock" in said[0]


def test_retained_messages_come_first_wherever_it_begins(played: Any, bus: Bus) -> None:
    """A retained message is in force at any later moment, and reaches who comes later still."""
    description = TopicItem(
        BEGAN_NS,
        "robot_description",
        "RobotDescription",
        as_map(RobotDescription("<robot/>")),
        retained=True,
    )
    items = [description, *(topic(float(n), "turtle1/pose") for n in range(1, 5))]
    run = played(items)
    run.player.seek(BEGAN_NS + 3 * S)
    run.step()
    heard: list[RobotDescription] = []
    late = bus.node("late")
    late.create_subscription(RobotDescription, "robot_description", heard.append, retained=True)
    eventually(lambda: heard == [RobotDescription("<robot/>")])


# The simulated time


@pytest.fixture
def follower(bus: Bus) -> Node:
    """A node with simulated time."""
    return bus.node("follower", sim_time=True)


def test_the_clock_is_that_of_the_recording(played: Any, follower: Node) -> None:
    """Paused it stands at the beginning, and moves with each step and seek."""
    items = [described(0, ("turtle1", False)), *(moving(s, float(s)) for s in range(9))]
    run = played(items, stamps="recorded", clock_hz=40.0)
    assert follower.wait_for_clock(20.0)
    assert follower.now_ns() == BEGAN_NS
    run.player.step(3)
    run.player.resume()
    eventually(lambda: follower.now_ns() > BEGAN_NS + 2 * S)
    run.player.pause()
    eventually(lambda: follower.now_ns() == run.player.progress.log_ns)
    run.player.seek(BEGAN_NS + 7 * S)
    eventually(lambda: follower.now_ns() == BEGAN_NS + 7 * S)
    run.player.seek(BEGAN_NS + S)
    eventually(lambda: follower.now_ns() == BEGAN_NS + S)


def test_the_clock_says_how_it_goes(played: Any, receiver: Node) -> None:
    """Its rate is the player's, and it says when it stands."""
    clocks: list[Clock] = []
    receiver.create_subscription(Clock, "clock", clocks.append)
    run = played([moving(s / 10, 1.0) for s in range(900)], stamps="recorded", clock_hz=100.0)
    eventually(lambda: clocks and clocks[-1].paused)
    run.player.set_rate(2.0)
    run.player.resume()
    eventually(lambda: not clocks[-1].paused and clocks[-1].rate == 2.0)


def test_a_recorded_clock_is_the_clock(played: Any, follower: Node) -> None:
    """Where the recorded nodes followed a simulated time, that one is published."""
    items = [
        moving(0, 1.0),
        TopicItem(
            BEGAN_NS + S, "clock", "Clock", {"stamp_ns": 5 * S, "rate": 1.0, "paused": False}
        ),
        TopicItem(BEGAN_NS + 2 * S, "clock", "Clock", {"stamp_ns": 9 * S, "rate": 1.0}),
    ]
    run = played(items, stamps="recorded", clock_hz=40.0)
    run.player.step(2)
    eventually(lambda: follower.now_ns() == 5 * S)
    run.player.step()
    eventually(lambda: follower.now_ns() == 9 * S)


def test_after_a_seek_a_recorded_clock_shows_what_it_showed_there(
    played: Any, follower: Node, receiver: Node
) -> None:
    """At once, also while it is paused, and nothing of the time before the jump comes after it."""
    clocks: list[Clock] = []
    receiver.create_subscription(Clock, "clock", clocks.append)
    items = [moving(n / 10, 1.0) for n in range(90)]
    items += [
        TopicItem(BEGAN_NS + s * S, "clock", "Clock", {"stamp_ns": (5 + s) * S}) for s in (0, 2, 8)
    ]
    items.sort(key=lambda item: item.log_ns)
    run = played(items, stamps="recorded", clock_hz=40.0, lasting=["clock"])
    eventually(lambda: follower.now_ns() == 5 * S)
    eventually(lambda: clocks)
    run.player.seek(BEGAN_NS + 85 * S // 10)
    eventually(lambda: follower.now_ns() == 13 * S)
    run.player.seek(BEGAN_NS + 3 * S)
    eventually(lambda: follower.now_ns() == 7 * S)
    eventually(lambda: clocks[-1].stamp_ns == 7 * S)
    assert [each for each, _ in groupby(clock.stamp_ns // S for clock in clocks)] == [5, 13, 7]


def test_stamps_of_a_simulated_time_are_moved_from_it(played: Any, buffer: Buffer) -> None:
    """Stamps that are years from the log times come out as those of now all the same."""
    rows = [Columns.of_transforms([at(float(n), stamp_ns=n * S + S)]) for n in range(3)]
    items = [TransformItem(BEGAN_NS + n * S, SIM, rows[n]) for n in range(3)]
    run = played(items)
    run.step()
    eventually(lambda: x_of(buffer) == 0.0)
    age_ns = time.time_ns() - buffer.lookup_transform("world", "turtle1").stamp_ns
    assert abs(age_ns) < 60 * S


# Services


def test_services_do_what_keys_do(played: Any, bus: Bus) -> None:
    """Other programs pause, step, seek and change the rate, and read how far it is."""
    run = played([moving(s, 1.0) for s in range(100)])
    stopped = threading.Event()
    serve(run.node, run.player, stopped.set)
    caller = bus.node("caller")

    def call(kind: Any, name: str, *values: Any) -> Any:
        client = caller.create_client(kind, f"player/{name}")
        return client.call(kind.Request(*values), timeout_s=20.0)

    ends = [call(Seek, "seek", offset_s).log_ns for offset_s in (-1e300, 1e300)]
    assert ends == [run.player.start_ns, run.player.end_ns]
    assert call(Seek, "seek", 12.5).log_ns == BEGAN_NS + 25 * S // 2
    assert call(Seek, "seek", 1.0, BEGAN_NS + S).offset_s == 2.0
    call(PlayNext, "play_next", 3)
    eventually(lambda: call(PlayProgress, "progress").sent == 3)
    call(SetRate, "set_rate", 4.0)
    assert call(PlayProgress, "progress").rate == 4.0
    with pytest.raises(Exception, match=r"rate .*from 0\.001"):
        call(SetRate, "set_rate", 0.0)
    call(Empty, "resume")
    assert not call(PlayProgress, "progress").paused
    call(Empty, "toggle_paused")
    assert call(PlayProgress, "progress").paused
    call(Empty, "stop")
    assert stopped.is_set()


# Who else is there


def test_a_stream_that_lives_is_named(played: Any, sender: Node, bus: Bus) -> None:
    """Two streams of one name cannot be told apart: the player says what to do."""
    TransformBroadcaster(sender, stream="sim").send_transform(at(1.0))
    node = bus.node("player")
    eventually(lambda: node.session.living("@tfbus/stream/*"))
    run = played([moving(0, 1.0)], node=node, names=ReplayedNames())
    assert "'sim'" in run.replay.living() and "--prefix" in run.replay.living()
    sender.close()
    eventually(lambda: run.replay.living() == "")


def test_a_description_that_cannot_be_read_is_left_out(played: Any, buffer: Buffer) -> None:
    """A damaged one is logged, and the rest is played."""
    items = [described(0, ("turtle1", False), epoch="now"), moving(0, 1.0), moving(1, 2.0)]
    run = played(items)
    run.step(2)
    eventually(lambda: x_of(buffer) == 2.0)
