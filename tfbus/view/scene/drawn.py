"""Additions of a program to the page: shapes, each attached to a frame; guests with a tab of it."""

import math
import threading
from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import cache
from typing import Any, Protocol

import numpy as np
import trimesh
import viser
from numpy.typing import ArrayLike, NDArray
from trimesh import creation

from tfbus.base.errors import InvalidArgumentException
from tfbus.geometry.transform import Transform
from tfbus.view.frames import Floats, Placed
from tfbus.view.panels.markup import Channel

# The node of viser's scene that all is drawn below: it has the axes of the fixed frame.
FIXED_NODE = "/fixed"


@dataclass(frozen=True, eq=False)
class Region:
    """A ball of the scene that is worth seeing whole: `middle` (3,) and radius in metres.

    `toward` (3,) points to where it is first seen from, None for from behind and above.
    """

    middle: NDArray[np.float64]
    radius_m: float
    toward: NDArray[np.float64] | None = None


class Guest(Protocol):
    """A tab with controls, and shapes in the scene.

    `title` is the name of the tab; `style` and `script` are CSS and JavaScript for its controls.
    The page calls `join` once, and then `draw` again and again, on one thread. The tab is there
    while `is_present`, but never on a page that is read-only: the page calls `add_controls` each
    time it appears, and then `refresh`.
    """

    title: str
    style: str
    script: str

    def join(self, scene: viser.SceneApi, is_watched: Callable[[], bool]) -> None:
        """Add the shapes, below FIXED_NODE; `is_watched` is for any thread."""

    @property
    def is_present(self) -> bool:
        """Whether the tab is of any use now."""

    def add_controls(self, gui: viser.GuiApi, channel: Channel) -> None:
        """Add the controls, inside a new tab; a former tab's are gone."""

    def refresh(self) -> None:
        """Bring the controls up to date."""

    def draw(self, placed: Placed, fixed_frame: str) -> None:
        """Move the shapes to where the frames are."""

    @property
    def frames(self) -> Collection[str]:
        """The frames to place even if their axes are hidden."""

    @property
    def region(self) -> Region | None:
        """The first target of a browser's camera; None while the guest shows nothing."""


Color = tuple[int, int, int]

_MOST_COLOR = 255


@dataclass(eq=False)
class Shape:
    """A shape below `node`, which is where the frame is. A label, `at` (3,) in the frame, is its
    own node.
    """

    frame: str
    node: Any
    handle: Any
    at: Floats | None = None


class Drawn:
    """Shapes by name, in the axes of their frames; they are hidden if their frame has no place.

    Safe from any thread.
    """

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._lock = threading.Lock()
        self._shapes: dict[str, Shape] = {}
        self._count = 0

    @property
    def frames(self) -> Collection[str]:
        """The frames that shapes are attached to."""
        with self._lock:
            return {shape.frame for shape in self._shapes.values()}

    def add(self, name: str, frame: str, make: Callable[[str], Any]) -> None:
        """Add the shape that `make(path)` adds to the scene; it replaces one of the same name."""
        with self._lock:
            former = self._without_label(name)
            # Not by its name, which may have slashes: viser makes trees of them. At the place of
            # the former, which viser replaces without a flicker.
            if former is None:
                self._count += 1
                node: Any = self._scene.add_frame(
                    f"{FIXED_NODE}/drawn/{self._count}", show_axes=False, visible=False
                )
            else:
                node = former.node
            try:
                handle = make(f"{node.name}/shape")
            except BaseException:
                if former is None:
                    node.remove()
                raise
            if former is not None and former.frame != frame:
                node.visible = False
            self._shapes[name] = Shape(frame, node, handle)

    def add_label(self, name: str, frame: str, text: str, at: Floats) -> None:
        """Write a text above a point (3,) of the frame; it replaces a shape of the same name."""
        # In the scene of viser: below a node that moves, browsers draw it one picture later.
        with self._lock:
            self._remove(name)
            self._count += 1
            handle: Any = self._scene.add_label(
                f"/labels/{self._count}", text, anchor="bottom-center", visible=False
            )
            self._shapes[name] = Shape(frame, handle, handle, at)

    def remove(self, name: str) -> bool:
        """Remove a shape; whether there was one."""
        with self._lock:
            return self._remove(name)

    def _remove(self, name: str) -> bool:
        shape = self._shapes.pop(name, None)
        if shape is not None:
            shape.handle.remove()
            if shape.at is None:
                shape.node.remove()
        return shape is not None

    def _without_label(self, name: str) -> Shape | None:
        """The shape of this name; a label is removed."""
        former = self._shapes.get(name)
        if former is None or former.at is None:
            return former
        self._remove(name)
        return None

    @property
    def shapes(self) -> dict[str, Shape]:
        """All shapes as they are now, by name."""
        with self._lock:
            return dict(self._shapes)

    def draw(self, placed: Placed, fixed: Transform) -> None:
        """Move the shapes to their frames; `fixed` is the pose of the fixed frame in the scene of
        viser.
        """
        with self._lock:
            for shape in self._shapes.values():
                row = placed.index.get(shape.frame)
                if row is not None and shape.at is not None:
                    shape.node.position = fixed.apply(placed.pose(row).apply(shape.at))
                elif row is not None:
                    shape.node.position = placed.xyz[row]
                    shape.node.wxyz = placed.quat_wxyz[row]
                if shape.node.visible != (row is not None):
                    shape.node.visible = row is not None


