"""Robots in the scene: the shapes of their links, which of them are drawn, meshes on their way."""

import logging
import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import viser
from numpy.typing import NDArray

from tfbus.base.errors import InvalidArgumentException
from tfbus.base.wording import printable
from tfbus.robot.mesh_files import MeshFiles, file_below, package_folder, parts_of
from tfbus.robot.model import Box, Collision, Cylinder, Mesh, Shape, Sphere, Visual
from tfbus.view.frames import Floats, Frames, Placed
from tfbus.view.meshes.loader import MeshLoader, MeshSource, ReadMesh
from tfbus.view.meshes.mesh import Color, MeshPart, bounds_of
from tfbus.view.robots import RobotSource, ShownRobot, source_at
from tfbus.view.scene.camera import Ray
from tfbus.view.scene.drawn import FIXED_NODE, unit_mesh
from tfbus.view.settings import ViewSettings

# For shapes without a colour, and for colliding ones.
_GREY = (180, 182, 186)
_COLLIDES = (70, 150, 190)

# If visuals are seen too, collisions are seen through.
_THROUGH = 0.35

# Fading is sent in steps of this size.
_STEP = 0.05

# Vertices (V, 3) and faces (F, 3) in the frame of a link.
Surface = tuple[NDArray[np.floating], NDArray[np.integer]]

Shown = Literal["visual", "collision", "both"]


@dataclass(frozen=True)
class Look:
    """The shapes that are drawn, and their opacity, from 0 to 1."""

    shown: Shown = "visual"
    opacity: float = 1.0


@dataclass(eq=False)
class _Node:
    """An object of viser: of the visuals or of the collisions. `opacity` is its material's;
    `parts` that has a picture is drawn in its mean colour if it is seen through.
    """

    link: str
    handle: Any
    is_collision: bool
    surface: Surface
    opacity: float = 1.0
    textured: MeshPart | None = None
    twin: Any = None


@dataclass(eq=False)
class _AwaitedMesh:
    """A mesh that is being loaded, and the shape that its parts make."""

    source: MeshSource
    shape: Visual | Collision


@dataclass(eq=False)
class _Link:
    frame: Any
    corners: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    fading: float = 1.0


