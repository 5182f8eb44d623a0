"""Moments as people write them: `1649109418.66`, `2026-11-21T09:00:00Z`, `-3s`, `now`."""

import re
from dataclasses import dataclass, field
from datetime import UTC, datetime
from decimal import Decimal

_NS_PER_UNIT = {
    "ns": 1,
    "us": 1_000,
    "ms": 1_000_000,
    "s": 1_000_000_000,
    "min": 60_000_000_000,
    "h": 3_600_000_000_000,
}
_NUMBER = re.compile(r"([+-]?)(\d+(?:\.\d*)?|\.\d+)\s*([a-z]*)")
_FRACTION = re.compile(r"(?<=:\d\d)[.,](\d+)")

# Whole numbers without a unit: seconds since 1970 stay below the first for 3000 years, and
# nanoseconds since 1970 passed the second after twelve days.
_SECONDS_BELOW = 10**11
_NANOSECONDS_FROM = 10**15

# Of a recording, numbers below this count from its beginning: three years, so that those from here
# on are times since 1970.
_ABSOLUTE_FROM_NS = 10**8 * 10**9

# The last stamp, and the most that can be added to now: 146 years.
_LAST_NS = 2**63 - 1
_FARTHEST_FROM_NOW_NS = 2**62


@dataclass(frozen=True)
class Moment:
    """A time in nanoseconds: since the Unix epoch, or since now if `is_relative`.

    Of a recording, one with `has_plus` counts from the beginning, another relative one from the
    end. A moment that is absolute and `is_number` was written without a sign, and not as a date.
    """

    ns: int
    is_relative: bool = False
    has_plus: bool = field(default=False, compare=False)
    is_number: bool = field(default=False, compare=False)

    def at(self, now_ns: int) -> int:
        """The moment in nanoseconds since the Unix epoch, if now is `now_ns`."""
        return now_ns + self.ns if self.is_relative else self.ns

    @property
    def is_from_beginning(self) -> bool:
        """Whether it counts from the beginning of a recording."""
        return self.has_plus or (self.is_number and self.ns < _ABSOLUTE_FROM_NS)

    def within(self, start_ns: int, end_ns: int) -> int:
        """The moment in a recording from `start_ns` to `end_ns`: `3` and `+3s` are 3 s after its
        beginning, `-3s` is 3 s before its end. A number from 100,000,000 s on counts since 1970. It
        may lie outside of the recording.
        """
        if self.is_from_beginning:
            return start_ns + self.ns
        return self.at(end_ns)


def parse_moment(text: str) -> Moment:
    """The moment that a text says. Raises ValueError for any other text.

    `now` is now. A number with a sign is relative to now, in seconds or in the unit that follows
    (ns, us, ms, s, min, h). A number without a sign counts from the Unix epoch: in its unit, or in
    seconds, or in nanoseconds if it is too large for seconds. Anything else is a date and time of
    ISO 8601, to the nanosecond, in local time if it names no zone.
    """
    text = text.strip()
    if text == "now":
        return Moment(0, is_relative=True)
    number = _NUMBER.fullmatch(text)
    moment = _counted(text, *number.groups()) if number else _dated(text)
    if abs(moment.ns) > (_FARTHEST_FROM_NOW_NS if moment.is_relative else _LAST_NS):
        raise ValueError(f"{text!r} is too far away: nanoseconds of 64 bits end in the year 2262")
    return moment


def _counted(text: str, sign: str, digits: str, unit: str) -> Moment:
    if unit and unit not in _NS_PER_UNIT:
        raise ValueError(f"{text!r} has an unknown unit {unit!r}; use {', '.join(_NS_PER_UNIT)}")
    ns = int(Decimal(digits) * _NS_PER_UNIT[unit or _implied_unit(text, sign, digits)])
    return Moment(
        -ns if sign == "-" else ns,
        is_relative=bool(sign),
        has_plus=sign == "+",
        is_number=not sign,
    )


def _implied_unit(text: str, sign: str, digits: str) -> str:
    if sign or "." in digits or int(digits) < _SECONDS_BELOW:
        return "s"
    if int(digits) >= _NANOSECONDS_FROM:
        return "ns"
    raise ValueError(
        f"{text!r} is too large for seconds and too small for nanoseconds since 1970; "
        "append its unit (ns, us, ms, s)"
    )


def _dated(text: str) -> Moment:
    try:
        # Python reads microseconds only.
        moment = datetime.fromisoformat(_FRACTION.sub("", text))
    except ValueError as error:
        raise ValueError(
            f"{text!r} is not a time; write seconds or nanoseconds since 1970, "
            "a date such as 2026-11-21T09:00:00.5Z, or a time from now such as -3s"
        ) from error
    since_epoch = moment.astimezone(UTC) - datetime.fromtimestamp(0, UTC)
    whole_ns = (since_epoch.days * 86_400 + since_epoch.seconds) * 1_000_000_000
    fraction = _FRACTION.search(text)
    return Moment(whole_ns + (int(f"{fraction[1]:0<9.9}") if fraction else 0))
