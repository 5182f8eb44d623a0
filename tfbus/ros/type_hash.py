"""Hashes of message types, RIHS01: `RIHS01_` and 64 hexadecimal digits, as ROS 2 computes them.

The hash is SHA-256 of the type's description in JSON, with those of the messages in it:
https://www.ros.org/reps/rep-2016.html. Constants, defaults and comments are not part of it.
"""

import json
from functools import lru_cache
from hashlib import sha256
from typing import Any

from tfbus.ros.definition_text import message_of
from tfbus.ros.definitions import Definition
from tfbus.ros.message_type import PLACEHOLDER, Message, Scalar, Sequence, Text, Type, messages_in

# type_description_interfaces/msg/FieldType
_MESSAGE = 1
_SCALARS = {
    "int8": 2,
    "uint8": 3,
    "char": 3,  # of .msg files: a character of IDL is 13
    "int16": 4,
    "uint16": 5,
    "int32": 6,
    "uint32": 7,
    "int64": 8,
    "uint64": 9,
    "float32": 10,
    "float64": 11,
    "bool": 15,
    "byte": 16,
}
_TEXT, _BOUNDED_TEXT = 17, 21
_ARRAY, _BOUNDED_SEQUENCE, _SEQUENCE = 48, 96, 144


@lru_cache
def type_hash(definition: Definition) -> str:
    """The hash of a message type.

    Raises DecodeError for a definition that is not valid, or has a wstring.
    """
    message = message_of(definition)
    first, *others = map(_description, messages_in(message))
    others.sort(key=lambda each: str(each["type_name"]))
    described = {"type_description": first, "referenced_type_descriptions": others}
    return f"RIHS01_{sha256(json.dumps(described).encode()).hexdigest()}"


def _description(message: Message) -> dict[str, Any]:
    fields = [{"name": field.name, "type": _type(field.type)} for field in message.fields]
    if not fields:
        fields = [{"name": PLACEHOLDER, "type": _type(Scalar("uint8"))}]
    return {"type_name": message.name, "fields": fields}


def _type(type_: Type) -> dict[str, Any]:
    kind, capacity = 0, 0
    if isinstance(type_, Sequence):
        kind = _BOUNDED_SEQUENCE if type_.most else _SEQUENCE if type_.size is None else _ARRAY
        capacity = type_.most or type_.size or 0
        type_ = type_.item
    most = type_.most if isinstance(type_, Text) else 0
    return {
        "type_id": kind + _type_id(type_),
        "capacity": capacity,
        "string_capacity": most,
        "nested_type_name": type_.name if isinstance(type_, Message) else "",
    }


def _type_id(type_: Type) -> int:
    if isinstance(type_, Scalar):
        return _SCALARS[type_.name]
    if isinstance(type_, Text):
        return _BOUNDED_TEXT if type_.most else _TEXT
    return _MESSAGE
