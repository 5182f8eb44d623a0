"""ROS's rclpy.exceptions."""

__all__ = [
    "InvalidHandle",
    "InvalidParameterTypeException",
    "InvalidParameterValueException",
    "NotInitializedException",
    "ParameterAlreadyDeclaredException",
    "ParameterNotDeclaredException",
    "ParameterUninitializedException",
]


class NotInitializedException(RuntimeError):
    """`rclpy.init()` was not called, or `rclpy.shutdown()` was."""


class InvalidHandle(RuntimeError):
    """The object was destroyed."""


class InvalidParameterTypeException(Exception):
    """A parameter was set to a value of another type."""


class InvalidParameterValueException(Exception):
    """A parameter was set to a value that is not allowed."""


class ParameterNotDeclaredException(Exception):
    """The node has not declared a parameter of this name."""


class ParameterAlreadyDeclaredException(Exception):
    """The node has declared a parameter of this name before."""


class ParameterUninitializedException(Exception):
    """A parameter that was declared without a default has no value yet."""
