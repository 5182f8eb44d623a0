"""A robot on the page: its description, and how its links' frames are called."""

from dataclasses import dataclass
from functools import cached_property

from tfbus.robot.mesh_files import package_folder, parts_of
from tfbus.robot.model import Collision, Mesh, Visual
from tfbus.robot.robot import Robot
from tfbus.view.meshes.loader import MeshSource
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
