"""The shapes of a robot's links, each at its frame."""

import logging
from collections.abc import Collection, Sequence
from importlib import import_module
from typing import Any

import viser

from tfbus.errors import UrdfError
from tfbus.robot.model import Box, Cylinder, Mesh, Sphere, Visual
from tfbus.view.model.placement import Placed

# For shapes without a colour.
_GREY = (160, 160, 165)


class RobotScene:
    """Draws visuals at the frames of their links; links without a place are hidden.

    `mistakes` says of each visual that is left out why, such as a mesh that cannot be read.
    """

    def __init__(
        self, scene: viser.SceneApi, visuals: Sequence[Visual], log: logging.Logger
    ) -> None:
        self.mistakes: list[str] = []
        links = dict.fromkeys(visual.link for visual in visuals)
        self._frames = {
            link: scene.add_frame(f"/robot/{number}", show_axes=False, visible=False)
            for number, link in enumerate(links)
        }
        for number, visual in enumerate(visuals):
            try:
                _add(scene, f"{self._frames[visual.link].name}/{number}", visual)
            # Mesh readers raise all kinds of errors, ImportError among them.
            except Exception as error:
                self.mistakes.append(f"A visual of link {visual.link!r} is not shown: {error}")
                log.warning("%s", self.mistakes[-1])

    @property
    def links(self) -> Collection[str]:
        """The links that have visuals."""
        return self._frames.keys()

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
    place: dict[str, Any] = {"position": visual.origin.xyz, "wxyz": (w, x, y, z)}
    look: dict[str, Any] = {
        "color": visual.color or _GREY,
        "opacity": None if visual.opacity >= 1.0 else visual.opacity,
    }
    shape = visual.shape
    match shape:
        case Box():
            scene.add_box(path, dimensions=shape.size, **look, **place)
        case Cylinder():
            scene.add_cylinder(path, radius=shape.radius, height=shape.length, **look, **place)
        case Sphere():
            scene.add_icosphere(path, radius=shape.radius, subdivisions=3, **look, **place)
        case Mesh():
            mesh = load_mesh(shape)
            if visual.color is None:
                scene.add_mesh_trimesh(path, mesh, **place)
            else:
                scene.add_mesh_simple(path, mesh.vertices, mesh.faces, **look, **place)


def load_mesh(shape: Mesh) -> Any:
    """The scaled trimesh.Trimesh of a mesh's file.

    Raises UrdfError if the file does not exist or no installed package reads it, and any error of
    a mesh reader.
    """
    if shape.file is None or not shape.file.is_file():
        package = shape.name.removeprefix("package://").partition("/")[0]
        remedy = f"; --package-path names the folder with package {package!r}"
        raise UrdfError(
            f"no file {shape.file or shape.name}"
            + (remedy if shape.name.startswith("package://") else "")
        )
    # Its functions have no exact types.
    trimesh: Any = import_module("trimesh")
    kind = shape.file.suffix[1:].lower()
    if kind not in trimesh.available_formats():
        remedy = "pip install pycollada" if kind == "dae" else "convert it to STL or GLB"
        raise UrdfError(f"no installed package reads {shape.file.name}; {remedy}")
    mesh = trimesh.load(shape.file, force="mesh")
    if kind == "dae":
        # The only format that states its unit.
        mesh.apply_scale(trimesh.units.unit_conversion(mesh.units, "meters"))
    mesh.apply_scale(shape.scale)
    return mesh
