"""The axes of many frames as few objects: one for all opaque frames, three for the fading ones.

viser's batched axes have no opacity.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import viser

from tfbus.view.model.placement import Floats
from tfbus.view.scene.shapes import arm

# The radius of an axis, in parts of its length.
_RADIUS = 0.035
_COLORS = ((217, 48, 48), (60, 160, 60), (40, 90, 220))

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
            for axis, color in enumerate(_COLORS)
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
