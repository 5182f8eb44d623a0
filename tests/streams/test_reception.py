"""Receiving one stream: epochs, misses, removals and marks, message by message."""

import logging
import re
from collections.abc import Callable
from typing import Any

import pytest

from tests.builders import S, at, payload
from tests.streams.received import Received, appear
from tfbus import Buffer
from tfbus.base.log import LogOnce
from tfbus.streams.reception import StreamReception
from tfbus.streams.stream_facts import ReceptionHooks
from tfbus.wire.transforms import TransformReader


@pytest.fixture
def received() -> Received:
    return Received()


def test_messages_are_counted(received: Received) -> None:
    """A stream counts its messages, transforms and bytes, and how late they come."""
    received.send(at(1, "robot", 8 * S), at(2, "arm", 8 * S))
    stream = received.stream
    assert (stream.counts.messages, stream.counts.transforms) == (1, 2)
    assert stream.counts.bytes == len(payload([at(1, "robot", 8 * S), at(2, "arm", 8 * S)]))
    assert stream.counts.delay_s == 1.0
    received.send(at(1, "robot", 9 * S))
    assert stream.counts.delay_s == pytest.approx(0.9)
    assert stream.counts.last_delay_s == 0.0


def test_delays_need_a_time(received: Received) -> None:
    """What comes before a simulated time is known is not late by the years since 1970."""
    received.now_ns = 0
    received.send(at(1, "robot", 8 * S))
    assert received.stream.counts.delay_s is None
    received.now_ns = 9 * S
    received.send(at(1, "robot", 8 * S))
    assert received.stream.counts.delay_s == 1.0


def test_a_new_epoch_has_delays_of_its_own(received: Received) -> None:
    """A restarted publisher may be on a host with another clock."""
    received.send(at(1, "robot", 8 * S))
    received.send(at(1, "robot", 2 * S), epoch_ns=2)
    counts = received.stream.counts
    assert (counts.delay_s, counts.last_delay_s) == (7.0, 7.0)


def test_kept_messages_have_a_delay_of_their_own(received: Received) -> None:
    """Until the first live one: that of the newest, in whatever order they come."""
    for stamp_ns in (2 * S, 4 * S, 3 * S):
        received.stream.receive_kept(payload([at(1, "robot", stamp_ns)], 1))
    counts = received.stream.counts
    assert (counts.last_delay_s, counts.kept_delay_s) == (None, 5.0)
    received.send(at(1, "robot", 8 * S))
    assert (counts.last_delay_s, counts.kept_delay_s) == (1.0, 5.0)
    received.send(at(1, "robot", 2 * S), epoch_ns=2)
    assert counts.kept_delay_s is None


def test_what_was_sent_before_the_first_message_heard_is_not_missed(received: Received) -> None:
    """Misses are gaps in the numbers of messages, from the first that was heard."""
    for seq in (5, 6, 9, 10):
        received.send(at(1, "robot"), seq=seq)
    assert received.stream.counts.missed == 2
    received.send(at(1, "robot", 2 * S), epoch_ns=2, seq=3)
    received.send(at(1, "robot", 3 * S), epoch_ns=2, seq=4)
    assert received.stream.counts.missed == 2


def test_a_message_that_comes_twice_or_late_is_not_a_miss(received: Received) -> None:
    """Numbers that go back are no gap, and messages without a number are not counted."""
    for seq in (1, 2, 1, 2, 3, None):
        received.send(at(1, "robot"), seq=seq)
    assert received.stream.counts.missed == 0


def test_a_new_epoch_restarts_the_stream(
    received: Received, caplog: pytest.LogCaptureFixture
) -> None:
    """A restarted publisher may send older stamps; its statics stay; one line says so."""
    received.send(at(1, "robot", 1000 * S))
    received.send_static(at(2, "post"))
    with caplog.at_level("INFO"):
        received.send(at(3, "robot", 5 * S), epoch_ns=2)
        received.send(at(4, "robot", 6 * S), epoch_ns=2)
    assert received.buffer.lookup_transform("world", "robot").stamp_ns == 6 * S
    assert received.x_of("post") == 2
    (record,) = caplog.records
    assert re.match("Stream 'sim' restarted: .*publisher", record.getMessage())


