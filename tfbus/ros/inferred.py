"""Types of messages: from the type hints of a dataclass, or from the values of a message."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import reduce
from typing import Any, get_args, get_origin, get_type_hints

from tfbus.ros.message_type import (
    BOOL,
    BYTES,
    FLOAT,
    INT,
    MSGPACK,
    NUMBER,
    PACKAGE,
    PLACEHOLDER,
    TEXT,
    UNKNOWN,
    UNSIGNED,
    MessageField,
    MessageType,
    Scalar,
    Sequence,
    Type,
    list_of,
    map_of,
    value_of_map,
)

# Beyond these, values are MessagePack: a schema for them would help no reader.
_MOST_DEPTH = 12
_MOST_FIELDS = 200
_LONGEST_KEY = 100

_SIMPLE: dict[Any, Type] = {bool: BOOL, int: INT, float: NUMBER, str: TEXT, bytes: BYTES}


def type_of_dataclass(message_type: type) -> MessageType:
    """The type of a message that is a dataclass, from its type hints as wire.codec reads them."""
    return _of_dataclass(message_type, ())


def type_of_values(name: str, values: Mapping[str, Any], floats: Scalar = FLOAT) -> MessageType:
    """The type of a message of a type of this name, from its values: MSGPACK if they are no
    fields. A float among them has the type `floats`: FLOAT, or NUMBER if it may be an integer
    in the next message.
    """
    return _Values(floats).of_fields(ros_name(name), values, 0) if _are_fields(values) else MSGPACK


def merged(one: Type, other: Type) -> Type:
    """The type that holds the values of both; MSGPACK if no other does."""
    if one == other or other == UNKNOWN:
        return one
    if one == UNKNOWN:
        return other
    if one in _NUMBERS and other in _NUMBERS:
        return max(one, other, key=_NUMBERS.index)
    if isinstance(one, Sequence) and isinstance(other, Sequence):
        if not one.is_octets and not other.is_octets:
            size = one.size if one.size == other.size else None
            return Sequence(merged(one.item, other.item), size)
    elif isinstance(one, MessageType) and isinstance(other, MessageType):
        return _merged_messages(one, other)
    return MSGPACK


# Each holds those before it, as far as they are exact. FLOAT holds no other.
_NUMBERS: list[Type] = [INT, UNSIGNED, NUMBER]


def ros_name(name: str) -> str:
    """The full name in ROS of a type of this name: `Spawn.Request` as tfbus_msgs/msg/SpawnRequest.

    Letters and digits stay, and each word begins with a capital.
    """
    words = re.findall(r"[A-Za-z0-9]+", name)
    leaf = "".join([word[0].upper() + word[1:] for word in words])[:_LONGEST_KEY]
    if not leaf[:1].isalpha():
        leaf = f"Type{leaf}"
    return f"{PACKAGE}{leaf}"


def field_names(keys: list[str]) -> list[str]:
    """The names in ROS of fields with these keys: lower case with underscores, each once."""
    names: list[str] = []
    for key in keys:
        snake = re.sub(r"([a-z0-9])([A-Z])", r"\1_\2", key)
        name = "_".join(re.findall(r"[a-z0-9]+", snake.lower()))
        if not name[:1].isalpha() or name == PLACEHOLDER:
            name = f"field_{name}".rstrip("_")
        plain, number = name, 1
        while name in names:
            number += 1
            name = f"{plain}_{number}"
        names.append(name)
    return names


def _fields(keys: list[str], types: list[Type]) -> tuple[MessageField, ...]:
    return tuple(map(MessageField, field_names(keys), types, keys))


# From type hints


def _of_dataclass(message_type: type, inside: tuple[type, ...]) -> MessageType:
    if message_type in inside:
        return MSGPACK  # ROS has no messages in themselves
    hints = get_type_hints(message_type)
    keys = [field.name for field in fields(message_type)]
    name = ros_name(message_type.__qualname__.rpartition("<locals>.")[2])
    inside = (*inside, message_type)
    types = [_of_hint(hints[key], f"{name}{_camel(key)}", inside) for key in keys]
    return MessageType(name, _fields(keys, types))


def _of_hint(hint: Any, name: str, inside: tuple[type, ...]) -> Type:
    if hint in _SIMPLE:
        return _SIMPLE[hint]
    if is_dataclass(hint) and isinstance(hint, type):
        return _of_dataclass(hint, inside)
    items = get_args(hint)
    if get_origin(hint) is tuple and Ellipsis not in items:
        types = [_of_hint(item, f"{name}{at}", inside) for at, item in enumerate(items)]
        if types and all(each == types[0] for each in types):
            return list_of(types[0], f"{name}Item", len(types))
        return MessageType(name, _fields([f"item{at}" for at in range(len(types))], types), "list")
    if get_origin(hint) in (list, tuple):
        return list_of(_of_hint(items[0], f"{name}Item", inside), f"{name}Item")
    if get_origin(hint) is dict:
        return map_of(_of_hint(items[1], f"{name}Value", inside), name)
    return MSGPACK


# From values


@dataclass(frozen=True)
class _Values:
    """Types from values, in which floats have the type `floats`."""

    floats: Scalar

    def of_fields(self, name: str, values: Mapping[str, Any], depth: int) -> MessageType:
        types = [
            self._of_value(value, f"{name}{_camel(key)}", depth) for key, value in values.items()
        ]
        return MessageType(name, _fields(list(values), types))

    def _of_value(self, value: Any, name: str, depth: int) -> Type:
        if isinstance(value, int) and not isinstance(value, bool):
            return INT if -(2**63) <= value < 2**63 else UNSIGNED if 0 < value < 2**64 else MSGPACK
        if type(value) in _SIMPLE:
            return self._simple(type(value))
        if depth < _MOST_DEPTH:
            if isinstance(value, list):
                return list_of(self._of_items(value, f"{name}Item", depth + 1), f"{name}Item")
            if isinstance(value, dict) and all(isinstance(key, str) for key in value):
                return self._of_map(value, name, depth + 1)
        return MSGPACK

    def _simple(self, kind: type) -> Type:
        return self.floats if kind is float else _SIMPLE[kind]

    def _of_items(self, values: list[Any], name: str, depth: int) -> Type:
        kinds = set(map(type, values))
        if len(kinds) == 1 and (kind := kinds.pop()) in (bool, float, str, bytes):
            return self._simple(kind)
        types: list[Type] = [UNKNOWN]
        for value in values:
            if (type_ := self._of_value(value, name, depth)) != types[-1]:
                types.append(type_)
        return reduce(merged, types)

    def _of_map(self, values: dict[str, Any], name: str, depth: int) -> Type:
        if values and _are_fields(values):
            return self.of_fields(name, values, depth)
        return map_of(self._of_items(list(values.values()), f"{name}Value", depth), name)


def _are_fields(values: Mapping[str, Any]) -> bool:
    return len(values) <= _MOST_FIELDS and all(
        isinstance(key, str) and len(key) <= _LONGEST_KEY for key in values
    )


def _camel(key: str) -> str:
    return ros_name(key).removeprefix(PACKAGE)


# Both


def have_same_keys(one: MessageType, other: MessageType) -> bool:
    """Whether both have the same fields in the same order, by the names in the map."""
    return [field.key for field in one.fields] == [field.key for field in other.fields]


def _merged_messages(one: MessageType, other: MessageType) -> Type:
    kinds = {one.kind, other.kind}
    if kinds == {"value"}:
        inner = merged(one.fields[0].type, other.fields[0].type)
        # Around a list only: what else it becomes needs no message around it.
        return _around(one, inner) if isinstance(inner, Sequence) else inner
    if not kinds <= {"fields", "map"}:
        return MSGPACK
    if kinds == {"fields"} and have_same_keys(one, other):
        return merged_fields(one, other)
    types: list[Type] = [UNKNOWN, *_value_types(one), *_value_types(other)]
    value = reduce(merged, types)
    return map_of(value, one.name) if value != MSGPACK else MSGPACK


def merged_fields(one: MessageType, other: MessageType) -> MessageType:
    """Messages with the same keys, each field merged."""
    pairs = zip(one.fields, other.fields, strict=True)
    return replace(
        one, fields=tuple(replace(own, type=merged(own.type, its.type)) for own, its in pairs)
    )


def packed_in(type_: Type) -> int:
    """How many parts of a type are MessagePack."""
    if isinstance(type_, Sequence):
        return packed_in(type_.item)
    if not isinstance(type_, MessageType):
        return 0
    if type_.kind == "msgpack":
        return 1
    return sum(packed_in(field.type) for field in type_.fields if type_.kind != "unknown")


def _around(message: MessageType, inner: Type) -> MessageType:
    return replace(message, fields=(replace(message.fields[0], type=inner),))


def _value_types(message: MessageType) -> list[Type]:
    if message.kind == "map":
        return [value_of_map(message)]
    return [field.type for field in message.fields]
