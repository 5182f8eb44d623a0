"""Times and transforms in ROS's layout and in tfbus's; any object with ROS's fields will do."""

from collections.abc import Sequence
from typing import Any

from tfbus.geometry.transform import Transform, TransformStamped
from tfbus.ros.message_classes import message_class

_SECOND_NS = 1_000_000_000

# The messages that tfbus.compat makes itself.
TimeMessage: Any = message_class("builtin_interfaces/msg/Time")
DurationMessage: Any = message_class("builtin_interfaces/msg/Duration")
Header: Any = message_class("std_msgs/msg/Header")
TransformStampedMessage: Any = message_class("geometry_msgs/msg/TransformStamped")
TFMessage: Any = message_class("tf2_msgs/msg/TFMessage")
_Vector3: Any = message_class("geometry_msgs/msg/Vector3")
_Quaternion: Any = message_class("geometry_msgs/msg/Quaternion")
_Transform: Any = message_class("geometry_msgs/msg/Transform")


class TimeBase:
    """The base of Time, which is recognized by it before rclpy is imported."""

    __slots__ = ("_nanoseconds",)
    _nanoseconds: int


def stamp_ns_of(time: Any, what: str = "time") -> int:
    """Nanoseconds since the epoch of a Time, or of a message's stamp; of rclpy's and rospy's too.

    Raises TypeError for another type, such as a Duration, or seconds as a number.
    """
    if isinstance(time, TimeBase):
        return time._nanoseconds
    if hasattr(time, "nanosec"):
        return int(time.sec) * _SECOND_NS + int(time.nanosec)
    if hasattr(time, "clock_type"):  # rclpy's: its Duration has nanoseconds, and no clock
        return int(time.nanoseconds)
    if hasattr(time, "nsecs"):
        return int(time.secs) * _SECOND_NS + int(time.nsecs)
    hint = ": write Time(seconds=...), or Time() for the latest"
    raise TypeError(
        f"{what} must be a Time or the stamp of a message, not a {type(time).__name__}{hint}"
    )


def stamped_of(message: Any) -> TransformStamped:
    """tfbus's TransformStamped of ROS's.

    Raises TypeError for an object without its fields, InvalidArgumentException if a number is
    not finite, a quaternion not of length 1, or a frame's name invalid.
    """
    if isinstance(message, TransformStamped):
        return message
    try:
        header = message.header
        motion = message.transform
        return TransformStamped(
            stamp_ns_of(header.stamp, "header.stamp"),
            header.frame_id,
            message.child_frame_id,
            transform_of(motion.translation, motion.rotation),
        )
    except AttributeError as error:
        raise TypeError(
            f"expected a geometry_msgs.msg.TransformStamped, got a {type(message).__name__}: "
            f"{error}"
        ) from None


def transform_of(translation: Any, rotation: Any) -> Transform:
    """tfbus's Transform of ROS's Vector3, or Point, and Quaternion."""
    return Transform(
        (translation.x, translation.y, translation.z),
        (rotation.x, rotation.y, rotation.z, rotation.w),
    )


def message_of(stamped: TransformStamped) -> Any:
    """ROS's TransformStamped of tfbus's."""
    return message_with(
        stamped.stamp_ns, stamped.frame_id, stamped.child_frame_id, stamped.transform.as_pose()
    )


def message_with(stamp_ns: int, parent: str, child: str, pose: Sequence[float]) -> Any:
    """ROS's TransformStamped of a pose: x, y, z, and a quaternion x, y, z, w."""
    sec, nanosec = divmod(stamp_ns, _SECOND_NS)
    x, y, z, qx, qy, qz, qw = pose
    return TransformStampedMessage(
        header=Header(stamp=TimeMessage(sec=sec, nanosec=nanosec), frame_id=parent),
        child_frame_id=child,
        transform=_Transform(
            translation=_Vector3(x=x, y=y, z=z),
            rotation=_Quaternion(x=qx, y=qy, z=qz, w=qw),
        ),
    )
