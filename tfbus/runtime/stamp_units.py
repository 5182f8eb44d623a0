"""Stamps in another unit than nanoseconds, or of another clock: how they are noticed, and what to
say of them.
"""

# Differences of stamps up to this fit 64 bits: 146 years.
LATEST_STAMP_NS = 2**62 - 1

# Clocks that show less since 1970 are simulated, and begin at 0: ten years.
_LEAST_OF_A_REAL_CLOCK_NS = 315_360_000_000_000_000

# By one clock a stamp of a measurement is never later than now; this much is no harm.
MOST_AHEAD_NS = 20_000_000

_YEAR_NS = 31_557_600_000_000_000

_UNITS = {"seconds": 1_000_000_000, "milliseconds": 1_000_000, "microseconds": 1_000}

# A stamp in another unit is nearly always of this moment, or of the samples that are looked up: a
# day allows for time zones. With years, a simulation would come by such stamps often: within a year
# of now in milliseconds it is for a whole minute.
_NEAR_NS = 86_400_000_000_000

# No stamp above this, in nanoseconds, can be one in microseconds: cheap to tell.
LATEST_OF_ANOTHER_UNIT = LATEST_STAMP_NS // 1_000


def other_unit(stamp_ns: int, near_ns: int) -> str:
    """The unit, other than nanoseconds, in which a stamp is within a day of a time: "seconds",
    "milliseconds" or "microseconds"; "" if there is none.

    Near the time of a simulated clock, which begins at 0, any small stamp is right: "".
    """
    if near_ns < _LEAST_OF_A_REAL_CLOCK_NS:
        return ""
    for unit, factor in _UNITS.items():
        if abs(stamp_ns * factor - near_ns) <= _NEAR_NS:
            return unit
    return ""


def other_clock(stamp_ns: int, newest_ns: int) -> str:
    """The advice on a stamp more than ten years from the newest sample, which are of different
    clocks: as the end of a sentence without its full stop; "" for one that is nearer.
    """
    years = round(abs(stamp_ns - newest_ns) / _YEAR_NS)
    if abs(stamp_ns - newest_ns) < _LEAST_OF_A_REAL_CLOCK_NS:
        return ""
    side, whose = ("earlier", "this node") if newest_ns < stamp_ns else ("later", "its publisher")
    return (
        f"its newest sample is {years} years {side}, so its stamps are of another clock; if one of "
        f"the two is simulated, pass --sim-time to {whose} too"
    )


def unit_hint(stamp_ns: int, unit: str) -> str:
    """The advice on a stamp in another unit, as a sentence without its full stop."""
    seconds = stamp_ns * _UNITS[unit] / 1e9
    return (
        f"the stamp {stamp_ns} looks like {unit}, but stamps are nanoseconds: "
        f"tfbus.stamp_ns({seconds:.15g}) makes one of seconds"
    )
