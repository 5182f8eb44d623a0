"""How far the clocks of other nodes are from ours, by the four times of NTP; warnings."""

import logging
import threading
import time
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.buses import DEADLINE_S, eventually
from tests.simulated_bus import Bus
from tfbus import (
    Buffer,
    Node,
    Transform,
    TransformBroadcaster,
    TransformListener,
    TransformStamped,
)
from tfbus.base import scheduler
from tfbus.bus.query import Answer
from tfbus.bus.settings import NodeSettings
from tfbus.streams.clock_offset import ClockOffset, ClockOffsets, measured
from tfbus.streams.info import StreamInfo
from tfbus.wire.codec import encode_map
from tfbus.wire.descriptions import StreamDescription
from tfbus.wire.keys import clock_key

MS = 1_000_000
SECOND = 1_000_000_000


def test_a_clock_that_is_ahead() -> None:
    """Asked at 10 s, there at 15 s by its clock, answered at once, back at 12 s: 4 s ahead."""
    assert measured(10 * SECOND, 15 * SECOND, 15 * SECOND, 12 * SECOND) == ClockOffset(4.0, 2.0)


def test_the_time_before_the_answer_is_not_on_the_way() -> None:
    """How long the other node takes to answer changes neither offset nor round trip."""
    assert measured(10 * SECOND, 15 * SECOND, 18 * SECOND, 15 * SECOND) == ClockOffset(4.0, 2.0)


@settings(deadline=None)
@given(
    offset=st.integers(-(10**12), 10**12),
    there=st.integers(0, 10**9),
    thinking=st.integers(0, 10**9),
    back=st.integers(0, 10**9),
)
def test_the_offset_is_known_to_half_of_the_round_trip(
    offset: int, there: int, thinking: int, back: int
) -> None:
    """For any two ways the error is at most half of both together."""
    asked = 1_700_000_000 * SECOND
    received = asked + there + offset
    found = measured(asked, received, received + thinking, asked + there + thinking + back)
    assert found.round_trip_s == pytest.approx((there + back) / 1e9)
    assert abs(found.offset_s - offset / 1e9) <= found.round_trip_s / 2 + 1e-9


@pytest.mark.parametrize(
    ("offset_s", "round_trip_s", "is_skewed"),
    [(0.09, 0.001, False), (-0.2, 0.001, True), (0.2, 0.001, True), (0.2, 0.5, False)],
)
def test_a_skew_worth_a_warning(offset_s: float, round_trip_s: float, is_skewed: bool) -> None:
    """A clock is skewed that is off by more than 100 ms and more than the round trip."""
    assert ClockOffset(offset_s, round_trip_s).is_skewed is is_skewed


def publish() -> None:
    """A program that publishes one frame with stamps of its host's clock."""
    with Node("robot") as node:
        broadcaster = TransformBroadcaster(node)

        def send() -> None:
            broadcaster.send_transform(
                TransformStamped(node.now_ns(), "odom", "base", Transform.identity())
            )

        node.create_timer(0.05, send)
        node.spin()


def start_robot(bus: Bus, ahead_s: float) -> None:
    """A publisher on a host of its own, whose clock is `ahead_s` ahead of ours."""
    host = bus.network.host("robot", offset_s=ahead_s)
    bus.network.program(host, publish).wait_for_line("ready")


def robot(listener: TransformListener) -> StreamInfo | None:
    """The listener's report of the robot, once its clock is measured."""
    infos = (info for info in listener.streams() if info.clock_offset_s is not None)
    return next((info for info in infos if info.name == "robot"), None)


@pytest.mark.parametrize(
    ("ahead_s", "said"),
    [
        (2.5, " is 2[.]\\d{3} s ahead of ours .* return where its frames were that long ago"),
        (-2.5, " is 2[.]\\d{3} s behind ours .* wait that long, or fail"),
    ],
)
def test_a_listener_warns_of_a_clock_that_is_off(bus: Bus, ahead_s: float, said: str) -> None:
    """Each listener knows how far a publisher's clock is from its own, and warns of it once."""
    start_robot(bus, ahead_s)
    echo = bus.start("echo", "odom", "base", "--rate", "50")
    node = bus.node("here")
    with TransformListener(Buffer(), node) as listener:
        info = eventually(lambda: robot(listener))
    assert info.clock_offset_s == pytest.approx(ahead_s, abs=0.25)
    echo.wait_for_line(f"The clock of /robot on host {info.host}{said}")
    assert echo.stop() == 0
    assert len([line for line in echo.err if "The clock of" in line]) == 1


def test_clocks_that_agree_are_not_warned_of(bus: Bus) -> None:
    """On one host the offset is nearly 0, and no warning is logged."""
    start_robot(bus, 0.0)
    echo = bus.start("echo", "odom", "base", "--rate", "50")
    with TransformListener(Buffer(), bus.node("here")) as listener:
        info = eventually(lambda: robot(listener))
    assert info.clock_offset_s == pytest.approx(0.0, abs=0.1)
    echo.wait_for_line("Translation")
    assert echo.stop() == 0
    assert not [line for line in echo.err if "The clock of" in line]


def test_the_clock_of_the_own_node_is_not_off(bus: Bus) -> None:
    """Streams of the listener's own node have its own clock."""
    node = bus.node("robot")
    with TransformListener(Buffer(), node) as listener:
        TransformBroadcaster(node).send_transform(
            TransformStamped(node.now_ns(), "odom", "base", Transform())
        )
        assert eventually(lambda: robot(listener)).clock_offset_s == 0.0


