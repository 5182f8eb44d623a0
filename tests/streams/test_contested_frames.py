"""Frames that several streams send, as a listener receives them, step by step."""

import logging
from typing import Any

import pytest

from tests.builders import S, at, payload
from tfbus import Buffer
from tfbus.streams.conflicts import Conflicts, Rule
from tfbus.streams.reception import DynamicReception, StreamReception
from tfbus.streams.stream_facts import ReceptionHooks
from tfbus.wire.descriptions import StreamDescription
from tfbus.wire.transforms import TransformReader


class Deciding(ReceptionHooks):
    """Decides at once by the conflicts of both streams."""

    def __init__(self, received: "Received") -> None:
        super().__init__(logging.getLogger("test"))
        self._received = received

    def claimed_by_others(self, stream: str, children: frozenset[str]) -> frozenset[str]:
        return self._received.conflicts.claimed_by_others(stream, children)

    def on_overlap(self, stream: str, frames: frozenset[str]) -> None:
        self._received.conflicts.restore(stream, frames)


class Received:
    """The streams "a" and "b", or others, in one buffer; "a" was started first."""

    def __init__(self, rule: Rule, buffer: Buffer | None = None, names: str = "ab") -> None:
        self.buffer = Buffer() if buffer is None else buffer
        log = logging.getLogger("test")
        self.streams = {
            name: StreamReception(
                name,
                self.buffer,
                log,
                lambda: 0,
                TransformReader(),
                around=Deciding(self),
            )
            for name in names
        }
        self.epochs = {name: number for number, name in enumerate(names, 1)}
        self.conflicts = Conflicts(rule, self.buffer, self.streams.get, log)
        self._sent = 0

    def send_static(self, stream: str, **x_of: float) -> None:
        self._sent += 1
        self.streams[stream].statics.receive(self._payload(stream, self._sent, x_of))

    def send(self, stream: str, **x_of: float) -> None:
        key = DynamicReception(self.streams[stream])
        key.receive(self._payload(stream, 0, x_of))

    def _payload(self, stream: str, seq: int, x_of: dict[str, float]) -> bytes:
        epoch_ns = self.epochs[stream]
        return payload([at(x, child, epoch_ns) for child, x in x_of.items()], epoch_ns, seq)

    def describe(self, stream: str, *children: str) -> None:
        """The stream lists these static frames."""
        rows = tuple(("world", child, True) for child in children)
        epoch = self.epochs[stream]
        self.streams[stream].describe(epoch, frozenset(children), frozenset(children))
        self.conflicts.judge(stream, StreamDescription(1, f"/{stream}", epoch, rows))

    def lose(self, stream: str) -> None:
        """The token of the stream is lost."""
        self.streams[stream].vanish()
        self.conflicts.judge(stream, None)

    def held(self, child: str) -> tuple[float, str, bool]:
        """Where a frame is, its authority, and whether it is gone."""
        frame = self.buffer.frame(child)
        x = self.buffer.lookup_transform("world", child).transform.x
        return x, frame.authority, frame.gone


@pytest.fixture
def both(rule: Rule) -> Received:
    """Both streams send the static frames `camera` and `lamp`, at 1 and at 2 m, "b" last."""
    received = Received(rule)
    for stream, x in (("a", 1.0), ("b", 2.0)):
        received.send_static(stream, camera=x, lamp=x)
        received.describe(stream, "camera", "lamp")
    return received


@pytest.mark.parametrize(
    ("rule", "winner", "other"),
    [("latest", "b", ("a", 1.0)), ("first", "a", ("b", 2.0)), ("priority", "a", ("b", 2.0))],
)
@pytest.mark.parametrize("order", ["static first", "description first"])
def test_a_static_frame_that_one_of_two_removes_is_the_others(
    both: Received, winner: str, other: tuple[str, float], order: str
) -> None:
    """Under every rule it is then where the other has it; other frames are as before."""
    before = both.held("lamp")
    assert before[1] == winner
    if order == "static first":
        both.send_static(winner, lamp=before[0])
        both.describe(winner, "lamp")
    else:
        both.describe(winner, "lamp")
        both.send_static(winner, lamp=before[0])
    name, x = other
    assert both.held("camera") == (x, name, False)
    assert both.held("lamp") == before


@pytest.mark.parametrize(
    ("rule", "winner", "other"),
    [("latest", "b", ("a", 1.0)), ("first", "a", ("b", 2.0)), ("priority", "a", ("b", 2.0))],
)
def test_a_static_frame_of_a_gone_publisher_is_the_others(
    both: Received, winner: str, other: tuple[str, float]
) -> None:
    """Under every rule the static transform of a live publisher replaces that of a gone one."""
    both.lose(winner)
    name, x = other
    assert both.held("camera") == (x, name, False)
    assert both.held("lamp") == (x, name, False)