def test_messages_of_a_former_epoch_are_outdated(received: Received) -> None:
    """Messages of a former process are dropped and counted."""
    received.send(at(1, "robot"), epoch_ns=2)
    received.send(at(7, "robot", 2 * S), epoch_ns=1)
    received.send_static(at(3, "post"), epoch_ns=2)
    received.send_static(at(4, "post"), epoch_ns=1)
    assert (received.x_of("robot"), received.x_of("post")) == (1, 3)
    assert received.stream.counts.outdated == 2


def test_an_older_process_that_is_left_alone_counts_again(
    received: Received, caplog: pytest.LogCaptureFixture
) -> None:
    """A node was started twice, and the second ended: after 1 s the first counts again."""
    received.stream.describe(1, frozenset({"robot"}), publisher=("/sim", 7, "ab12"))
    received.send(at(1, "robot", 1 * S), epoch_ns=1)
    received.send(at(2, "robot", 2 * S), epoch_ns=2)
    received.send_static(at(2, "post"), epoch_ns=2)
    with caplog.at_level("INFO"):
        for received.time_s in (0.0, 0.4, 0.8, 1.0):
            received.send(at(1, "robot", 3 * S), epoch_ns=1)
        assert (received.x_of("robot"), received.taken_over) == (2, [])
        received.time_s = 1.2
        received.send(at(1, "robot", 4 * S), epoch_ns=1)
    assert (received.x_of("robot"), received.taken_over) == (1, [("sim", 1)])
    assert received.stream.counts.outdated == 4
    twice, restarted = [record.getMessage() for record in caplog.records]
    assert re.search(r"'sim': /sim .* twice.*\(--name\)$", twice)
    assert re.match("Stream 'sim' restarted: .*silent", restarted)
    received.send_static(at(2, "post"), epoch_ns=2)
    received.send_static(at(1, "post"), epoch_ns=1)
    assert received.x_of("post") == 1
    received.send(at(3, "robot", 5 * S), epoch_ns=3)
    assert received.x_of("robot") == 3


def test_two_processes_do_not_take_turns(
    received: Received, caplog: pytest.LogCaptureFixture
) -> None:
    """While both send, the one that was started last counts; it is logged once."""
    received.send(at(1, "robot", S), epoch_ns=1)
    for received.time_s in range(100):
        received.send(at(2, "robot", S), epoch_ns=2)
        received.send(at(1, "robot", S), epoch_ns=1)
    assert (received.x_of("robot"), received.taken_over) == (2, [])
    (record,) = caplog.records
    assert re.search("'sim': .* started", record.getMessage())


def test_a_slow_process_does_not_come_between(received: Received) -> None:
    """Of two that send at different rates one counts, and keeps counting."""
    for received.time_s in range(100):
        if received.time_s % 10 == 0:
            received.send(at(2, "robot", S), epoch_ns=2)
        received.send(at(1, "robot", S), epoch_ns=1)
    assert (received.x_of("robot"), received.taken_over) == (1, [("sim", 1)])


def test_late_messages_do_not_bring_a_former_process_back(
    received: Received,
) -> None:
    """Late messages are few or come at once; kept and static ones show no live process."""
    received.send(at(2, "robot", 2 * S), epoch_ns=2)
    for _ in range(1000):
        received.send(at(1, "robot"), epoch_ns=1)
    for received.time_s in (10.0, 20.0):
        received.send(at(1, "robot"), epoch_ns=1)
        received.send(at(2, "robot", 2 * S), epoch_ns=2)
    for received.time_s in range(30, 60):
        received.stream.receive_kept(payload([at(1, "robot")], 1))
        received.send_static(at(1, "post"), epoch_ns=1)
        received.describe("robot", epoch_ns=1)
    assert (received.x_of("robot"), received.taken_over) == (2, [])


def test_a_host_without_a_clock_battery_may_restart(received: Received) -> None:
    """After its token was lost an earlier epoch is new too: its clock went back."""
    appear(received.stream)
    received.send(at(1, "robot", 9 * S), epoch_ns=2)
    received.stream.vanish()
    appear(received.stream)
    received.send(at(2, "robot", 1 * S), epoch_ns=1)
    assert received.x_of("robot") == 2
    assert received.stream.counts.outdated == 0


def test_statics_of_an_earlier_epoch_follow_its_first_dynamic_message(received: Received) -> None:
    """If that message comes before its token, the set of the process before does not stay."""
    appear(received.stream)
    received.send_static(at(1, "post"), epoch_ns=2)
    received.stream.vanish()
    received.send(at(2, "robot", 1 * S), epoch_ns=1)
    appear(received.stream)
    received.describe("post", "robot", epoch_ns=1)
    received.send_static(at(2, "post"), epoch_ns=1)
    assert received.x_of("post") == 2


