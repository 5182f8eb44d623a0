"""`tfbus frames`, `top`, `doctor` and the page of `tfbus view` judge the state of a frame alike."""

import re
from dataclasses import replace
from html import unescape
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.buses import eventually
from tests.simulated_bus import Bus
from tfbus import (
    Buffer,
    FrameInfo,
    NodeSettings,
    Transform,
    TransformBroadcaster,
    TransformListener,
    TransformStamped,
)
from tfbus.base.clock import SimulatedClock
from tfbus.doctor.examination import CHECKS, Examination
from tfbus.frames.clocks import SimulatedTime
from tfbus.frames.document import tree_lines
from tfbus.frames.moment import BusMoment, stale_after_s, state
from tfbus.frames.report import Report
from tfbus.frames.snapshot import FrameTree, frame_tree
from tfbus.streams.info import StreamInfo
from tfbus.top.rows import frames_table
from tfbus.view.frames import frames_of
from tfbus.view.panels.tree import facts_of

S = 1_000_000_000
NOW_NS = 1_670_400_300 * S
HOUR_S = 3600.0

# The frame that is judged, below `map`; what is wrong with it, the worst first.
FRAME = "base"
Faults = tuple[str, ...]

ARM = StreamInfo("arm", node="/arm", host="robot7", alive=True, frames=(("map", FRAME, False),))
LEFT, RIGHT = replace(ARM, name="left"), replace(ARM, name="right")


def buffer_of(
    *, newest_s: float = 0.0, rate_hz: float = 10.0, samples: int = 11, static: bool = False
) -> Buffer:
    """The samples of the frame, the newest `newest_s` ago by its stamp."""
    buffer = Buffer(cache_time_s=100.0)
    for back in range(samples):
        stamp_ns = NOW_NS - round((newest_s + back / rate_hz) * S)
        edge = TransformStamped(stamp_ns, "map", FRAME, Transform.identity())
        buffer.set_transform(edge, static=static, authority="arm")
    return buffer


def gone(buffer: Buffer) -> Buffer:
    buffer.mark_gone([FRAME], True, "arm")
    return buffer