@pytest.mark.parametrize("rule", ["first", "priority"])
@pytest.mark.parametrize("is_static", [True, False])
def test_a_frame_that_is_rejected_while_it_is_sent_is_not_kept(rule: Rule, is_static: bool) -> None:
    """A transform on its way into the buffer is dropped when another publisher gets priority."""

    class LateBuffer(Buffer):
        """Takes transforms of "b" only after "a" has got priority."""

        def set_transforms(self, batch: Any, **how: Any) -> int:
            if how["authority"] == "b" and not received.streams["b"].contest.excluded:
                received.describe("b", "camera")
            return super().set_transforms(batch, **how)

    received = Received(rule, LateBuffer())
    received.send_static("a", camera=1.0)
    received.describe("a", "camera")
    send = received.send_static if is_static else received.send
    send("b", camera=2.0, lamp=2.0)
    assert received.held("camera") == (1.0, "a", False)
    assert received.held("lamp") == (2.0, "b", False)


@pytest.mark.parametrize("rule", ["latest", "first", "priority"])
@pytest.mark.parametrize("is_static", [True, False])
@pytest.mark.parametrize("is_described", [True, False])
def test_a_static_frame_that_is_listed_comes_back_from_one_that_does_not_list_it(
    rule: Rule, is_static: bool, is_described: bool
) -> None:
    """Also where the other sent it before it was known that it is listed."""
    received = Received(rule)
    if is_described:
        received.describe("b", "other")
    received.send_static("a", camera=1.0)
    (received.send_static if is_static else received.send)("b", camera=2.0, bolt=2.0)
    assert received.held("camera")[:2] == (2.0, "b")
    received.describe("a", "camera")
    assert received.held("camera") == (1.0, "a", False)
    assert received.held("bolt") == (2.0, "b", False)
    (received.send_static if is_static else received.send)("b", camera=3.0, bolt=3.0)
    assert received.held("camera") == (1.0, "a", False)
    assert received.held("bolt") == (3.0, "b", False)


@pytest.mark.parametrize("rule", ["latest", "first", "priority"])
@pytest.mark.parametrize("is_static", [True, False])
@pytest.mark.parametrize("ahead_s", [0, 3600])
def test_a_dynamic_frame_that_is_listed_is_taken_with_the_next_message(
    rule: Rule, is_static: bool, ahead_s: int
) -> None:
    """It is never missing meanwhile, and nothing that the other sent of it stays."""
    received = Received(rule)
    received.send("a", robot=1.0)
    received.epochs["b"] += ahead_s * S
    (received.send_static if is_static else received.send)("b", robot=2.0)
    received.describe("a", "robot")
    assert received.held("robot") == (2.0, "b", False)
    received.send("a", robot=1.0)
    assert received.held("robot") == (1.0, "a", False)
    assert received.buffer.sent_by("a") == {"robot": 1}


@pytest.mark.parametrize("rule", ["latest", "first", "priority"])
def test_a_static_frame_that_one_no_longer_lists_but_sends_late_is_the_others(rule: Rule) -> None:
    """Of the list and the set either may be the older one."""
    received = Received(rule)
    for stream, x in (("b", 2.0), ("a", 1.0)):
        received.send_static(stream, camera=x)
        received.describe(stream, "camera")
    received.describe("b")
    received.send_static("b", camera=3.0)
    received.send_static("b", bolt=3.0)
    assert received.held("camera") == (1.0, "a", False)


@pytest.mark.parametrize("rule", ["latest", "first", "priority"])
def test_a_static_frame_that_is_listed_late_is_where_it_was_sent_last(rule: Rule) -> None:
    """Also where an older pose of its own is there, and another listed it in between."""
    received = Received(rule)
    received.describe("a", "lamp")
    received.send_static("a", lamp=1.0, camera=1.0)
    received.describe("b", "camera")
    received.send_static("a", lamp=1.0, camera=2.0)
    assert received.held("camera") == (1.0, "a", False)
    received.describe("a", "lamp", "camera")
    assert received.held("camera") == (2.0, "a", False)


