"""Types of the fields of a message, as ROS 2 has them, and what their values are in a map."""

import dataclasses
import struct
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, Literal

from tfbus.core import lazy_numpy as np

# Between a definition and those of the messages in it.
SEPARATOR = "=" * 80

# As struct has them, by the names in ROS.
SCALARS = {
    "bool": "?",
    "byte": "B",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}

# Sequences of these are bytes.
OCTETS = frozenset(("byte", "char", "uint8"))

# What ROS 2 puts into a message without fields.
PLACEHOLDER = "structure_needs_at_least_one_member"


@dataclass(frozen=True)
class Definition:
    """The name of a message type, `tf2_msgs/msg/TFMessage`, and its text with all in it."""

    name: str
    text: str


@dataclass(frozen=True)
class Scalar:
    """A number or a boolean, by its name in ROS.

    With `takes_ints` an integer may stand for the float that is the same number, as in all typed
    messages of tfbus; it comes back as that float.
    """

    name: str
    takes_ints: bool = False


@dataclass(frozen=True)
class Text:
    """A text of at most `most` bytes; 0 for no limit."""

    most: int = 0


@dataclass(frozen=True)
class Sequence:
    """A list, or bytes if the items are. `size` is the number of items if it is fixed, `most`
    the greatest; 0 for no limit.
    """

    item: "Type"
    size: int | None = None
    most: int = 0

    @property
    def is_octets(self) -> bool:
        """Whether the value is bytes."""
        return isinstance(self.item, Scalar) and self.item.name in OCTETS


@dataclass(frozen=True)
class MessageField:
    """A field by its name in ROS; `key` is its name in the map, and `default` the value of a new
    message if that is not zero.
    """

    name: str
    type: "Type"
    key: str
    default: Any = dataclasses.field(default=None, compare=False)


@dataclass(frozen=True)
class Constant:
    """A value that a message type has a name for."""

    name: str
    type: Scalar | Text
    value: Any


@dataclass(frozen=True)
class MessageType:
    """A message by its full name, `tfbus_msgs/msg/Pose`.

    Its value is a map of its fields; with `kind` "map" the map of its entries, which have a key and
    a value; with "list" the list of its fields; with "value" the value of its only field, since ROS
    has no list of lists; with "msgpack" any value, in MessagePack. "unknown" is the item of a list
    that was empty: it is written as MessagePack, and no value fits it.
    """

    name: str
    fields: tuple[MessageField, ...]
    kind: Literal["fields", "map", "list", "value", "msgpack", "unknown"] = "fields"
    constants: tuple[Constant, ...] = dataclasses.field(default=(), compare=False)


Type = Scalar | Text | Sequence | MessageType


@dataclass(frozen=True)
class Rows:
    """A sequence of numbers, or of messages that hold numbers of one type only, in the memory of an
    array: (N,), or (N, width) with `columns`, the paths of the numbers in a message.
    """

    kind: str
    columns: tuple[str, ...] = ()

    @property
    def dtype(self) -> str:
        """The type of the numbers as numpy has it, little-endian."""
        return f"<{SCALARS[self.kind]}"

    @property
    def size(self) -> int:
        """The bytes of a row."""
        return struct.calcsize(self.dtype) * max(len(self.columns), 1)

    def of_memory(self, data: Any) -> Any:
        """The array on these bytes. Raises ValueError if they are not whole rows."""
        array = np.frombuffer(data, self.dtype)
        return array.reshape(-1, len(self.columns)) if self.columns else array

    def is_of(self, array: Any) -> bool:
        """Whether it is an array of numpy with such rows."""
        shape = getattr(array, "shape", None)
        tail = (len(self.columns),) if self.columns else ()
        return shape is not None and shape[1:] == tail and array.dtype == np.dtype(self.dtype)

    def maps_of(self, array: Any) -> list[dict[str, Any]]:
        """The messages of an array with columns, as maps."""
        paths = [column.split(".") for column in self.columns]
        made = []
        for row in array.tolist():
            message: dict[str, Any] = {}
            for path, number in zip(paths, row, strict=True):
                below = message
                for name in path[:-1]:
                    below = below.setdefault(name, {})
                below[path[-1]] = number
            made.append(message)
        return made