# What was recorded of the bus, and what is wrong with the frame.
RECORDED: dict[str, tuple[Buffer, list[StreamInfo], Faults]] = {
    "dynamic": (buffer_of(), [ARM], ()),
    "static": (buffer_of(samples=1, static=True, newest_s=50.0), [ARM], ()),
    "stale": (buffer_of(newest_s=1.1), [ARM], ("stale",)),
    "silent for two periods": (buffer_of(newest_s=4.0, rate_hz=0.5), [ARM], ()),
    "silent for more than three periods": (buffer_of(newest_s=6.1, rate_hz=0.5), [ARM], ("stale",)),
    "a single sample": (buffer_of(newest_s=2.9, samples=1), [ARM], ()),
    "an old single sample": (buffer_of(newest_s=3.1, samples=1), [ARM], ("stale",)),
    "gone": (gone(buffer_of(newest_s=5.0)), [replace(ARM, alive=False)], ("gone",)),
    "gone and static": (gone(buffer_of(static=True)), [replace(ARM, alive=False)], ("gone",)),
    "conflict": (buffer_of(), [ARM, LEFT], ("conflict",)),
    "conflict over a static frame": (buffer_of(static=True), [ARM, LEFT], ("conflict",)),
    "one of two publishers gone": (buffer_of(), [ARM, replace(LEFT, alive=False)], ()),
    "gone and in conflict": (
        gone(buffer_of()),
        [replace(ARM, alive=False), LEFT, RIGHT],
        ("gone", "conflict"),
    ),
    "clock behind": (buffer_of(newest_s=HOUR_S), [replace(ARM, last_delay_s=HOUR_S)], ()),
    "clock ahead": (
        buffer_of(newest_s=-HOUR_S),
        [replace(ARM, last_delay_s=-HOUR_S)],
        ("ahead",),
    ),
    "stamped ahead": (
        buffer_of(newest_s=-0.03),
        [replace(ARM, last_delay_s=-0.03, clock_offset_s=0.0)],
        ("ahead",),
    ),
    "clock a little ahead": (
        buffer_of(newest_s=-0.03),
        [replace(ARM, last_delay_s=-0.03, clock_offset_s=0.031)],
        (),
    ),
    "clock ahead by more than clocks may differ": (
        buffer_of(newest_s=-0.2),
        [replace(ARM, last_delay_s=-0.2, clock_offset_s=0.201)],
        ("ahead",),
    ),
    "stamped behind, only history heard": (
        buffer_of(newest_s=301.0, rate_hz=0.5),
        [replace(ARM, clock_offset_s=0.0, kept_delay_s=300.5)],
        (),
    ),
    "stamped behind, only history heard, long ago": (
        buffer_of(newest_s=306.6, rate_hz=0.5),
        [replace(ARM, clock_offset_s=0.0, kept_delay_s=300.5)],
        ("stale",),
    ),
    "stamped ahead, only history heard, long ago": (
        buffer_of(newest_s=-293.0, rate_hz=0.5),
        [replace(ARM, clock_offset_s=0.0, kept_delay_s=-299.5)],
        ("stale",),
    ),
    "stale, only history heard": (
        buffer_of(newest_s=5.0),
        [replace(ARM, clock_offset_s=0.0, kept_delay_s=4.5)],
        ("stale",),
    ),
    "stamped ahead, only history heard": (
        buffer_of(newest_s=-300.0),
        [replace(ARM, clock_offset_s=0.0)],
        ("ahead",),
    ),
    "stamped ahead by ROS, as its localisation does": (
        buffer_of(newest_s=-1.0),
        [replace(ARM, last_delay_s=-1.0, origin=("01",))],
        (),
    ),
    "of ROS, an hour ahead": (
        buffer_of(newest_s=-HOUR_S),
        [replace(ARM, last_delay_s=-HOUR_S, origin=("01",))],
        ("ahead",),
    ),
    "ahead and in conflict": (
        buffer_of(newest_s=-HOUR_S),
        [replace(ARM, last_delay_s=-HOUR_S), LEFT],
        ("conflict",),
    ),
    "clock stepped, the mean delay lags behind": (
        buffer_of(newest_s=HOUR_S),
        [replace(ARM, delay_s=0.1 * HOUR_S, last_delay_s=HOUR_S)],
        (),
    ),
    "clock ahead, stale": (
        buffer_of(newest_s=5.0 - HOUR_S),
        [replace(ARM, last_delay_s=-HOUR_S, clock_offset_s=HOUR_S)],
        ("stale",),
    ),
    "clock ahead, stale, only history heard": (
        buffer_of(newest_s=5.0 - HOUR_S),
        [replace(ARM, clock_offset_s=HOUR_S)],
        ("stale",),
    ),
}


def said_by_frames(tree: FrameTree) -> Faults:
    """The words in capitals behind the frame in `tfbus frames`."""
    (line,) = [line for line in tree_lines(tree) if f"─ {FRAME} " in line]
    return tuple(word.lower() for word in re.findall(r"\b[A-Z]{4,}\b", line))


def said_by_top(tree: FrameTree) -> Faults:
    """The cell `state` of the frame in `tfbus top`."""
    unused: Any = None
    table = frames_table(Report(BusMoment(at_ns=NOW_NS, tree=tree), {}, unused, None))
    (row,) = [row for row in table.rows if row.key == FRAME]
    said = row.cells[table.headings.index("state")].text
    faults = tuple(said.split(", ")) if said else ()
    assert row.state == (*faults, state(tree, tree.frames[FRAME]))[0]
    return faults


def said_by_doctor(tree: FrameTree) -> Faults:
    """The checks of `tfbus doctor` that name the frame."""
    seen = Examination(NodeSettings("doctor"), BusMoment(at_ns=NOW_NS, tree=tree), (), {}, 3.0)
    checks = {"gone": "gone", "conflicts": "conflict", "stale": "stale", "stamps": "ahead"}
    return tuple(
        fault
        for check, fault in checks.items()
        if f"'{FRAME}'" in " ".join(CHECKS[check](seen).evidence)
    )


def said_by_view(tree: FrameTree, buffer: Buffer) -> Faults:
    """The words before a colon in the facts of the frame on the page."""
    frame = frames_of(BusMoment(at_ns=NOW_NS, tree=tree), buffer, "map")[FRAME]
    row = re.findall(r"<dt>State</dt><dd>(.*?)</dd>", facts_of(frame, tree.recorded_ns))[0]
    words = re.findall(r"(\w+):", unescape(re.sub("<.*?>", "", row)))
    assert words[0] == frame.state
    return tuple(word for word in words if word not in ("dynamic", "static", "root"))


