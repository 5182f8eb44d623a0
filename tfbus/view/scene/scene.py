"""The frames in three dimensions: axes, arrows, marks, trails and names, as few objects.

Axes are one object for all opaque frames, and three for the fading ones: viser's batched axes have
no opacity. All are in the scene of viser, not in a fixed frame that moves there while cameras
follow: browsers draw such batches, and names, one picture later than its move.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

from tfbus.base.wording import listed
from tfbus.frames.moment import State
from tfbus.geometry.transform import Transform
from tfbus.view.data.shapes import AXES_RGB
from tfbus.view.frames import (
    FAULTS,
    Floats,
    Frames,
    Placed,
    ViewFrame,
    arrow_points,
    arrow_rows,
)
from tfbus.view.scene.camera import Viewport
from tfbus.view.scene.drawn import FIXED_NODE
from tfbus.view.settings import Selections, ViewSettings

Mesh = tuple[NDArray[np.float32], NDArray[np.uint32]]


def arm(axis: int, length_m: float, radius_m: float) -> Mesh:
    """A thin box from the origin along x (0), y (1) or z (2)."""
    low, high = np.full(3, -radius_m), np.full(3, radius_m)
    low[axis], high[axis] = 0.0, length_m
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    return (low + corners * (high - low)).astype(np.float32), _BOX


def octahedron(radius_m: float) -> Mesh:
    """An octahedron around the origin."""
    points = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)])
    corners = [(x, y, z) for x in (0, 1) for y in (2, 3) for z in (4, 5)]
    faces = [_outward(points, face) for face in corners]
    return (points * radius_m).astype(np.float32), np.array(faces, np.uint32)


def _outward(points: NDArray[np.int64], face: tuple[int, int, int]) -> tuple[int, int, int]:
    """The face with its corners counter-clockwise as seen from outside."""
    a, b, c = points[list(face)]
    return face if np.dot(np.cross(b - a, c - a), a + b + c) > 0 else (face[0], face[2], face[1])


_BOX = np.array(
    [
        (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
        (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
    ],
    np.uint32,
)  # fmt: skip


# The radius of an axis, in parts of its length.
_RADIUS = 0.035

NO_QUATERNIONS = np.array([[1.0, 0.0, 0.0, 0.0]])
NO_POSITIONS = np.zeros((1, 3))


class Axes:
    """Axes of many frames; a click calls `on_click(client, name)`."""

    def __init__(self, scene: viser.SceneApi, on_click: Callable[[int, str], object]) -> None:
        self._bright: tuple[str, ...] = ()
        self._faded: tuple[str, ...] = ()
        self._axes = scene.add_batched_axes(
            "/frames/axes",
            NO_QUATERNIONS,
            NO_POSITIONS,
            np.ones(1),
            axes_length=1.0,
            axes_radius=_RADIUS,
            visible=False,
        )
        self._arms: list[Any] = [
            scene.add_batched_meshes_simple(
                f"/frames/faded/{'xyz'[axis]}",
                *arm(axis, 1.0, _RADIUS),
                NO_QUATERNIONS,
                NO_POSITIONS,
                batched_scales=np.ones(1),
                batched_colors=color,
                batched_opacities=np.ones(1),
                cast_shadow=False,
                receive_shadow=False,
                visible=False,
            )
            for axis, color in enumerate(AXES_RGB)
        ]
        for handle in (self._axes, *self._arms):
            handle.on_click(lambda event: on_click(event.client_id, self._clicked(event)))

    def draw(
        self, names: Sequence[str], xyz: Floats, quat_wxyz: Floats, opacity: Floats, size: float
    ) -> None:
        """Draw these frames and no others, with axes `size` metres long."""
        faded = opacity < 1.0
        self._bright = tuple(name for name, dim in zip(names, faded, strict=True) if not dim)
        self._faded = tuple(name for name, dim in zip(names, faded, strict=True) if dim)
        place(self._axes, xyz[~faded], quat_wxyz[~faded], size)
        for handle in self._arms:
            if faded.any():
                handle.batched_opacities = opacity[faded].astype(np.float32)
            place(handle, xyz[faded], quat_wxyz[faded], size)

    def _clicked(self, event: Any) -> str:
        """The frame that was clicked; "" if it has just gone."""
        names = self._bright if event.target is self._axes else self._faded
        at = event.instance_index
        return names[at] if at is not None and at < len(names) else ""


def place(handle: Any, xyz: Floats, quat_wxyz: Floats, size: float) -> None:
    """Move the instances of a batch, all of one size; an empty batch is hidden."""
    if len(xyz):
        scales = np.full(len(xyz), size, np.float32)
        if not np.array_equal(handle.batched_scales, scales):
            handle.batched_scales = scales
        handle.batched_positions = xyz.astype(np.float32)
        handle.batched_wxyzs = quat_wxyz.astype(np.float32)
    if handle.visible != bool(len(xyz)):
        handle.visible = bool(len(xyz))


# The radius of a mark, in parts of an axis.
_MARK = 0.14

_SELECTED = (255, 150, 0)


def add_marks(scene: viser.SceneApi, path: str) -> Any:
    """A batch of marks, hidden at first."""
    return scene.add_batched_meshes_simple(
        path,
        *octahedron(_MARK),
        NO_QUATERNIONS,
        NO_POSITIONS,
        batched_scales=np.ones(1),
        batched_colors=_SELECTED,
        cast_shadow=False,
        receive_shadow=False,
        visible=False,
    )


class SelectedMarks:
    """Marks in each browser the frame that it has selected, unless its state has a mark."""

    def __init__(self, server: viser.ViserServer, selections: Selections) -> None:
        self._server = server
        self._selections = selections
        self._marks: dict[int, Any] = {}

    def draw(self, frames: Frames, placed: Placed, size: float) -> None:
        """Move the marks to where the selected frames are."""
        marks = {}
        for number, client in self._server.get_clients().items():
            mark = self._marks.get(number) or add_marks(client.scene, "/selected")
            marks[number] = mark
            name = self._selections.of(number)
            is_marked = name in placed.index and frames[name].state not in FAULTS
            rows = np.array([placed.index[name]] if is_marked else [], np.intp)
            place(mark, placed.xyz[rows], NO_QUATERNIONS[: len(rows)], size)
        self._marks = marks


_TRAIL = (240, 120, 30)

# In parts of an axis.
_SHAFT_RADIUS = 0.025
_HEAD_RADIUS = 0.08
_HEAD_LENGTH = 0.2


# With more arrows their heads merge into each other, and without a graphics card lines are drawn
# ten times as fast.
MOST_ARROWS = 100


class Arrows:
    """Arrows from frames to their parents; lines if there are more than 100."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._arrows: Any = None
        self._lines: Any = None

    def draw(self, points: Floats, colors: NDArray[np.uint8], size: float) -> None:
        """Draw these, (N, 2, 3) from tail to tip, and no others; `size` is the length of axes."""
        are_many = len(points) > MOST_ARROWS
        _show(self._arrows, len(points) > 0 and not are_many)
        _show(self._lines, are_many)
        if are_many:
            self._draw_lines(points, colors)
        elif len(points):
            self._draw_arrows(points, colors, size)

    def _draw_arrows(self, points: Floats, colors: NDArray[np.uint8], size: float) -> None:
        shape: dict[str, Any] = {
            "shaft_radius": _SHAFT_RADIUS * size,
            "head_radius": _HEAD_RADIUS * size,
            "head_length": _HEAD_LENGTH * size,
        }
        if self._arrows is None:
            self._arrows = self._scene.add_arrows("/frames/arrows", points, colors, **shape)
            return
        self._arrows.points = points.astype(np.float32)
        _color(self._arrows, colors)
        for name, value in shape.items():
            if getattr(self._arrows, name) != value:
                setattr(self._arrows, name, value)

    def _draw_lines(self, points: Floats, colors: NDArray[np.uint8]) -> None:
        of_ends = np.repeat(colors[:, None], 2, axis=1)
        if self._lines is None:
            self._lines = self._scene.add_line_segments(
                "/frames/lines",
                points,
                of_ends,
                thickness=1.5,
                thickness_units="screen",
            )
        else:
            self._lines.points = points.astype(np.float32)
            _color(self._lines, of_ends)


