"""The fields of message, service and action types: their types, defaults and docstrings."""

import inspect
import textwrap
from collections.abc import Iterable, Iterator
from dataclasses import MISSING, Field, asdict, dataclass, fields, is_dataclass
from typing import Any, get_origin, get_type_hints

from tfbus.cli.output import as_json, paint, print_json, print_lines, width
from tfbus.wire.codec import as_map

_ZEROS: dict[Any, Any] = {bool: False, int: 0, float: 0.0, str: "", bytes: "", list: [], dict: {}}

# The parts of a service, and of an action, in the order of a call.
_PARTS = ("Request", "Response", "Goal", "Result", "Feedback")


@dataclass(frozen=True)
class FieldInfo:
    """A field of a message: its type's name, its default (None if it has none), and the fields
    of a nested message.
    """

    name: str
    type: str
    default: Any
    fields: "tuple[FieldInfo, ...]" = ()


@dataclass(frozen=True)
class PartInfo:
    """A message, or the request, response, goal, result or feedback of a service or action."""

    name: str
    doc: str
    fields: tuple[FieldInfo, ...]


def prototype(message_type: type) -> dict[str, Any]:
    """A message of this type with its defaults, or zeros if it has none."""
    hints = get_type_hints(message_type)
    return {entry.name: _value(entry, hints[entry.name]) for entry in fields(message_type)}


def parts_of(type_: type) -> Iterator[PartInfo]:
    """The message itself, or the parts of a service or action."""
    for name, part in [
        (type_.__name__, type_),
        *((name, getattr(type_, name, None)) for name in _PARTS),
    ]:
        if isinstance(part, type) and is_dataclass(part):
            yield PartInfo(name, doc_of(part), tuple(_fields(part)))
        elif isinstance(part, type) and hasattr(part, "get_fields_and_field_types"):
            yield PartInfo(name, doc_of(part), tuple(_fields_of_ros(part)))


def is_called(type_: object) -> bool:
    """Whether this is the type of a service or an action."""
    return isinstance(type_, type) and request_of(type_) is not None


def request_of(type_: type | None) -> type | None:
    """The type of the requests of a service, or of the goals of an action; None for another."""
    part = getattr(type_, "Request", None) or getattr(type_, "Goal", None)
    return part if isinstance(part, type) and is_dataclass(part) else None


def doc_of(type_: type) -> str:
    """The docstring in one line; "" for the one that Python writes for a dataclass."""
    doc = inspect.getdoc(type_) or ""
    return "" if doc.startswith(f"{type_.__name__}(") else " ".join(doc.split())


def _fields(message_type: type) -> Iterator[FieldInfo]:
    hints = get_type_hints(message_type)
    for entry in fields(message_type):
        hint = hints[entry.name]
        nested = tuple(_fields(hint)) if isinstance(hint, type) and is_dataclass(hint) else ()
        has_default = entry.default is not MISSING or entry.default_factory is not MISSING
        default = _value(entry, hint) if has_default and not nested else None
        yield FieldInfo(entry.name, _type_name(hint), default, nested)


def _fields_of_ros(message_type: Any) -> Iterator[FieldInfo]:
    """The fields of a message of ROS; defaults are shown where they are neither zero nor empty."""
    made = message_type()
    for name, shown in message_type.get_fields_and_field_types().items():
        value = getattr(made, name)
        if hasattr(value, "get_fields_and_field_types"):
            yield FieldInfo(name, shown, None, tuple(_fields_of_ros(type(value))))
        else:
            is_scalar = isinstance(value, bool | int | float | str)
            yield FieldInfo(name, shown, value if is_scalar and value else None)


def _type_name(hint: Any) -> str:
    is_plain = isinstance(hint, type) and get_origin(hint) is None
    return hint.__qualname__ if is_plain else str(hint).replace("typing.", "")


def _value(entry: "Field[Any]", hint: Any) -> Any:
    if entry.default is not MISSING:
        return _plain(entry.default)
    if entry.default_factory is not MISSING:
        return _plain(entry.default_factory())
    if isinstance(hint, type) and is_dataclass(hint):
        return prototype(hint)
    return _ZEROS.get(get_origin(hint) or hint)


def _plain(value: Any) -> Any:
    """A default as the wire has it: maps and lists."""
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return as_map(value) if is_dataclass(value) and not isinstance(value, type) else value


def print_type(type_: type, *, as_json: bool) -> None:
    """Print what a type is for, and the fields of each of its parts."""
    if as_json:
        parts = [asdict(part) for part in parts_of(type_)]
        print_json({"type": type_.__qualname__, "doc": doc_of(type_), "parts": parts})
    else:
        print_lines(_type_lines(type_))


def print_types(types: Iterable[type]) -> None:
    """Print one line for each type: its name, and the first sentence of its docstring."""
    rows = {type_.__qualname__: _brief(type_) for type_ in types}
    room = max(map(len, rows), default=0)
    print_lines(
        f"{paint(name, 'type')}{' ' * (room - len(name))}  {brief}" for name, brief in rows.items()
    )


def _brief(type_: type) -> str:
    return textwrap.shorten(doc_of(type_).partition(". ")[0].rstrip("."), 80, placeholder=" …")


def _type_lines(type_: type) -> Iterator[str]:
    yield from _headed(type_.__qualname__, doc_of(type_))
    for part in parts_of(type_):
        if part.name != type_.__name__:
            yield ""
            yield from _headed(part.name, part.doc)
        yield from _field_lines(part.fields, "  ")


def _headed(name: str, doc: str) -> list[str]:
    lines = textwrap.wrap(f"{name}: {doc}" if doc else name, max(width(), 40))
    return [
        line.replace(name, paint(name, "type"), 1) if not at else line
        for at, line in enumerate(lines)
    ]


def _field_lines(fields: Iterable[FieldInfo], lead: str) -> Iterator[str]:
    for field in fields:
        default = "" if field.default is None else f" = {as_json(field.default)}"
        yield f"{lead}{paint(field.name, 'name')}: {field.type}{default}"
        yield from _field_lines(field.fields, lead + "  ")
