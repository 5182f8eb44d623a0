"""Pictures drawn by matplotlib: the tree of frames, and the poses of a frame over time."""

from __future__ import annotations

import textwrap
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal, get_args

from tfbus.base import lazy_numpy as np
from tfbus.base.errors import TfbusError
from tfbus.base.lazy_numpy import NDArray
from tfbus.base.whole_file import replacing
from tfbus.base.wording import columns, counted, cut
from tfbus.frames.moment import State, facts, state
from tfbus.frames.snapshot import FrameTree
from tfbus.frames.track import angular_speed, gaps_of, linear_speed, rpy_rad, seconds_of
from tfbus.geometry.trajectory import Trajectory


@dataclass(frozen=True)
class Size:
    """How wide a frame's label is: its name, and its facts in a smaller type."""

    name: float
    facts: float


@dataclass(frozen=True)
class FramePlace:
    """A frame's name, the facts about it, and the line from its parent that ends at the name.

    `x` and `y` are the left end of the name, `facts_x` and `facts_y` of the facts; `line` has the
    corners of the line, none for a root.
    """

    x: float
    y: float
    facts_x: float
    facts_y: float
    line: tuple[tuple[float, float], ...] = ()


_GAP, _BEND, _ARROW = 0.45, 0.31, 0.14
_TIDY_ROW, _FACTS_BELOW = 0.46, 0.15
_OUTLINE_ROW, _INDENT = 0.26, 0.4


def tidy(tree: FrameTree, sizes: dict[str, Size]) -> dict[str, FramePlace]:
    """A column for each depth, a row for each leaf, a parent midway between its children."""
    depth: dict[str, int] = {}
    row: dict[str, float] = {}
    leaves = 0
    for root in tree.roots:
        order = list(tree.walk(root.name))
        for level, frame in order:
            depth[frame.name] = level
            if not tree.children(frame.name):
                row[frame.name] = leaves
                leaves += 1
        for _, frame in reversed(order):
            if children := tree.children(frame.name):
                row[frame.name] = (row[children[0]] + row[children[-1]]) / 2
    lefts = _columns(depth, sizes)
    places = {}
    for name, level in depth.items():
        x, y = lefts[level], row[name] * _TIDY_ROW
        parent = tree.frames[name].parent
        line: tuple[tuple[float, float], ...] = ()
        if parent in depth:
            from_x = lefts[level - 1] + sizes[parent].name + 0.08
            from_y, bend = row[parent] * _TIDY_ROW, x - _BEND
            line = ((from_x, from_y), (bend, from_y), (bend, y), (x - _ARROW, y))
        places[name] = FramePlace(x, y, x, y + _FACTS_BELOW, line)
    return places


def outline(tree: FrameTree, sizes: dict[str, Size]) -> dict[str, FramePlace]:
    """A row for each frame, its children below it and further right: for large trees."""
    places: dict[str, FramePlace] = {}
    for root in tree.roots:
        for depth, frame in tree.walk(root.name):
            x, y = depth * _INDENT, len(places) * _OUTLINE_ROW
            line: tuple[tuple[float, float], ...] = ()
            if frame.parent in places:
                trunk = x - _INDENT + 0.1
                from_y = places[frame.parent].y + 0.08
                line = ((trunk, from_y), (trunk, y), (x - _ARROW / 2, y))
            places[frame.name] = FramePlace(x, y, x + sizes[frame.name].name + 0.15, y, line)
    return places


def extent(places: dict[str, FramePlace], sizes: dict[str, Size]) -> tuple[float, float]:
    """How wide and how high the drawing is."""
    rights = [
        max(place.x + sizes[name].name, place.facts_x + sizes[name].facts)
        for name, place in places.items()
    ]
    bottoms = [place.facts_y for place in places.values()]
    return max(rights, default=0.0), max(bottoms, default=0.0)


def _columns(depth: dict[str, int], sizes: dict[str, Size]) -> list[float]:
    """The beginning of each column."""
    widths = [0.0] * (1 + max(depth.values(), default=0))
    for name, level in depth.items():
        widths[level] = max(widths[level], sizes[name].name, sizes[name].facts)
    lefts = [0.0]
    for width in widths:
        lefts.append(lefts[-1] + width + _GAP)
    return lefts


