"""The frames in three dimensions: axes, arrows, marks, trails and names, as few objects."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

from tfbus.nodes.viewer.axes import NO_POSITIONS, NO_QUATERNIONS, Axes, place
from tfbus.nodes.viewer.frames import Frames
from tfbus.nodes.viewer.labels import Labels
from tfbus.nodes.viewer.placing import Floats, Placed, edges
from tfbus.nodes.viewer.settings import ViewSettings
from tfbus.nodes.viewer.shapes import octahedron
from tfbus.nodes.viewer.status import FrameState, Status

Rgb = tuple[int, int, int]

# Of arrows and marks, and told apart in brightness too.
COLORS: dict[Status, Rgb] = {
    Status.FRESH: (214, 170, 40),
    Status.STATIC: (70, 130, 190),
    Status.STALE: (140, 140, 140),
    Status.GONE: (190, 40, 40),
    Status.CONFLICT: (200, 60, 190),
    Status.ROOT: (140, 140, 140),
}
_MARKED = (Status.STALE, Status.GONE, Status.CONFLICT)
_SELECTED = (255, 150, 0)
_TRAIL = (240, 120, 30)

# The radius of a mark, in parts of an axis.
_MARK = 0.14

# Below what lies on the ground.
_GRID_Z_M = -0.02

# How long axes are, in parts of what is shown; and the least that counts as shown.
_SIZE = 1.0 / 10.0
_LEAST_EXTENT_M = 1.0


class Scene:
    """Draws what is placed; a click on a frame calls `on_select(name)`."""

    def __init__(self, scene: viser.SceneApi, on_select: Callable[[str], object]) -> None:
        self._scene = scene
        self._size = 0.0
        self._axes = Axes(scene, on_select)
        self._labels = Labels(scene)
        self._arrows = _Rewritten(self._draw_arrows)
        self._trails = _Rewritten(self._draw_trails)
        self._grid = scene.add_grid(
            "/grid",
            infinite_grid=True,
            fade_distance=60.0,
            cell_size=1.0,
            section_size=5.0,
            position=(0.0, 0.0, _GRID_Z_M),
        )
        self._marks = scene.add_batched_meshes_simple(
            "/frames/marks",
            *octahedron(_MARK),
            NO_QUATERNIONS,
            NO_POSITIONS,
            batched_scales=np.ones(1),
            batched_colors=_SELECTED,
            cast_shadow=False,
            receive_shadow=False,
            visible=False,
        )
        self._marked_colors: bytes = b""
        self._is_dark: bool | None = None

    def draw(
        self,
        frames: Frames,
        placed: Placed,
        trails: Mapping[str, Floats],
        settings: ViewSettings,
        around_m: float,
    ) -> None:
        """Show these frames, each as its state is, and nothing else.

        `around_m` is how large what else is shown is.
        """
        states = [frames.states[name] for name in placed.names]
        size = self._fit(max(placed.extent_m(), around_m)) * settings.scale
        opacity = settings.opacity * np.array([state.opacity for state in states])
        shown = slice(None) if settings.axes else slice(0, 0)
        self._axes.draw(
            placed.names[shown], placed.xyz[shown], placed.quat_wxyz[shown], opacity[shown], size
        )
        self._mark(states, placed, settings.selected, size)
        self._arrows.show(settings.arrows and self._arrow_points(frames, placed, size))
        self._trails.show(trails and _segments(trails))
        self._labels.draw(states, placed, settings, size)
        self._dress(settings)

    def _fit(self, extent_m: float) -> float:
        """A length of axes that suits what is shown; it changes only where it has to."""
        wanted = max(extent_m, _LEAST_EXTENT_M) * _SIZE
        if not wanted / 2.0 < self._size < wanted * 2.0:
            self._size = wanted
        return self._size

    def _dress(self, settings: ViewSettings) -> None:
        if self._grid.visible != settings.grid:
            self._grid.visible = settings.grid
        if self._is_dark != settings.dark:
            self._is_dark = settings.dark
            level = 70 if settings.dark else 205
            self._grid.cell_color = (level, level, level)
            self._grid.section_color = (level - 25, level - 25, level - 25)

    def _mark(
        self, states: Sequence[FrameState], placed: Placed, selected: str, size: float
    ) -> None:
        rows = [
            row
            for row, state in enumerate(states)
            if state.status in _MARKED or state.name == selected
        ]
        if rows:
            colors = np.array(
                [
                    COLORS[states[row].status] if states[row].status in _MARKED else _SELECTED
                    for row in rows
                ],
                np.uint8,
            )
            if colors.tobytes() != self._marked_colors:
                self._marked_colors = colors.tobytes()
                self._marks.batched_colors = colors
        place(self._marks, placed.xyz[rows], np.tile(NO_QUATERNIONS, (len(rows), 1)), size)

    def _arrow_points(
        self, frames: Frames, placed: Placed, size: float
    ) -> tuple[Floats, NDArray[np.uint8], float] | None:
        parents = {name: frames.states[name].info.parent for name in placed.names}
        names, points = edges(placed, parents)
        if not names:
            return None
        colors = np.array([COLORS[frames.states[name].status] for name in names], np.uint8)
        return points, colors, size

    def _draw_arrows(self, before: Any, what: tuple[Floats, NDArray[np.uint8], float]) -> Any:
        points, colors, size = what
        if before is None:
            return self._scene.add_arrows(
                "/frames/arrows",
                points,
                colors,
                shaft_radius=0.025 * size,
                head_radius=0.08 * size,
                head_length=0.2 * size,
            )
        before.points = points.astype(np.float32)
        if not np.array_equal(before.colors, colors):
            before.colors = colors
        if before.head_length != 0.2 * size:
            before.shaft_radius, before.head_radius = 0.025 * size, 0.08 * size
            before.head_length = 0.2 * size
        return before

    def _draw_trails(self, before: Any, what: Floats) -> Any:
        if before is None:
            return self._scene.add_line_segments(
                "/frames/trails", what, _TRAIL, thickness=3.0, thickness_units="screen"
            )
        before.points = what.astype(np.float32)
        return before


class _Rewritten:
    """An object that is made when first needed, then changed, and hidden while there is nothing."""

    def __init__(self, draw: Callable[[Any, Any], Any]) -> None:
        self._draw = draw
        self._handle: Any = None

    def show(self, what: Any) -> None:
        """Draw it; nothing where `what` is false or None."""
        if what is not None and what is not False and len(what):
            self._handle = self._draw(self._handle, what)
            visible = True
        else:
            visible = False
        if self._handle is not None and self._handle.visible != visible:
            self._handle.visible = visible


def _segments(trails: Mapping[str, Floats]) -> Floats:
    """The trails as separate lines: (N, 2, 3)."""
    return np.concatenate([np.stack([path[:-1], path[1:]], axis=1) for path in trails.values()])
