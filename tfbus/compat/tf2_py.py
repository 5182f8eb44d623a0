"""ROS's tf2_py: the buffer without a node, and the errors of transforms, which are tfbus's.

Times are `rclpy.time.Time` or a message's stamp, and 0 is the latest. `BufferCore.tfbus_buffer` is
the `tfbus.Buffer` underneath.
"""

from typing import Any

from tfbus.base.errors import (
    ConnectivityException,
    ExtrapolationException,
    FutureExtrapolationException,
    InvalidArgumentException,
    LookupException,
    PastExtrapolationException,
    TimeoutException,
    TransformException,
)
from tfbus.base.log import LogOnce, library_log
from tfbus.buffer.buffer import Buffer
from tfbus.buffer.formats import as_dot, as_yaml
from tfbus.compat.rclpy.duration import Duration, seconds_of
from tfbus.compat.rclpy.time import Time
from tfbus.ros.transforms import message_of, stamp_ns_of, stamped_of

__all__ = [
    "BufferCore",
    "ConnectivityException",
    "ExtrapolationException",
    "InvalidArgumentException",
    "LookupException",
    "TimeoutException",
    "TransformException",
]

Vector = tuple[float, float, float]

# The parameters that errors of tfbus advise, and the words of a program with ROS's names.
_IN_ROS = {
    "timeout_s": " (timeout=Duration(seconds=...))",
    "stamp_ns=None": ", Time()",
    "cache_time_s": " (cache_time)",
}

# The sentences of tf2 for times outside of the samples; programs look for them.
_BEGINNINGS: dict[type[TransformException], str] = {
    PastExtrapolationException: "Lookup would require extrapolation into the past: ",
    FutureExtrapolationException: "Lookup would require extrapolation into the future: ",
}