def test_a_publisher_that_was_heard_again_keeps_its_epoch(received: Received) -> None:
    """A link that was down for a while does not make earlier epochs new."""
    received.send(at(1, "robot", 9 * S), epoch_ns=2)
    received.stream.vanish()
    appear(received.stream)
    received.send(at(2, "robot", 10 * S), epoch_ns=2)
    received.send(at(3, "robot", 11 * S), epoch_ns=1)
    assert received.x_of("robot") == 2
    assert received.stream.counts.outdated == 1


def test_statics_outlive_a_jump_of_the_clock(received: Received) -> None:
    """A stream that restarts since its clock went back need not send its statics again."""
    received.send_static(at(1, "post"), epoch_ns=1)
    received.send(at(1, "robot"), epoch_ns=2)
    received.stream.describe(2, frozenset({"post", "robot"}), frozenset({"post"}))
    assert received.x_of("post") == 1
    assert received.gone() == [] and not received.stream.statics.are_lacking()
    late = Received()
    late.send(at(1, "robot"), epoch_ns=2)
    late.send_static(at(1, "post"), epoch_ns=1)
    assert late.x_of("post") == 1


def test_a_static_that_is_no_longer_in_the_set_is_removed(received: Received) -> None:
    """Each message of statics is the whole set: what is missing was removed."""
    received.send_static(at(1, "post"), at(2, "lamp"))
    received.send_static(at(3, "post"))
    assert received.buffer.frames() == ["post", "world"]
    assert received.x_of("post") == 3


def test_a_static_frame_that_becomes_dynamic_is_not_removed(received: Received) -> None:
    """A frame that leaves the set because it is dynamic now stays."""
    received.send_static(at(1, "post"), at(2, "door"))
    received.send(at(3, "door"))
    received.send_static(at(1, "post"))
    assert received.x_of("door") == 3


def test_a_frame_that_is_no_longer_described_is_removed(received: Received) -> None:
    """A frame that leaves the description of the same epoch was removed by its publisher."""
    received.send(at(1, "robot"), at(2, "arm"))
    received.describe("robot", "arm")
    received.describe("robot")
    assert received.buffer.frames() == ["robot", "world"]


def test_a_frame_that_is_removed_as_the_clock_goes_back_is_removed() -> None:
    """A frame that the same process no longer lists is removed; that of another is gone."""
    same, other = ("/sim", 7, "ab12"), ("/sim", 8, "cd34")
    for publisher, frames in ((same, ["robot", "world"]), (other, ["arm", "robot", "world"])):
        received = Received()
        received.stream.describe(1, frozenset({"robot", "arm"}), publisher=same)
        received.send(at(1, "robot"), at(2, "arm"))
        received.send(at(1, "robot"), epoch_ns=2)
        received.stream.describe(2, frozenset({"robot"}), publisher=publisher)
        assert received.buffer.frames() == frames
        assert received.gone() == frames[:-2]


def test_a_frame_that_another_sends_now_is_not_removed(received: Received) -> None:
    """Only the publisher that sent a frame last removes it."""
    received.send(at(1, "robot"))
    received.describe("robot")
    received.buffer.set_transform(at(5, "robot", 2 * S), authority="other")
    received.describe()
    assert received.x_of("robot") == 5


def test_all_frames_of_a_stream_go_and_come_with_its_token(received: Received) -> None:
    """While the publisher is gone, dynamic and static frames are marked, and stay usable."""
    appear(received.stream)
    received.send(at(1, "robot"))
    received.send_static(at(2, "post"))
    received.describe("robot", "post")
    received.stream.vanish()
    assert received.gone() == ["post", "robot"]
    assert (received.x_of("robot"), received.x_of("post")) == (1, 2)
    appear(received.stream)
    assert received.gone() == []


def test_frames_that_no_list_names_are_back_with_the_first_message(received: Received) -> None:
    """A token alone may be that of another process, which sends other frames."""
    appear(received.stream)
    received.send(at(1, "robot"), at(2, "arm"))
    received.stream.vanish()
    appear(received.stream)
    assert received.gone() == ["arm", "robot"]
    received.send(at(1, "robot", 2 * S))
    assert received.gone() == []


