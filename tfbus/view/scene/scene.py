"""The frames in three dimensions: axes, arrows, marks and trails, as few objects."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

from tfbus.frames.moment import State
from tfbus.view.model.frames import FAULTS, Floats, Frames, Placed, arrow_points, arrow_rows
from tfbus.view.model.settings import ViewSettings
from tfbus.view.scene.axes import NO_QUATERNIONS, Axes, add_marks, place

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
                "/frames/lines", points, of_ends, thickness=1.5, thickness_units="screen"
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
                "/frames/trails", pieces, _TRAIL, thickness=3.0, thickness_units="screen"
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

# The grid fades out after this many cells.
_CELLS = 60.0


class Scene:
    """Draws placed frames; a click on a frame calls `on_select(client, name)`.

    `size_m` is the length of the axes.
    """

    def __init__(self, scene: viser.SceneApi, on_select: Callable[[int, str], object]) -> None:
        self._scene = scene
        self._size = 0.0
        self.size_m = 0.0
        self._axes = Axes(scene, on_select)
        self._arrows = Arrows(scene)
        self._trails = Trails(scene)
        # The sizes of the handle can be set, which mypy does not see.
        self._grid: Any = scene.add_grid(
            "/grid",
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
        trails: Mapping[str, Floats],
        settings: ViewSettings,
        around_m: float,
    ) -> None:
        """Show these frames, styled by their states, and no others.

        `around_m` is the size of the other things in the scene.
        """
        if not self._styling.is_of(frames, placed.names, settings):
            self._styling = Styling(frames, placed.names, settings)
        styling = self._styling
        self.size_m = size = (
            self._fit(max(placed.extent_m(), around_m), len(placed.names)) * settings.scale
        )
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
        self._trails.draw(list(trails.values()))
        self._dress(settings)

    def _fit(self, extent_m: float, count: int) -> float:
        """A length of axes that suits the scene; it changes only when off by a factor of 2."""
        shown_m = max(extent_m, _LEAST_EXTENT_M)
        wanted = shown_m * min(_SIZE, _SIZE_OF_MANY / math.sqrt(max(count, 1)))
        if not wanted / 2.0 < self._size < wanted * 2.0:
            self._size = wanted
            # A power of ten gives some cells, but not too many to tell apart.
            cell_m = 10.0 ** math.floor(math.log10(shown_m / 2.0))
            self._grid.cell_size, self._grid.section_size = cell_m, 5.0 * cell_m
            self._grid.fade_distance = _CELLS * cell_m
        return self._size

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
