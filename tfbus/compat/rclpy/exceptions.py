"""ROS's rclpy.exceptions."""

__all__ = [
    "InvalidHandle",
    "NotInitializedException",
    "ParameterAlreadyDeclaredException",
    "ParameterNotDeclaredException",
]


class NotInitializedException(RuntimeError):
    """`rclpy.init()` was not called, or `rclpy.shutdown()` was."""


class InvalidHandle(RuntimeError):
    """The object was destroyed."""


class ParameterNotDeclaredException(Exception):
    """The node has not declared a parameter of this name."""


class ParameterAlreadyDeclaredException(Exception):
    """The node has declared a parameter of this name before."""