def test_a_stream_of_a_new_process_has_its_clock(bus: Bus) -> None:
    """Where a stream comes from another session, the former one is no longer measured."""
    node = bus.node("listener")
    offsets = ClockOffsets(node.session, node.log)
    former, later = bus.node("former"), bus.node("later")
    for robot in (former, later):
        session = robot.session.id
        key = clock_key(robot.name)
        eventually(lambda key=key: list(node.session.ask(key)))
        description = StreamDescription(1, robot.full_name, 1, (), session=session)
        offsets.watch("robot", description)
        eventually(lambda session=session: offsets.last_of(session))
    assert offsets.last_of(former.session.id) is None
    offsets.forget("robot")
    assert offsets.last_of(later.session.id) is None
    offsets.close()


def test_a_node_that_joins_is_measured_at_once(bus: Bus, monkeypatch: pytest.MonkeyPatch) -> None:
    """Though the nodes before it are due in half a minute only."""
    node, asked = bus.node("listener"), list[str]()
    ask_later = node.session.ask_later

    def noted(key: str, *given: Any, **more: Any) -> None:
        if key in (clock_key("first"), clock_key("second")):
            asked.append(key)
        ask_later(key, *given, **more)

    monkeypatch.setattr(node.session, "ask_later", noted)
    offsets = ClockOffsets(node.session, node.log)
    for robot in (bus.node("first"), bus.node("second")):
        key, session = clock_key(robot.name), robot.session.id
        eventually(lambda key=key: list(node.session.ask(key)))
        asked.clear()
        begun_s = scheduler.monotonic()
        offsets.watch(robot.name, StreamDescription(1, robot.full_name, 1, (), session=session))
        eventually(lambda session=session: offsets.last_of(session))
        assert scheduler.monotonic() - begun_s < 10.0
        assert set(asked) == {key}
        # From then on it rests.
        asked.clear()
        rests_s = scheduler.monotonic() + 1.0
        eventually(lambda rests_s=rests_s: scheduler.monotonic() > rests_s)
        assert asked == []
    offsets.close()


class SilentSession:
    """A session on which no query is ever answered, or ended."""

    id = "own"
    settings = NodeSettings("listener")

    def __init__(self) -> None:
        self.is_asked = threading.Event()

    def ask_later(self, *_: object, **__: object) -> None:
        self.is_asked.set()


def test_the_end_of_measuring_leaves_no_thread() -> None:
    """One that were still in Zenoh when Python shuts down would abort the process."""
    session = SilentSession()
    offsets = ClockOffsets(session, logging.getLogger("test"))  # type: ignore[arg-type]
    offsets.watch("sim", StreamDescription(1, "/sim", 1, (), session="theirs"))
    assert session.is_asked.wait(DEADLINE_S)
    offsets.close()
    assert all(thread.name != "clock offsets" for thread in threading.enumerate())


class SteppedSession(SilentSession):
    """A session whose host's clock is set back by 2 s while the first answer is on its way."""

    def __init__(self) -> None:
        super().__init__()
        self.back_ns = 0

    def time_ns(self) -> int:
        return time.time_ns() - self.back_ns

    def ask_later(self, key: str, payload: None, on_answer: Any, on_end: Any, **_: object) -> None:
        now = {"received": time.time_ns(), "now": time.time_ns()}
        self.back_ns = 2 * SECOND
        on_answer(Answer(key, encode_map(now)))
        on_end()


def test_a_clock_that_is_set_meanwhile_is_measured_by_what_it_was_or_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Not by the mean of both, nor is a round trip shorter than none."""
    session = SteppedSession()
    monkeypatch.setattr(scheduler, "time_ns", session.time_ns)
    offsets = ClockOffsets(session, logging.getLogger("test"), warns=False)  # type: ignore[arg-type]
    offsets.watch("robot", StreamDescription(1, "/robot", 1, (), session="robot"))
    found = eventually(lambda: offsets.last_of("robot"))
    # Another stream of that node has what is known.
    offsets.watch("arm", StreamDescription(1, "/robot", 1, (), session="robot"))
    assert offsets.last_of("robot")
    offsets.close()
    assert round(found.offset_s, 1) in (0.0, 2.0)
    assert found.round_trip_s >= 0.0


def test_many_clocks_are_asked_together(bus: Bus, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten at a time: one after the other, a fleet would take longer than the time between."""
    node = bus.node("listener")
    open_questions, most = set[str](), 0
    ask_later = node.session.ask_later

    def noted(key: str, payload: Any, on_answer: Any, on_end: Any, **more: Any) -> None:
        nonlocal most

        def end() -> None:
            open_questions.discard(key)
            on_end()

        open_questions.add(key)
        most = max(most, len(open_questions))
        ask_later(key, payload, on_answer, end, **more)

    robots = [bus.node(f"robot{number}") for number in range(15)]
    keys = [clock_key(robot.name) for robot in robots]
    eventually(lambda: all(list(node.session.ask(key)) for key in keys))
    monkeypatch.setattr(node.session, "ask_later", noted)
    offsets = ClockOffsets(node.session, node.log)
    for robot in robots:
        description = StreamDescription(1, robot.full_name, 1, (), session=robot.session.id)
        offsets.watch(robot.name, description)
    eventually(lambda: all(offsets.last_of(robot.session.id) for robot in robots))
    assert most == 10
    offsets.close()
