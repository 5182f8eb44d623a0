"""ROS's messages that tfbus.compat makes itself."""

from typing import Any

from tfbus.compat.message_classes import message_class

Time: Any = message_class("builtin_interfaces/msg/Time")
Duration: Any = message_class("builtin_interfaces/msg/Duration")
Header: Any = message_class("std_msgs/msg/Header")
Vector3: Any = message_class("geometry_msgs/msg/Vector3")
Quaternion: Any = message_class("geometry_msgs/msg/Quaternion")
Transform: Any = message_class("geometry_msgs/msg/Transform")
TransformStamped: Any = message_class("geometry_msgs/msg/TransformStamped")
TFMessage: Any = message_class("tf2_msgs/msg/TFMessage")
