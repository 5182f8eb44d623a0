"""Stamps: from seconds, datetime and datetime64; in another unit, or of another clock."""

from math import isfinite
from typing import TYPE_CHECKING, Any, overload

from tfbus.base.errors import InvalidArgumentException
from tfbus.base.structs import Struct

if TYPE_CHECKING:
    from collections.abc import Sequence
    from datetime import datetime
    from decimal import Decimal
    from fractions import Fraction

    import numpy as np
    from numpy.typing import NDArray

    Time = int | float | Decimal | Fraction | datetime | np.datetime64

# Differences of stamps up to this fit 64 bits: 146 years.
LATEST_STAMP_NS = 2**62 - 1

# Clocks that show less since 1970 are simulated, and begin at 0: ten years.
_LEAST_OF_A_REAL_CLOCK_NS = 315_360_000_000_000_000

# By one clock a stamp of a measurement is never later than now; this much is no harm.
MOST_AHEAD_NS = 20_000_000

_YEAR_NS = 31_557_600_000_000_000

_SECOND_NS = 1_000_000_000
_UNITS = {"seconds": _SECOND_NS, "milliseconds": 1_000_000, "microseconds": 1_000}

# A stamp in another unit is nearly always of this moment, or of the samples that are looked up: a
# day allows for time zones. With years, a simulation would come by such stamps often: within a year
# of now in milliseconds it is for a whole minute.
_NEAR_NS = 86_400_000_000_000

# No stamp above this, in nanoseconds, can be one in microseconds: cheap to tell.
LATEST_OF_ANOTHER_UNIT = LATEST_STAMP_NS // 1_000


def is_of_simulated_clock(now_ns: int) -> bool:
    """Whether a clock that shows this is a simulated one, which began at 0."""
    return now_ns < _LEAST_OF_A_REAL_CLOCK_NS


def other_unit(stamp_ns: int, near_ns: int) -> str:
    """The unit, other than nanoseconds, in which a stamp is within a day of a time: "seconds",
    "milliseconds" or "microseconds"; "" if there is none.

    Near the time of a simulated clock, which begins at 0, any small stamp is right: "".
    """
    if is_of_simulated_clock(near_ns):
        return ""
    for unit, factor in _UNITS.items():
        if abs(stamp_ns * factor - near_ns) <= _NEAR_NS:
            return unit
    return ""


class Mistake(Struct):
    """The mistake of a stamp, and the advice, each as a part of a sentence."""

    fact: str
    advice: str


def other_clock(stamp_ns: int, newest_ns: int) -> Mistake | None:
    """The mistake if a stamp is more than ten years from the newest sample, which are of different
    clocks; None for one that is nearer.
    """
    years = round(abs(stamp_ns - newest_ns) / _YEAR_NS)
    if abs(stamp_ns - newest_ns) < _LEAST_OF_A_REAL_CLOCK_NS:
        return None
    side, whose = ("earlier", "this node") if newest_ns < stamp_ns else ("later", "its publisher")
    return Mistake(
        f"its newest sample is {years} years {side}, so its stamps are of another clock",
        f"if one of the two is simulated, pass --sim-time to {whose} too",
    )


def unit_hint(stamp_ns: int, unit: str) -> str:
    """The advice on a stamp in another unit, as a sentence without its full stop."""
    seconds = stamp_ns * _UNITS[unit] / 1e9
    return (
        f"the stamp {stamp_ns} looks like {unit}, but stamps are nanoseconds: "
        f"tfbus.stamp_ns({seconds:.15g}) makes one of seconds"
    )


# Farther from 1970, in years, a datetime64 may not fit nanoseconds, and wraps around silently.
_MOST_YEARS = 146


@overload
def stamp_ns(time: "Time") -> int: ...


@overload
def stamp_ns(time: "Sequence[Time] | NDArray[Any]") -> "NDArray[np.int64]": ...


def stamp_ns(time: "Time | Sequence[Time] | NDArray[Any]") -> "int | NDArray[np.int64]":
    """The stamp of a time: integer nanoseconds since the Unix epoch, as all stamps are.

    `time` is seconds since the epoch, or a datetime, or a numpy datetime64; of an array (N,) or a
    list of them the answer is an int64 array (N,).

    - A float is read as it is written: 1.1 is 1100000000. Today's seconds are exact to 0.2 us; an
      int, Decimal or Fraction is exact.
    - A datetime without a time zone is local time, as Python has it.
    - A datetime64 is UTC. Of a pandas Timestamp the nanoseconds are kept.

    Back: `stamp_ns / 1e9`, `np.datetime64(stamp_ns, "ns")`. Raises InvalidArgumentException for
    other types, and for times not within 146 years of 1970.
    """
    if isinstance(time, list | tuple) or (hasattr(time, "ndim") and time.ndim):
        return _stamps(time)
    stamp = _stamp(time)
    if not -LATEST_STAMP_NS <= stamp <= LATEST_STAMP_NS:
        raise _too_far(time)
    return stamp


def _stamp(time: Any) -> int:
    # Slow to import, and a node needs none of them.
    from datetime import UTC, datetime, timedelta
    from decimal import Decimal
    from fractions import Fraction

    if hasattr(time, "to_datetime64"):
        time = time.to_datetime64()  # a pandas Timestamp is a datetime, but to the nanosecond
    kind = getattr(getattr(time, "dtype", None), "kind", "")
    if kind == "M":
        return int(_of_datetime64(time))
    if isinstance(time, datetime):
        return (
            (time.astimezone(UTC) - datetime(1970, 1, 1, tzinfo=UTC))
            // timedelta(microseconds=1)
            * 1000
        )
    if kind == "f" or isinstance(time, float):
        seconds = float(time)
        time = Fraction(repr(seconds)) if isfinite(seconds) else seconds
    if isinstance(time, float | Decimal | Fraction):
        if not isfinite(time):
            raise InvalidArgumentException(f"time: seconds must be finite, not {time}")
        return round(Fraction(time) * _SECOND_NS)
    if hasattr(time, "__index__") and not isinstance(time, bool):
        return int(time.__index__()) * _SECOND_NS
    hint = ": datetime.fromisoformat(...) reads a text" if isinstance(time, str) else ""
    raise InvalidArgumentException(
        f"time: expected seconds, a datetime or a datetime64, got {type(time).__name__}{hint}"
    )


def _stamps(times: Any) -> "NDArray[np.int64]":
    import numpy as np

    array = np.asarray(times)
    if array.ndim != 1:
        raise InvalidArgumentException(f"times: expected shape (N,), got {array.shape}")
    if array.dtype.kind == "M":
        return _of_datetime64(array)
    # One by one, so that each is converted as it is alone.
    return np.array([stamp_ns(time) for time in array.tolist()], dtype=np.int64)


def _of_datetime64(times: Any) -> "NDArray[np.int64]":
    if (times != times).any():  # as NaT only
        raise InvalidArgumentException("time: NaT is not a time")
    if (abs(times.astype("datetime64[Y]").astype("int64")) >= _MOST_YEARS).any():
        raise _too_far(times)
    stamps: NDArray[np.int64] = times.astype("datetime64[ns]").astype("int64")
    return stamps


def _too_far(time: object) -> InvalidArgumentException:
    return InvalidArgumentException(
        f"the time {time!r:.60} is not within 146 years of 1970: numbers must be seconds since then"
    )
