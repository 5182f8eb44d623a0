"""Moments as people write them."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tfbus.command.types import Moment, parse_moment


@pytest.mark.parametrize(
    ("text", "ns"),
    [
        ("1649109418.661570822", 1_649_109_418_661_570_822),
        ("1649109418", 1_649_109_418_000_000_000),
        ("1649109418661570822", 1_649_109_418_661_570_822),
        ("0", 0),
        (".5", 500_000_000),
        ("12.5s", 12_500_000_000),
        ("5000000000ns", 5_000_000_000),
        ("2022-04-04T21:56:58.661570822Z", 1_649_109_418_661_570_822),
        ("2022-04-04T23:56:58,661570822+02:00", 1_649_109_418_661_570_822),
        ("2022-04-04 21:56:58Z", 1_649_109_418_000_000_000),
        ("1969-12-31T23:59:59.5Z", -500_000_000),
    ],
)
def test_absolute_times_are_exact_to_the_nanosecond(text: str, ns: int) -> None:
    """Seconds, nanoseconds and ISO 8601 name a time to the nanosecond, whatever now is."""
    assert parse_moment(text) == Moment(ns)
    assert parse_moment(text).at(now_ns=77) == ns


@pytest.mark.parametrize(
    ("text", "ns"),
    [
        ("-3s", -3_000_000_000),
        ("-3", -3_000_000_000),
        ("-0.5", -500_000_000),
        ("-250ms", -250_000_000),
        ("+1us", 1_000),
        ("-2min", -120_000_000_000),
        ("-1 h", -3_600_000_000_000),
        ("now", 0),
    ],
)
def test_a_sign_makes_a_time_relative_to_now(text: str, ns: int) -> None:
    """A number with a sign is that far from now, in seconds without a unit; `now` is 0."""
    assert parse_moment(text) == Moment(ns, is_relative=True)
    assert parse_moment(text).at(now_ns=10**18) == 10**18 + ns


def test_a_date_without_a_zone_is_local_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """A date that names no zone is read in the machine's own."""
    assert parse_moment("2022-01-01T00:00:00").ns % 1_000_000_000 == 0
    assert parse_moment("2022-01-01") == parse_moment("2022-01-01T00:00:00")


@given(st.integers(10**15, 2**63 - 1))
def test_nanoseconds_are_read_back_as_they_are(ns: int) -> None:
    """A count of nanoseconds means itself, and the same as its seconds with nine digits."""
    assert parse_moment(str(ns)) == parse_moment(f"{ns // 10**9}.{ns % 10**9:09}") == Moment(ns)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "is not a time"),
        ("yesterday", "is not a time"),
        ("1e9", "is not a time"),
        ("nan", "is not a time"),
        ("2022-13-01", "is not a time"),
        ("99999999999999999999999h", "too far away"),
        ("-9999999999s", "too far away"),
        ("9223372036854775808", "too far away"),
        ("-3d", "unknown unit 'd'"),
        ("1649109418661", "append its unit"),
    ],
)
def test_what_is_no_time_gets_a_sentence(text: str, reason: str) -> None:
    """A text that is no time, or could be two, is refused with what may be written instead."""
    with pytest.raises(ValueError, match=reason):
        parse_moment(text)


@pytest.mark.parametrize(
    ("text", "s"),
    [
        ("3", 103),
        ("+3s", 103),
        ("3s", 103),
        ("2min", 220),
        ("0", 100),
        ("-3", 197),
        ("-3s", 197),
        ("-0s", 200),
        ("now", 200),
        ("99999999", 100_000_099),
        ("100000000", 100_000_000),
        ("1670400305.0", 1_670_400_305),
        ("1670400305000000000", 1_670_400_305),
        ("1970-01-01T00:00:05Z", 5),
    ],
)
def test_a_number_counts_from_the_beginning_of_a_recording(text: str, s: int) -> None:
    """3 is 3 s after its beginning, -3 is 3 s before its end, now its end; from 100,000,000 s on a
    number is a time since 1970, as a date always is.
    """
    second = 1_000_000_000
    assert parse_moment(text).within(100 * second, 200 * second) == s * second
