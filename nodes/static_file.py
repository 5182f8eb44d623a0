"""Files of edges that never change.

    - {frame_id: world, child_frame_id: camera, x: 1.0, yaw: 0.5}
    - frame_id: camera
      child_frame_id: lens
      z: 0.02
      qz: 1.0
      qw: 0.0

The keys are the flags of `tfbus static`; `deg: true` says that the angles of an edge are degrees.
Every mistake is told with its line and key.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

import yaml

from tfbus import Buffer, InvalidArgumentException, TfbusError, TransformStamped

from .static_edge import FRAMES, NUMBERS, EdgeMistake, make_edge

_KEYS = (*FRAMES, *NUMBERS, "deg")
_TRUTH = {"true": True, "false": False}


class EdgeFileError(TfbusError):
    """A file of edges that cannot be read, or has a mistake."""


@dataclass(frozen=True)
class _Place:
    """A line of the file, counted from 1, and the key that stands there."""

    path: Path
    line: int
    key: str = ""

    def mistake(self, reason: str) -> EdgeFileError:
        key = f"{self.key}: " if self.key else ""
        return EdgeFileError(f"{self.path}:{self.line}: {key}{reason}")


@dataclass(frozen=True)
class _Entry:
    """One edge as it is written: the text of each key, and where each stands."""

    place: _Place
    texts: dict[str, str]
    places: dict[str, _Place]

    def place_of(self, key: str) -> _Place:
        return self.places.get(key, _Place(self.place.path, self.place.line, key))


def read_edges(path: Path, *, degrees: bool = False) -> list[TransformStamped]:
    """The edges in a file, in its order; `degrees` is what `deg` is where an edge has none.

    Raises EdgeFileError, also where two edges cannot stand together: a child with two parents,
    or a loop.
    """
    entries = list(_entries(path))
    edges = [_edge(entry, degrees) for entry in entries]
    _check_tree(entries, edges)
    return edges


def _check_tree(entries: list[_Entry], edges: list[TransformStamped]) -> None:
    tree = Buffer()
    seen: dict[str, int] = {}
    for entry, edge in zip(entries, edges, strict=True):
        place, child = entry.place_of("child_frame_id"), edge.child_frame_id
        if child in seen:
            raise place.mistake(
                f"{child!r} has its place in the tree from line {seen[child]} already; keep one"
            )
        seen[child] = place.line
        try:
            tree.set_transform(edge, static=True, authority=place.path.name)
        except InvalidArgumentException as error:
            raise place.mistake(str(error)) from error


def _edge(entry: _Entry, degrees: bool) -> TransformStamped:
    if "deg" in entry.texts:
        degrees = _truth(entry, "deg")
    frames = {key: entry.texts[key] for key in FRAMES if key in entry.texts}
    numbers = {key: _number(entry, key) for key in NUMBERS if key in entry.texts}
    try:
        return make_edge(frames, numbers, degrees=degrees)
    except EdgeMistake as mistake:
        raise entry.place_of(mistake.field).mistake(mistake.reason) from mistake


def _number(entry: _Entry, key: str) -> float:
    try:
        return float(entry.texts[key])
    except ValueError as error:
        raise entry.places[key].mistake(f"{entry.texts[key]!r} is not a number") from error


def _truth(entry: _Entry, key: str) -> bool:
    text = entry.texts[key]
    if text not in _TRUTH:
        raise entry.places[key].mistake(f"{text!r} is neither true nor false")
    return _TRUTH[text]


def _entries(path: Path) -> Iterator[_Entry]:
    document = _document(path)
    if not isinstance(document, yaml.SequenceNode) or not document.value:
        line = document.start_mark.line + 1 if document else 1
        raise _Place(path, line).mistake(
            "a list of edges is wanted, each beginning with `- frame_id:`"
        )
    for node in document.value:
        yield _entry(_Place(path, node.start_mark.line + 1), node)


def _entry(place: _Place, node: yaml.Node) -> _Entry:
    if not isinstance(node, yaml.MappingNode):
        raise place.mistake("an edge is wanted, lines of `key: value`")
    entry = _Entry(place, {}, {})
    for key_node, value_node in node.value:
        key = str(key_node.value)
        here = _Place(place.path, key_node.start_mark.line + 1, key)
        if key not in _KEYS:
            raise here.mistake(f"is not a key of an edge{_meant(key)}; keys are {', '.join(_KEYS)}")
        if key in entry.texts:
            raise here.mistake(f"is written twice, first in line {entry.places[key].line}")
        if not isinstance(value_node, yaml.ScalarNode):
            raise here.mistake("one value is wanted")
        entry.texts[key], entry.places[key] = str(value_node.value), here
    return entry


def _meant(key: str) -> str:
    close = get_close_matches(key, _KEYS, n=1)
    return f" (did you mean {close[0]!r}?)" if close else ""


def _document(path: Path) -> yaml.Node | None:
    try:
        return yaml.compose(path.read_text(encoding="utf-8"), Loader=yaml.SafeLoader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = mark.line + 1 if mark else 1
        raise _Place(path, line).mistake(f"is not YAML: {error.problem}") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise EdgeFileError(f"{path} is not a text file in YAML: {error}") from error
    except OSError as error:
        raise EdgeFileError(f"{path} cannot be read: {error.strerror}") from error
