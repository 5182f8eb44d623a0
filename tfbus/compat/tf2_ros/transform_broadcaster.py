"""ROS's tf2_ros.transform_broadcaster."""

from collections.abc import Iterable
from typing import Any

from tfbus.base.arguments import called_as
from tfbus.compat.rclpy.node import node_of_transforms
from tfbus.compat.tf2_ros.transform_listener import warn_of_qos
from tfbus.geometry.transform import TransformStamped
from tfbus.ros.transforms import stamped_of
from tfbus.streams.broadcaster import TransformBroadcaster as TfbusBroadcaster

__all__ = ["TransformBroadcaster"]


class TransformBroadcaster:
    """Sends dynamic transforms. QoS is not applied, which is logged."""

    @called_as("TransformBroadcaster(node)")
    def __init__(self, node: Any, qos: Any = None) -> None:
        warn_of_qos(node, "TransformBroadcaster", qos)
        self.tfbus_broadcaster = TfbusBroadcaster(node_of_transforms(node, "/tf"))

    def sendTransform(self, transform: Any) -> None:
        """Send a TransformStamped, or several in one message.

        Raises InvalidArgumentException for a transform that tf2's listeners drop with a line in the
        log, such as one whose quaternion is not of length 1.
        """
        self.tfbus_broadcaster.send_transform(as_tfbus(transform))


def as_tfbus(transform: Any) -> TransformStamped | list[TransformStamped]:
    """tfbus's transforms of the argument of `sendTransform`."""
    if isinstance(transform, Iterable):
        return [stamped_of(each) for each in transform]
    return stamped_of(transform)
