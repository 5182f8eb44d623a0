"""Types of messages as ROS 2 has them, the values of their fields, and definitions as text.

Text is `ros2msg` of MCAP: written for our messages, read of any. The parts of our messages beyond
ROS stand in comments, `# tfbus: map`, which others pass over. So do the names of fields in ROS 1
that ROS 2 does not allow: `uint32 i_tow # tfbus: "iTOW"`.
"""

import dataclasses
import json
import re
import struct
from collections.abc import Iterator, Mapping
from collections.abc import Sequence as Items
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from typing import Any, Literal

from tfbus.base import lazy_numpy as np
from tfbus.base.errors import DecodeError
from tfbus.base.wording import printable

# Between a definition and the definitions of the messages in it.
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

# ROS 2's field of a message without fields.
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
    """A list of items; `name` is of a message around each, if ROS needs one."""
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


_REMARK = "# tfbus: "
_KINDS = ("map", "list", "value")

# Messages in messages; more come from a mistake or an attack.
_MOST_DEPTH = 50
_LONGEST_TEXT = 1_000_000

_FIELD = re.compile(
    r"\s*(?P<type>[A-Za-z][\w/]*)(?P<bound><=\d{1,9})?"
    r"(?P<array>\[(?:(?:<=)?[1-9]\d{0,8})?\])?\s+(?P<name>[A-Za-z]\w*)\s*(?P<rest>.*)"
)
_ROS2_FIELD = re.compile(r"[a-z](?:_?[a-z0-9])*")
_SEPARATOR = re.compile(r"={3,}\s*")
_MSG = re.compile(r"MSG:\s*([\w/]+)\s*")

# Names without a package, and definitions that writers leave out since everyone has them.
_SHORT_NAMES = {
    "time": "builtin_interfaces/msg/Time",
    "duration": "builtin_interfaces/msg/Duration",
    "Header": "std_msgs/msg/Header",
}
_EVERYWHERE = {
    "builtin_interfaces/msg/Time": ["int32 sec", "uint32 nanosec"],
    "builtin_interfaces/msg/Duration": ["int32 sec", "uint32 nanosec"],
    "std_msgs/msg/Header": ["builtin_interfaces/Time stamp", "string frame_id"],
}


def definition_of(message: MessageType) -> Definition:
    """The definition of one of our messages."""
    first, *others = messages_in(message)
    parts = [_section(first)]
    for each in others:
        parts.append(f"{SEPARATOR}\nMSG: {_short(each.name)}\n{_section(each)}")
    return Definition(message.name, "".join(parts))


@lru_cache(maxsize=200)
def message_of(definition: Definition) -> MessageType:
    """The message that a definition defines.

    Raises DecodeError, with the line, for a definition that is not valid, or has a wstring, or a
    message in itself, which are not read.
    """
    if len(definition.text) > _LONGEST_TEXT:
        raise DecodeError(f"a definition of {len(definition.text)} letters: at most a million")
    name = _full(definition.name)
    return Definitions(_EVERYWHERE | sections_in(definition.text, name)).message(name)


def text_of_ros(message: MessageType) -> str:
    """The text of a message of ROS with its constants and all messages in it, each behind the one
    that has it first.
    """
    found: dict[str, MessageType] = {}
    _add_depth_first(message, found)
    first, *others = found.values()
    parts = [_section(first)]
    parts += [f"{SEPARATOR}\nMSG: {_short(each.name)}\n{_section(each)}" for each in others]
    return "".join(parts)


def _add_depth_first(message: MessageType, found: dict[str, MessageType]) -> None:
    if message.name not in found:
        found[message.name] = message
        for field in message.fields:
            type_ = field.type.item if isinstance(field.type, Sequence) else field.type
            if isinstance(type_, MessageType):
                _add_depth_first(type_, found)


def _section(message: MessageType) -> str:
    lines = [f"{_REMARK}{message.kind}"] if message.kind in _KINDS else []
    lines += [
        f"{_type_text(each.type)} {each.name}={_constant_text(each)}" for each in message.constants
    ]
    lines += [_line(field) for field in message.fields] or [f"uint8 {PLACEHOLDER}"]
    return "".join(f"{line}\n" for line in lines)


def _line(field: MessageField) -> str:
    line = f"{_type_text(field.type)} {field.name}"
    return line if field.name == field.key else f"{line} {_REMARK}{json.dumps(field.key)}"


