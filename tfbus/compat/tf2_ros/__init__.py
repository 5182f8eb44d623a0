"""ROS's package tf2_ros over tfbus: change the imports, and most programs run."""

from typing import TYPE_CHECKING

from tfbus.compat.modules import missing_names
from tfbus.compat.rclpy.duration import Duration
from tfbus.compat.rclpy.time import Time
from tfbus.compat.tf2_py import (
    BufferCore,
    ConnectivityException,
    ExtrapolationException,
    InvalidArgumentException,
    LookupException,
    TimeoutException,
    TransformException,
)
from tfbus.compat.tf2_ros.buffer import Buffer
from tfbus.compat.tf2_ros.buffer_interface import (
    BufferInterface,
    ConvertRegistration,
    NotImplementedException,
    Stamped,
    TransformRegistration,
    TypeException,
    convert,
)
from tfbus.compat.tf2_ros.static_transform_broadcaster import StaticTransformBroadcaster
from tfbus.compat.tf2_ros.transform_broadcaster import TransformBroadcaster
from tfbus.compat.tf2_ros.transform_listener import TransformListener
from tfbus.ros.transforms import Header, TFMessage
from tfbus.ros.transforms import TransformStampedMessage as TransformStamped

__all__ = [
    "Buffer",
    "BufferCore",
    "BufferInterface",
    "ConnectivityException",
    "ConvertRegistration",
    "Duration",
    "ExtrapolationException",
    "Header",
    "InvalidArgumentException",
    "LookupException",
    "NotImplementedException",
    "Stamped",
    "StaticTransformBroadcaster",
    "TFMessage",
    "Time",
    "TimeoutException",
    "TransformBroadcaster",
    "TransformException",
    "TransformListener",
    "TransformRegistration",
    "TransformStamped",
    "TypeException",
    "convert",
]

# Names of tf2_ros that are not here, and their substitutes.
_INSTEAD = {
    "BufferClient": "each process has a Buffer, which receives only what it needs by "
    "tfbus.TransformListener(buffer, node, reads='needed')",
    "BufferServer": "each process has a Buffer",
    "StaticTransformListener": "a TransformListener receives static transforms too",
}


if not TYPE_CHECKING:  # type checkers find missing names themselves
    __getattr__ = missing_names(__name__, _INSTEAD, "tfbus.Buffer and tfbus.Node may have it")
