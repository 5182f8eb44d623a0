"""ROS's rclpy.time."""

from enum import IntEnum
from functools import total_ordering
from typing import Any

from tfbus.compat.rclpy.duration import Duration
from tfbus.ros.transforms import TimeBase, TimeMessage

__all__ = ["ClockType", "Duration", "Time"]

_SECOND_NS = 1_000_000_000


class ClockType(IntEnum):
    """Which clock a time is of; times of different clocks cannot be compared."""

    ROS_TIME = 1
    SYSTEM_TIME = 2
    STEADY_TIME = 3


@total_ordering
class Time(TimeBase):
    """A time since the Unix epoch, of `seconds` and `nanoseconds` together.

    `Time()` is 0, which asks a lookup for the latest. A time of `node.get_clock()` or `from_msg` is
    ROS_TIME, another one SYSTEM_TIME unless `clock_type` says so. Raises ValueError if it is
    negative, OverflowError if it does not fit 64 bits.
    """

    __slots__ = ("_clock_type",)

    def __init__(
        self,
        *,
        seconds: float = 0,
        nanoseconds: int = 0,
        clock_type: ClockType = ClockType.SYSTEM_TIME,
    ) -> None:
        if not isinstance(clock_type, ClockType):
            raise TypeError(f"clock_type must be a ClockType, not {clock_type!r}")
        if seconds < 0 or nanoseconds < 0:
            raise ValueError(
                f"a Time must not be negative: seconds={seconds}, nanoseconds={nanoseconds}"
            )
        self._nanoseconds = int(seconds * _SECOND_NS) + int(nanoseconds)
        if self._nanoseconds >= 2**63:
            raise OverflowError(
                f"a Time of {self._nanoseconds} ns does not fit 64 bits: it counts nanoseconds"
            )
        self._clock_type = clock_type

    @property
    def nanoseconds(self) -> int:
        """Nanoseconds since the epoch."""
        return self._nanoseconds

    @property
    def clock_type(self) -> ClockType:
        """The clock that it is of."""
        return self._clock_type

    def seconds_nanoseconds(self) -> tuple[int, int]:
        """Whole seconds, and the nanoseconds after them."""
        return divmod(self._nanoseconds, _SECOND_NS)

    def to_msg(self) -> Any:
        """As a message's stamp holds it."""
        sec, nanosec = divmod(self._nanoseconds, _SECOND_NS)
        return TimeMessage(sec=sec, nanosec=nanosec)

    @classmethod
    def from_msg(cls, msg: Any, clock_type: ClockType = ClockType.ROS_TIME) -> "Time":
        """From a message's stamp, with the fields sec and nanosec."""
        if not hasattr(msg, "nanosec"):
            raise TypeError(
                "Time.from_msg takes a message's stamp, a builtin_interfaces.msg.Time, not a "
                f"{type(msg).__name__}"
            )
        return cls(seconds=msg.sec, nanoseconds=msg.nanosec, clock_type=clock_type)

    def __add__(self, other: Duration) -> "Time":
        if not isinstance(other, Duration):
            return NotImplemented
        return Time(nanoseconds=self._nanoseconds + other.nanoseconds, clock_type=self._clock_type)

    __radd__ = __add__

    def __sub__(self, other: "Time | Duration") -> Any:
        """A Duration from another Time, a Time from a Duration."""
        if isinstance(other, Time):
            self._check_clock(other)
            return Duration(nanoseconds=self._nanoseconds - other._nanoseconds)
        if not isinstance(other, Duration):
            return NotImplemented
        return Time(nanoseconds=self._nanoseconds - other.nanoseconds, clock_type=self._clock_type)

    def _check_clock(self, other: "Time") -> None:
        if self._clock_type != other._clock_type:
            raise TypeError(
                f"times of {self._clock_type.name} and {other._clock_type.name} cannot be compared "
                "or subtracted: give both the same clock_type"
            )

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Time):
            return NotImplemented
        self._check_clock(other)
        return self._nanoseconds == other._nanoseconds

    def __lt__(self, other: object) -> bool:
        if not isinstance(other, Time):
            return NotImplemented
        self._check_clock(other)
        return self._nanoseconds < other._nanoseconds

    def __hash__(self) -> int:
        return hash(self._nanoseconds)

    def __repr__(self) -> str:
        return f"Time(nanoseconds={self._nanoseconds}, clock_type={self._clock_type.name})"
