"""A buffer as text, a graph and a drawing, for people and for tools that read tf2's dumps.

All but `show` take the frames as `buffer.all_frames()` returns them.
"""

import math
import re
import sys
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass

from tfbus.base import scheduler
from tfbus.base.errors import (
    ConnectivityException,
    InvalidArgumentException,
    LookupException,
    TransformException,
)
from tfbus.base.wording import counted, printable, stamp_text
from tfbus.buffer.buffer import Buffer
from tfbus.buffer.info import FrameInfo
from tfbus.geometry.transform import TransformStamped

# The rate that tf2 writes for static edges, which have none.
_TF2_STATIC_RATE = 10000.0

# Names that YAML 1.1 reads as something else.
_YAML_WORDS = {"null", "true", "false", "yes", "no", "on", "off", "y", "n"}

_ON_PATH = "#e07010"
# Levels that are drawn as branches; the lines of deeper frames would grow with their depth.
_DRAWN_LEVELS = 100

_ROW_PX, _INDENT_PX, _CHAR_PX = 24, 28, 8


def as_yaml(frames: Iterable[FrameInfo]) -> str:
    """A map of child frames in the form of tf2's `allFramesAsYAML`; `[]` without any."""
    edges = [frame for frame in frames if frame.parent is not None]
    if not edges:
        return "[]"
    lines = []
    for edge in edges:
        oldest_s, newest_s = _seconds(edge.oldest_ns), _seconds(edge.newest_ns)
        lines += [
            f"{_yaml_key(edge.name)}: ",
            f"  parent: {_quoted(edge.parent or '')}",
            f"  broadcaster: {_quoted(edge.authority)}",
            f"  rate: {edge.rate_hz or _TF2_STATIC_RATE:.3f}",
            f"  most_recent_transform: {newest_s:.6f}",
            f"  oldest_transform: {oldest_s:.6f}",
            f"  buffer_length: {newest_s - oldest_s:.3f}",
        ]
    return "\n".join(lines) + "\n"


def as_dot(frames: Iterable[FrameInfo], recorded_ns: int | None = None) -> str:
    """A Graphviz graph in the form of tf2's view_frames; the legend says when it was recorded."""
    recorded_ns = scheduler.time_ns() if recorded_ns is None else recorded_ns
    edges = [frame for frame in frames if frame.parent is not None]
    if not edges:
        return 'digraph G { "no tf data received" }'
    lines = ["digraph G {"]
    for edge in edges:
        newest_s = _seconds(edge.newest_ns)
        age = "" if edge.static else f" ({recorded_ns / 1e9 - newest_s:.3f} sec old)"
        label = "\\n".join(
            (
                f"Broadcaster: {_dot(edge.authority)}",
                f"Average rate: {edge.rate_hz or _TF2_STATIC_RATE:.3f} Hz",
                f"Most recent transform: {newest_s:.6f}{age}",
                f"Buffer length: {newest_s - _seconds(edge.oldest_ns):.3f} sec",
            )
        )
        lines.append(f'"{_dot(edge.parent or "")}" -> "{_dot(edge.name)}" [label="{label}\\n"];')
    root = next(frame.parent for frame in edges)
    lines += [
        "edge [style=invis];",
        'subgraph cluster_legend { style=bold; color=black; label ="view_frames Result";',
        f'"Recorded at time: {recorded_ns / 1e9:.6f}"[ shape=plaintext ] ;',
        f'}}->"{_dot(root or "")}";',
        "}",
    ]
    return "\n".join(lines) + "\n"


def as_text(frames: Iterable[FrameInfo], path: Collection[str] = ()) -> str:
    """The trees, a frame a line, children below their parent; a `*` marks the frames of a path."""
    return "\n".join(
        f"{lead}{_line(frame, ' *' if frame.name in path else '')}"
        for lead, _, frame in _walk(frames)
    )


