"""Clocks other than ours: simulated, recorded, ahead or late. The one rule for all tools.

A stamp is *ahead* if it is later than our time by more than 20 ms, and by more than the
publisher's clock may differ from ours: a lookup at the present time then finds no sample, or an
old one. Samples are *late* if each comes over 1 s after its stamp, and over five periods of its
frame: the present time is then never covered.
"""

from collections.abc import Iterable
from dataclasses import dataclass

from tfbus.base.clock import SYSTEM_CLOCK, Clock, Limit, Wake
from tfbus.base.stamps import MOST_AHEAD_NS, is_of_simulated_clock, other_unit
from tfbus.base.wording import counted
from tfbus.recording.items import TopicItem
from tfbus.streams.info import StreamInfo
from tfbus.wire.descriptions import NodeDescription
from tfbus.wire.keys import CLOCK_TOPIC

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

# A measurement is rarely computed for longer, and if it is, seldom comes often.
_MOST_LATE_S, _MOST_LATE_PERIODS = 1.0, 5.0

# Stamps farther away than this are of another time, such as a simulated one.
_YEAR_S = 365.25 * 86_400

ASK_IF_SIMULATED = "is its time simulated? try --sim-time"


def is_ahead(age_s: float | None, stream: StreamInfo, *, is_simulated: bool) -> bool:
    """Whether an age of a sample of this stream, below zero, is of a stamp that is ahead.

    `is_simulated` is whether the age is by a simulated clock.
    """
    return age_s is not None and age_s < -_most_ahead_s(stream, is_simulated)


def is_late(delay_s: float | None, rate_hz: float | None, *, is_simulated: bool) -> bool:
    """Whether samples of this rate come so long after their stamps that no lookup at the present
    time finds one. `is_simulated` is whether the delay is by a simulated clock.
    """
    if delay_s is None or not rate_hz:
        return False
    most_s = _MOST_AHEAD_OF_SIMULATED_S if is_simulated else _MOST_LATE_S
    return delay_s > max(most_s, _MOST_LATE_PERIODS / rate_hz)


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
    """The question to ask about stamps of another clock than our own, which may be simulated."""
    return "is its node without --sim-time?" if is_simulated else ASK_IF_SIMULATED


def why_no_stamp(stamp_ns: int, now_ns: int) -> str:
    """Why a number is no stamp at this time: stamps like it "look like seconds", or "are 0"; "" for
    nanoseconds. By a simulated time, which begins at 0, they are.
    """
    if stamp_ns == 0 and not is_of_simulated_clock(now_ns):
        return "are 0"
    unit = other_unit(stamp_ns, now_ns)
    return f"look like {unit}" if unit else ""


# The type of the clock's topic, whatever its name.
_CLOCK = "Clock"


@dataclass(frozen=True)
class SimulatedTime:
    """The nodes that publish a simulated time, and the publishers of transforms that follow it.

    All by their full names. `publishers` counts all nodes that publish transforms.
    """

    clocks: tuple[str, ...] = ()
    followers: frozenset[str] = frozenset()
    publishers: int = 0

    @property
    def published(self) -> str:
        """`/clock publishes a simulated time`."""
        verb = "publishes" if len(self.clocks) == 1 else "publish"
        return f"{' and '.join(self.clocks)} {verb} a simulated time"

    @property
    def followed(self) -> str:
        """`the stamps of 1 of 2 publishers follow it`."""
        publishers = counted(self.publishers, "publisher")
        return f"the stamps of {len(self.followers)} of {publishers} follow it"


# Where nothing is known of it.
NOT_SIMULATED = SimulatedTime()


def simulated_time(nodes: Iterable[NodeDescription]) -> SimulatedTime:
    """The publishers and followers of a simulated time among these nodes."""
    nodes = tuple(nodes)
    clocks = tuple(node.name for node in nodes if _CLOCK in node.publishes.values())
    publishers = [node for node in nodes if node.streams]
    followers = [node.name for node in publishers if _CLOCK in node.subscribes.values()]
    return SimulatedTime(clocks, frozenset(followers if clocks else ()), len(publishers))


class RecordedClock(Clock):
    """Stands at `log_ns`; if it `follows` the recorded clock, at its last time instead."""

    def __init__(self, *, follows: bool = False) -> None:
        self.log_ns = 0
        self._follows = follows
        self._simulated_ns: int | None = None

    @property
    def is_simulated(self) -> bool:  # type: ignore[override]  # theirs can be set
        """Whether the time is simulated: it is from the first message of the recorded clock on."""
        return self._simulated_ns is not None

    def now_ns(self) -> int:
        return self.log_ns if self._simulated_ns is None else self._simulated_ns

    def elapsed_ns(self) -> int:
        return self.log_ns

    def limit(self, timeout_s: float | None, wake: Wake) -> Limit:
        return SYSTEM_CLOCK.limit(0.0, wake)  # it stands, and nothing comes meanwhile

    def log_s(self) -> float:
        """The log time in seconds."""
        return self.log_ns / 1e9

    def set_by(self, item: TopicItem, namespace: str = "") -> bool:
        """Set it by a message of the recorded clock, by no other; whether it was set back."""
        stamp_ns = item.values.get("stamp_ns")
        if not self._follows or type(stamp_ns) is not int or item.topic != clock_topic(namespace):
            return False
        before_ns, self._simulated_ns = self._simulated_ns, stamp_ns
        return before_ns is not None and stamp_ns < before_ns


def clock_topic(namespace: str = "") -> str:
    """The topic of the clock of a namespace, by its full name."""
    return f"{namespace}/{CLOCK_TOPIC}" if namespace else CLOCK_TOPIC


def follows_clock(nodes: Iterable[NodeDescription]) -> bool:
    """Whether all publishers of transforms followed a simulated time."""
    time = simulated_time(nodes)
    return bool(time.clocks) and len(time.followers) == time.publishers
