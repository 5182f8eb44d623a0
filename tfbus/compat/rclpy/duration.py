"""ROS's rclpy.duration."""

from functools import total_ordering
from math import isnan
from typing import Any

from tfbus.ros.transforms import DurationMessage

__all__ = ["Duration", "Infinite"]

_SECOND_NS = 1_000_000_000
_END_NS = 2**63


@total_ordering
class Duration:
    """A span of time, of `seconds` and `nanoseconds` together; may be negative.

    Raises OverflowError if it does not fit 64 bits of nanoseconds.
    """

    __slots__ = ("_nanoseconds",)

    def __init__(self, *, seconds: float = 0, nanoseconds: int = 0) -> None:
        self._nanoseconds = int(seconds * _SECOND_NS) + int(nanoseconds)
        if not -_END_NS <= self._nanoseconds < _END_NS:
            raise OverflowError(
                f"a Duration of {self._nanoseconds} ns does not fit 64 bits: it counts nanoseconds"
            )

    @property
    def nanoseconds(self) -> int:
        """The whole span, in nanoseconds."""
        return self._nanoseconds

    def to_msg(self) -> Any:
        """As a message holds it."""
        sec, nanosec = divmod(self._nanoseconds, _SECOND_NS)
        return DurationMessage(sec=sec, nanosec=nanosec)

    @classmethod
    def from_msg(cls, msg: Any) -> "Duration":
        """From a message's duration, with the fields sec and nanosec."""
        if not hasattr(msg, "nanosec"):
            raise TypeError(
                "Duration.from_msg takes a builtin_interfaces.msg.Duration, not a "
                f"{type(msg).__name__}"
            )
        return cls(seconds=msg.sec, nanoseconds=msg.nanosec)

    def __add__(self, other: "Duration") -> "Duration":
        if not isinstance(other, Duration):
            return NotImplemented
        return Duration(nanoseconds=self._nanoseconds + other._nanoseconds)

    def __sub__(self, other: "Duration") -> "Duration":
        if not isinstance(other, Duration):
            return NotImplemented
        return Duration(nanoseconds=self._nanoseconds - other._nanoseconds)

    def __mul__(self, factor: float) -> "Duration":
        if isinstance(factor, int):
            return Duration(nanoseconds=self._nanoseconds * factor)
        if not isinstance(factor, float):
            return NotImplemented
        if isnan(factor):
            raise ValueError("a Duration times NaN is no duration")
        product = self._nanoseconds * factor
        return Infinite if product == float("inf") else Duration(nanoseconds=int(product))

    def __neg__(self) -> "Duration":
        return Duration(nanoseconds=-self._nanoseconds)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Duration):
            return NotImplemented
        return self._nanoseconds == other._nanoseconds

    def __lt__(self, other: object) -> bool:
        if not isinstance(other, Duration):
            return NotImplemented
        return self._nanoseconds < other._nanoseconds

    def __hash__(self) -> int:
        return hash(self._nanoseconds)

    def __repr__(self) -> str:
        return f"Duration(nanoseconds={self._nanoseconds})"


# Longer than any wait.
Infinite = Duration(nanoseconds=_END_NS - 1)


def seconds_of(timeout: Any, what: str = "timeout") -> float:
    """The seconds of a Duration, of tfbus's, rclpy's or rospy's.

    Raises TypeError for another type, such as a plain number.
    """
    if type(timeout) is Duration:
        return timeout._nanoseconds / 1e9
    if hasattr(timeout, "nanoseconds") and not hasattr(timeout, "clock_type"):
        return float(timeout.nanoseconds / 1e9)
    if hasattr(timeout, "to_sec"):
        return float(timeout.to_sec())
    raise TypeError(
        f"{what} must be a Duration, not a {type(timeout).__name__}: write "
        f"{what}=Duration(seconds=...)"
    )
