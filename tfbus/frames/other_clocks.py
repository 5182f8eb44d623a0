"""Stamps by another clock than ours: ahead of it, or of another time. The one rule for all tools.

A stamp is *ahead* if it is later than our time by more than 20 ms, and by more than the
publisher's clock may differ from ours: a lookup at the present time then finds no sample, or an
old one.
"""

from tfbus.listen.info import StreamInfo
from tfbus.runtime.stamps import MOST_AHEAD_NS

# Clocks of hosts that are synchronised differ by less; above this, lookups at a node's own "now"
# fail or extrapolate.
MOST_SKEW_S = 0.1

_MOST_AHEAD_S = MOST_AHEAD_NS / 1e9

# A simulated clock goes in steps, of seconds where it is fast, and some processes get its time
# before others.
_MOST_AHEAD_OF_SIMULATED_S = 10.0

# ROS's publishers of map -> odom stamp it this far ahead by default (transform_tolerance), so that
# lookups at the present time find it.
_MOST_AHEAD_IN_ROS_S = 1.0

# Stamps farther away than this are of another time, such as a simulated one.
_YEAR_S = 365.25 * 86_400

ASK_IF_SIMULATED = "is its time simulated? try --sim-time"


def is_ahead(age_s: float | None, stream: StreamInfo, *, is_simulated: bool) -> bool:
    """Whether an age of a sample of this stream, below zero, is of a stamp that is ahead.

    `is_simulated` is whether the age is by a simulated clock.
    """
    return age_s is not None and age_s < -_most_ahead_s(stream, is_simulated)


def _most_ahead_s(stream: StreamInfo, is_simulated: bool) -> float:
    if is_simulated:
        return _MOST_AHEAD_OF_SIMULATED_S
    skew_s = stream.clock_offset_s
    tolerated_s = MOST_SKEW_S if skew_s is None else min(max(skew_s, 0.0), MOST_SKEW_S)
    # A stream of ROS has an origin, or in a recording no host.
    of_ros_s = _MOST_AHEAD_IN_ROS_S if stream.origin or not stream.host else 0.0
    return _MOST_AHEAD_S + tolerated_s + of_ros_s


def is_another_time(age_s: float | None) -> bool:
    """Whether an age is more than a year, in the past or in the future."""
    return age_s is not None and abs(age_s) > _YEAR_S


def whose_clock(*, is_simulated: bool) -> str:
    """What to ask where stamps are of another clock than one's own, which may be simulated."""
    return "is its node without --sim-time?" if is_simulated else ASK_IF_SIMULATED
