"""ROS's tf2_ros.static_transform_broadcaster."""

from typing import Any

from tfbus.base.arguments import called_as
from tfbus.compat.rclpy.node import node_of_transforms
from tfbus.compat.tf2_ros.transform_broadcaster import as_tfbus
from tfbus.compat.tf2_ros.transform_listener import warn_of_qos
from tfbus.streams.broadcaster import StaticTransformBroadcaster as TfbusBroadcaster

__all__ = ["StaticTransformBroadcaster"]


class StaticTransformBroadcaster:
    """Sends static transforms, also to listeners that come later. QoS is not applied, which is
    logged.
    """

    @called_as("StaticTransformBroadcaster(node)")
    def __init__(self, node: Any, qos: Any = None) -> None:
        warn_of_qos(node, "StaticTransformBroadcaster", qos)
        self.tfbus_broadcaster = TfbusBroadcaster(node_of_transforms(node, "/tf_static"))

    def sendTransform(self, transform: Any) -> None:
        """Add a TransformStamped, or several, or replace the ones of the same child frame.

        Raises as `TransformBroadcaster.sendTransform`.
        """
        self.tfbus_broadcaster.send_transform(as_tfbus(transform))
