"""Stamps are made of times in other forms, and stamps in another unit are noticed."""

from datetime import UTC, datetime, timedelta, timezone
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tfbus import stamp_ns
from tfbus.base.errors import InvalidArgumentException
from tfbus.base.stamps import LATEST_OF_ANOTHER_UNIT, other_unit, unit_hint

S = 1_000_000_000
NOW_NS = 1_700_000_000 * S


@pytest.mark.parametrize(
    ("time", "stamp"),
    [
        (0, 0),
        (1_700_000_000, NOW_NS),
        (np.int32(12), 12 * S),
        (-1.5, -S - S // 2),
        (1.1, 1_100_000_000),
        (1e-9, 1),
        (1_700_000_000.1, NOW_NS + S // 10),
        (np.float64(0.3), 300_000_000),
        (np.float32(0.5), 500_000_000),
        (Decimal("1700000000.123456789"), NOW_NS + 123_456_789),
        (Fraction(1, 4), S // 4),
        (datetime(2023, 11, 14, 22, 13, 20, 123_456, UTC), NOW_NS + 123_456_000),
        (datetime(2023, 11, 15, 0, 13, 20, tzinfo=timezone(timedelta(hours=2))), NOW_NS),
        (np.datetime64("2023-11-14T22:13:20.123456789"), NOW_NS + 123_456_789),
        (np.datetime64("1970-01-02"), 86_400 * S),
    ],
)
def test_a_time_has_a_stamp(time: object, stamp: int) -> None:
    """Seconds, datetime and datetime64 become integer nanoseconds."""
    made = stamp_ns(time)
    assert (made, type(made)) == (stamp, int)


def test_a_datetime_without_a_zone_is_local_time() -> None:
    """As datetime.timestamp() has it."""
    local = datetime(2023, 11, 14, 22, 13, 20)
    assert stamp_ns(local) == round(local.timestamp()) * S


@given(st.datetimes(datetime(1830, 1, 1), datetime(2110, 1, 1), timezones=st.just(UTC)))
def test_datetimes_and_datetime64_agree(time: datetime) -> None:
    """To the microsecond, before 1970 too."""
    assert stamp_ns(time) == stamp_ns(np.datetime64(time.replace(tzinfo=None)))


@pytest.mark.parametrize(
    "times",
    [
        [0.1, 1_700_000_000.3],
        np.array([1, 2, 3]),
        np.array(["2023-11-14", "1969-01-01"], "datetime64[s]"),
        [datetime(2023, 11, 14, tzinfo=UTC), datetime(2020, 1, 1, tzinfo=UTC)],
        (Decimal("0.5"), Decimal(3)),
        [],
    ],
)
def test_an_array_of_times_has_an_array_of_stamps(times: object) -> None:
    """Each is what it is alone."""
    stamps = stamp_ns(times)
    assert stamps.dtype == np.int64 and stamps.tolist() == [stamp_ns(time) for time in times]


@pytest.mark.parametrize(
    ("time", "says"),
    [
        ("2023-11-14", r"got str: datetime.fromisoformat"),
        (None, "expected seconds, a datetime or a datetime64, got NoneType"),
        (True, "got bool"),
        (float("nan"), "finite"),
        (Decimal("inf"), "finite"),
        (1e12, "within 146 years of 1970: numbers must be seconds"),
        (NOW_NS, "within 146 years"),
        (np.datetime64("NaT"), "NaT"),
        (np.datetime64("3000-01-01"), "within 146 years"),
        (np.array(["3000-01-01", "NaT"], "datetime64[s]"), "NaT"),
        ([[1.0]], r"expected shape \(N,\), got \(1, 1\)"),
    ],
)
def test_what_is_no_time_is_refused(time: object, says: str) -> None:
    """In one sentence."""
    with pytest.raises(InvalidArgumentException, match=says):
        stamp_ns(time)


@pytest.mark.parametrize(
    ("factor", "unit"), [(1, "seconds"), (10**3, "milliseconds"), (10**6, "microseconds")]
)
def test_a_stamp_in_another_unit_is_noticed(factor: int, unit: str) -> None:
    """By where it lies in that unit: within a day of now."""
    stamp = NOW_NS // S * factor
    assert other_unit(stamp, NOW_NS) == other_unit(stamp - 80_000 * factor, NOW_NS) == unit
    assert other_unit(stamp - 90_000 * factor, NOW_NS) == ""
    assert stamp < LATEST_OF_ANOTHER_UNIT
    hint = unit_hint(stamp, unit)
    assert f"{stamp} looks like {unit}" in hint and "tfbus.stamp_ns(1700000000)" in hint


@given(st.integers(0, 2**62 - 1), st.integers(0, 300 * 86_400 * S))
def test_a_simulated_clock_may_show_any_small_stamp(stamp: int, now_ns: int) -> None:
    """It begins at 0, where 1.7 s is a stamp as good as any."""
    assert other_unit(stamp, now_ns) == ""


@given(st.integers(NOW_NS - 10**17, NOW_NS + 10**17))
def test_nanoseconds_are_no_other_unit(stamp: int) -> None:
    """Within three years of now."""
    assert other_unit(stamp, NOW_NS) == ""