def points_of(points: ArrayLike, what: str = "points") -> Floats:
    """Points (N, 3). Raises InvalidArgumentException for another shape."""
    array = np.asarray(points, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3:
        raise InvalidArgumentException(f"{what}: expected shape (N, 3), got {array.shape}")
    return array


def point_of(xyz: ArrayLike, what: str) -> Floats:
    """A point (3,). Raises InvalidArgumentException for another shape, and for infinity or NaN."""
    array = np.asarray(xyz, dtype=np.float64)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise InvalidArgumentException(f"{what}: expected 3 finite numbers, got {xyz!r}")
    return array


def length_of(value: float, what: str) -> float:
    """A length in metres. Raises InvalidArgumentException unless it is more than 0."""
    if not (math.isfinite(value) and value > 0.0):
        raise InvalidArgumentException(f"{what} must be a number of metres above 0, got {value!r}")
    return float(value)


def color_of(color: ArrayLike, count: int | None = None) -> NDArray[np.uint8]:
    """A colour (3,), or with a count one for each (N, 3), from 0 to 255.

    Raises InvalidArgumentException.
    """
    array = np.asarray(color)
    shapes = [(3,)] if count is None else [(3,), (count, 3)]
    if array.shape not in shapes or not np.issubdtype(array.dtype, np.integer):
        wanted = " or ".join(map(str, shapes))
        raise InvalidArgumentException(
            f"color: expected red, green and blue as integers from 0 to 255, of shape {wanted}, "
            f"got {array.dtype} of shape {array.shape}"
        )
    if array.size and (int(array.min()) < 0 or int(array.max()) > _MOST_COLOR):
        raise InvalidArgumentException("color: each part must be from 0 to 255")
    return array.astype(np.uint8)


def image_of(image: ArrayLike) -> NDArray[np.uint8]:
    """An image (H, W, 3) or (H, W), uint8. Raises InvalidArgumentException."""
    array = np.asarray(image)
    if array.ndim == 2:
        array = np.repeat(array[:, :, None], 3, axis=2)
    if array.dtype != np.uint8 or array.ndim != 3 or array.shape[2] != 3 or not array.size:
        raise InvalidArgumentException(
            f"image: expected uint8 of shape (H, W, 3) or (H, W), got {array.dtype} of shape "
            f"{array.shape}"
        )
    return array


def place_of(pose: Transform | ArrayLike | None) -> dict[str, Any]:
    """The pose of a shape in its frame, in viser's words; from a pose there, or a point (3,)."""
    if pose is None:
        return {}
    if not isinstance(pose, Transform):
        return {"position": point_of(pose, "pose")}
    x, y, z, w = pose.quat_xyzw
    return {"position": pose.xyz, "wxyz": (w, x, y, z)}


def scale_of_depth(fov_y_rad: float, aspect: float) -> float:
    """viser's scale of a frustum that is 1 m deep: there frustums of one scale have one volume."""
    half_height = math.tan(fov_y_rad / 2.0)
    return math.cbrt(half_height * half_height * aspect / 3.0)


@cache
def unit_mesh(kind: str) -> tuple[Any, Any]:
    """The mesh of a body that is 1 m long each way; arrows and cones are along x."""
    if kind == "cube":
        mesh = creation.box()
    elif kind == "sphere":
        mesh = creation.icosphere(subdivisions=3, radius=0.5)
    elif kind == "cylinder":
        mesh = creation.cylinder(0.5, 1.0, sections=24)
    elif kind == "cone":
        # Its tip is at the origin.
        mesh = creation.cone(0.5, 1.0, sections=24)
        mesh.apply_translation((0.0, 0.0, -1.0))
        mesh.apply_transform(Transform.from_rpy(0.0, -np.pi / 2, 0.0).as_matrix())
    else:
        shaft = creation.cylinder(0.25, 0.77, sections=16)
        shaft.apply_translation((0.0, 0.0, 0.385))
        head = creation.cone(0.5, 0.23, sections=16)
        head.apply_translation((0.0, 0.0, 0.77))
        mesh = trimesh.util.concatenate([shaft, head])
        mesh.apply_transform(Transform.from_rpy(0.0, np.pi / 2, 0.0).as_matrix())
    return mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32)