def test_no_frame_is_back_in_the_middle_of_a_restart(received: Received) -> None:
    """Marks that are set before the former samples are dropped bring no frame back."""
    received.send(at(1, "robot"), at(2, "arm"))
    received.describe("robot", "arm")
    received.stream.vanish()
    back: list[str] = []
    received.buffer.on_change(
        lambda change: back.append(change.frame) if change.kind == "publisher back" else None
    )

    class Late:
        """The buffer, which another thread reaches before the samples are dropped."""

        def forget(self, *args: Any) -> None:
            received.stream.marks.update()
            received.buffer.forget(*args)

        def __getattr__(self, name: str) -> Any:
            return getattr(received.buffer, name)

    received.stream.buffer = Late()  # type: ignore[assignment]
    received.send(at(1, "robot", 2 * S), epoch_ns=2)
    assert back == ["robot"]


def test_a_late_message_does_not_bring_a_publisher_back(received: Received) -> None:
    """Frames of a message that comes after the publisher is gone are marked as gone too."""
    appear(received.stream)
    received.send(at(1, "robot"))
    received.stream.vanish()
    received.send(at(2, "robot", 2 * S), at(2, "arm", 2 * S))
    assert received.gone() == ["arm", "robot"]


def test_frames_that_a_new_process_does_not_send_are_gone(received: Received) -> None:
    """Frames that only the former process sent are gone, not removed; new ones are not gone."""
    received.send(at(1, "robot"), at(2, "arm"))
    received.send_static(at(3, "post"), at(4, "lamp"))
    received.describe("robot", "arm", "post", "lamp")
    received.send(at(1, "robot", 2 * S), epoch_ns=2)
    received.send_static(at(3, "post"), epoch_ns=2)
    received.describe("post", epoch_ns=2)
    assert received.gone() == ["arm", "lamp"]
    assert received.x_of("lamp") == 4
    received.send(at(1, "arm", 2 * S), epoch_ns=2)
    assert received.gone() == ["lamp"]
    received.describe("post", "robot", "arm", epoch_ns=2)
    assert received.gone() == ["lamp"]


def test_a_set_of_the_former_process_that_comes_late_is_of_gone_frames(received: Received) -> None:
    """A frame that the present process does not list is gone, though it comes after the list."""
    received.describe("post", epoch_ns=2)
    received.send_static(at(3, "post"), at(4, "lamp"), epoch_ns=1)
    assert received.gone() == ["lamp"]
    received.send_static(at(3, "post"), epoch_ns=2)
    assert received.gone() == ["lamp"]


def test_what_a_new_process_has_not_sent_yet_stays_gone(received: Received) -> None:
    """Before the new process has described itself, only what it sends is back."""
    received.send(at(1, "robot"), at(2, "arm"))
    received.send_static(at(3, "post"))
    received.describe("robot", "arm", "post")
    received.stream.vanish()
    received.send(at(1, "robot", 2 * S), epoch_ns=2)
    assert received.gone() == ["arm", "post"]
    received.send_static(at(3, "post"), epoch_ns=2)
    assert received.gone() == ["arm"]


def test_kept_messages_fill_the_past(received: Received) -> None:
    """Kept messages go below those that came meanwhile, and are no misses."""
    received.send(at(5, "robot", 5 * S), seq=50)
    for stamp in (3, 4, 5):
        received.stream.receive_kept(payload([at(stamp, "robot", stamp * S)], seq=stamp))
    received.send(at(6, "robot", 6 * S), seq=51)
    xyz = received.buffer.lookup_transforms("world", "robot", [3 * S, 4 * S, 5 * S, 6 * S]).xyz
    assert xyz[:, 0].tolist() == [3, 4, 5, 6]
    assert received.stream.counts.missed == 0
    assert received.buffer.frame("robot").conflicts == 0


def test_kept_messages_do_not_bring_a_removed_frame_back(received: Received) -> None:
    """A frame that is no longer listed is left out of kept messages."""
    received.describe("robot", "arm")
    received.describe("robot")
    received.stream.receive_kept(payload([at(1, "robot"), at(2, "arm")]))
    assert received.buffer.frames() == ["robot", "world"]
    received.describe("robot", "arm")
    received.stream.receive_kept(payload([at(1, "robot"), at(2, "arm")]))
    assert received.buffer.frames() == ["arm", "robot", "world"]


def test_a_removed_frame_may_be_back_in_the_next_epoch(received: Received) -> None:
    """A frame that was removed in one epoch is taken in the next."""
    received.describe("robot", "arm")
    received.describe("robot")
    received.stream.receive_kept(payload([at(1, "arm")], epoch_ns=2))
    assert received.buffer.frames() == ["arm", "world"]


