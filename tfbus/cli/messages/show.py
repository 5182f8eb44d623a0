"""`tfbus topic show` and `tfbus service show`: types, and their fields."""

import textwrap
from collections.abc import Iterable, Iterator
from dataclasses import asdict

from tfbus.cli.messages.fields import FieldInfo, doc_of, parts_of
from tfbus.cli.output import as_json, paint, print_json, print_lines, width


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