COLOURS: dict[State, str] = {
    "root": "#111827",
    "dynamic": "#2563eb",
    "static": "#4b5563",
    "stale": "#b45309",
    "ahead": "#0f766e",
    "gone": "#b91c1c",
    "conflict": "#a21caf",
}
_GREY, _TRUNK = "#6b7280", "#9ca3af"

# With more frames than this the columns would be wider than any screen.
_LARGE = 60

# In inches; a letter is at most this wide, on average.
_MARGIN, _HEAD, _LEAST_WIDTH = 0.3, 0.9, 7.2
_NAME_CHAR, _FACT_CHAR, _TEXT_CHAR = 0.088, 0.062, 0.072
_PROBLEM_ROW = 0.17

# Longer names are cut: they would make every picture wider than a screen.
_LONGEST_NAME = 60

# Some viewers open no PNG with more pixels: a larger one gets fewer dots per inch.
_DOTS_PER_INCH, _MOST_PIXELS = 150, 30_000


@dataclass(frozen=True)
class _FrameLabel:
    """The text at a frame's place."""

    name: str
    facts: str
    state: State

    @property
    def size(self) -> Size:
        """How large it is."""
        return Size(columns(self.name) * _NAME_CHAR, columns(self.facts) * _FACT_CHAR)


@contextmanager
def drawing() -> Iterator[None]:
    """How matplotlib draws, inside a `with`.

    Text stays text in an SVG: it can be searched, and uses the reader's own font. A letter that no
    font has, such as an emoji, is drawn as a box, without a warning for each.
    """
    import matplotlib

    with matplotlib.rc_context({"svg.fonttype": "none"}), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from")
        yield


def _figure(**given: Any) -> Any:
    """A matplotlib Figure that is in no window."""
    from matplotlib.figure import Figure

    return Figure(**given)


def write_picture(tree: FrameTree, path: Path) -> None:
    """Draw the tree into a file, whose ending chooses one of matplotlib's formats.

    A failure leaves the file as it was.
    """
    labels = {
        name: _FrameLabel(
            cut(name, _LONGEST_NAME), ", ".join(facts(tree, frame)), state(tree, frame)
        )
        for name, frame in tree.frames.items()
    }
    sizes = {name: label.size for name, label in labels.items()}
    places = (outline if len(labels) > _LARGE else tidy)(tree, sizes)
    right, bottom = extent(places, sizes)
    width = max(right + 2 * _MARGIN, _LEAST_WIDTH)
    problems = _problem_lines(tree, width)
    height = _HEAD + bottom + 3 * _MARGIN + _PROBLEM_ROW * len(problems)

    with drawing():
        figure = _figure(figsize=(width, height), facecolor="white")
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        axes.set_axis_off()
        axes.set_xlim(-_MARGIN, width - _MARGIN)
        axes.set_ylim(height - _HEAD, -_HEAD)
        _draw_head(axes, tree)
        for name, place in places.items():
            _draw_frame(axes, place, labels[name])
        for number, line in enumerate(problems):
            _write(
                axes, 0.0, bottom + 2 * _MARGIN + _PROBLEM_ROW * number, line, 8, COLOURS["gone"]
            )
        dpi = min(_DOTS_PER_INCH, _MOST_PIXELS / max(width, height))
        with replacing(path) as file:
            figure.savefig(file, format=path.suffix[1:], dpi=dpi)


def _draw_head(axes: Any, tree: FrameTree) -> None:
    streams = sum(stream.alive for stream in tree.streams.values())
    when = datetime.fromtimestamp(tree.recorded_ns / 1e9).astimezone()
    frames = counted(len(tree.frames), "frame") if tree.frames else "no frame"
    title = f"{frames}, {counted(streams, 'publisher')}"
    _write(axes, 0.0, -0.58, title, 13, COLOURS["root"], weight="bold")
    _write(axes, 0.0, -0.32, f"recorded {when:%Y-%m-%d %H:%M:%S %Z}", 8, _GREY)
    kinds: tuple[State, ...] = ("dynamic", "static", "stale", "ahead", "gone", "conflict")
    for number, kind in enumerate(kinds):
        _write(axes, 2.6 + 0.7 * number, -0.32, f"● {kind}", 8, COLOURS[kind])


