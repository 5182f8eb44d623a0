"""`tfbus clock`: its messages; pausing, setting and changing its rate."""

import pytest

from tests.buses import DEADLINE_S, eventually
from tests.processes.sim_time import SECOND, Remote, follower, start_clock
from tests.simulated_bus import Bus
from tfbus.messages import Clock, SetClock


def test_it_publishes_its_rate_and_whether_it_is_paused(bus: Bus) -> None:
    """A clock publishes its time, its rate and whether it is paused; the rate is a parameter."""
    start_clock(bus, "--paused", "--start", "7s", "--rate", "2")
    node = bus.node("here")
    report: list[Clock] = []
    node.create_subscription(Clock, "clock", report.append)
    eventually(lambda: Clock(7 * SECOND, rate=2.0, paused=True) in report)
    assert bus.run("param", "set", "clock", "rate", "50").returncode == 0
    Remote(node).resume()
    eventually(lambda: report[-1].rate == 50.0 and not report[-1].paused)


def test_time_goes_on_in_whole_steps(bus: Bus) -> None:
    """All published times are whole steps from the start, in order."""
    start_clock(bus, "--start", "5s", "--step", "0.25", "--rate", "20")
    report: list[Clock] = []
    bus.node("here").create_subscription(Clock, "clock", report.append)
    eventually(lambda: len(report) > 20)
    stamps = [clock.stamp_ns for clock in report]
    assert {stamp % (SECOND // 4) for stamp in stamps} == {0}
    assert sorted(stamps) == stamps


def test_a_clock_that_is_set_goes_on_from_there(bus: Bus) -> None:
    """Set while it runs, a clock goes on from its new time."""
    start_clock(bus, "--start", "1000s")
    node = follower(bus)
    assert node.wait_for_clock(DEADLINE_S)
    node.create_client(SetClock, "clock/set").call(SetClock.Request(5 * SECOND))
    eventually(lambda: 5 * SECOND < node.now_ns() < 500 * SECOND)


def test_an_invalid_time_is_refused(bus: Bus) -> None:
    """Setting a clock before 1970 is refused."""
    start_clock(bus, "--paused", "--start", "7s")
    call = bus.run("call", "clock/set", "{stamp_ns: -5}")
    assert call.returncode == 2
    assert "stamp_ns must be" in call.stderr and "not -5" in call.stderr
    with pytest.raises(TypeError, match="takes SetClock"):
        bus.node("here").create_client(SetClock, "clock/set").call(Clock(5))


def test_a_time_that_would_run_out_of_numbers_is_refused(bus: Bus) -> None:
    """As --start refuses it; the clock goes on from where it is."""
    start_clock(bus, "--start", "7s")
    call = bus.run("call", "clock/set", f"{{stamp_ns: {2**63 - 1}}}")
    assert call.returncode == 1
    assert "stamp_ns must be between 1970 and 2116" in call.stderr
    node = follower(bus)
    eventually(lambda: 7 * SECOND < node.now_ns() < 100 * SECOND)


def test_a_clock_does_not_follow_itself(bus: Bus) -> None:
    """The clock uses the system's time even if the environment sets simulated time."""
    clock = bus.start("clock", "--start", "7s", "--sim-time", env={"TFBUS_SIM_TIME": "1"})
    node = follower(bus)
    eventually(lambda: node.now_ns() > 7 * SECOND)
    assert clock.stop() == 0


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--rate", "0"], "must be at least 0.001, not 0"),
        (["--step", "0"], "must be at least 1e-09, not 0"),
        (["--start", "soon"], "'soon' is not a time"),
        (["--start=-30000000min"], "--start must be between 1970 and 2116"),
        (["--start", "2200-01-01"], "--start must be between 1970 and 2116"),
    ],
)
def test_a_mistake_is_an_error(bus: Bus, options: list[str], said: str) -> None:
    """An invalid rate, step or start is one sentence, with exit code 2."""
    clock = bus.run("clock", *options)
    assert clock.returncode == 2
    assert said in clock.stderr
