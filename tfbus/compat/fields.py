"""Transforms of ROS's layout from and to tfbus's; any object with ROS's fields will do."""

from collections.abc import Sequence
from typing import Any

from tfbus.compat import used_messages as ros
from tfbus.compat.rclpy.time import stamp_ns_of
from tfbus.geometry.transform import Transform, TransformStamped

_SECOND_NS = 1_000_000_000


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
    return ros.TransformStamped(
        header=ros.Header(stamp=ros.Time(sec=sec, nanosec=nanosec), frame_id=parent),
        child_frame_id=child,
        transform=ros.Transform(
            translation=ros.Vector3(x=x, y=y, z=z),
            rotation=ros.Quaternion(x=qx, y=qy, z=qz, w=qw),
        ),
    )
