"""ROS's rclpy.action: actions with ROS's methods, which are actions of tfbus on the bus."""

from tfbus.compat.rclpy.action.client import ActionClient
from tfbus.compat.rclpy.action.server import ActionServer, CancelResponse, GoalResponse

__all__ = ["ActionClient", "ActionServer", "CancelResponse", "GoalResponse"]