@pytest.mark.parametrize("rule", ["latest", "first", "priority"])
def test_a_frame_that_is_listed_while_it_is_sent_is_not_lost(rule: Rule) -> None:
    """The lists of both streams come while the frame goes into the buffer."""

    class BusyBuffer(Buffer):
        def set_transforms(self, batch: Any, **how: Any) -> int:
            stored = super().set_transforms(batch, **how)
            if how["authority"] == "a" and not lists:
                lists.append("both")
                received.describe("b", "camera")
                received.describe("a", "camera")
            return stored

    lists: list[str] = []
    received = Received(rule, BusyBuffer())
    received.send_static("b", camera=2.0)
    received.send_static("a", camera=1.0)
    assert received.held("camera")[0] in ({1.0, 2.0} if rule == "latest" else {1.0})


def test_a_list_has_nothing_judged_again_that_was_not_sent_since_the_last() -> None:
    """A list of another stream takes the permit of one that sent a frame of the list which it does
    not list; the lists that come before its next message do not.
    """
    received = Received("first")
    facts = received.streams["b"].facts
    received.send("b", lamp=1.0)
    before = facts.permit
    received.describe("a", "lamp")
    after = facts.permit
    received.describe("a", "camera")
    assert not before.is_valid
    assert facts.permit is after
    received.send("b", lamp=2.0)
    received.describe("a", "lamp")
    assert not after.is_valid


def test_a_list_has_only_streams_judged_again_that_sent_its_frames() -> None:
    """When many streams come back at once, and send before they are described, the list of each
    costs the others nothing; that of a frame which some sent concerns these, and for a frame of any
    earlier message too.
    """
    names = "abcdefghijklmnopqrstuvwxyz"
    received = Received("latest", names=names)
    streams = received.streams

    def judged_again(stream: str, *children: str) -> list[str]:
        before = {name: streams[name].facts.permit for name in names}
        received.describe(stream, *children)
        return [name for name in names if not before[name].is_valid]

    for name in names:
        for other in names:
            received.send(other, **{f"{other}_robot": 1.0})
        assert judged_again(name, f"{name}_robot") == []
    received.send("b", lamp=1.0)
    received.send("c", lamp=1.0)
    received.send("c", bolt=1.0)
    assert judged_again("a", "a_robot", "lamp") == ["b", "c"]
    assert judged_again("a", "a_robot", "lamp") == []


def test_a_list_after_questions_without_end_has_all_judged_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Beyond a bound it is not remembered which stream asked for which frame: nothing is missed."""
    monkeypatch.setattr("tfbus.streams.conflicts._MOST_ASKED", 3)
    received = Received("latest", names="abc")
    for number in range(5):
        received.send("b", **{f"b{number}": 1.0})
    received.send("c", lamp=1.0)
    before = {name: received.streams[name].facts.permit for name in "bc"}
    received.describe("a", "b0")
    assert not before["b"].is_valid
    received.send("b", b0=2.0)
    assert received.buffer.frame("b0").authority == "b"
    received.send_static("a", b0=3.0)
    assert received.held("b0")[:2] == (3.0, "a")


@pytest.mark.parametrize("rule", ["latest", "first", "priority"])
def test_a_stream_that_was_forgotten_leaves_the_frames_to_the_others(rule: Rule) -> None:
    """As one is that takes too much memory."""
    received = Received(rule)
    for stream, x in (("a", 1.0), ("b", 2.0)):
        received.send_static(stream, camera=x)
        received.describe(stream, "camera")
    received.streams.pop("b")
    received.buffer.remove_sent(["camera"], "b")
    received.conflicts.judge("b", None)
    assert received.held("camera") == (1.0, "a", False)


@pytest.mark.parametrize("rule", ["latest", "first", "priority"])
@pytest.mark.parametrize("is_static", [True, False])
def test_each_list_is_heeded_from_the_next_message_on(rule: Rule, is_static: bool) -> None:
    """Though messages before it with the very same frames were taken, or dropped."""
    received = Received(rule)

    def x_of_camera_sent(x: float) -> float:
        (received.send_static if is_static else received.send)("b", camera=x, bolt=x)
        assert received.held("bolt")[0] == x
        return received.held("camera")[0]

    assert [x_of_camera_sent(x) for x in (2.0, 3.0)] == [2.0, 3.0]
    received.send_static("a", camera=1.0)
    received.describe("a", "camera")
    assert [x_of_camera_sent(x) for x in (4.0, 5.0)] == [1.0, 1.0]
    received.describe("a", "lamp")
    assert [x_of_camera_sent(x) for x in (6.0, 7.0)] == [6.0, 7.0]
    received.describe("a", "lamp", "camera")
    received.describe("b", "camera", "bolt")
    x_of_camera_sent(8.0)
    assert x_of_camera_sent(9.0) == (9.0 if rule == "latest" else 1.0)
    received.lose("a")
    assert [x_of_camera_sent(x) for x in (10.0, 11.0)] == [10.0, 11.0]
