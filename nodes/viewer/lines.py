"""Arrows and trails: one object for all of each, made when there is first something to draw."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

from tfbus.nodes.viewer.placing import Floats

_TRAIL = (240, 120, 30)

# In parts of an axis.
_SHAFT_RADIUS = 0.025
_HEAD_RADIUS = 0.08
_HEAD_LENGTH = 0.2


class Arrows:
    """Arrows of frames to their parents."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._handle: Any = None

    def draw(self, points: Floats, colors: NDArray[np.uint8], size: float) -> None:
        """Draw these, (N, 2, 3) from tail to tip, and no others; `size` is that of axes."""
        if self._handle is not None and self._handle.visible != bool(len(points)):
            self._handle.visible = bool(len(points))
        if not len(points):
            return
        shape: dict[str, Any] = {
            "shaft_radius": _SHAFT_RADIUS * size,
            "head_radius": _HEAD_RADIUS * size,
            "head_length": _HEAD_LENGTH * size,
        }
        if self._handle is None:
            self._handle = self._scene.add_arrows("/frames/arrows", points, colors, **shape)
            return
        self._handle.points = points.astype(np.float32)
        if not np.array_equal(self._handle.colors, colors):
            self._handle.colors = colors
        for name, value in shape.items():
            if getattr(self._handle, name) != value:
                setattr(self._handle, name, value)


class Trails:
    """Lines along which frames have come."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._handle: Any = None

    def draw(self, paths: Sequence[Floats]) -> None:
        """Draw these, each (N, 3), and no others."""
        if self._handle is not None and self._handle.visible != bool(paths):
            self._handle.visible = bool(paths)
        if not paths:
            return
        pieces = np.concatenate([np.stack([path[:-1], path[1:]], axis=1) for path in paths])
        if self._handle is None:
            self._handle = self._scene.add_line_segments(
                "/frames/trails", pieces, _TRAIL, thickness=3.0, thickness_units="screen"
            )
        else:
            self._handle.points = pieces.astype(np.float32)