def said_by_all(tree: FrameTree, buffer: Buffer) -> Faults:
    """What all four say; an AssertionError if they differ."""
    faults = said_by_frames(tree)
    assert said_by_top(tree) == faults
    assert said_by_doctor(tree) == faults
    assert said_by_view(tree, buffer) == faults
    return faults


@pytest.mark.parametrize("name", RECORDED)
def test_all_say_the_same_of_what_was_recorded(name: str) -> None:
    """Given the same buffer and streams, in every state."""
    buffer, streams, faults = RECORDED[name]
    assert said_by_all(frame_tree(buffer, streams, NOW_NS), buffer) == faults


def test_the_offset_of_a_clock_does_not_count_under_simulated_time() -> None:
    """The stamps are of the simulated clock, whatever the clock of the publisher's host."""
    buffer = buffer_of()
    buffer.clock = SimulatedClock()
    streams = [replace(ARM, clock_offset_s=HOUR_S)]
    assert said_by_all(frame_tree(buffer, streams, NOW_NS), buffer) == ()


@pytest.mark.parametrize(("ahead_s", "faults"), [(2.0, ()), (HOUR_S, ("ahead",))])
def test_a_simulated_time_goes_in_steps(ahead_s: float, faults: Faults) -> None:
    """Its publishers may have the next one already, but not that of an hour later."""
    buffer = buffer_of(newest_s=-ahead_s)
    buffer.clock = SimulatedClock()
    tree = frame_tree(buffer, [replace(ARM, last_delay_s=-ahead_s)], NOW_NS)
    assert said_by_frames(tree) == faults


def test_a_simulated_time_that_is_not_ours_is_not_ahead() -> None:
    """Where its publisher follows it, and the tool does not."""
    simulated = SimulatedTime(("/clock",), frozenset(["/arm"]), 1)
    tree = frame_tree(buffer_of(newest_s=-HOUR_S), [ARM], NOW_NS, simulated)
    assert said_by_frames(tree) == ()
    assert [problem.kind for problem in tree.problems()] == ["clock"]


def test_a_simulated_time_that_the_tool_follows_is_no_problem() -> None:
    """Also once the nodes have said that they follow it."""
    simulated = SimulatedTime(("/clock",), frozenset(["/arm"]), 1)
    buffer = buffer_of()
    buffer.clock = SimulatedClock()
    tree = frame_tree(buffer, [ARM], NOW_NS, simulated)
    assert list(tree.problems()) == []
    assert said_by_frames(tree) == ()


def test_a_root_is_a_root() -> None:
    """A frame without a parent is not a fault, whichever stream lists it."""
    above = [replace(stream, frames=(("odom", "map", False),)) for stream in (ARM, LEFT)]
    tree = frame_tree(buffer_of(), above, NOW_NS)
    assert state(tree, tree.frames["map"]) == "root"
    assert frames_of(BusMoment(at_ns=NOW_NS, tree=tree), buffer_of(), "map")["map"].state == "root"


@given(st.floats(0.01, 1e3))
def test_a_frame_may_be_silent_for_a_second_and_for_three_periods(rate_hz: float) -> None:
    """Whatever its rate."""
    limit_s = stale_after_s(FrameInfo(FRAME, parent="map", rate_hz=rate_hz))
    assert limit_s >= 1.0
    assert limit_s * rate_hz >= 3.0 - 1e-9


def test_all_say_the_same_of_a_node_whose_clock_is_wrong(bus: Bus) -> None:
    """On a real bus, with stamps that are an hour old: dynamic, then stale, then gone."""
    arm, listening = bus.node("arm"), bus.node("listening")
    broadcaster = TransformBroadcaster(arm)

    def send() -> None:
        stamp_ns = arm.now_ns() - round(HOUR_S * S)
        broadcaster.send_transform(TransformStamped(stamp_ns, "map", FRAME, Transform.identity()))

    timer = arm.create_timer(0.05, send)
    buffer = Buffer()
    with TransformListener(buffer, listening) as listener:

        def said() -> Faults:
            return said_by_all(frame_tree(buffer, listener.streams(), listening.now_ns()), buffer)

        eventually(lambda: FRAME in buffer.frames() and buffer.frame(FRAME).samples > 20)
        assert said() == ()
        assert "STALE" not in bus.run("frames").stdout
        assert said() == ()
        timer.cancel()
        eventually(lambda: said() == ("stale",))
        arm.close()
        eventually(lambda: said() == ("gone",))