def as_svg(frames: Iterable[FrameInfo], path: Collection[str] = ()) -> str:
    """The trees as an SVG drawing, a frame a row, for a notebook or a web page; the edges of a path
    are thick.
    """
    rows = list(_walk(frames))
    if not rows:
        return (
            '<svg xmlns="http://www.w3.org/2000/svg" width="160" height="32" '
            'font-family="monospace" font-size="13"><text x="8" y="20" fill="#888">'
            "no frames yet</text></svg>"
        )
    width = max((_INDENT_PX * d + _CHAR_PX * len(_line(f)) for _, d, f in rows), default=0) + 60
    height = _ROW_PX * len(rows) + 16
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" '
        'font-family="monospace" font-size="13">'
    ]
    row_of = {frame.name: row for row, (_, _, frame) in enumerate(rows)}
    for row, (_, depth, frame) in enumerate(rows):
        x, y = 16 + _INDENT_PX * depth, 20 + _ROW_PX * row
        if frame.parent in row_of and depth:
            up_x, up_y = x - _INDENT_PX, 20 + _ROW_PX * row_of[frame.parent]
            dash = "" if frame.static else ' stroke-dasharray="4 2"'
            if frame.name in path and frame.parent in path:
                line = f'stroke="{_ON_PATH}" stroke-width="3"'
            else:
                line = f'stroke="#888"{dash}'
            parts.append(f'<path d="M{up_x} {up_y + 6}V{y}H{x - 6}" fill="none" {line}/>')
        colour = "#c33" if frame.conflicts else "#888" if frame.static else "#27c"
        parts.append(f'<circle cx="{x}" cy="{y}" r="5" fill="{colour}"/>')
        facts = _escaped(_facts(frame))
        bold = ' font-weight="bold"' if frame.name in path else ""
        parts.append(
            f'<text x="{x + 12}" y="{y + 4}" fill="currentColor"{bold}>{_escaped(frame.name)}'
            f'<tspan fill="#888">{"  " if facts else ""}{facts}</tspan></text>'
        )
    return "".join(parts) + "</svg>"


def _escaped(text: str) -> str:
    """A text within HTML or SVG."""
    from html import escape  # slow to import, and few draw

    return escape(text)


def as_html(frames: Iterable[FrameInfo], path: Collection[str] = ()) -> str:
    """The drawing of `as_svg`, in a box that scrolls sideways."""
    return f'<div style="overflow-x:auto">{as_svg(frames, path)}</div>'


def show(
    buffer: Buffer,
    target_frame: str | None = None,
    source_frame: str | None = None,
    stamp_ns: int | None = None,
) -> None:
    """Show the trees of a buffer: drawn in a notebook, printed elsewhere.

    With two frames the path between them is marked, and their transform is shown, or why there
    is none. `tfbus.view.show(buffer)` opens a page in three dimensions.
    """
    drawing = _drawing(buffer, target_frame, source_frame, stamp_ns)
    ipython = sys.modules.get("IPython")
    if ipython is not None and ipython.get_ipython() is not None:
        ipython.display.display(drawing)
    else:
        print(drawing)


@dataclass(frozen=True)
class _Drawing:
    """The trees of a buffer, and with a path the transform along it, or why there is none."""

    frames: Sequence[FrameInfo]
    path: tuple[str, ...] = ()
    answer: TransformStamped | TransformException | None = None

    def __str__(self) -> str:
        tree = as_text(self.frames, self.path) if self.frames else "no frames yet"
        return tree if self.answer is None else f"{tree}\n\n{_numbers(self.answer)}"

    __repr__ = __str__

    def _repr_html_(self) -> str:
        drawn = as_html(self.frames, self.path)
        if self.answer is None:
            return drawn
        return f"{drawn}<pre>{_escaped(_numbers(self.answer))}</pre>"


