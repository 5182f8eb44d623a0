"""A buffer under a simulated clock: its timeouts, and samples forgotten at a jump back."""

import asyncio

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.buses import eventually
from tests.fakes import InAThread
from tfbus import Buffer, LookupException, TimeoutException, Transform, TransformStamped
from tfbus.base.clock import SimulatedClock

SECOND = 1_000_000_000


def at(second: int, x: float = 0.0, *, parent: str = "a", child: str = "b") -> TransformStamped:
    """Where a frame is at a second."""
    return TransformStamped(second * SECOND, parent, child, Transform((x, 0.0, 0.0)))


def waiting(buffer: Buffer) -> bool:
    """Whether a lookup waits in the buffer, with its limit by the buffer's clock."""
    clock = buffer.clock
    return buffer.waiting > 0 and isinstance(clock, SimulatedClock) and bool(clock._alarms)


def test_a_timeout_is_in_simulated_seconds() -> None:
    """A lookup under a clock that stands still waits, and gives up when its seconds have gone."""
    clock = SimulatedClock()
    clock.set(100 * SECOND)
    buffer = Buffer(clock=clock)
    lookup = InAThread(lambda: buffer.lookup_transform("a", "b", timeout_s=5.0))
    eventually(lambda: waiting(buffer))
    clock.set(105 * SECOND - 1)
    assert lookup.is_waiting
    clock.set(105 * SECOND)
    error = lookup.result()
    assert isinstance(error, TimeoutException)
    assert isinstance(error.reason, LookupException)
    assert str(error).startswith("timed out after 5 s: ")


def test_a_lookup_under_a_clock_that_stands_is_woken_by_data() -> None:
    """Data wakes who waits, whether the clock moves or not."""
    clock = SimulatedClock()
    buffer = Buffer(clock=clock)
    lookup = InAThread(lambda: buffer.lookup_transform("a", "b", timeout_s=5.0))
    eventually(lambda: waiting(buffer))
    buffer.set_transform(at(1, 2.0))
    answer = lookup.result()
    assert isinstance(answer, TransformStamped)
    assert answer.transform.x == 2.0


def test_a_closed_clock_ends_a_lookup() -> None:
    """A lookup ends with the node whose clock it waits by."""
    clock = SimulatedClock()
    buffer = Buffer(clock=clock)
    lookup = InAThread(lambda: buffer.lookup_transform("a", "b", timeout_s=5.0))
    eventually(lambda: waiting(buffer))
    clock.close()
    error = lookup.result()
    assert isinstance(error, TimeoutException)
    assert error.fact.startswith("the node closes")


def test_asyncio_waits_in_simulated_seconds_too() -> None:
    """The timeout of wait_for_transform is in seconds of the buffer's clock."""
    clock = SimulatedClock()
    clock.set(0)
    buffer = Buffer(clock=clock)
    wait = InAThread(lambda: asyncio.run(buffer.wait_for_transform("a", "b", timeout_s=5.0)))
    eventually(lambda: waiting(buffer))
    clock.set(5 * SECOND - 1)
    assert wait.is_waiting
    clock.set(5 * SECOND)
    assert isinstance(wait.result(), TimeoutException)


def test_with_another_function_of_time_a_timeout_is_real() -> None:
    """A buffer whose clock is a plain function waits real seconds."""
    with pytest.raises(TimeoutException):
        Buffer(clock=lambda: 0).lookup_transform("a", "b", timeout_s=0.01)


def test_what_lies_in_the_future_can_be_forgotten() -> None:
    """Cleared after a time, a buffer knows what it knew then; static transforms stay."""
    buffer = Buffer()
    for second in range(5):
        buffer.set_transform(at(second, float(second)))
    buffer.set_transform(at(4, child="late"))
    buffer.set_transform(at(4, 7.0, child="fixed"), static=True)
    buffer.clear(after_ns=2 * SECOND)
    assert buffer.latest_common_time("a", "b") == 2 * SECOND
    assert buffer.lookup_transform("a", "b", SECOND * 3 // 2).transform.x == 1.5
    assert buffer.lookup_transform("a", "fixed").transform.x == 7.0
    assert not buffer.can_transform("a", "late")
    buffer.set_transform(at(3, 30.0))
    assert buffer.lookup_transform("a", "b").transform.x == 30.0


@settings(deadline=None)
@given(st.lists(st.integers(0, 9)), st.integers(-1, 10), st.lists(st.integers(0, 9)))
def test_what_was_forgotten_was_never_there(stamps: list[int], after: int, more: list[int]) -> None:
    """Cleared after a time, a buffer answers as one that never had later samples."""
    cleared, other = Buffer(), Buffer()
    for stamp in stamps:
        cleared.set_transform(at(stamp, stamp**2))
        if stamp <= after:
            other.set_transform(at(stamp, stamp**2))
    cleared.clear(after_ns=after * SECOND)
    for stamp in more:
        cleared.set_transform(at(stamp, -stamp))
        other.set_transform(at(stamp, -stamp))
    for half_second in range(20):
        stamp_ns = half_second * SECOND // 2
        assert cleared.can_transform("a", "b", stamp_ns) == other.can_transform("a", "b", stamp_ns)
        if cleared.can_transform("a", "b", stamp_ns):
            answers = [each.lookup_transform("a", "b", stamp_ns) for each in (cleared, other)]
            assert answers[0].transform.x == answers[1].transform.x


def test_a_frame_that_changed_its_parent_is_forgotten_whole() -> None:
    """A frame whose parent has changed does not go back to the former one."""
    buffer = Buffer()
    buffer.set_transform(at(1))
    buffer.set_transform(at(3, parent="c"))
    buffer.clear(after_ns=4 * SECOND)
    assert buffer.can_transform("a", "b", SECOND)
    buffer.clear(after_ns=2 * SECOND)
    assert not buffer.can_transform("a", "b", SECOND)
    assert not buffer.can_transform("c", "b")
