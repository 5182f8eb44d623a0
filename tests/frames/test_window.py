"""The last numbers of a measurement, and their spread."""

import math

from hypothesis import given
from hypothesis import strategies as st

from tfbus.frames.windows import MessageWindow, WindowReading, spread_of


def test_the_spread_of_numbers() -> None:
    """Mean, bounds, deviation and percentiles, of numbers in any order."""
    spread = spread_of([4.0, 2.0, 2.0, 4.0])
    assert spread is not None
    assert (spread.count, spread.mean, spread.min, spread.max) == (4, 3.0, 2.0, 4.0)
    assert (spread.std_dev, spread.p50, spread.p99) == (1.0, 2.0, 4.0)
    assert spread_of([]) is None


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=50))
def test_percentiles_are_numbers_of_the_list_in_order(numbers: list[float]) -> None:
    """A percentile is one of the numbers, and at least that part is not above it."""
    spread = spread_of(numbers)
    assert spread is not None
    assert spread.min <= spread.p50 <= spread.p95 <= spread.p99 <= spread.max
    for part, value in ((0.5, spread.p50), (0.95, spread.p95), (0.99, spread.p99)):
        assert value in numbers
        assert sum(number <= value for number in numbers) >= part * len(numbers) - 1e-9
    assert math.isclose(spread.mean, sum(numbers) / len(numbers), abs_tol=1e-6)


def test_a_window_keeps_the_last() -> None:
    """A window forgets the oldest of more than it holds, and counts all."""
    window = MessageWindow(2)
    for at in range(3):
        window.add(float(at), 10.0 * at)
    reading = window.read()
    assert reading == WindowReading((1.0, 2.0), (10.0, 20.0), 3)
    assert reading.intervals_s == [1.0]