class BufferCore:
    """The transforms of the last `cache_time`, by default 10 s, with tf2's methods."""

    def __init__(self, cache_time: Duration | None = None) -> None:
        cache_time_s = 10.0 if cache_time is None else seconds_of(cache_time, "cache_time")
        self._buffer = Buffer(cache_time_s)
        self._once = LogOnce(library_log("tfbus.compat.tf2"))

    @property
    def tfbus_buffer(self) -> Buffer:
        """The buffer of tfbus, for all that tf2 has no method for."""
        return self._buffer

    # Filling it

    def set_transform(self, transform: Any, authority: str) -> None:
        """Store a transform, of ROS's layout; one older than the cache is logged and left out.

        Raises InvalidArgumentException for transforms that tf2 drops with a line in the log: a
        frame that is its own parent, numbers that are not finite, a quaternion not of length 1, a
        leading slash.
        """
        if not self._buffer.set_transform(stamped_of(transform), authority=authority):
            self._once.warning(
                ("old", transform.child_frame_id),
                "Left out a transform of %r, sent by %r: it is older than the newest by more than "
                "the cache time",
                transform.child_frame_id,
                authority,
            )

    def set_transform_static(self, transform: Any, authority: str) -> None:
        """Store a transform that holds at all times. Raises as `set_transform`."""
        self._buffer.set_transform(stamped_of(transform), static=True, authority=authority)

    def clear(self) -> None:
        """Forget all samples; static transforms stay."""
        self._buffer.clear()

    # Looking up

    def lookup_transform_core(self, target_frame: str, source_frame: str, time: Any) -> Any:
        """The transform that takes data in the source frame into the target frame, at that time.

        Raises LookupException, ConnectivityException, ExtrapolationException or
        InvalidArgumentException.
        """
        return self._look_up(target_frame, source_frame, time, 0.0)

    def lookup_transform_full_core(
        self, target_frame: str, target_time: Any, source_frame: str, source_time: Any,
        fixed_frame: str,
    ) -> Any:  # fmt: skip
        """The source as it was at one time, seen from the target at another."""
        return self._look_up_full(
            target_frame, target_time, source_frame, source_time, fixed_frame, 0.0
        )

    def can_transform_core(
        self, target_frame: str, source_frame: str, time: Any
    ) -> tuple[bool, str]:
        """Whether it can be looked up, and why not."""
        return self._can(target_frame, source_frame, time, 0.0)

    def can_transform_full_core(
        self, target_frame: str, target_time: Any, source_frame: str, source_time: Any,
        fixed_frame: str,
    ) -> tuple[bool, str]:  # fmt: skip
        """Whether it can be looked up, and why not."""
        return self._can_full(
            target_frame, target_time, source_frame, source_time, fixed_frame, 0.0
        )

    def get_latest_common_time(self, target_frame: str, source_frame: str) -> Time:
        """The latest time for which every edge between the two has data; 0 if all are static."""
        try:
            stamp_ns = self._buffer.latest_common_time(target_frame, source_frame)
        except TransformException as error:
            raise in_ros_words(error) from None
        return Time(nanoseconds=max(0, stamp_ns or 0))

    def lookupVelocityCore(
        self, tracking_frame: str, observation_frame: str, time: Any, averaging_interval: Any
    ) -> tuple[Vector, Vector]:
        """The velocity of a frame seen from another, linear in m/s and angular in rad/s."""
        return self.lookupVelocityFullCore(
            tracking_frame,
            observation_frame,
            observation_frame,
            (0.0, 0.0, 0.0),
            tracking_frame,
            time,
            averaging_interval,
        )

    def lookupVelocityFullCore(
        self, tracking_frame: str, observation_frame: str, reference_frame: str,
        reference_point: Any, reference_point_frame: str, time: Any, averaging_interval: Any,
    ) -> tuple[Vector, Vector]:  # fmt: skip
        """The velocity, in the axes of the reference frame, of the point that moves with the
        tracking frame and is at `reference_point` of its frame now.

        Of a moving observer, and for another point, it is the velocity that tf2 means to give and
        does not.
        """
        try:
            twist = self._buffer.lookup_twist(
                tracking_frame,
                observation_frame,
                _stamp(time),
                observation_frame=reference_frame,
                window_s=seconds_of(averaging_interval, "averaging_interval"),
            )
            at_ns = None if twist.stamp_ns == 0 else twist.stamp_ns
            origin = self._buffer.lookup_transform(reference_frame, tracking_frame, at_ns)
            point = self._buffer.lookup_transform(reference_frame, reference_point_frame, at_ns)
        except TransformException as error:
            raise in_ros_words(error) from None
        x, y, z = (
            a - b
            for a, b in zip(
                point.transform.apply(tuple(reference_point)).tolist(),
                origin.transform.xyz.tolist(),
                strict=True,
            )
        )
        vx, vy, vz = twist.linear.tolist()
        wx, wy, wz = twist.angular.tolist()
        linear = (vx + wy * z - wz * y, vy + wz * x - wx * z, vz + wx * y - wy * x)
        return linear, (wx, wy, wz)

    # Looking around

    def all_frames_as_yaml(self) -> str:
        """Every edge as YAML."""
        return as_yaml(self._buffer.all_frames())

    def all_frames_as_string(self) -> str:
        """A line for each edge."""
        return "".join(
            f"Frame {frame.name} exists with parent {frame.parent}.\n"
            for frame in self._buffer.all_frames()
            if frame.parent is not None
        )

    def _allFramesAsDot(self, time: Any = None) -> str:
        return as_dot(self._buffer.all_frames())

    def _getFrameStrings(self) -> list[str]:
        return self._buffer.frames()

    def _frameExists(self, frame_id: str) -> bool:
        return frame_id in self._buffer.frames()

    # With a timeout in seconds

    def _look_up(self, target_frame: str, source_frame: str, time: Any, timeout_s: float) -> Any:
        try:
            return message_of(
                self._buffer.lookup_transform(
                    target_frame, source_frame, _stamp(time), timeout_s=timeout_s
                )
            )
        except TransformException as error:
            raise in_ros_words(error) from None

    def _look_up_full(
        self, target_frame: str, target_time: Any, source_frame: str, source_time: Any,
        fixed_frame: str, timeout_s: float,
    ) -> Any:  # fmt: skip
        try:
            return message_of(
                self._buffer.lookup_transform_full(
                    target_frame,
                    _stamp(target_time, "target_time"),
                    source_frame,
                    _stamp(source_time, "source_time"),
                    fixed_frame,
                    timeout_s=timeout_s,
                )
            )
        except TransformException as error:
            raise in_ros_words(error) from None

    def _can(
        self, target_frame: str, source_frame: str, time: Any, timeout_s: float
    ) -> tuple[bool, str]:
        try:
            self._look_up(target_frame, source_frame, time, timeout_s)
        except TransformException as error:
            return False, str(error)
        return True, ""

    def _can_full(
        self, target_frame: str, target_time: Any, source_frame: str, source_time: Any,
        fixed_frame: str, timeout_s: float,
    ) -> tuple[bool, str]:  # fmt: skip
        try:
            self._look_up_full(
                target_frame, target_time, source_frame, source_time, fixed_frame, timeout_s
            )
        except TransformException as error:
            return False, str(error)
        return True, ""


def in_ros_words(error: TransformException) -> TransformException:
    """The error as tf2 raises it: after waiting the reason, and the text in ROS's words."""
    waited = ""
    if isinstance(error, TimeoutException) and error.reason is not None:
        timeout, error = error, error.reason
        error.waiting = error.waiting_by = ""
        if timeout.advice:
            error.advice, error.advice_by = timeout.advice, timeout.advice_by
        waited = f" ({timeout.fact})"
    error.args = (_BEGINNINGS.get(type(error), "") + error.fact,)
    error.waiting += _IN_ROS.get(error.waiting_by, "")
    error.advice += _IN_ROS.get(error.advice_by, "")
    error.waiting_by = error.advice_by = ""
    if error.advice:
        error.advice += waited
    else:
        error.args = (f"{error.fact}{waited}",)
    return error


def _stamp(time: Any, what: str = "time") -> int | None:
    """The stamp of a lookup, None for the latest."""
    return stamp_ns_of(time, what) or None
