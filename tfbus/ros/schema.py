"""Messages of topics as messages of ROS: a definition for each type, and the bytes in both
directions.
"""

import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import reduce
from typing import Any, get_args, get_origin, get_type_hints

from tfbus import messages
from tfbus.base.errors import DecodeError, InvalidArgumentException
from tfbus.base.wording import printable
from tfbus.messages.fields import ArrayOf
from tfbus.ros.cdr import CdrWriter
from tfbus.ros.counterparts import AS_IN_ROS, COUNTERPARTS, Counterpart, fitted, with_floats
from tfbus.ros.definitions import Definition
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
    TypeNames,
    definition_of,
    list_of,
    map_of,
    message_of,
    value_of_map,
)
from tfbus.ros.value_codec import UnfitError, ValueReader, codec_of
from tfbus.wire.codec import type_name as name_of

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


# Each holds the ones before it, as far as they are exact. FLOAT holds no other.
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
    if isinstance(hint, ArrayOf):
        numbers = [Scalar(hint.kind) for _ in hint.columns]
        keys = [path.replace(".", "_") for path in hint.columns]
        row = MessageType(f"{name}Item", _fields(keys, [*numbers]))
        return Sequence(row if hint.columns else Scalar(hint.kind))
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
        # Around a list only: any other type needs no message around it.
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


# Of one type of message. A publisher that sends more forms than these has no type to speak of.
_MOST_CODECS = 8

_MISFITS = (UnfitError, struct.error, OverflowError, UnicodeEncodeError)


class MessageCodec:
    """Writes and reads the messages of one type, as maps of their fields.

    `definition` is the type as ROS 2 has it. A value comes back as it was: integers of 64 bits,
    floats, texts, bytes, lists and maps with the order of their keys, bit by bit. Only if the
    type is a dataclass's or ROS's own, an integer in a field of floats comes back as the float that
    is the same number.
    """

    def __init__(
        self, message: MessageType, definition: Definition, counterpart: Counterpart | None = None
    ) -> None:
        self._message = message
        self._codec = codec_of(message)
        self._counterpart = counterpart
        self.definition = definition

    @staticmethod
    def of_type(message_type: type, names: TypeNames | None = None) -> "MessageCodec":
        """The codec of a dataclass, that of ROS's own type if it has one that says the same.
        Messages get names of their own among `names`.
        """
        name = name_of(message_type)
        if message_type is getattr(messages, message_type.__name__, None):  # not one of its name
            if (as_in_ros := AS_IN_ROS.get(name)) is not None:
                return MessageCodec.of_definition(as_in_ros.definition)
            if (counterpart := COUNTERPARTS.get(name)) is not None:
                return MessageCodec.of_definition(counterpart.definition, counterpart)
        return _codec(type_of_dataclass(message_type), names)

    @staticmethod
    def of_values(
        type_name: str, values: Mapping[str, Any], names: TypeNames | None = None
    ) -> "MessageCodec":
        """The codec that the values of one message of an unknown type suggest; RAW if ROS
        cannot express them as fields.
        """
        return _codec(type_of_values(type_name, values), names)

    @staticmethod
    def of_definition(
        definition: Definition, counterpart: Counterpart | None = None
    ) -> "MessageCodec":
        """The codec of a type of a file: any type of ROS 2, or one of ours. Its values have the
        fields of our `counterpart`, if there is one.

        Raises DecodeError if the definition is not valid, or has a wstring.
        """
        return MessageCodec(message_of(definition), definition, counterpart)

    @property
    def is_of_ros(self) -> bool:
        """Whether the type is ROS's own, which has our values under other names."""
        return self._counterpart is not None

    def encode(self, values: Mapping[str, Any]) -> bytes | None:
        """The message with these values; None if they are not of this type. An array of just the
        type's numbers, of numpy for example, is copied as a whole.
        """
        if self._counterpart is None:
            return self._written(values)
        try:
            values = self._counterpart.to_ros(values)
        except _MISFITS:
            return None
        written = self._written(values)
        if written is None and not self._counterpart.is_on_bus:
            # Programs write Vector3(1, 0, 0), and its fields are floats all the same.
            written = self._written(with_floats(values, self._message))
        return written

    def _written(self, values: Mapping[str, Any]) -> bytes | None:
        writer = CdrWriter()
        try:
            self._codec.write(writer, values if type(values) is dict else dict(values))
        except _MISFITS:
            return None
        return writer.message()

    def encode_fitted(self, values: Mapping[str, Any]) -> bytes | None:
        """As `encode`, of values of a program, which may be made to fit: floats are rounded to 32
        bits, and fields that are not there are zero.
        """
        data = self.encode(values)
        if data is not None:
            return data
        try:
            return self.encode(fitted(values, self._message))
        except UnfitError:
            return None

    def decode(self, data: bytes, *, arrays: bool = False) -> dict[str, Any]:
        """The values of a message by field; with `arrays` lists of numbers are arrays of numpy (N,)
        that share the memory of `data`. Raises DecodeError if the bytes are none.
        """
        reader = ValueReader(data, arrays=arrays)
        if self._codec.least_size > reader.left:
            raise DecodeError(
                f"the message has {reader.left} bytes, and its type at least "
                f"{self._codec.least_size}"
            )
        values = self._codec.read(reader)
        reader.finish()
        if not isinstance(values, dict):
            raise DecodeError("the message is no map of fields")
        return values if self._counterpart is None else self._counterpart.of_ros(values)