@cache
def rows_of(type_: Type) -> Rows | None:
    """How a sequence of any length lies in the memory of an array; None for one that does not."""
    if not isinstance(type_, Sequence) or type_.size is not None:
        return None
    if isinstance(type_.item, Scalar):
        return Rows(type_.item.name) if type_.item.name != "bool" else None
    if not isinstance(type_.item, MessageType) or type_.item.kind != "fields":
        return None
    numbers = [*_numbers_in(type_.item, "")]
    kinds = {kind for _, kind in numbers}
    if len(kinds) != 1 or not kinds <= _ROW_KINDS or len(numbers) > _MOST_COLUMNS:
        return None
    return Rows(kinds.pop(), tuple(path for path, _ in numbers))


# Longer messages are no rows of an array.
_MOST_COLUMNS = 16
_ROW_KINDS = {"float32", "float64"}


def _numbers_in(message: MessageType, path: str) -> Iterator[tuple[str, str]]:
    """The paths and types of the numbers in a message, "" for the type of all else."""
    for field in message.fields:
        below = f"{path}{field.key}"
        if isinstance(field.type, MessageType) and field.type.kind == "fields":
            yield from _numbers_in(field.type, f"{below}.")
        else:
            yield below, field.type.name if isinstance(field.type, Scalar) else ""


BOOL = Scalar("bool")
INT = Scalar("int64")
UNSIGNED = Scalar("uint64")
FLOAT = Scalar("float64")
NUMBER = Scalar("float64", takes_ints=True)
TEXT = Text()
BYTES = Sequence(Scalar("uint8"))

PACKAGE = "tfbus_msgs/msg/"
_PACKED = (MessageField("data", BYTES, "data"),)
MSGPACK = MessageType(f"{PACKAGE}Msgpack", _PACKED, "msgpack")
UNKNOWN = MessageType(f"{PACKAGE}Msgpack", _PACKED, "unknown")


def list_of(item: Type, name: str, size: int | None = None) -> Sequence:
    """A list of items; `name` is that of a message around each, if ROS needs one."""
    if isinstance(item, Sequence):
        item = MessageType(name, (MessageField("items", item, "items"),), "value")
    return Sequence(item, size)


def map_of(value: Type, name: str) -> MessageType:
    """A map by text, as a message of this name."""
    fields = (MessageField("key", TEXT, "key"), MessageField("value", value, "value"))
    entry = MessageType(f"{name}Entry", fields)
    return MessageType(name, (MessageField("entries", Sequence(entry), "entries"),), "map")


def value_of_map(message: MessageType) -> Type:
    """The type of a map's values."""
    entries = message.fields[0].type
    assert isinstance(entries, Sequence) and isinstance(entries.item, MessageType)
    return entries.item.fields[1].type


def messages_in(message: MessageType) -> Iterator[MessageType]:
    """The messages in a message, each name once, itself first."""
    found = {message.name: message}
    for each in (waiting := [message]):
        for field in each.fields:
            type_ = field.type.item if isinstance(field.type, Sequence) else field.type
            if isinstance(type_, MessageType) and type_.name not in found:
                found[type_.name] = type_
                waiting.append(type_)
    return iter(found.values())


class TypeNames:
    """The names of messages in one file: no two different messages have the same."""

    def __init__(self) -> None:
        self._of_name: dict[str, MessageType] = {MSGPACK.name: MSGPACK}

    def named(self, message: MessageType) -> MessageType:
        """The message, and each in it, under a name of its own: with a number if the name is
        taken by another.
        """
        if message.kind in ("msgpack", "unknown"):
            return message
        fields = tuple(replace(field, type=self._named(field.type)) for field in message.fields)
        message = replace(message, fields=fields)
        name, number = message.name, 1
        while self._of_name.setdefault(message.name, message) != message:
            number += 1
            message = replace(message, name=f"{name}{number}")
        return message

    def _named(self, type_: Type) -> Type:
        if isinstance(type_, Sequence):
            return replace(type_, item=self._named(type_.item))
        return self.named(type_) if isinstance(type_, MessageType) else type_