class RobotScene:
    """Draws the shapes of one robot at the frames of its links; links without a place are hidden.

    Meshes appear once `loader` has them. `mistakes` says of each shape that is left out why, such
    as a mesh that cannot be read.
    """

    def __init__(
        self, scene: viser.SceneApi, path: str, robot: ShownRobot, loader: MeshLoader
    ) -> None:
        self.robot = robot
        self.mistakes: dict[str, None] = {}
        self._scene = scene
        self._path = path
        self._loader = loader
        self._look = Look()
        self.nodes: list[_Node] = []
        self._waiting: list[_AwaitedMesh] = []
        self._sources: dict[MeshSource, bool] = {}
        self._added: set[bool] = set()
        self._root = scene.add_frame(path, show_axes=False)
        self.links = {
            link: _Link(scene.add_frame(f"{path}/{number}", show_axes=False, visible=False))
            for number, link in enumerate(robot.shaped_links)
        }
        self._count = 0
        self.show(Look(), True)

    # Its parts

    @property
    def sources(self) -> Collection[MeshSource]:
        """The mesh files that it needs, for the shown shapes."""
        return self._sources.keys()

    @property
    def loaded(self) -> int:
        """How many of them are loaded, or cannot be."""
        return sum(self._sources.values())

    def points(self, placed: Placed) -> Floats:
        """The corners (N, 3) of the boxes around its links that have a place, and their origins."""
        found = [np.zeros((0, 3))]
        for name, link in self.links.items():
            row = placed.index.get(self.robot.frame_of(name))
            if row is not None:
                found.append(placed.pose(row).apply(np.vstack((link.corners, np.zeros(3)))))
        return np.concatenate(found)

    def met_by(self, ray: Ray, placed: Placed) -> float:
        """The way in m along a ray of the fixed frame to its shown shapes; infinity for none."""
        ways = [math.inf]
        for node in self.nodes:
            row = placed.index.get(self.robot.frame_of(node.link))
            if row is not None and _shows(self._look.shown, node.is_collision):
                ways.append(ray.seen_from(placed.pose(row)).to_triangles(*node.surface))
        return min(ways)

    def placed_links(self, placed: Placed) -> int:
        """How many links with shapes have a place."""
        return sum(self.robot.frame_of(link) in placed.index for link in self.links)

    # How it is drawn

    def show(self, look: Look, is_visible: bool) -> None:
        """Draw it so; collisions are only made once they are shown."""
        wanted = [kind for kind in (False, True) if _shows(look.shown, kind)]
        for is_collision in wanted:
            if is_collision not in self._added:
                self._added.add(is_collision)
                self._add_all(self.robot.collisions if is_collision else self.robot.visuals)
        self._look = look
        for node in self.nodes:
            self._dress(node)
        if self._root.visible != is_visible:
            self._root.visible = is_visible

    def draw(self, placed: Placed, opacity_of: Callable[[str], float]) -> None:
        """Move the links to their frames, each as faded as its frame."""
        faded = set()
        for name, link in self.links.items():
            frame = self.robot.frame_of(name)
            row = placed.index.get(frame)
            if link.frame.visible != (row is not None):
                link.frame.visible = row is not None
            if row is None:
                continue
            link.frame.position, link.frame.wxyz = placed.xyz[row], placed.quat_wxyz[row]
            fading = round(opacity_of(frame) / _STEP) * _STEP
            if fading != link.fading:
                link.fading = fading
                faded.add(name)
        for node in self.nodes if faded else ():
            if node.link in faded:
                self._dress(node)

    def take_meshes(self, most: int) -> bool:
        """Draw at most this many meshes that have come meanwhile; whether there were any."""
        taken = 0
        for waiting in list(self._waiting):
            mesh = self._loader.found(waiting.source)
            if mesh is None:
                continue
            self._waiting.remove(waiting)
            self._sources[waiting.source] = True
            if isinstance(mesh, str):
                self._note(waiting.shape, f"is not shown: mesh {waiting.source.name}: {mesh}")
            else:
                for name, why in mesh.refused.items():
                    lack = f"{name} of mesh {waiting.source.name}: {why}"
                    self._note(waiting.shape, f"is shown without {lack}")
                self._add_parts(waiting.shape, mesh.parts)
            taken += 1
            if taken == most:
                break
        return taken > 0

    def remove(self) -> None:
        """Take it out of the scene."""
        self._root.remove()

    # The parts

    def _add_all(self, shapes: Sequence[Visual | Collision]) -> None:
        for shape in shapes:
            texture = shape.texture if isinstance(shape, Visual) else ""
            match shape.shape:
                case Mesh():
                    source = self.robot.source_of(shape.shape, texture)
                    if isinstance(source, str):
                        self._note(shape, f"is not shown: mesh {shape.shape.name}: {source}")
                        continue
                    self._sources.setdefault(source, False)
                    self._waiting.append(_AwaitedMesh(source, shape))
                    self._loader.load(source, self.robot.sender)
                case _:
                    if texture:
                        self._note(shape, f"is shown without {texture}: only meshes have pictures")
                    self._add_primitive(shape, shape.shape)

    def _note(self, shape: Visual | Collision, what: str) -> None:
        kind = "collision" if isinstance(shape, Collision) else "visual"
        self.mistakes[f"A {kind} of link {shape.link!r} {what}"] = None

    def _add_primitive(self, shape: Visual | Collision, primitive: Shape) -> None:
        path, look = self._next_path(shape), self._solid(shape)
        make: Any
        extent: dict[str, Any]
        match primitive:
            case Box(size):
                kind = "cube"
                make, extent = self._scene.add_box, {"dimensions": size}
                corner = np.array(size) / 2.0
            case Cylinder(radius, length):
                kind = "cylinder"
                make, extent = self._scene.add_cylinder, {"radius": radius, "height": length}
                corner = np.array((radius, radius, length / 2.0))
            case Sphere(radius):
                kind = "sphere"
                make, extent = self._scene.add_icosphere, {"radius": radius, "subdivisions": 3}
                corner = np.full(3, radius)
            case _:
                return
        color = getattr(shape, "color", None)
        handle = make(path, color=self._color(shape, color), **extent, **look)
        vertices, faces = unit_mesh(kind)
        surface = shape.origin.apply(vertices * (2.0 * corner)), faces
        self._keep(shape, handle, getattr(shape, "opacity", 1.0), surface)
        self._enclose(shape, np.array([-corner, corner]), (1.0, 1.0, 1.0))

    def _add_parts(self, shape: Visual | Collision, parts: Sequence[MeshPart]) -> None:
        assert isinstance(shape.shape, Mesh)
        scale = shape.shape.scale
        self._enclose(shape, bounds_of(parts), scale)
        for part in parts:
            surface = shape.origin.apply(part.vertices * np.array(scale)), part.faces
            if part.textured and isinstance(shape, Visual):
                handle: Any = self._scene.add_glb(
                    self._next_path(shape), part.textured, scale=scale, **_place(shape)
                )
                self._keep(shape, handle, 1.0, surface, part)
                continue
            # As in RViz, the mesh's colour goes first.
            color = part.color or getattr(shape, "color", None)
            opacity = part.opacity if part.color else getattr(shape, "opacity", 1.0)
            handle = self._add_part(shape, part, self._color(shape, color))
            self._keep(shape, handle, opacity, surface)

    def _add_part(self, shape: Visual | Collision, part: MeshPart, color: Color) -> Any:
        assert isinstance(shape.shape, Mesh)
        return self._scene.add_mesh_simple(
            self._next_path(shape),
            part.vertices,
            part.faces,
            color=color,
            scale=shape.shape.scale,
            side="double",
            **self._solid(shape),
        )

    def _keep(
        self,
        shape: Visual | Collision,
        handle: Any,
        opacity: float,
        surface: Surface,
        textured: MeshPart | None = None,
    ) -> None:
        is_collision = isinstance(shape, Collision)
        node = _Node(shape.link, handle, is_collision, surface, opacity, textured)
        if textured is not None:
            node.twin = lambda: self._add_part(shape, textured, textured.color or _GREY)
        self.nodes.append(node)
        self._dress(node)

    def _dress(self, node: _Node) -> None:
        is_shown = _shows(self._look.shown, node.is_collision)
        opacity = node.opacity * self._look.opacity * self.links[node.link].fading
        if node.is_collision and self._look.shown == "both":
            opacity *= _THROUGH
        if node.textured is None:
            _set(node.handle, is_shown, opacity)
            return
        # viser draws pictures opaque only.
        is_through = opacity < 1.0
        if is_through and callable(node.twin):
            node.twin = node.twin()
        if not callable(node.twin):
            _set(node.twin, is_shown and is_through, opacity)
        _set(node.handle, is_shown and not is_through, None)

    def _color(self, shape: Visual | Collision, color: Color | None) -> Color:
        return _COLLIDES if isinstance(shape, Collision) else color or _GREY

    def _solid(self, shape: Visual | Collision) -> dict[str, Any]:
        return {"cast_shadow": False, "receive_shadow": False, **_place(shape)}

    def _next_path(self, shape: Visual | Collision) -> str:
        self._count += 1
        return f"{self.links[shape.link].frame.name}/{self._count}"

    def _enclose(
        self, shape: Visual | Collision, box: Floats, scale: tuple[float, float, float]
    ) -> None:
        corners = np.array([[x, y, z] for x in box[:, 0] for y in box[:, 1] for z in box[:, 2]])
        link = self.links[shape.link]
        link.corners = np.concatenate((link.corners, shape.origin.apply(corners * scale)))


