"""Files of static edges.

    - {frame_id: world, child_frame_id: camera, x: 1.0, yaw: 0.5}
    - frame_id: camera
      child_frame_id: lens
      z: 0.02
      qz: 1.0
      qw: 0.0

The keys are the flags of `tfbus static`; `deg: true` says that the angles of an edge are degrees.
Every error names its line and key.
"""

from pathlib import Path

from tfbus import Buffer, InvalidArgumentException, TransformStamped
from tfbus.base.yaml_file import Value, read_yaml_file

from .static_edge import FRAMES, NUMBERS, EdgeMistake, make_edge

_KEYS = (*FRAMES, *NUMBERS, "deg")
_TRUTH = {"true": True, "false": False}


def read_edges(path: Path, *, degrees: bool = False) -> list[TransformStamped]:
    """The edges in a file, in its order; `degrees` is the default of `deg`.

    Raises YamlFileError, also for edges that make no tree: a child with two parents, or a loop.
    """
    document = read_yaml_file(path, "a list of edges")
    entries = document.items()
    if not entries:
        raise document.place.mistake("is empty; write a list of edges")
    edges = [_edge(entry, entry.fields(_KEYS), degrees) for entry in entries]
    _check_tree(path, entries, edges)
    return edges


def _check_tree(path: Path, entries: list[Value], edges: list[TransformStamped]) -> None:
    tree = Buffer()
    lines: dict[str, int] = {}
    for entry, edge in zip(entries, edges, strict=True):
        place, child = entry.entries()["child_frame_id"].place, edge.child_frame_id
        if child in lines:
            raise place.mistake(f"{child!r} already has a parent, in line {lines[child]}; keep one")
        lines[child] = place.line
        try:
            tree.set_transform(edge, static=True, authority=path.name)
        except InvalidArgumentException as error:
            raise place.mistake(str(error)) from error


def _edge(entry: Value, fields: dict[str, Value], degrees: bool) -> TransformStamped:
    if "deg" in fields:
        degrees = _truth(fields["deg"])
    frames = {key: fields[key].text() for key in FRAMES if key in fields}
    numbers = {key: _number(fields[key]) for key in NUMBERS if key in fields}
    try:
        return make_edge(frames, numbers, degrees=degrees)
    except EdgeMistake as mistake:
        if mistake.field in fields:
            raise fields[mistake.field].place.mistake(mistake.reason) from mistake
        raise entry.place.mistake(f"{mistake.field} {mistake.reason}") from mistake


def _number(value: Value) -> float:
    try:
        return float(value.text())
    except ValueError as error:
        raise value.place.mistake(f"{value.text()!r} is not a number") from error


def _truth(value: Value) -> bool:
    if value.text() not in _TRUTH:
        raise value.place.mistake(f"must be true or false, not {value.text()!r}")
    return _TRUTH[value.text()]
