"""ROS's rclpy.utilities."""

import sys
from collections.abc import Sequence

from tfbus.compat.rclpy.context import current as get_default_context
from tfbus.compat.rclpy.context import is_ok as ok
from tfbus.compat.rclpy.context import split_arguments

__all__ = ["get_default_context", "ok", "remove_ros_args"]


def remove_ros_args(args: Sequence[str] | None = None) -> list[str]:
    """The arguments, by default `sys.argv`, without the ones of nodes: from --ros-args to -- or the
    end, and the options of `tfbus launch`.
    """
    return split_arguments(sys.argv if args is None else args)[0]
