"""Definitions as text, `ros2msg` of MCAP: written for our messages, read of any.

What our messages say beyond ROS stands in comments, `# tfbus: map`, which others pass over. So do
the names of fields in ROS 1 that ROS 2 does not allow: `uint32 i_tow # tfbus: "iTOW"`.
"""

import json
import re
from collections.abc import Iterator
from dataclasses import replace

from tfbus.errors import DecodeError
from tfbus.ros.definitions import SEPARATOR, Definition
from tfbus.ros.message_type import (
    MSGPACK,
    PACKAGE,
    PLACEHOLDER,
    SCALARS,
    Field,
    Message,
    Scalar,
    Sequence,
    Text,
    Type,
    messages_in,
)
from tfbus.wording import printable

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

# Names without a package, and what writers leave out since everyone has it.
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


def definition_of(message: Message) -> Definition:
    """The definition of one of our messages."""
    first, *others = messages_in(message)
    parts = [_section(first)]
    for each in others:
        parts.append(f"{SEPARATOR}\nMSG: {_short(each.name)}\n{_section(each)}")
    return Definition(message.name, "".join(parts))


def message_of(definition: Definition) -> Message:
    """The message that a definition defines.

    Raises DecodeError, with the line, for a definition that is not valid, or has what is not read:
    wstring, and messages in themselves.
    """
    if len(definition.text) > _LONGEST_TEXT:
        raise DecodeError(f"a definition of {len(definition.text)} letters: at most a million")
    name = _full(definition.name)
    return _Definitions(name, _sections(name, definition.text)).message(name, ())


def _section(message: Message) -> str:
    lines = [f"{_REMARK}{message.kind}"] if message.kind in _KINDS else []
    lines += [_line(field) for field in message.fields] or [f"uint8 {PLACEHOLDER}"]
    return "".join(f"{line}\n" for line in lines)


def _line(field: Field) -> str:
    line = f"{_type_text(field.type)} {field.name}"
    return line if field.name == field.key else f"{line} {_REMARK}{json.dumps(field.key)}"


def _type_text(type_: Type) -> str:
    if isinstance(type_, Scalar):
        return type_.name
    if isinstance(type_, Text):
        return f"string<={type_.most}" if type_.most else "string"
    if isinstance(type_, Message):
        return _short(type_.name)
    size = f"<={type_.most}" if type_.most else "" if type_.size is None else type_.size
    return f"{_type_text(type_.item)}[{size}]"


def _short(name: str) -> str:
    return name.replace("/msg/", "/")


def _full(name: str) -> str:
    """A name with what it is in the middle: `std_msgs/Header` as `std_msgs/msg/Header`."""
    package, _, leaf = name.rpartition("/")
    return name if "/" in package or not package else f"{package}/msg/{leaf}"


def _sections(name: str, text: str) -> dict[str, list[str]]:
    """The lines of each message by its full name."""
    lines: list[str] = []
    sections = {name: lines}
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
    for us what it was.
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
    """Whether ROS 2 allows the name; those of constants stay anyhow."""
    is_constant = found["rest"].startswith("=")
    return is_constant or _ROS2_FIELD.fullmatch(found["name"]) is not None


def _is_renamed(name: str, former: str) -> bool:
    """Whether a name is what `with_ros2_names` makes of a former one."""
    return name != former and re.fullmatch(rf"{_snake(former)}(_\d+)?", name) is not None


def _snake(name: str) -> str:
    """A name in lower case with single underscores between words: `i_tow` of iTOW."""
    words = re.sub(r"([a-z0-9])([A-Z])", r"\1_\2", name).lower()
    return "_".join(filter(None, re.findall(r"[a-z0-9]+", words)))


class _Definitions:
    """Makes the messages of one definition."""

    def __init__(self, name: str, sections: dict[str, list[str]]) -> None:
        self._sections = _EVERYWHERE | sections
        self._made: dict[str, Message] = {}
        self._package = name.rpartition("/")[0]

    def message(self, name: str, inside: tuple[str, ...]) -> Message:
        """The message of this full name, in those `inside` of which it is."""
        if name in self._made:
            return self._made[name]
        if name == MSGPACK.name:
            return MSGPACK
        shown = printable(name, 100)
        if name in inside or len(inside) >= _MOST_DEPTH:
            raise DecodeError(f"the definition of {shown} contains itself, or too many others")
        if name not in self._sections:
            raise DecodeError(f"the definition of {shown} is missing")
        fields, kind = [], "fields"
        for line in self._sections[name]:
            remark = line.removeprefix(_REMARK) if _is_ours(name) else ""
            if remark in _KINDS:
                kind = remark
            elif field := self._field(line, name, (*inside, name)):
                fields.append(field)
        if [field.name for field in fields] == [PLACEHOLDER]:
            fields = []
        message = self._made[name] = _checked(Message(name, tuple(fields)), kind)
        return message

    def _field(self, line: str, name: str, inside: tuple[str, ...]) -> Field | None:
        """The field that a line defines; None for a constant and for a line without a field."""
        if not (stripped := line.strip()) or stripped[0] in "#@":
            return None
        found = _FIELD.fullmatch(line)
        if not found or (found["bound"] and found["type"] != "string"):
            raise DecodeError(
                f"'{printable(stripped, 60)}' in the definition of {printable(name, 100)} is no "
                "field"
            )
        if found["rest"].startswith("="):
            return None
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
        return Field(found["name"], type_, found["name"] if key is None else key)

    def _type(self, name: str, bound: int, inside: tuple[str, ...]) -> Type:
        if name in SCALARS:
            return Scalar(name)
        if name == "string":
            return Text(bound)
        if name == "wstring":
            raise DecodeError(f"{printable(inside[-1], 100)} has a wstring, which is not read")
        if "/" not in name:
            package = inside[-1].rpartition("/")[0]
            own = f"{package}/{name}"
            name = own if own in self._sections else _SHORT_NAMES.get(name, own)
        return self.message(_full(name), inside)


def _is_ours(name: str) -> bool:
    return name.startswith(PACKAGE)


def _key(rest: str) -> str | None:
    """The name in the map that stands behind a field."""
    if not rest.startswith(_REMARK):
        return None
    try:
        key = json.loads(rest.removeprefix(_REMARK))
    except ValueError:
        return None
    return key if isinstance(key, str) else None


def _checked(message: Message, kind: str) -> Message:
    """The message as this kind, where it has the fields of one; else as it is."""
    types = [field.type for field in message.fields]
    if kind == "list":
        return replace(message, kind="list")
    if kind == "value" and len(types) == 1:
        return replace(message, kind="value")
    if kind == "map" and len(types) == 1 and _are_entries(types[0]):
        return replace(message, kind="map")
    return message


def _are_entries(type_: Type) -> bool:
    if not isinstance(type_, Sequence) or not isinstance(type_.item, Message):
        return False
    entry = type_.item
    types = [field.type for field in entry.fields]
    return entry.kind == "fields" and len(types) == 2 and isinstance(types[0], Text)