def _draw_frame(axes: Any, place: FramePlace, label: _FrameLabel) -> None:
    colour = COLOURS[label.state]
    if place.line:
        *trunk, corner, end = place.line
        xs, ys = zip(*trunk, corner, strict=True)
        axes.plot(xs, ys, color=_TRUNK, linewidth=1.0)
        style = "--" if label.state in ("gone", "stale") else "-"
        xs, ys = zip(corner, end, strict=True)
        axes.plot(xs, ys, color=colour, linewidth=1.2, linestyle=style)
        axes.plot(*end, marker=">", markersize=3.5, color=colour)
    _write(axes, place.x, place.y, label.name, 10, colour, weight="bold")
    _write(axes, place.facts_x, place.facts_y, label.facts, 7, _GREY)


def _problem_lines(tree: FrameTree, width: float) -> list[str]:
    letters = int((width - 2 * _MARGIN) / _TEXT_CHAR)
    return [
        line
        for problem in tree.problems()
        for line in textwrap.wrap(f"{problem.kind}: {problem.text}", letters)
    ]


def _write(
    axes: Any, x: float, y: float, text: str, points: int, colour: str, weight: str = "normal"
) -> None:
    # matplotlib takes a dollar sign for the start of a formula.
    shown = text.replace("$", r"\$")
    axes.text(x, y, shown, fontsize=points, color=colour, weight=weight, va="center")


Panel = Literal["position", "orientation", "speed", "path"]
PANELS: tuple[Panel, ...] = get_args(Panel)

_COLOURS = ("#dc2626", "#16a34a", "#2563eb")  # x, y and z, as RViz has them
_SIZE = (5.2, 3.4)

# As the view: beyond, matplotlib has no axis.
_FARTHEST_M = 1e15

# The least that an axis spans: a frame at rest is a straight line, not the noise of rounding.
_LEAST_M, _LEAST_DEGREES = 0.001, 0.1
_LEAST_M_PER_S, _LEAST_RAD_PER_S = 0.001, 0.001


def draw(track: Trajectory, panels: tuple[Panel, ...]) -> Any:
    """A matplotlib Figure with the panels, two in a row."""
    figure = _figure()
    _draw_into(figure, track, panels)
    return figure


def write_plot(track: Trajectory, path: Path, panels: tuple[Panel, ...]) -> None:
    """Draw the panels into a file, whose ending chooses one of matplotlib's formats.

    A failure leaves the file as it was.
    """
    with drawing(), replacing(path) as file:
        draw(track, panels).savefig(file, format=path.suffix[1:], dpi=150)


def show_plot(track: Trajectory, panels: tuple[Panel, ...]) -> None:
    """Draw the panels into a window; returns when it is closed.

    Raises TfbusError if matplotlib has no toolkit to open one with.
    """
    from matplotlib import pyplot

    figure = pyplot.figure(f"{track.child_frame_id} seen from {track.frame_id}")
    if pyplot.get_backend().lower() == "agg":  # its choice when it finds no toolkit
        raise TfbusError(
            "there is no toolkit to open a window with: write a file with -o, or install one, "
            "such as Debian's python3-tk, or pip install pyqt6"
        )
    with drawing():
        _draw_into(figure, track, panels)
        pyplot.show()


