"""The meter of transforms: its measurements of edges and streams on a live bus."""

import math
import time

import pytest

from tests.builders import at, payload
from tests.buses import eventually
from tests.simulated_bus import Bus
from tfbus import Transform, TransformBroadcaster, TransformStamped
from tfbus.base.clock import SimulatedClock, SystemClock
from tfbus.frames import meter as meter_module
from tfbus.frames.meter import TransformMeter
from tfbus.frames.report import EdgeFlow

S = 1_000_000_000


class Seconds(SystemClock):
    """A clock that stands still until the test sets `now_s`."""

    now_s = 0.0

    def elapsed_ns(self) -> int:
        return round(self.now_s * 1e9)


def test_an_edge_has_its_gap_order_and_delays(bus: Bus) -> None:
    """Gaps go from the newest stamp so far; older stamps and zeros are counted."""
    meter = TransformMeter(bus.node("meter"), recent_s=math.inf)
    robot = bus.node("robot")
    broadcaster = TransformBroadcaster(robot)
    now_ns = robot.now_ns()

    def send(stamp_ns: int) -> bool:
        broadcaster.send_transform(
            TransformStamped(stamp_ns, "world", "base", Transform.identity())
        )
        return True

    # What was sent before the meter found the robot does not count.
    eventually(lambda: send(now_ns) and any(meter.edges()))
    for stamp_ns in (now_ns + 20 * S, now_ns + 10 * S, 0, now_ns + 30 * S):
        send(stamp_ns)

    def flow() -> EdgeFlow:
        return next(meter.edges())

    eventually(lambda: (flow().least_delay_s or 0.0) < -20.0)
    assert (flow().stream, flow().parent, flow().child) == ("robot", "world", "base")
    assert flow().at_zero == 1
    least_s = flow().least_delay_s
    assert least_s is not None and -30.1 < least_s < -20.0
    assert flow().rate_hz is not None
    assert meter.stream("robot").messages_hz > 0.0
    assert 100 < (meter.streams()["robot"].largest_bytes or 0) < 1000


def test_a_publisher_that_begins_again_earlier_is_not_out_of_order(bus: Bus) -> None:
    """As the player of a recording does in each of its loops: only its older samples count."""
    meter = TransformMeter(bus.node("meter"))
    for epoch_ns in (1, 2):
        for stamp_ns in (10 * S, 30 * S, 20 * S):
            meter.receive("tf/player", payload([at(1, "base", stamp_ns)], epoch_ns))
    (flow,) = meter.edges()
    assert (flow.out_of_order, flow.longest_gap_s) == (2, 20.0)


def test_samples_after_a_jump_back_of_the_clock_are_not_out_of_order(bus: Bus) -> None:
    """A simulator that is reset begins again, and its publishers go on."""
    node = bus.node("meter", sim_time=True)
    assert isinstance(node.clock, SimulatedClock)
    meter = TransformMeter(node)
    for now_s in (10, 20, 1, 2):
        node.clock.set(now_s * S)
        meter.receive("tf/sim", payload([at(1, "base", now_s * S)]))
    (flow,) = meter.edges()
    assert flow.out_of_order == 0


def test_rates_are_in_real_time_where_a_simulated_clock_stands_still(bus: Bus) -> None:
    """A paused clock makes neither rates without end nor a recent past without end."""
    node = bus.node("meter", sim_time=True)
    meter, began_s = TransformMeter(node), time.monotonic()
    broadcaster = TransformBroadcaster(bus.node("robot"))
    sent = 0

    def send() -> EdgeFlow | None:
        nonlocal sent
        sent += 1
        broadcaster.send_transform(TransformStamped(sent, "world", "base", Transform.identity()))
        return next((flow for flow in meter.edges() if flow.rate_hz), None)

    eventually(send)
    assert 0.0 < meter.stream("robot").messages_hz <= sent / (time.monotonic() - began_s) * 1.5


def test_without_samples_nothing_is_measured(bus: Bus) -> None:
    """An unknown stream has no load, and there are no edges."""
    meter = TransformMeter(bus.node("meter"))
    assert list(meter.edges()) == []
    assert meter.stream("robot").bytes_per_s == 0.0
    assert EdgeFlow("robot", "world", "base").least_delay_s is None


def test_silent_edges_make_room_for_others(bus: Bus, monkeypatch: pytest.MonkeyPatch) -> None:
    """A flood of names is not measured for ever, and what is held of samples has a limit."""
    monkeypatch.setattr(meter_module, "_MOST_EDGES", 3)
    monkeypatch.setattr(meter_module, "_MOST_IN_ALL", 20)
    clock = Seconds()
    meter = TransformMeter(bus.node("meter"), recent_s=math.inf, clock=clock)
    for number in range(50):
        meter.receive("tf/flood", payload([at(1, f"frame{number % 5}", number)]))
    assert {flow.child for flow in meter.edges()} == {"frame0", "frame1", "frame2"}
    assert meter.samples <= 23
    clock.now_s = 100.0
    meter.receive("tf/honest", payload([at(1, "robot")]))
    assert {(flow.stream, flow.child) for flow in meter.edges()} == {("honest", "robot")}
    assert meter.samples <= 3
