"""Robots as the page needs them: their shapes, the frames of their links, meshes and joints."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

from tfbus.robot.mesh_files import package_folder, parts_of
from tfbus.robot.model import Collision, Mesh, Visual
from tfbus.robot.robot import Robot
from tfbus.view.meshes.loader import MeshSource
from tfbus.view.meshes.mesh import MeshError
from tfbus.wire.fleet import FrameNames


@dataclass(frozen=True, eq=False)
class ShownRobot:
    """A robot whose links have the frames of their names behind `prefix`, as `names` calls them
    here.

    `is_described` is whether it comes from a bus or a recording, by a process that publishes its
    frames, `is_fetched` whether meshes that are not on this machine can be had from there, in the
    namespace `origin`. `sender` tells who describes it from others, whose meshes take turns.
    """

    robot: Robot
    prefix: str = ""
    names: FrameNames | None = None
    is_described: bool = False
    is_fetched: bool = False
    sender: str = ""

    @property
    def origin(self) -> str:
        """The namespace that it is in, relative to ours."""
        return self.names.namespace if self.names else ""

    @property
    def title(self) -> str:
        """The key that tells it from other robots."""
        return "/".join(filter(None, (self.origin, self.prefix.strip("/_"), self.robot.name)))

    @cached_property
    def frames(self) -> dict[str, str]:
        """The frame of each link."""
        return {link: self._called(link) for link in self.robot.links}

    def frame_of(self, link: str) -> str:
        """The frame of a link."""
        return self.frames[link]

    def _called(self, link: str) -> str:
        frame = f"{self.prefix}{link}"
        return self.names.outside(frame) if self.names else frame

    @cached_property
    def visuals(self) -> tuple[Visual, ...]:
        """The visuals of all links."""
        return tuple(each for link in self.robot.links.values() for each in link.visuals)

    @cached_property
    def collisions(self) -> tuple[Collision, ...]:
        """The collisions of all links."""
        return tuple(each for link in self.robot.links.values() for each in link.collisions)

    @cached_property
    def shaped_links(self) -> tuple[str, ...]:
        """The links that have shapes."""
        shown = [each.link for each in self.visuals]
        collide = [each.link for each in self.collisions]
        return tuple(dict.fromkeys((*shown, *collide)))

    def source_of(self, mesh: Mesh, texture: str = "") -> MeshSource | str:
        """The file of a mesh, with a texture of the URDF, or why it cannot be."""
        file = mesh.file
        if file is not None and file.is_file():
            status = file.stat()
            version = f"{status.st_mtime_ns} {status.st_size}"
            # Pictures may lie beside the folder of meshes.
            root = package_folder(mesh.name, file) or file.parent.parent
            picture = mesh.beside(texture) if texture else None
            return MeshSource(mesh.name, file, root, "", version, texture, picture)
        if self.is_fetched:
            return MeshSource(mesh.name, origin=self.origin, texture=texture)
        package, _ = parts_of(mesh.name)
        remedy = f"; --package-path names the folder with package {package!r}" if package else ""
        if file is None:
            return f"it is not on this machine{remedy}"
        return f"no file {file}{remedy}"


class Joints(Protocol):
    """The joints of one robot on the bus."""

    @property
    def positions(self) -> Mapping[str, float]:
        """Their last positions, in rad and m, those that are known."""

    @property
    def is_heard(self) -> bool:
        """Whether a process takes targets."""

    def send(self, targets: Mapping[str, float]) -> None:
        """Send targets to it, in rad and m."""


class RobotSource(Protocol):
    """The robots of a bus, a recording or a program; safe from any thread."""

    def robots(self) -> Sequence[ShownRobot]:
        """The robots now; one that has not changed is the same object."""

    def mistakes(self) -> Sequence[str]:
        """Why there are not more, in sentences that can be printed."""

    def joints(self, robot: ShownRobot) -> Joints | None:
        """The joints of a robot; None if nothing can move them."""

    def fetch(self, origin: str, mesh: str, within_s: float) -> bytes:
        """The content of a mesh that is not on this machine. Raises MeshError, also if it takes
        longer.
        """

    def close(self) -> None:
        """End it. Twice is fine."""


class GivenRobots:
    """The robots that a program has given."""

    def __init__(self, robots: Sequence[ShownRobot] = ()) -> None:
        self._robots = list(robots)

    def robots(self) -> Sequence[ShownRobot]:
        """The given robots."""
        return list(self._robots)

    def add(self, robot: ShownRobot) -> None:
        """Add a robot; it replaces one of the same title."""
        self._robots = [
            *(each for each in self._robots if each.title != robot.title),
            robot,
        ]

    def mistakes(self) -> Sequence[str]:
        """None."""
        return ()

    def joints(self, robot: ShownRobot) -> Joints | None:
        """None: nothing is on a bus."""
        return None

    def fetch(self, origin: str, mesh: str, within_s: float) -> bytes:
        """Nothing is fetched."""
        raise MeshError("it is not on this machine")

    def close(self) -> None:
        """Nothing to end."""
