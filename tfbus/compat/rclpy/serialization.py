"""ROS's rclpy.serialization: messages as their bytes in ROS, which is CDR."""

from typing import Any

from tfbus.base.errors import DecodeError
from tfbus.ros.definitions import standard_definition
from tfbus.ros.schema import MessageCodec
from tfbus.wire.codec import from_map

__all__ = ["deserialize_message", "serialize_message"]


def serialize_message(message: Any) -> bytes:
    """The bytes of a message. Raises TypeError and ValueError with the field that is wrong."""
    encoded = _codec(type(message)).encode_fitted(type(message).__write__(message, ""))
    if encoded is None:
        raise ValueError("the message has a text that is not valid Unicode")
    return encoded


def deserialize_message(serialized_message: bytes, message_type: type) -> Any:
    """The message in the bytes. Raises DecodeError."""
    return from_map(message_type, _codec(message_type).decode(serialized_message, arrays=True))


def _codec(message_type: Any) -> MessageCodec:
    definition = standard_definition(getattr(message_type, "__ros_name__", ""))
    if definition is None:
        raise DecodeError(f"{message_type.__name__} has no definition in ROS: bytes are of those")
    return MessageCodec.of_definition(definition)
