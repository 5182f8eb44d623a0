"""Simulated time between real processes: any rate, paused, jumps, late starts, and the end."""

import threading
import time

import pytest

from tests.buses import DEADLINE_S, eventually
from tests.processes.sim_time import SECOND, Remote, follower, start_clock
from tests.simulated_bus import Bus
from tfbus import Buffer, TimeoutException
from tfbus.messages import Clock, SetClock


def test_without_a_clock_time_is_0_and_nothing_goes_on(bus: Bus) -> None:
    """Before the first message the time is 0, and a node that is ready logs what it waits for."""
    process = bus.start("carrot", "--sim-time")
    process.wait_for_line("Waiting for the clock: no message on 'clock' yet")
    node = follower(bus)
    assert (node.now_ns(), node.wait_for_clock(0.01)) == (0, False)
    start_clock(bus, "--paused", "--start", "5s")
    process.wait_for_line("The clock is running")
    assert node.wait_for_clock(DEADLINE_S)
    assert node.now_ns() == 5 * SECOND
    assert process.stop() == 0


def test_who_comes_late_knows_the_time_of_a_paused_clock(bus: Bus) -> None:
    """A node that starts after the clock was paused gets the time."""
    start_clock(bus, "--paused", "--start", "100s")
    node = follower(bus)
    assert node.wait_for_clock(DEADLINE_S)
    assert node.now_ns() == 100 * SECOND


@pytest.mark.parametrize("rate", ["0.1", "10", "100"])
def test_time_goes_by_at_the_rate_of_the_clock(bus: Bus, rate: str) -> None:
    """A node's time goes by as many times faster, or slower, as the clock's rate says."""
    start_clock(bus, "--rate", rate, "--start", "0s")
    node = follower(bus)
    assert node.wait_for_clock(DEADLINE_S)
    began_ns, began_s = node.now_ns(), time.monotonic()
    assert node.wait(0.5 * float(rate))
    # The clock's time, and that of the network, which is virtual too.
    simulated_s, network_s = (node.now_ns() - began_ns) / SECOND, time.monotonic() - began_s
    assert 0.5 * float(rate) <= simulated_s
    assert simulated_s / network_s == pytest.approx(float(rate), rel=0.1)


def test_timeouts_are_in_simulated_seconds(bus: Bus) -> None:
    """At 100 times the speed a lookup gives up after its own seconds, not after the network's."""
    start_clock(bus, "--rate", "100", "--start", "0s")
    node = follower(bus)
    buffer = Buffer(clock=node.clock)
    assert node.wait_for_clock(DEADLINE_S)
    began_ns, began_s = node.now_ns(), time.monotonic()
    with pytest.raises(TimeoutException, match="timed out after 100 s"):
        buffer.lookup_transform("map", "nowhere", timeout_s=100.0)
    assert node.now_ns() - began_ns >= 100 * SECOND
    assert time.monotonic() - began_s == pytest.approx(1.0, abs=0.1)  # of the network, virtual


def test_timers_stand_still_while_the_clock_is_paused(bus: Bus) -> None:
    """A timer ticks while the clock runs, and neither it nor time goes on while it is paused."""
    start_clock(bus)
    node = follower(bus)
    remote = Remote(node)
    ticks: list[int] = []
    node.create_timer(0.02, lambda: ticks.append(node.now_ns()))
    eventually(lambda: len(ticks) > 5)
    paused: list[tuple[int, int]] = []
    node.create_subscription(
        Clock, "clock", lambda clock: clock.paused and paused.append((clock.stamp_ns, len(ticks)))
    )
    remote.pause()
    # The time is repeated, also while it stands still.
    eventually(lambda: len(paused) > 3)
    assert len(set(paused[1:])) == 1
    count = len(ticks)
    remote.resume()
    eventually(lambda: len(ticks) > count + 5)
    assert ticks == sorted(ticks)


def test_jumps_of_a_paused_clock_bring_timers_one_tick(bus: Bus) -> None:
    """A jump forward is one tick of a timer; after a jump back it has as much left as before."""
    start_clock(bus, "--paused", "--start", "100s")
    node = follower(bus)
    remote = Remote(node)
    assert node.wait_for_clock(DEADLINE_S)
    ticks: list[float] = []
    node.create_timer(1.0, lambda: ticks.append(node.now_ns() / SECOND))
    remote.set(150.0)
    eventually(lambda: len(ticks) == 1)
    remote.set(150.75)
    remote.set(10.0)
    remote.set(10.125)
    remote.set(10.25)
    eventually(lambda: len(ticks) == 2)
    assert ticks == [150.0, 10.25]


def test_closing_a_node_ends_its_waits(bus: Bus) -> None:
    """A loop by simulated time ends with its node, from whatever thread it was closed."""
    node = follower(bus)
    loops: list[bool] = []
    loop = threading.Thread(target=lambda: loops.append(node.wait(1.0)))
    loop.start()
    node.close()
    loop.join(DEADLINE_S)
    assert loops == [False]
    assert not node.wait(1.0)


def test_a_clock_without_a_namespace_serves_all(bus: Bus) -> None:
    """One clock without a namespace serves every robot; one with a namespace only its own."""
    start_clock(bus, "--paused", "--start", "7s")
    robot7 = follower(bus, namespace="robot7")
    base = follower(bus, namespace="fleet/robot8")
    assert robot7.wait_for_clock(DEADLINE_S)
    assert base.wait_for_clock(DEADLINE_S)
    assert robot7.now_ns() == base.now_ns() == 7 * SECOND


def test_a_clock_of_a_namespace_is_not_that_of_others(bus: Bus) -> None:
    """A clock in a namespace is followed by the nodes within it alone."""
    start_clock(bus, "--paused", "--start", "7s", "--namespace", "fleet")
    other = follower(bus, namespace="robot7")
    inner = follower(bus, namespace="fleet/robot8")
    assert inner.wait_for_clock(DEADLINE_S)
    assert inner.now_ns() == 7 * SECOND
    assert not other.clock.is_running


def test_bad_messages_on_the_topic_are_dropped(bus: Bus, capfd: pytest.CaptureFixture[str]) -> None:
    """A message that is no Clock is logged once, and the clock stays as it is."""
    node = follower(bus)
    publisher = bus.node("stranger").create_publisher(SetClock.Response, "clock")
    clock = bus.node("teller").create_clock_publisher()
    clock.publish(Clock(3 * SECOND))
    assert node.wait_for_clock(DEADLINE_S)

    said: list[str] = []

    def is_reported() -> bool:
        publisher.publish(SetClock.Response())
        said.append(capfd.readouterr().err)
        return "Dropped a message" in "".join(said)

    eventually(is_reported)
    assert "on topic 'clock'" in "".join(said) and "'stamp_ns' is missing" in "".join(said)
    assert node.now_ns() == 3 * SECOND