class Trails:
    """Lines along which frames have moved."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._handle: Any = None

    def draw(self, paths: Sequence[Floats]) -> None:
        """Draw these, each (N, 3), and no others."""
        _show(self._handle, bool(paths))
        if not paths:
            return
        pieces = np.concatenate([np.stack([path[:-1], path[1:]], axis=1) for path in paths])
        if self._handle is None:
            self._handle = self._scene.add_line_segments(
                "/frames/trails",
                pieces,
                _TRAIL,
                thickness=3.0,
                thickness_units="screen",
            )
        else:
            self._handle.points = pieces.astype(np.float32)


def _show(handle: Any, visible: bool) -> None:
    if handle is not None and handle.visible != visible:
        handle.visible = visible


def _color(handle: Any, colors: NDArray[np.uint8]) -> None:
    if not np.array_equal(handle.colors, colors):
        handle.colors = colors


Rgb = tuple[int, int, int]

# Of arrows and marks; they differ in brightness too.
COLORS: dict[State, Rgb] = {
    "dynamic": (214, 170, 40),
    "static": (70, 130, 190),
    "stale": (140, 140, 140),
    "ahead": (20, 150, 140),
    "gone": (190, 40, 40),
    "conflict": (200, 60, 190),
    "root": (140, 140, 140),
}


class Styling:
    """Opacities, colours and marks of frames, wherever they are; they change seldom."""

    def __init__(self, frames: Frames, names: Sequence[str], settings: ViewSettings) -> None:
        self.frames, self.names, self.settings = frames, names, settings
        shown = [frames[name] for name in names]
        self.opacity = settings.opacity * np.array([frame.opacity for frame in shown])
        rows = [row for row, frame in enumerate(shown) if frame.state in FAULTS]
        self.marked = np.array(rows, np.intp)
        self.mark_colors = np.array([COLORS[shown[row].state] for row in rows], np.uint8)
        parents = {frame.name: frame.info.parent for frame in shown}
        self.children, self.parents = arrow_rows(names, parents)
        colors = np.array([COLORS[frame.state] for frame in shown], np.uint8).reshape(-1, 3)
        self.arrow_colors = colors[self.children]

    def is_of(self, frames: Frames, names: Sequence[str], settings: ViewSettings) -> bool:
        """Whether it still holds for these frames and settings."""
        return frames is self.frames and settings is self.settings and names == self.names


# Below anything that lies on the ground.
_GRID_Z_M = -0.02

# The length of axes in parts of the scene, and less for many frames: as if they filled a square,
# half the distance from one to the next. And the least size of a scene.
_SIZE = 1.0 / 10.0
_SIZE_OF_MANY = 0.5
_LEAST_EXTENT_M = 1.0

# Beside messages that are much larger, axes are at least this part of those, so that they are seen;
# but at most this many times as long as among the frames alone, which they would hide.
_SIZE_BESIDE_DATA = 1.0 / 25.0
_MOST_BESIDE_DATA = 8.0

# The part of points, along each axis, that a length leaves out as possibly wrong ones.
_LEFT_OUT_PERCENT = 2.5

# The grid fades out after this many cells.
_CELLS = 60.0

_UNSCALED = ViewSettings().scale


class DataExtent:
    """The size of all that is drawn of messages, `m`, in metres.

    It only grows while the same topics are drawn, so that the axes and the grid do not jump with
    each scan.
    """

    def __init__(self) -> None:
        self.m = 0.0
        self._topics: frozenset[str] = frozenset()

    def see(self, xyz: Floats, topics: Iterable[str]) -> None:
        """Take points (N, 3) of the messages of these topics."""
        if (seen := frozenset(topics)) != self._topics:
            self._topics, self.m = seen, 0.0
        xyz = xyz[np.isfinite(xyz).all(axis=1)]
        if len(xyz):
            outer = (_LEFT_OUT_PERCENT, 100.0 - _LEFT_OUT_PERCENT)
            self.m = max(self.m, float(np.ptp(np.percentile(xyz, outer, axis=0), axis=0).max()))


class Scene:
    """Draws placed frames; a click on a frame calls `on_select(client, name)`.

    `size_m` is the length of the axes.
    """

    def __init__(self, scene: viser.SceneApi, on_select: Callable[[int, str], object]) -> None:
        self._scene = scene
        self._size = 0.0
        self.size_m = 0.0
        self._beside_m = 0.0
        self._grid_for_m = 0.0
        self._axes = Axes(scene, on_select)
        self._arrows = Arrows(scene)
        self._trails = Trails(scene)
        # The sizes of the handle can be set, which mypy does not see.
        self._grid: Any = scene.add_grid(
            f"{FIXED_NODE}/grid",
            infinite_grid=True,
            position=(0.0, 0.0, _GRID_Z_M),
        )
        self._marks = add_marks(scene, "/frames/marks")
        self._styling = Styling(Frames(), (), ViewSettings())
        self._is_dark: bool | None = None

    def draw(
        self,
        frames: Frames,
        placed: Placed,
        trails: Sequence[Floats],
        settings: ViewSettings,
    ) -> None:
        """Show these frames, placed in the scene of viser, styled by their states, and no others;
        `fit` goes first.
        """
        size = self.size_m
        if not self._styling.is_of(frames, placed.names, settings):
            self._styling = Styling(frames, placed.names, settings)
        styling = self._styling
        shown = slice(None) if settings.axes else slice(0, 0)
        self._axes.draw(
            placed.names[shown],
            placed.xyz[shown],
            placed.quat_wxyz[shown],
            styling.opacity[shown],
            size,
        )
        self._mark(styling, placed.xyz, size)
        points, kept = arrow_points(placed.xyz, styling.children, styling.parents)
        drawn = kept if settings.arrows else np.zeros_like(kept)
        self._arrows.draw(points[drawn], styling.arrow_colors[drawn], size)
        self._trails.draw(trails)
        self._dress(settings)

    def fit(
        self, placed: Placed, settings: ViewSettings, around_m: float, data_m: float = 0.0
    ) -> None:
        """Take a length of axes that suits these frames, other things of the size `around_m`, and
        messages of the size `data_m`; and a grid. Each changes only when off by a factor of 2.
        """
        # Axes that somebody has scaled are as long as wanted, whatever messages come.
        if settings.scale == _UNSCALED:
            self._beside_m = data_m
        own_m = max(placed.extent_m(), around_m, _LEAST_EXTENT_M)
        own = own_m * min(_SIZE, _SIZE_OF_MANY / math.sqrt(max(len(placed.names), 1)))
        wanted = max(own, min(_SIZE_BESIDE_DATA * self._beside_m, _MOST_BESIDE_DATA * own))
        if _is_off(self._size, wanted):
            self._size = wanted
        self.size_m = self._size * settings.scale
        self._fit_grid(max(own_m, data_m))

    def _fit_grid(self, shown_m: float) -> None:
        if not _is_off(self._grid_for_m, shown_m):
            return
        self._grid_for_m = shown_m
        # A power of ten gives some cells, but not too many to tell apart.
        cell_m = 10.0 ** math.floor(math.log10(shown_m / 2.0))
        self._grid.cell_size, self._grid.section_size = cell_m, 5.0 * cell_m
        self._grid.fade_distance = _CELLS * cell_m

    def _dress(self, settings: ViewSettings) -> None:
        if self._grid.visible != settings.grid:
            self._grid.visible = settings.grid
        if self._is_dark != settings.dark:
            self._is_dark = settings.dark
            level = 70 if settings.dark else 205
            self._grid.cell_color = (level, level, level)
            self._grid.section_color = (level - 25, level - 25, level - 25)

    def _mark(self, styling: Styling, xyz: Floats, size: float) -> None:
        rows = styling.marked
        if len(rows) and not np.array_equal(self._marks.batched_colors, styling.mark_colors):
            self._marks.batched_colors = styling.mark_colors
        place(self._marks, xyz[rows], np.tile(NO_QUATERNIONS, (len(rows), 1)), size)


def _is_off(length: float, wanted: float) -> bool:
    """Whether a length is no longer about the wanted one."""
    return not wanted / 2.0 < length < wanted * 2.0


# At most this many names are drawn at once.
MOST_NAMES = 40

# Of this many frames at most, the nearest: more would lie behind each other.
_CONSIDERED = 200

# Frames closer together than this part of an axis share a label, which names at most three.
_TOGETHER = 0.4
_MOST_TOGETHER = 3

# A name is above its frame by this part of an axis; the rest is in pixels.
_ABOVE = 0.35
_LETTER = 6.2
_MARGIN = 10.0
_HEIGHT = 18.0

# Longer names are cut in the middle; the tree shows them whole.
_LONGEST = 32


class FrameLabels:
    """The names in the scenes of all browsers, as far as each one's camera can read them."""

    def __init__(
        self,
        server: viser.ViserServer,
        selections: Selections,
        window_of: Callable[[int], Viewport | None],
    ) -> None:
        self._server = server
        self._selections = selections
        self._window_of = window_of
        self._labels: dict[int, Labels] = {}

    def draw(
        self,
        frames: Sequence[ViewFrame] | None,
        placed: Placed,
        settings: ViewSettings,
        size: float,
        fixed: Transform,
    ) -> None:
        """Choose which of these frames have names; for None, only move the names there are. `fixed`
        is the pose of the fixed frame in the scene of viser.
        """
        clients = self._server.get_clients()
        self._labels = {
            number: self._labels.get(number) or Labels(client.scene)
            for number, client in clients.items()
        }
        for number, labels in self._labels.items():
            window = None if frames is None else self._window_of(number)
            if frames is None or window is None:
                labels.move(placed, size, fixed)
            else:
                own = replace(settings, selected=self._selections.of(number))
                labels.choose(frames, placed, own, size, window)
                labels.move(placed, size, fixed)