def _constant_text(constant: Constant) -> str:
    value = constant.value
    return str(int(value)) if isinstance(value, bool) else str(value)


def _type_text(type_: Type) -> str:
    if isinstance(type_, Scalar):
        return type_.name
    if isinstance(type_, Text):
        return f"string<={type_.most}" if type_.most else "string"
    if isinstance(type_, MessageType):
        return _short(type_.name)
    size = f"<={type_.most}" if type_.most else "" if type_.size is None else type_.size
    return f"{_type_text(type_.item)}[{size}]"


def _short(name: str) -> str:
    return name.replace("/msg/", "/")


def _full(name: str) -> str:
    """A name with its kind in the middle: `std_msgs/Header` as `std_msgs/msg/Header`."""
    package, _, leaf = name.rpartition("/")
    return name if "/" in package or not package else f"{package}/msg/{leaf}"


def sections_in(text: str, name: str = "") -> dict[str, list[str]]:
    """The lines of each message of a text by its full name; `name` is the first message's."""
    lines: list[str] = []
    sections = {name: lines} if name else {}
    after_separator = False
    for line in text.splitlines():
        if after_separator and (found := _MSG.fullmatch(line)):
            lines = sections.setdefault(_full(found[1]), [])
        elif not _SEPARATOR.fullmatch(line):
            lines.append(line)
        after_separator = _SEPARATOR.fullmatch(line) is not None
    return sections


def with_ros2_names(definition: Definition) -> Definition:
    """The definition with names that readers of ROS 2 take: a field `iTOW` is `i_tow` for them, and
    keeps its name for us.
    """
    sections: list[list[str]] = [[]]
    for line in definition.text.splitlines():
        if _SEPARATOR.fullmatch(line):
            sections.append([])
        sections[-1].append(line)
    lines = [line for section in sections for line in _renamed(section)]
    return Definition(definition.name, "".join(f"{line}\n" for line in lines))


def _renamed(lines: list[str]) -> Iterator[str]:
    """The lines of one message with names that ROS 2 allows."""
    fields = [_FIELD.fullmatch(line) for line in lines]
    taken = {found["name"] for found in fields if found and _is_allowed(found)}
    for line, found in zip(lines, fields, strict=True):
        if found is None or _is_allowed(found):
            yield line
            continue
        plain = _snake(found["name"])
        name, number = plain, 1
        while name in taken:
            number += 1
            name = f"{plain}_{number}"
        taken.add(name)
        yield f"{line[: found.start('name')]}{name} {_REMARK}{json.dumps(found['name'])}"


def _is_allowed(found: re.Match[str]) -> bool:
    """Whether ROS 2 allows the name; names of constants stay anyhow."""
    is_constant = found["rest"].startswith("=")
    return is_constant or _ROS2_FIELD.fullmatch(found["name"]) is not None


def _is_renamed(name: str, former: str) -> bool:
    """Whether `with_ros2_names` makes this name of a former one."""
    return name != former and re.fullmatch(rf"{_snake(former)}(_\d+)?", name) is not None


def _snake(name: str) -> str:
    """A name in lower case with single underscores between words: `i_tow` of iTOW."""
    words = re.sub(r"([a-z0-9])([A-Z])", r"\1_\2", name).lower()
    return "_".join(filter(None, re.findall(r"[a-z0-9]+", words)))