def _shows(shown: Shown, is_collision: bool) -> bool:
    return shown == "both" or (shown == "collision") == is_collision


def _set(handle: Any, is_shown: bool, opacity: float | None) -> None:
    """Set only values that change: each change is a message to all browsers."""
    if opacity is not None:
        wanted = None if opacity >= 1.0 else round(opacity, 3)
        if handle.opacity != wanted:
            handle.opacity = wanted
    if handle.visible != is_shown:
        handle.visible = is_shown


def _place(shape: Visual | Collision) -> dict[str, Any]:
    x, y, z, w = shape.origin.quat_xyzw
    return {"position": shape.origin.xyz, "wxyz": (w, x, y, z)}


def all_mistakes(scenes: Collection[RobotScene]) -> Iterator[str]:
    """The parts that cannot be shown, each once; with the robot if there are several."""
    for each in scenes:
        lead = f"{each.robot.title}: " if len(scenes) > 1 else ""
        for mistake in each.mistakes:
            yield f"{lead}{mistake}"


# Markers come from anyone on the bus: of so many files, of robots, their meshes are loaded.
_MOST_FOREIGN = 100

# A picture must not wait for many meshes.
_MESHES_A_STEP = 4


class RobotScenes:
    """Draws the robots of a source at the frames of their links.

    A robot of a file whose frames are not published stands at the origin, at `positions`.
    """

    def __init__(
        self,
        scene: viser.SceneApi,
        source: RobotSource,
        log: logging.Logger,
        *,
        heeds_up_axis: bool = False,
        package_path: Sequence[Path] = (),
    ) -> None:
        self.source = source
        self._package_path = tuple(package_path)
        self.positions: dict[str, float] = {}
        self._scene = scene
        self._log = log
        self._loader = MeshLoader(source.fetch, heeds_up_axis=heeds_up_axis)
        self._count = 0
        self.by_robot: dict[ShownRobot, RobotScene] = {}
        self._settings: ViewSettings | None = None
        self._logged: set[str] = set()
        self._still: dict[ShownRobot, Placed] = {}
        # Of markers, by the names of their files.
        self._foreign: dict[str, MeshSource] = {}
        self._has_freed = False

    @property
    def robots(self) -> Collection[ShownRobot]:
        """The robots in the scene."""
        return self.by_robot.keys()

    def close(self) -> None:
        """End the loading of meshes, and the source."""
        self._loader.close()
        self.source.close()

    # Drawing

    def look(self, settings: ViewSettings) -> bool:
        """Add robots that have come, and remove gone ones; whether there were any."""
        found = self.source.robots()
        is_new = list(found) != list(self.by_robot)
        if is_new:
            self._replace(found)
            self._log_mistakes()
        if is_new or self._has_freed:
            self._has_freed = False
            used = {source for scene in self.by_robot.values() for source in scene.sources}
            self._loader.keep(used | set(self._foreign.copy().values()))
        if is_new or settings is not self._settings:
            self._settings = settings
            for robot, scene in self.by_robot.items():
                scene.show(_look_of(settings), robot.title not in settings.hidden_robots)
        return is_new

    def _replace(self, found: Collection[ShownRobot]) -> None:
        for robot in [robot for robot in self.by_robot if robot not in found]:
            self.by_robot.pop(robot).remove()
        for robot in found:
            if robot not in self.by_robot:
                self._count += 1
                path = f"{FIXED_NODE}/robots/{self._count}"
                self.by_robot[robot] = RobotScene(self._scene, path, robot, self._loader)
        self.by_robot = {robot: self.by_robot[robot] for robot in found}

    def take_meshes(self) -> bool:
        """Draw meshes that have come; whether there were any."""
        taken = any([scene.take_meshes(_MESHES_A_STEP) for scene in self.by_robot.values()])
        if taken:
            self._log_mistakes()
        return taken

    def mesh_named(
        self, name: str, drawn: Callable[[], Collection[str]] = frozenset
    ) -> ReadMesh | str | None:
        """The mesh of a file that a marker names, why there is none, or None while it is loaded:
        one that a robot in the scene has, or that lies in a package on this machine, or whose path
        is below a folder of the package path. If there are too many, all but the `drawn` are freed.
        """
        source = self._foreign.get(name)
        if source is None:
            found = self._source_named(name)
            if isinstance(found, str):
                return found
            if len(self._foreign) >= _MOST_FOREIGN:
                kept = drawn()
                self._free([each for each in self._foreign if each not in kept])
            if len(self._foreign) >= _MOST_FOREIGN:
                return f"more than {_MOST_FOREIGN} meshes of markers are not drawn"
            source = self._foreign[name] = found
        # Again, as the loader may have forgotten it before it had its name here.
        self._loader.load(source, "markers")
        return self._loader.found(source)

    def _free(self, names: Collection[str]) -> None:
        for name in names:
            del self._foreign[name]
        # The loader forgets them with the next look, on the thread that adds robots.
        self._has_freed = True

    def _source_named(self, name: str) -> MeshSource | str:
        meshes: list[tuple[ShownRobot, Mesh]] = []
        for robot in list(self.by_robot):
            drawn: list[Visual | Collision] = [*robot.visuals, *robot.collisions]
            meshes += [(robot, each.shape) for each in drawn if isinstance(each.shape, Mesh)]
        for robot, mesh in meshes:
            if mesh.name == name:
                return robot.source_of(mesh)
        package, inside = parts_of(name)
        # Anyone on the bus names files: none is opened but files in packages, and below the folders
        # that the user has named.
        with suppress(OSError, ValueError):  # no file can have such a name
            for robot, mesh in meshes:
                folder = None if mesh.file is None else package_folder(mesh.name, mesh.file)
                if folder is None or mesh.package != package:
                    continue
                file = (folder / inside).resolve()
                if file.is_relative_to(folder.resolve()) and file.is_file():
                    return robot.source_of(replace(mesh, name=name, file=file))
            known = MeshFiles(None, self._package_path).find(name)
            within = package_folder(name, known) if known else None
            if known and within and known.resolve().is_relative_to(within.resolve()):
                return source_at(name, known)
            if below := file_below(name, self._package_path):
                return replace(source_at(name, below[0]), root=below[1])
        return (
            "it is no mesh of a robot in the view, nor in a package here; --package-path names a "
            "folder with packages, in which paths of files may lead, too"
        )

    def _log_mistakes(self) -> None:
        for mistake in self._lacking():
            if mistake not in self._logged and len(self._logged) < 1000:
                self._logged.add(mistake)
                self._log.warning("%s", mistake)

    def draw(self, placed: Placed, frames: Frames) -> None:
        """Move the robots to where their frames are."""
        for robot, scene in self.by_robot.items():
            if self.is_still(robot, frames):
                scene.draw(self._standing(robot), lambda frame: 1.0)
            else:
                self._still.pop(robot, None)
                scene.draw(placed, lambda frame: frames[frame].opacity if frame in frames else 1.0)

    def is_still(self, robot: ShownRobot, frames: Frames) -> bool:
        """Whether it stands by itself: a robot of a file that has no frames."""
        return not robot.is_described and not any(
            frame in frames for frame in robot.frames.values()
        )

    def move(self, positions: Mapping[str, float]) -> None:
        """Let robots without frames stand so."""
        self.positions.update(positions)
        self._still.clear()

    def _standing(self, robot: ShownRobot) -> Placed:
        placed = self._still.get(robot)
        if placed is None:
            known = {
                joint.name: self.positions[joint.name]
                for joint in robot.robot.free_joints
                if joint.name in self.positions
            }
            try:
                poses = robot.robot.fk(known)
            except InvalidArgumentException:
                poses = robot.robot.fk()
            xyz = np.array([pose.xyz for pose in poses.values()])
            quat = np.array([pose.quat_xyzw for pose in poses.values()])[:, [3, 0, 1, 2]]
            names = tuple(robot.frame_of(link) for link in poses)
            placed = self._still[robot] = Placed(names, xyz, quat, {})
        return placed

    # Frames and meshes

    @property
    def frames(self) -> frozenset[str]:
        """The frames of all links with shapes, which need a place."""
        return frozenset(
            robot.frame_of(link) for robot in self.by_robot for link in robot.shaped_links
        )

    @property
    def covered(self) -> frozenset[str]:
        """The frames of all links of the robots that are drawn: their axes would hide them."""
        settings = self._settings
        if settings is None or settings.link_axes:
            return frozenset()
        return frozenset(
            frame
            for robot in self.by_robot
            if robot.shaped_links and robot.title not in settings.hidden_robots
            for frame in robot.frames.values()
        )

    @property
    def progress(self) -> tuple[int, int]:
        """How many meshes are loaded, and how many there are."""
        scenes = self.by_robot.values()
        return sum(scene.loaded for scene in scenes), sum(len(scene.sources) for scene in scenes)

    def loaded(self, robot: ShownRobot) -> tuple[int, int]:
        """The same of one robot."""
        scene = self.by_robot[robot]
        return scene.loaded, len(scene.sources)

    def mistakes(self) -> list[str]:
        """The parts that cannot be shown, in sentences that can be printed."""
        return [*self.source.mistakes(), *self._lacking()]

    def _lacking(self) -> list[str]:
        return [printable(each, 400) for each in all_mistakes(self.by_robot.values())]

    def built(self, placed: Placed, frames: Frames) -> tuple[int, int]:
        """How many robots that are shown have frames, and how many of their links have a place and
        of their meshes are loaded: with each there is more to see.
        """
        shown = [scene for robot, scene in self.by_robot.items() if self._is_shown(robot)]
        moving = [scene for scene in shown if not self.is_still(scene.robot, frames)]
        at = [(scene, self._where(scene.robot, placed, frames)) for scene in shown]
        parts = sum(scene.loaded + scene.placed_links(where) for scene, where in at)
        return sum(scene.placed_links(placed) > 0 for scene in moving), parts

    def points(self, placed: Placed, frames: Frames) -> Floats:
        """Points (N, 3) in the fixed frame that robots which are shown lie between."""
        found = [np.zeros((0, 3))]
        for robot, scene in self.by_robot.items():
            if self._is_shown(robot):
                found.append(scene.points(self._where(robot, placed, frames)))
        return np.concatenate(found)

    def met_by(self, ray: Ray, placed: Placed, frames: Frames) -> float:
        """The way in m along a ray of the fixed frame to a robot; infinity if none is met."""
        shown = [(robot, scene) for robot, scene in self.by_robot.items() if self._is_shown(robot)]
        ways = [scene.met_by(ray, self._where(robot, placed, frames)) for robot, scene in shown]
        return min(ways, default=math.inf)

    def _is_shown(self, robot: ShownRobot) -> bool:
        return self._settings is None or robot.title not in self._settings.hidden_robots

    def _where(self, robot: ShownRobot, placed: Placed, frames: Frames) -> Placed:
        return self._standing(robot) if self.is_still(robot, frames) else placed


def _look_of(settings: ViewSettings) -> Look:
    shown: Shown = "visual"
    for each in get_args(Shown):
        if each == settings.shapes:
            shown = each
    return Look(shown, settings.robot_opacity)
