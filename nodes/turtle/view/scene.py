"""The turtles' field in the scene: its picture on the ground, and turtles on it."""

from importlib import import_module
from typing import Any

import numpy as np
import viser

from tfbus import Transform
from tfbus.view.frames import Placed
from tfbus.view.scene.drawn import FIXED_NODE, Region

from .. import field
from ..turtle_colors import Rgb, colors_of
from .turtles import Picture, Turtles

# The frame at the middle of the field.
WORLD = "world"

# Of a ball around the visible part of the field.
_FIELD_RADIUS_M = 0.68 * field.SIZE_M

# Below the frames on the ground, and above the grid.
_PAPER_Z_M = -0.01


class TurtleScene:
    """Shows the field at its frame, or around the origin while there are no frames."""

    def __init__(self, scene: viser.SceneApi, turtles: Turtles) -> None:
        self._scene = scene
        self._turtles = turtles
        self._root = scene.add_frame(f"{FIXED_NODE}/turtles", show_axes=False, visible=False)
        self._shown: Picture | None = None
        self._paper: Any = None
        self._bodies: dict[str, Any] = {}

    @property
    def region(self) -> Region | None:
        """The field; None while it is hidden."""
        if not self._root.visible:
            return None
        return Region(np.array(self._root.position, np.float64), _FIELD_RADIUS_M)

    def draw(self, placed: Placed, fixed_frame: str) -> None:
        """Show the turtles at their frames, or at the poses that they publish."""
        at_world = placed.index.get(WORLD)
        visible = self._turtles.are_there and (at_world is not None or not fixed_frame)
        if self._root.visible != visible:
            self._root.visible = visible
        if not visible:
            return
        if at_world is not None:
            self._root.position = placed.xyz[at_world]
            self._root.wxyz = placed.quat_wxyz[at_world]
        self._draw_paper()
        for name in self._bodies.keys() - set(self._turtles.names):
            self._bodies.pop(name).remove()
        for name in self._turtles.names:
            self._draw_turtle(name, placed, at_world)

    def _draw_paper(self) -> None:
        picture = self._turtles.picture
        if picture is None or picture is self._shown:
            return
        self._shown = picture
        if self._paper is None:
            # Half a turn about x: viser's images have y down.
            self._paper = self._scene.add_image(
                f"{FIXED_NODE}/turtles/paper",
                picture.pixels,
                field.SIZE_M,
                field.SIZE_M,
                format="png",
                position=(0.0, 0.0, _PAPER_Z_M),
                wxyz=(0.0, 1.0, 0.0, 0.0),
                cast_shadow=False,
                receive_shadow=False,
            )
        else:
            self._paper.image = picture.pixels

    def _draw_turtle(self, name: str, placed: Placed, at_world: int | None) -> None:
        pose = self._place_of(name, placed, at_world)
        if pose is None:
            return
        if name not in self._bodies:
            self._bodies[name] = _add_turtle(self._scene, f"{FIXED_NODE}/turtles/body/{name}", name)
        body = self._bodies[name]
        x, y, z, w = pose.quat_xyzw
        body.position, body.wxyz = pose.xyz, (w, x, y, z)

    def _place_of(self, name: str, placed: Placed, at_world: int | None) -> Transform | None:
        """The turtle's pose in the world: by its frame at the time shown, else its last pose."""
        row = placed.index.get(name)
        if row is not None and at_world is not None:
            return placed.pose(at_world).inverse() @ placed.pose(row)
        pose = self._turtles.pose(name)
        if pose is None:
            return None
        xyz = (pose.x - field.MIDDLE_M, pose.y - field.MIDDLE_M, 0.0)
        return Transform.from_rpy(0.0, 0.0, pose.theta, xyz)


def _linear(color: Rgb) -> tuple[int, int, int, int]:
    """The colour in linear light, as glTF has it for vertices."""
    r, g, b = (round(255 * (part / 255) ** 2.2) for part in color)
    return r, g, b, 255


def _add_turtle(scene: viser.SceneApi, path: str, name: str) -> Any:
    """A turtle one metre long that looks along x, in the colours of its name."""
    # Its functions have no exact types.
    trimesh: Any = import_module("trimesh")
    colors = colors_of(name)
    parts: list[Any] = []

    def ellipsoid(
        centre: tuple[float, float, float],
        radii: tuple[float, float, float],
        color: Rgb,
        turn_rad: float = 0.0,
    ) -> None:
        part = trimesh.creation.icosphere(subdivisions=2)
        part.apply_scale(radii)
        part.apply_transform(trimesh.transformations.rotation_matrix(turn_rad, (0, 0, 1)))
        part.apply_translation(centre)
        part.visual.vertex_colors = np.tile(_linear(color), (len(part.vertices), 1))
        parts.append(part)

    ellipsoid((0.0, 0.0, 0.06), (0.39, 0.32, 0.05), colors.rim)
    ellipsoid((0.0, 0.0, 0.07), (0.33, 0.27, 0.12), colors.shell)
    ellipsoid((0.45, 0.0, 0.07), (0.15, 0.11, 0.07), colors.skin)
    for side in (1, -1):
        ellipsoid((0.26, 0.27 * side, 0.04), (0.19, 0.07, 0.03), colors.skin, 0.75 * side)
        ellipsoid((-0.26, 0.24 * side, 0.04), (0.15, 0.065, 0.03), colors.skin, 2.45 * side)
        ellipsoid((0.54, 0.06 * side, 0.11), (0.03, 0.03, 0.03), (20, 24, 28))
    return scene.add_mesh_trimesh(path, trimesh.util.concatenate(parts))