class Definitions:
    """Makes messages of the lines that define them, by their full names."""

    def __init__(self, sections: Mapping[str, Items[str]]) -> None:
        self._sections = sections
        self._made: dict[str, MessageType] = {}

    def message(self, name: str, inside: tuple[str, ...] = ()) -> MessageType:
        """The message of this full name, `inside` of these others.

        Raises DecodeError, with the line, if its definition is not valid.
        """
        if name in self._made:
            return self._made[name]
        if name == MSGPACK.name:
            return MSGPACK
        shown = printable(name, 100)
        if name in inside or len(inside) >= _MOST_DEPTH:
            raise DecodeError(f"the definition of {shown} contains itself, or too many others")
        if name not in self._sections:
            raise DecodeError(f"the definition of {shown} is missing")
        fields: list[MessageField] = []
        constants: list[Constant] = []
        kind = "fields"
        for line in self._sections[name]:
            remark = line.removeprefix(_REMARK) if _is_ours(name) else ""
            if remark in _KINDS:
                kind = remark
                continue
            found = self._line(line, name, (*inside, name))
            if isinstance(found, MessageField):
                fields.append(found)
            elif found is not None:
                constants.append(found)
        if [field.name for field in fields] == [PLACEHOLDER]:
            fields = []
        message = MessageType(name, tuple(fields), constants=tuple(constants))
        message = self._made[name] = _checked(message, kind)
        return message

    def _line(
        self, line: str, name: str, inside: tuple[str, ...]
    ) -> MessageField | Constant | None:
        """The definition in a line; None for a line without a field, and a constant that is not
        read.
        """
        if not (stripped := line.strip()) or stripped[0] in "#@":
            return None
        found = _FIELD.fullmatch(line)
        if not found or (found["bound"] and found["type"] != "string"):
            raise DecodeError(
                f"'{printable(stripped, 60)}' in the definition of {printable(name, 100)} is no "
                "field"
            )
        rest = found["rest"]
        if rest.startswith("="):
            return _constant(found["type"], found["name"], rest[1:].strip())
        type_ = self._type(found["type"], int((found["bound"] or "<=0")[2:]), inside)
        if found["array"]:
            size = found["array"][1:-1]
            if size.startswith("<="):
                type_ = Sequence(type_, most=int(size[2:]))
            else:
                type_ = Sequence(type_, int(size) if size else None)
        key = _key(found["rest"])
        if key is not None and not _is_ours(name) and not _is_renamed(found["name"], key):
            key = None  # a comment of others
        default = _default(type_, rest)
        return MessageField(found["name"], type_, found["name"] if key is None else key, default)

    def _type(self, name: str, bound: int, inside: tuple[str, ...]) -> Type:
        if name in SCALARS:
            return Scalar(name)
        if name == "string":
            return Text(bound)
        if name == "wstring":
            raise DecodeError(f"{printable(inside[-1], 100)} has a wstring, which is not read")
        if "/" not in name:
            package = inside[-1].partition("/")[0]
            own = f"{package}/msg/{name}"
            name = own if own in self._sections else _SHORT_NAMES.get(name, own)
        return self.message(_full(name), inside)


def _constant(type_name: str, name: str, text: str) -> Constant | None:
    type_ = Text() if type_name == "string" else Scalar(type_name)
    value = _value(type_, text) if type_name == "string" or type_name in SCALARS else None
    return None if value is None else Constant(name, type_, value)


def _default(type_: Type, text: str) -> Any:
    """The default that stands behind a field; None for none, and for one that is not read."""
    if not text or text.startswith("#"):
        return None
    if isinstance(type_, Sequence):
        text = text.partition("#")[0].strip()
        if not (text.startswith("[") and text.endswith("]")):
            return None
        items = [_value(type_.item, item.strip()) for item in text[1:-1].split(",") if item.strip()]
        return None if None in items else items
    return _value(type_, text)


def _value(type_: Type, text: str) -> Any:
    """The value that a text stands for; None if it is none of this type."""
    if isinstance(type_, Text):
        return text[1:-1] if len(text) > 1 and text[0] == text[-1] and text[0] in "\"'" else text
    text = text.partition("#")[0].strip()
    try:
        if not isinstance(type_, Scalar):
            return None
        if type_.name == "bool":
            return {"true": True, "false": False, "1": True, "0": False}.get(text.lower())
        return float(text) if type_.name.startswith("float") else int(text, 0)
    except ValueError:
        return None


def _is_ours(name: str) -> bool:
    return name.startswith(PACKAGE)


def _key(rest: str) -> str | None:
    """The name in the map that stands behind a field."""
    if not rest.startswith(_REMARK):
        return None
    try:
        key = json.loads(rest.removeprefix(_REMARK))
    except (ValueError, RecursionError):
        return None
    return key if isinstance(key, str) else None


def _checked(message: MessageType, kind: str) -> MessageType:
    """The message as this kind, if it has the fields of one; else as it is."""
    types = [field.type for field in message.fields]
    if kind == "list":
        return replace(message, kind="list")
    if kind == "value" and len(types) == 1:
        return replace(message, kind="value")
    if kind == "map" and len(types) == 1 and _are_entries(types[0]):
        return replace(message, kind="map")
    return message


def _are_entries(type_: Type) -> bool:
    if not isinstance(type_, Sequence) or not isinstance(type_.item, MessageType):
        return False
    entry = type_.item
    types = [field.type for field in entry.fields]
    return entry.kind == "fields" and len(types) == 2 and isinstance(types[0], Text)