def test_kept_messages_may_be_faster_than_the_list_of_frames(received: Received) -> None:
    """Kept messages of a frame that the stream has not listed so far are taken."""
    received.describe()
    received.stream.receive_kept(payload([at(1, "robot")]))
    received.describe("robot")
    assert received.buffer.frames() == ["robot", "world"]


def test_frames_of_a_publisher_with_priority_are_left_out(received: Received) -> None:
    """Rows of rejected frames are counted, and not taken."""
    received.stream.contest.exclude(set(), {"arm"})
    received.send(at(1, "robot"), at(2, "arm"))
    assert received.buffer.frames() == ["robot", "world"]
    assert received.stream.counts.excluded == 1
    received.stream.contest.exclude({"arm"}, set())
    received.send(at(1, "robot", 2 * S), at(2, "arm", 2 * S))
    assert received.x_of("arm") == 2
    assert received.stream.counts.excluded == 1


def test_a_bad_message_is_counted_and_harms_nothing(received: Received) -> None:
    """Bytes that are no message are counted, whatever the key."""
    received.key.receive(b"nonsense")
    received.stream.statics.receive(b"nonsense")
    received.stream.receive_kept(b"")
    assert received.stream.counts.rejected == 3
    assert received.buffer.frames() == []


def test_streams_of_made_up_names_do_not_hide_the_line_of_a_confirmed_one(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """They fill the log of strangers; a stream that its publisher has confirmed has another."""
    log = logging.getLogger("test")
    around = ReceptionHooks(log)
    around.once, around.once_of_unconfirmed = LogOnce(log, most=10), LogOnce(log, most=10)

    def stream(name: str) -> StreamReception:
        return StreamReception(
            name,
            Buffer(),
            log,
            lambda: 9 * S,
            TransformReader(),
            around=around,
        )

    for number in range(1000):
        stream(f"made_up_{number}").receive_kept(b"bad")
    assert len(caplog.messages) == 11
    honest = stream("sim")
    honest.describe(1, frozenset({"robot"}), publisher=("/sim", 7, "ab12"), confirmed=True)
    honest.receive_kept(b"bad")
    honest.vanish()
    honest.receive_kept(b"bad")
    (line,) = caplog.messages[11:]
    assert line.startswith("Dropped ") and "stream 'sim'" in line


def test_listed_statics_that_have_not_come_are_lacking(received: Received) -> None:
    """A stream that is not gone lacks statics that have not come, or may have changed."""
    stream = received.stream
    assert not stream.statics.are_lacking()
    stream.describe(1, frozenset({"robot", "post", "lamp"}), frozenset({"post", "lamp"}))
    assert stream.statics.are_lacking()
    received.send_static(at(1, "post"))
    assert stream.statics.are_lacking()
    received.send_static(at(1, "post"), at(2, "lamp"))
    assert not stream.statics.are_lacking()
    stream.vanish()
    assert not stream.statics.are_lacking()
    appear(stream)
    assert stream.statics.are_lacking()
    received.send_static(at(1, "post"), at(2, "lamp"))
    assert not stream.statics.are_lacking()


def test_the_set_of_a_former_process_is_lacking_until_that_of_the_next_comes(
    received: Received,
) -> None:
    """Three publish the stream, and list the same: the sets of the first two are not that of the
    last, also where they come again, or late, until it has sent its own.
    """
    stream, frames = received.stream, frozenset({"post"})
    received.send_static(at(1, "post"))
    stream.describe(1, frames, frames, ("/sim", 1, "a"), confirmed=True)
    assert not stream.statics.are_lacking()
    stream.describe(3, frames, frames, ("/sim", 3, "c"), confirmed=True)
    for number in (1, 2):
        received.send_static(at(number, "post"), epoch_ns=number)
        assert stream.statics.are_lacking()
    received.send_static(at(3, "post"), epoch_ns=3)
    assert (stream.statics.are_lacking(), received.x_of("post")) == (False, 3)


def test_a_late_set_is_lacking_of_the_first_process_that_a_listener_meets(
    received: Received,
) -> None:
    """The process of the set has ended before the listener began."""
    stream, frames = received.stream, frozenset({"post"})
    stream.describe(2, frames, frames, ("/sim", 2, "b"), confirmed=True)
    received.send_static(at(1, "post"), epoch_ns=1)
    assert stream.statics.are_lacking()
    received.send_static(at(2, "post"), epoch_ns=2)
    assert not stream.statics.are_lacking()


def test_a_set_of_statics_that_comes_late_does_not_replace_a_newer_one(received: Received) -> None:
    """By their numbers, an older set that was asked for is not taken for the last."""
    for x, seq in ((2, 2), (1, 1)):
        received.stream.statics.receive(payload([at(x, "post")], seq=seq))
    assert received.x_of("post") == 2


def test_a_new_set_of_statics_is_not_in_its_own_way(received: Received) -> None:
    """Frames of a set that trade places, or that it no longer has, do not refuse the others."""
    received.send_static(at(1, "base"), at(1, "arm", parent="base"))
    received.send_static(at(2, "arm"), at(2, "base", parent="arm"))
    assert (received.x_of("arm"), received.x_of("base")) == (2.0, 4.0)
    received.send_static(at(3, "world", parent="base"))
    assert received.buffer.path("base", "world") == ["world", "base"]


@pytest.mark.parametrize("end", ["gone", "removed"])
def test_refused_statics_are_taken_when_what_is_in_the_way_ends(
    received: Received, end: str
) -> None:
    """They count once the other edge's publisher is gone or removes it: they are not sent again."""
    buffer = received.buffer
    buffer.set_transform(at(1, "world", parent="base"), static=True, authority="wrong")
    received.send_static(at(2, "base"), at(3, "post"))
    assert (received.x_of("post"), buffer.frame("world").authority) == (3.0, "wrong")
    if end == "gone":
        buffer.mark_gone(["world"], True, "wrong")
    else:
        buffer.remove_sent(["world"], "wrong")
    assert received.x_of("base") == 2.0
    assert buffer.frame("world").parent is None


class MeanwhileBuffer(Buffer):
    """Lets something happen between the judgement of the first rows and their way into it."""

    happens: Callable[[], None] | None = None

    def set_transforms(self, batch: Any, **how: Any) -> int:
        """As of any buffer."""
        happens, self.happens = self.happens, None
        if happens is not None:
            happens()
        return super().set_transforms(batch, **how)


def test_rows_of_an_epoch_that_ends_under_way_are_not_stored() -> None:
    """Neither alone nor behind those of the next epoch; the message counts as outdated."""
    received = Received(MeanwhileBuffer())
    received.send(at(1, "robot"), epoch_ns=1)
    received.buffer.happens = lambda: received.send(at(2, "robot", 2 * S), epoch_ns=2)
    received.send(at(3, "robot", 3 * S), at(3, "arm", 3 * S), epoch_ns=1)
    assert (received.x_of("robot"), received.x_of("arm")) == (2, None)
    assert received.buffer.sent_by("sim") == {"robot": 1}
    counts = received.stream.counts
    assert (counts.messages, counts.outdated) == (2, 1)


def test_a_kept_frame_that_is_removed_under_way_is_not_stored() -> None:
    """Its list without the frame comes while the message is judged."""
    received = Received(MeanwhileBuffer())
    received.describe("robot", "arm")
    received.buffer.happens = lambda: received.describe("robot")
    received.stream.receive_kept(payload([at(1, "robot"), at(2, "arm")], 1))
    assert (received.x_of("robot"), received.x_of("arm")) == (1, None)
    assert received.stream.counts.messages == 1


def test_a_list_that_comes_while_frames_are_marked_is_not_undone(received: Received) -> None:
    """The marks by the list before it are on their way."""
    received.send(at(1, "robot"), at(1, "arm"), epoch_ns=1)
    received.send(at(2, "robot", 2 * S), epoch_ns=2)
    marks: Any = received.stream.marks
    find = marks._find_left_behind

    def find_slowly(held: dict[str, int]) -> frozenset[str]:
        marks._find_left_behind = find
        found: frozenset[str] = find(held)
        assert found == {"arm"}
        received.describe("robot", "arm", epoch_ns=2)
        return found

    marks._find_left_behind = find_slowly
    received.describe("robot", epoch_ns=2)
    assert received.gone() == []


def test_a_set_of_statics_is_stored_though_an_epoch_ends_under_way() -> None:
    """Static transforms hold in all epochs."""
    received = Received(MeanwhileBuffer())
    received.send(at(1, "robot"), epoch_ns=1)
    received.buffer.happens = lambda: received.send(at(2, "robot", 2 * S), epoch_ns=2)
    received.send_static(at(3, "post"), epoch_ns=1)
    assert (received.x_of("robot"), received.x_of("post")) == (2, 3)
