"""Axes and marks at the origins of many frames, as few objects.

Axes are one object for all opaque frames, and three for the fading ones: viser's batched axes have
no opacity.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

from tfbus.view.model.frames import FAULTS, Floats, Frames, Placed
from tfbus.view.model.settings import Selections

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
