"""A lookup that fails because of seconds for nanoseconds says so."""

import re

import pytest

from tests.builders import S, moved
from tfbus import Buffer, ExtrapolationException, FutureExtrapolationException
from tfbus.base.errors import PastExtrapolationException, SingleSampleException, StaleException

NOW_NS = 1_700_000_000 * S


def of(*stamps: int) -> Buffer:
    buffer = Buffer()
    for stamp in stamps:
        buffer.set_transform(moved(stamp, "map", "base"))
    return buffer


def why(buffer: Buffer, stamp_ns: int, kind: type[ExtrapolationException]) -> str:
    with pytest.raises(kind) as caught:
        buffer.lookup_transform("map", "base", stamp_ns)
    assert caught.value.retry_after_s is None
    return str(caught.value)


@pytest.mark.parametrize(
    ("factor", "unit"), [(1, "seconds"), (10**3, "milliseconds"), (10**6, "microseconds")]
)
def test_a_lookup_at_seconds_is_told_of_nanoseconds(factor: int, unit: str) -> None:
    """Instead of the advice to query a later time."""
    stamp = 1_700_000_000 * factor
    says = f"stamp {stamp} looks like {unit}, .*: tfbus.stamp_ns.170000"
    assert re.search(says, why(of(NOW_NS, NOW_NS + S), stamp, PastExtrapolationException))
    assert re.search(says, why(of(NOW_NS), stamp, SingleSampleException))


def test_a_publisher_that_sends_seconds_is_named() -> None:
    """Where the lookup is at nanoseconds, the samples are wrong."""
    said = why(of(1_700_000_000, 1_700_000_001), NOW_NS, FutureExtrapolationException)
    assert re.search("its publisher's stamps .* 1700000001 looks like seconds", said)


def test_a_lookup_of_the_latest_names_the_publisher_that_sends_seconds() -> None:
    """Where a path has an edge in nanoseconds and one in seconds, they have no common time."""
    buffer = of(NOW_NS, NOW_NS + S)
    buffer.set_transform(moved(1_700_000_001, "base", "gps"), authority="receiver")
    with pytest.raises(ExtrapolationException, match="1700000001 looks like seconds") as caught:
        buffer.lookup_transform("map", "gps")
    assert "'gps', sent by 'receiver': its" in str(caught.value)
    assert "common time" not in str(caught.value)


def test_small_stamps_are_of_simulated_time() -> None:
    """Where the samples are of simulated time, seconds after 0 are what they seem."""
    with pytest.raises(FutureExtrapolationException, match="wait about"):
        of(S, 2 * S).lookup_transform("map", "base", 1_700_000_000_000)


@pytest.mark.parametrize("count", [1, 2])
def test_a_stamp_of_another_clock_gets_no_advice_to_wait(count: int) -> None:
    """Years from all samples, the answer is --sim-time for the side whose clock is the system's."""
    real = of(*(NOW_NS + at * S for at in range(count)))
    simulated = of(*(5 * S + at * S for at in range(count)))
    late = SingleSampleException if count == 1 else FutureExtrapolationException
    early = SingleSampleException if count == 1 else PastExtrapolationException
    clock = "of another clock; .* --sim-time to"
    assert re.search(f"54 years earlier, .* {clock} this node", why(simulated, NOW_NS, late))
    assert re.search(f"54 years later, .* {clock} its publisher", why(real, 7 * S, early))


def test_edges_of_two_clocks_have_no_common_time() -> None:
    """The latest common time of simulated and real stamps is not worth waiting for."""
    buffer = of(5 * S)
    buffer.set_transform(moved(NOW_NS, "map", "cup"))
    with pytest.raises(ExtrapolationException, match="are of different clocks") as caught:
        buffer.lookup_transform("base", "cup")
    assert "wait" not in str(caught.value)
    with pytest.raises(StaleException, match="are of another clock") as stale:
        buffer.lookup_transform("map", "base", max_age_s=3.0)
    assert "wait" not in str(stale.value)
