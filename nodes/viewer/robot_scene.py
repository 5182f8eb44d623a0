"""A robot's links in three dimensions, each where its frame is."""

import logging
from collections.abc import Sequence
from importlib import import_module
from typing import Any

import viser

from tfbus.nodes.viewer.placing import Placed
from tfbus.nodes.viewer.urdf import Box, Cylinder, Mesh, Sphere, Visual


class RobotScene:
    """Draws visuals on the frames of their links; links without a place are not drawn.

    A mesh that cannot be read is told in the log, and left out.
    """

    def __init__(
        self, scene: viser.SceneApi, visuals: Sequence[Visual], log: logging.Logger
    ) -> None:
        links = dict.fromkeys(visual.link for visual in visuals)
        self._frames = {
            link: scene.add_frame(f"/robot/{number}", show_axes=False, visible=False)
            for number, link in enumerate(links)
        }
        for number, visual in enumerate(visuals):
            try:
                _add(scene, f"{self._frames[visual.link].name}/{number}", visual)
            # Readers of meshes raise whatever their libraries do, ImportError among them.
            except Exception as error:
                log.warning("A visual of link %r is not shown: %s", visual.link, error)

    def draw(self, placed: Placed) -> None:
        """Move the links to their frames."""
        for link, frame in self._frames.items():
            row = placed.index.get(link)
            if frame.visible != (row is not None):
                frame.visible = row is not None
            if row is not None:
                frame.position, frame.wxyz = placed.xyz[row], placed.quat_wxyz[row]


def _add(scene: viser.SceneApi, path: str, visual: Visual) -> None:
    x, y, z, w = visual.origin.quat_xyzw
    look: dict[str, Any] = {
        "color": visual.color,
        "opacity": None if visual.opacity >= 1.0 else visual.opacity,
        "position": visual.origin.xyz,
        "wxyz": (w, x, y, z),
    }
    shape = visual.shape
    match shape:
        case Box():
            scene.add_box(path, dimensions=shape.size, **look)
        case Cylinder():
            scene.add_cylinder(path, radius=shape.radius, height=shape.length, **look)
        case Sphere():
            scene.add_icosphere(path, radius=shape.radius, subdivisions=3, **look)
        case Mesh():
            _add_mesh(scene, path, shape, look)


def _add_mesh(scene: viser.SceneApi, path: str, shape: Mesh, look: dict[str, Any]) -> None:
    # What it loads has no exact type.
    trimesh: Any = import_module("trimesh")
    mesh = trimesh.load(shape.file, force="mesh")
    mesh.apply_scale(shape.scale)
    scene.add_mesh_simple(path, mesh.vertices, mesh.faces, **look)
