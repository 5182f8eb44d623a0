"""Clocks: a simulated one stands still between calls of `set`, which end waits by it."""

import gc
import itertools
import threading
import weakref

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tfbus.base.clock import SYSTEM_CLOCK, SimulatedClock, limit_by

S = 1_000_000_000


def wake_nothing() -> None:
    """A wake that does nothing."""


def test_the_time_is_0_before_the_first_set() -> None:
    """A simulated clock that was never set is at 0 and does not run."""
    clock = SimulatedClock()
    assert (clock.now_ns(), clock.is_running) == (0, False)
    clock.set(0)
    assert (clock.now_ns(), clock.is_running) == (0, True)


def test_the_time_is_that_of_the_last_set() -> None:
    """The time is what was set last, forward or back; a call of the clock returns it too."""
    clock = SimulatedClock()
    for now_ns in (5 * S, 7 * S, 2 * S):
        clock.set(now_ns)
        assert clock.now_ns() == clock() == now_ns


def test_a_jump_back_is_reported() -> None:
    """Setting a clock back returns by how much, and calls the jump callbacks."""
    clock = SimulatedClock()
    jumps: list[int] = []
    clock.add_jump_callback(jumps.append)
    assert [clock.set(now_ns) for now_ns in (5 * S, 7 * S, 4 * S, 4 * S, 6 * S)] == [
        *(0, 0),
        3 * S,
        *(0, 0),
    ]
    clock.remove_jump_callback(jumps.append)
    clock.remove_jump_callback(jumps.append)
    clock.set(0)
    assert jumps == [4 * S]


@settings(deadline=None)
@given(st.lists(st.integers(0, 2**63 - 1), min_size=1))
def test_elapsed_time_never_goes_back(times: list[int]) -> None:
    """Elapsed time is the sum of all steps forward since the first `set`."""
    clock = SimulatedClock()
    elapsed = []
    for now_ns in times:
        clock.set(now_ns)
        elapsed.append(clock.elapsed_ns())
    steps = [after - before for before, after in itertools.pairwise(times)]
    assert elapsed[0] == 0
    assert elapsed == sorted(elapsed)
    assert elapsed[-1] == sum(step for step in steps if step > 0)


def test_a_limit_counts_simulated_seconds() -> None:
    """A limit passes with the `set` that reaches its time, which calls its wake once."""
    clock = SimulatedClock()
    clock.set(100 * S)
    woken: list[int] = []
    with clock.limit(2.0, lambda: woken.append(clock.now_ns())) as limit:
        for now_ns in (101 * S, 102 * S - 1):
            clock.set(now_ns)
            assert not limit.passed
        for now_ns in (102 * S, 103 * S):
            clock.set(now_ns)
            assert limit.passed
    assert woken == [102 * S]


def test_a_jump_back_leaves_as_much_to_wait_as_before() -> None:
    """After a jump back a limit has as much left as before it."""
    clock = SimulatedClock()
    clock.set(100 * S)
    with clock.limit(5.0, wake_nothing) as limit:
        clock.set(102 * S)  # 3 s are left
        clock.set(10 * S)
        clock.set(13 * S - 1)
        assert not limit.passed
        clock.set(13 * S)
        assert limit.passed


def test_a_jump_forward_is_time_that_has_passed() -> None:
    """A jump forward ends every wait whose time it reaches."""
    clock = SimulatedClock()
    clock.set(0)
    with clock.limit(5.0, wake_nothing) as limit:
        clock.set(3600 * S)
        assert limit.passed


def test_the_first_set_is_no_jump() -> None:
    """A wait that started before the first `set` counts from it, whatever time it is."""
    clock = SimulatedClock()
    with clock.limit(5.0, wake_nothing) as limit:
        clock.set(1_700_000_000 * S)
        assert not limit.passed
        clock.set(1_700_000_005 * S)
        assert limit.passed


@pytest.mark.parametrize("timeout_s", [None, float("inf"), 1e30])
def test_without_a_limit_nothing_passes(timeout_s: float | None) -> None:
    """None, and more seconds than any stamp, are no limit."""
    clock = SimulatedClock()
    clock.set(0)
    with clock.limit(timeout_s, wake_nothing) as limit:
        clock.set(2**63 - 1)
        assert not limit.passed


def test_a_closed_clock_ends_all_waits() -> None:
    """Closing a clock ends all waits by it, and later waits end at once."""
    clock = SimulatedClock()
    woken: list[str] = []
    with clock.limit(None, lambda: woken.append("first")) as limit:
        clock.close()
        assert limit.passed
    with clock.limit(10.0, lambda: woken.append("second")) as limit:
        assert limit.passed
    assert woken == ["first", "second"]


def test_ended_limits_are_not_kept() -> None:
    """A limit that has ended leaves nothing in a clock that stands still for ever."""
    clock = SimulatedClock()

    def wake() -> None:
        """Kept by the limit that it ends."""

    kept = weakref.ref(wake)
    with clock.limit(10.0, wake):
        pass
    del wake
    gc.collect()
    assert kept() is None
    assert clock.now_ns() == 0


def test_alarms_are_woken_in_the_order_of_their_times() -> None:
    """The alarm of an earlier time wakes first, whichever was set first."""
    clock = SimulatedClock()
    woken: list[int] = []
    for second in (3, 1, 2, 9):
        clock.call_at(second * S, lambda second=second: woken.append(second))
    clock.call_at(0, lambda: woken.append(0))
    clock.set(50 * S)
    assert woken == [0]
    clock.set(53 * S)
    assert woken == [0, 1, 2, 3]
    clock.call_at(2 * S, lambda: woken.append(-2))
    assert woken == [0, 1, 2, 3, -2]


def test_a_wake_may_set_another_alarm() -> None:
    """A wake may set an alarm at once."""
    clock = SimulatedClock()
    woken: list[int] = []

    def tick() -> None:
        woken.append(clock.elapsed_ns())
        clock.call_at(clock.elapsed_ns() + S, tick)

    clock.call_at(S, tick)
    for second in range(4):
        clock.set(second * S)
    assert woken == [S, 2 * S, 3 * S]


def test_limits_of_the_system_clock_are_real_seconds() -> None:
    """A limit of the system's clock has the real seconds that are left."""
    assert SYSTEM_CLOCK.is_running
    with SYSTEM_CLOCK.limit(1000.0, wake_nothing) as limit:
        assert not limit.passed
        assert limit.left_s is not None
        assert 900.0 < limit.left_s <= 1000.0
    with SYSTEM_CLOCK.limit(0.0, wake_nothing) as limit:
        assert limit.passed
    with SYSTEM_CLOCK.limit(None, wake_nothing) as limit:
        assert (limit.passed, limit.left_s) == (False, None)
    with SYSTEM_CLOCK.limit(float("inf"), wake_nothing) as limit:
        assert limit.left_s == threading.TIMEOUT_MAX


def test_any_function_of_time_has_real_limits() -> None:
    """With a plain function as the clock, waits are in real seconds."""
    with limit_by(lambda: 0, 1000.0, wake_nothing) as limit:
        assert limit.left_s is not None
