"""Transforms of ROS's layout from and to tfbus's; any object with ROS's fields will do."""

from typing import Any

from tfbus.compat.builtin_interfaces.msg import Time
from tfbus.compat.geometry_msgs import msg as ros
from tfbus.compat.rclpy.time import stamp_ns_of
from tfbus.compat.std_msgs.msg import Header
from tfbus.geometry.transform import Transform, TransformStamped

_SECOND_NS = 1_000_000_000


def stamped_of(message: Any) -> TransformStamped:
    """tfbus's TransformStamped of ROS's.

    Raises TypeError for an object without its fields, InvalidArgumentException where a number is
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


def message_of(stamped: TransformStamped) -> ros.TransformStamped:
    """ROS's TransformStamped of tfbus's."""
    sec, nanosec = divmod(stamped.stamp_ns, _SECOND_NS)
    x, y, z, qx, qy, qz, qw = stamped.transform.as_pose()
    return ros.TransformStamped(
        header=Header(stamp=Time(sec=sec, nanosec=nanosec), frame_id=stamped.frame_id),
        child_frame_id=stamped.child_frame_id,
        transform=ros.Transform(
            translation=ros.Vector3(x=x, y=y, z=z),
            rotation=ros.Quaternion(x=qx, y=qy, z=qz, w=qw),
        ),
    )
