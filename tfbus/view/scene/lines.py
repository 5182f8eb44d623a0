"""Arrows and trails: one object for all of each, made when the first is drawn."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

from tfbus.view.model.placement import Floats

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
