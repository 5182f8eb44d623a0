"""ROS's rclpy.clock."""

from typing import Any

from tfbus.base.clock import SYSTEM_CLOCK
from tfbus.base.clock import Clock as TfbusClock
from tfbus.compat.rclpy.time import ClockType, Time

__all__ = ["Clock", "ClockType", "ROSClock"]


class Clock:
    """A clock; a node's follows the topic `clock` if time is simulated."""

    def __init__(
        self,
        *,
        clock_type: ClockType = ClockType.SYSTEM_TIME,
        tfbus_clock: TfbusClock = SYSTEM_CLOCK,
    ) -> None:
        self._clock_type = clock_type
        self._clock = tfbus_clock

    @property
    def tfbus_clock(self) -> TfbusClock:
        """The clock of tfbus that it is."""
        return self._clock

    @property
    def clock_type(self) -> ClockType:
        """The kind of clock."""
        return self._clock_type

    @property
    def ros_time_is_active(self) -> bool:
        """Whether time is simulated."""
        return self._clock.is_simulated

    def now(self) -> Time:
        """The time now; 0 if it is simulated and has not begun."""
        steady = self._clock_type == ClockType.STEADY_TIME
        now_ns = self._clock.elapsed_ns() if steady else self._clock.now_ns()
        return Time(nanoseconds=max(0, now_ns), clock_type=self._clock_type)

    def create_jump_callback(self, *_: Any, **__: Any) -> Any:
        """Not there: listeners forget by themselves samples that a jump back has made wrong."""
        raise NotImplementedError(
            "tfbus.compat has no jump callbacks: buffers follow jumps of the clock by themselves, "
            "and node.tfbus_node.clock.add_jump_callback(callback) calls for jumps back"
        )

    def __repr__(self) -> str:
        return f"Clock(clock_type={self._clock_type.name})"


class ROSClock(Clock):
    """The clock of ROS_TIME, without a node: the system's."""

    def __init__(self) -> None:
        super().__init__(clock_type=ClockType.ROS_TIME)