def _drawing(
    buffer: Buffer, target_frame: str | None, source_frame: str | None, stamp_ns: int | None
) -> _Drawing:
    if target_frame is None and source_frame is None:
        return _Drawing(buffer.all_frames())
    if target_frame is None or source_frame is None:
        raise InvalidArgumentException("name two frames, the target and the source, or none")
    try:
        names = buffer.path(target_frame, source_frame)
    except (ConnectivityException, LookupException):
        names = [target_frame, source_frame]
    try:
        answer: TransformStamped | TransformException = buffer.lookup_transform(
            target_frame, source_frame, stamp_ns
        )
    except TransformException as error:
        answer = error
    return _Drawing(buffer.all_frames(), tuple(names), answer)


def _numbers(answer: TransformStamped | TransformException) -> str:
    """The transform in numbers for people, or why there is none."""
    if isinstance(answer, TransformException):
        return str(answer)
    pose = answer.transform
    xyz = ", ".join(f"{value + 0.0:.3f}" for value in pose.xyz)
    rpy = ", ".join(f"{math.degrees(value) + 0.0:.2f}" for value in pose.as_rpy())
    when = f" at {stamp_text(answer.stamp_ns)} s" if answer.stamp_ns else ""
    return (
        f"{answer.child_frame_id} seen from {answer.frame_id}{when}:\n"
        f"x, y, z in m: {xyz}\nroll, pitch, yaw in degrees: {rpy}"
    )


def _walk(frames: Iterable[FrameInfo]) -> Iterable[tuple[str, int, FrameInfo]]:
    """Each frame below its parent, with the lines that lead to it and its depth."""
    by_name = {frame.name: frame for frame in frames}
    roots = [frame for frame in by_name.values() if frame.parent not in by_name]
    # A stack, since a tree may be deeper than Python's own.
    stack = [("", "", 0, root) for root in reversed(roots)]
    while stack:
        lead, below, depth, frame = stack.pop()
        yield lead, depth, frame
        children = [by_name[name] for name in frame.children if name in by_name]
        for place, child in enumerate(reversed(children)):
            lead_of_child, below_child = branch(below, depth + 1, is_last=place == 0)
            stack.append((lead_of_child, below_child, depth + 1, child))


def branch(below: str, depth: int, *, is_last: bool) -> tuple[str, str]:
    """The text before a frame of this depth, 1 below a root, and before its children; `below` is
    the text before its parent's children. Below 100 levels the depth is a number.
    """
    if depth > _DRAWN_LEVELS:
        return f"{below}[{depth}] ", below
    return (f"{below}└─ ", f"{below}   ") if is_last else (f"{below}├─ ", f"{below}│  ")


def _line(frame: FrameInfo, mark: str = "") -> str:
    facts = _facts(frame)
    return f"{frame.name}{mark}  ({facts})" if facts else f"{frame.name}{mark}"


def _facts(frame: FrameInfo) -> str:
    if frame.parent is None:
        return ""
    facts: list[str] = []
    if frame.static:
        facts.append("static")
    elif frame.rate_hz is not None:
        facts.append(f"{frame.rate_hz:.1f} Hz")
    else:
        facts.append(counted(frame.samples, "sample"))
    if frame.authority:
        facts.append(f"by {printable(frame.authority)}")
    if frame.conflicts:
        facts.append(counted(frame.conflicts, "conflict"))
    return ", ".join(facts)


def _seconds(stamp_ns: int | None) -> float:
    return 0.0 if stamp_ns is None else stamp_ns / 1e9


def _quoted(text: str) -> str:
    return "'" + printable(text, len(text)).replace("'", "''") + "'"


def _yaml_key(name: str) -> str:
    plain = re.fullmatch(r"[A-Za-z_][\w/.-]*", name) and name.lower() not in _YAML_WORDS
    return name if plain else _quoted(name)


def _dot(text: str) -> str:
    return printable(text, len(text)).replace("\\", "\\\\").replace('"', '\\"')