class Labels:
    """The names that one browser shows, few, since each is an object of its own."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._shown: dict[str, Any] = {}
        self._count = 0

    def choose(
        self,
        frames: Sequence[ViewFrame],
        placed: Placed,
        settings: ViewSettings,
        size: float,
        window: Viewport,
    ) -> None:
        """Write names at the frames; with names off, only at the selected one."""
        texts = readable(frames, placed.xyz, settings, size, window, frozenset(self._shown))
        for name in self._shown.keys() - texts.keys():
            self._shown.pop(name).remove()
        for name, text in texts.items():
            label = self._shown.get(name)
            if label is None:
                # Not by its name, which may have slashes: viser makes trees of them.
                self._count += 1
                self._shown[name] = self._scene.add_label(
                    f"/names/{self._count}", text, anchor="bottom-center"
                )
            elif label.text != text:
                label.text = text

    def move(self, placed: Placed, size: float, fixed: Transform) -> None:
        """Keep the names above their frames; remove the names of frames without a place."""
        for name in list(self._shown):
            row = placed.index.get(name)
            if row is None:
                self._shown.pop(name).remove()
            else:
                above = placed.xyz[row] + (0.0, 0.0, _ABOVE * size)
                self._shown[name].position = fixed.apply(above)


def readable(
    frames: Sequence[ViewFrame],
    xyz: Floats,
    settings: ViewSettings,
    size: float,
    window: Viewport,
    shown: frozenset[str] = frozenset(),
) -> dict[str, str]:
    """The names to write, by frame: none over another, none out of sight.

    First the selected frame, then stale, gone or conflicting ones, then names `shown` already, then
    the nearest. A name that covers two others ends in "+2", if there is room for that.
    """
    rows = range(len(frames)) if settings.names else _selected(frames, settings.selected)
    if not rows:
        return {}
    at = np.array(rows, np.intp)
    pixels, depth_m = window.project(xyz[at] + (0.0, 0.0, _ABOVE * size))
    importance = np.array([_importance(frames[row], settings.selected, shown) for row in at])
    order = np.lexsort((depth_m, importance))
    order = order[window.sees(pixels, depth_m)[order]][:_CONSIDERED]
    written: list[_WrittenName] = []
    for nearest in order:
        row = int(at[nearest])
        beside = next((one for one in written if _are_together(xyz, one.rows[0], row, size)), None)
        rows_here = sorted([*beside.rows, row]) if beside else [row]
        left, top = pixels[nearest].tolist()
        pixel = beside.pixel if beside else (left, top)
        covered = beside.covered if beside else 0
        box = _box(pixel, _text([frames[row] for row in rows_here], covered))
        over = [one for one in written if one is not beside and _overlap(box, one.box)]
        if over:
            _cover([beside, *over] if beside else over, written, frames)
        elif beside:
            beside.rows.append(row)
            beside.box = box
        elif len(written) < MOST_NAMES:
            written.append(_WrittenName([row], pixel, box))
    # Names in one label are in the order of the tree.
    return {frames[one.rows[0]].name: one.text(frames) for one in written}


# Left and top; with right and bottom.
Pixel = tuple[float, float]
Box = tuple[float, float, float, float]


@dataclass
class _WrittenName:
    """The name of frames at one place; `covered` others would lie below it, or beside too close."""

    rows: list[int]
    pixel: Pixel
    box: Box
    covered: int = 0

    def text(self, frames: Sequence[ViewFrame]) -> str:
        return _text([frames[row] for row in sorted(self.rows)], self.covered)


def _cover(
    over: Sequence[_WrittenName], written: Sequence[_WrittenName], frames: Sequence[ViewFrame]
) -> None:
    """Count a frame without a name at the first of the names over it that has room for that."""
    for one in over:
        counted = replace(one, covered=one.covered + 1)
        box = _box(one.pixel, counted.text(frames))
        if not any(_overlap(box, other.box) for other in written if other is not one):
            one.covered, one.box = counted.covered, box
            return


def _selected(frames: Sequence[ViewFrame], name: str) -> list[int]:
    return [row for row, frame in enumerate(frames) if frame.name == name]


def _importance(frame: ViewFrame, selected: str, shown: frozenset[str]) -> int:
    if frame.name == selected:
        return 0
    if frame.state in FAULTS:
        return 1
    return 2 if frame.name in shown else 3


def _are_together(xyz: Floats, one: int, other: int, size: float) -> bool:
    return bool(np.abs(xyz[one] - xyz[other]).max() < size * _TOGETHER)


def _text(frames: Sequence[ViewFrame], covered: int) -> str:
    names = [
        f"{_short(frame.name)} ({frame.state})" if frame.state in FAULTS else _short(frame.name)
        for frame in frames
    ]
    return listed(names, most=_MOST_TOGETHER) + (f" +{covered}" if covered else "")


def _short(name: str) -> str:
    if len(name) <= _LONGEST:
        return name
    return f"{name[: _LONGEST // 2 - 1]}…{name[-_LONGEST // 2 :]}"


def _box(pixel: Pixel, text: str) -> Box:
    half = (_LETTER * len(text) + _MARGIN) / 2.0
    return pixel[0] - half, pixel[1] - _HEIGHT, pixel[0] + half, pixel[1]


def _overlap(one: Box, other: Box) -> bool:
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]
