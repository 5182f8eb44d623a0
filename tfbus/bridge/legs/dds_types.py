"""Types of ROS 2 for cyclonedds, whose samples are the bytes of messages."""

from functools import cache
from typing import Any

from cyclonedds.idl import make_idl_struct, types

from tfbus.ros.definition_text import message_of
from tfbus.ros.definitions import Definition
from tfbus.ros.message_type import PLACEHOLDER, MessageType, Scalar, Sequence, Text, Type
from tfbus.ros.rmw import dds_type

# Before the names of types in what cyclonedds tells of them, so that no type there is one of ROS.
# Cyclone answers each question about types, also one meant for others, with those it knows. For a
# type of ROS that has some of the same parts, Fast DDS 3 (ROS 2 Kilted) takes such an answer as the
# last, finds it inconsistent, and does not match the publishers of that type. Where Cyclone knows
# nothing of it, Fast DDS goes by the name of the type.
_OWN = "tfbus."

# As cyclonedds has them, by the names in ROS.
_SCALARS: dict[str, Any] = {
    "bool": bool,
    "byte": types.byte,
    "char": types.uint8,
    "int8": types.int8,
    "uint8": types.uint8,
    "int16": types.int16,
    "uint16": types.uint16,
    "int32": types.int32,
    "uint32": types.uint32,
    "int64": types.int64,
    "uint64": types.uint64,
    "float32": types.float32,
    "float64": types.float64,
}


class RawSample:
    """A message as its bytes; a class made by `raw_type` says of which type.

    To cyclonedds it looks like one of its structs, which it asks for bytes and makes of bytes.
    """

    __slots__ = ("data", "sample_info")

    def __init__(self, data: bytes) -> None:
        self.data = data
        # Set by the reader that it comes from.
        self.sample_info: Any = None

    def serialize(self, **_: object) -> bytes:
        """The bytes to send."""
        return self.data

    @classmethod
    def deserialize(cls, data: bytes) -> "RawSample":
        """A message that came."""
        return cls(data)

    @classmethod
    def deserialize_key(cls, data: bytes) -> "RawSample":
        """No message: a writer is gone."""
        return cls(data)


@cache
def raw_type(definition: Definition) -> type[RawSample]:
    """The type in DDS of messages of this definition. Raises DecodeError if that is not valid,
    or has a wstring.
    """
    idl = _struct(message_of(definition)).__idl__
    # The name of the type in DDS.
    idl.idl_transformed_typename = dds_type(definition.name)
    return type("RawMessage", (RawSample,), {"__slots__": (), "__idl__": idl})


def _struct(message: MessageType) -> Any:
    fields = {field.name: _type(field.type) for field in message.fields}
    dotted = _OWN + dds_type(message.name).replace("::", ".")
    leaf = dotted.rpartition(".")[2]
    return make_idl_struct(leaf, dotted, fields or {PLACEHOLDER: types.uint8})


def _type(type_: Type) -> Any:
    if isinstance(type_, Scalar):
        return _SCALARS[type_.name]
    if isinstance(type_, Text):
        return types.bounded_str[type_.most] if type_.most else str
    if isinstance(type_, Sequence):
        item = _type(type_.item)
        if type_.size is not None:
            return types.array[item, type_.size]
        return types.sequence[item, type_.most] if type_.most else types.sequence[item]
    return _struct(type_)