def _codec(message: MessageType, names: TypeNames | None) -> MessageCodec:
    message = (names or TypeNames()).named(message)
    return MessageCodec(message, definition_of(message))


# Any message, in MessagePack: if no type fits.
RAW = MessageCodec(MSGPACK, definition_of(MSGPACK))


# The types that nodes publish.
_KNOWN = {
    name_of(each): each for each in (messages.Clock, messages.Color, messages.Pose, messages.Twist)
}


class MessageCodecs:
    """The codecs of all messages of one file, made as messages come. Not thread-safe.

    A type of tfbus.messages has its own definition from the start, or ROS's. Any other has that of
    its first message, and another one, under a name with a number, once a message does not fit;
    after eight, and if ROS cannot express a message at all, it is RAW.

    Without `exact`, for eyes, numbers that are integers and floats in turn are all floats, so that
    the definition stays.
    """

    def __init__(self, *, exact: bool = True) -> None:
        self._names = TypeNames()
        self._floats = FLOAT if exact else NUMBER
        # Of each type the one used last first, each with its message as it would be named alone.
        self._of_type: dict[str, list[tuple[MessageCodec, MessageType]]] = {}

    def encode(self, type_name: str, values: Mapping[str, Any]) -> tuple[MessageCodec, bytes]:
        """A message of a type of this name, `Pose`, and the codec that reads it.

        If the name is not known, the topic's will do. Raises InvalidArgumentException for
        a text that is not valid Unicode, and an integer of more than 64 bits.
        """
        codecs = self._of_type.get(type_name)
        if codecs is None:
            codecs = self._of_type[type_name] = []
            known = COUNTERPARTS.get(type_name) or AS_IN_ROS.get(type_name)
            if known is not None:
                message = message_of(known.definition)
                codecs.append((MessageCodec(message, known.definition, known), message))
            elif type_name in _KNOWN:
                self._add(codecs, type_of_dataclass(_KNOWN[type_name]))
        is_ros = type_name in AS_IN_ROS
        for at, (codec, message) in enumerate(codecs):
            data = codec.encode(values)
            # On the bus a float of 32 bits may be one of Python, 0.1; ROS has it rounded.
            if data is None and is_ros and codec.is_of_ros:
                is_whole = values.keys() == {field.key for field in message.fields}
                data = codec.encode_fitted(values) if is_whole else None
            if data is not None:
                if at:
                    codecs.insert(0, codecs.pop(at))
                return codec, data
        return self._encode_new(type_name, codecs, values)

    def _encode_new(
        self,
        type_name: str,
        codecs: list[tuple[MessageCodec, MessageType]],
        values: Mapping[str, Any],
    ) -> tuple[MessageCodec, bytes]:
        message = type_of_values(type_name, values, self._floats)
        if message.kind == "fields" and len(codecs) < _MOST_CODECS:
            codec = self._add(codecs, self._wider(message, codecs))
            if (data := codec.encode(values)) is not None:
                return codec, data
        if (data := RAW.encode(values)) is None:
            raise InvalidArgumentException(
                f"a message of type '{printable(type_name, 60)}' cannot be written: it has a text "
                "that is not valid Unicode, or an integer of more than 64 bits"
            )
        return RAW, data

    def _wider(
        self, message: MessageType, codecs: list[tuple[MessageCodec, MessageType]]
    ) -> MessageType:
        """A type that takes the messages of a known one as well, if ROS can express both; for
        the last of a type anyhow. A type of ROS's own stays as it is.
        """
        for codec, before in codecs:
            if not codec.is_of_ros and have_same_keys(before, message):
                both = merged_fields(before, message)
                is_clear = packed_in(both) <= max(packed_in(before), packed_in(message))
                if is_clear or len(codecs) + 1 == _MOST_CODECS:
                    return both
        return message

    def _add(
        self, codecs: list[tuple[MessageCodec, MessageType]], message: MessageType
    ) -> MessageCodec:
        codec = _codec(message, self._names)
        codecs.insert(0, (codec, message))
        return codec