def _draw_into(figure: Any, track: Trajectory, panels: tuple[Panel, ...]) -> None:
    if not (np.abs(track.xyz) <= _FARTHEST_M).all():
        raise TfbusError(
            f"{track.child_frame_id!r} is farther than 1e15 m away: that cannot be plotted"
        )
    columns = min(len(panels), 2)
    rows = -(-len(panels) // columns)
    figure.set_size_inches(_SIZE[0] * columns, _SIZE[1] * rows + 0.5)
    figure.set_layout_engine("constrained")
    first = datetime.fromtimestamp(int(track.stamps_ns[0]) / 1e9, tz=UTC)
    name = f"{track.child_frame_id} seen from {track.frame_id}".replace("$", r"\$")
    figure.suptitle(f"{name}, from {first:%Y-%m-%d %H:%M:%S} UTC", fontsize=11)
    for number, panel in enumerate(panels, start=1):
        axes = figure.add_subplot(rows, columns, number)
        axes.grid(visible=True, color="#e5e7eb", linewidth=0.6)
        axes.set_axisbelow(True)
        _DRAW[panel](axes, track)


def _draw_position(axes: Any, track: Trajectory) -> None:
    seconds = broken(track, seconds_of(track))
    for values, name, colour in zip(broken(track, track.xyz).T, "xyz", _COLOURS, strict=True):
        axes.plot(seconds, values, color=colour, label=name, linewidth=1.3)
    _widen(axes, "y", _LEAST_M)
    _label(axes, "position (m)")


def _draw_orientation(axes: Any, track: Trajectory) -> None:
    seconds, degrees = (
        broken(track, each) for each in (seconds_of(track), np.degrees(rpy_rad(track)))
    )
    names = ("roll", "pitch", "yaw")
    for values, name, colour in zip(degrees.T, names, _COLOURS, strict=True):
        axes.plot(seconds, values, color=colour, label=name, linewidth=1.3)
    _widen(axes, "y", _LEAST_DEGREES)
    _label(axes, "orientation (degrees)")


def _draw_speed(axes: Any, track: Trajectory) -> None:
    between = (seconds_of(track)[1:] + seconds_of(track)[:-1]) / 2
    is_gap = gaps_of(track)
    linear, turning = (
        np.where(is_gap, np.nan, each) for each in (linear_speed(track), angular_speed(track))
    )
    axes.plot(between, linear, color="#111827", label="linear", linewidth=1.3)
    angular = axes.twinx()
    angular.plot(between, turning, color="#d97706", label="angular", linewidth=1.0, alpha=0.9)
    angular.set_ylabel("angular speed (rad/s)", color="#d97706", fontsize=9)
    angular.tick_params(labelsize=8)
    # Keeps lines of constant speed visible, beside each other and at zero.
    for each, least, room in ((axes, _LEAST_M_PER_S, 1.1), (angular, _LEAST_RAD_PER_S, 1.3)):
        top = room * max(each.dataLim.y1, least)
        each.set_ylim(-0.03 * top, top)
    axes.set_ylabel("linear speed (m/s)", fontsize=9)
    axes.set_xlabel("seconds", fontsize=9)
    axes.tick_params(labelsize=8)


def _draw_path(axes: Any, track: Trajectory) -> None:
    x, y = track.xyz[:, 0], track.xyz[:, 1]
    axes.plot(*broken(track, track.xyz[:, :2]).T, color="#2563eb", linewidth=1.4)
    axes.plot(x[0], y[0], "o", color="#16a34a", markersize=6, label="first")
    axes.plot(x[-1], y[-1], "s", color="#dc2626", markersize=6, label="last")
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.1)
    _widen(axes, "x", _LEAST_M)
    _widen(axes, "y", _LEAST_M)
    axes.locator_params(axis="x", nbins=6)
    axes.set_xlabel("x (m)", fontsize=9)
    axes.set_ylabel("y (m)", fontsize=9)
    axes.set_title("path from above", fontsize=9, color=_GREY)
    axes.tick_params(labelsize=8)
    axes.legend(fontsize=8, loc="best")


def broken(track: Trajectory, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """The values with one in each gap that is not drawn: nothing is known of the time between."""
    return np.insert(values, np.flatnonzero(gaps_of(track)) + 1, np.nan, axis=0)


def _widen(axes: Any, side: Literal["x", "y"], least: float) -> None:
    """Widen an axis around the data to span at least `least`, and write its numbers in full."""
    low, high = getattr(axes.dataLim, f"interval{side}")
    if high - low < least:
        middle = (low + high) / 2
        ends = np.array([[middle - least / 2] * 2, [middle + least / 2] * 2])
        axes.update_datalim(ends, updatex=side == "x", updatey=side == "y")
        axes.autoscale_view()
    axes.ticklabel_format(axis=side, useOffset=False)


def _label(axes: Any, text: str) -> None:
    axes.set_ylabel(text, fontsize=9)
    axes.set_xlabel("seconds", fontsize=9)
    axes.tick_params(labelsize=8)
    axes.legend(fontsize=8, loc="best")


_DRAW = {
    "position": _draw_position,
    "orientation": _draw_orientation,
    "speed": _draw_speed,
    "path": _draw_path,
}
