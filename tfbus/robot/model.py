"""The parts of a robot as values: links with their shapes, and joints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf, isfinite, pi
from pathlib import Path

from tfbus.geometry.transform import Transform
from tfbus.robot.mesh_files import file_beside, parts_of

Vector = tuple[float, float, float]

# How many numbers the position of a joint of each type has: of a floating one x y z qx qy qz qw.
POSITION_SIZES = {
    "revolute": 1,
    "continuous": 1,
    "prismatic": 1,
    "planar": 3,
    "floating": 7,
    "fixed": 0,
}


@dataclass(frozen=True, slots=True)
class Box:
    """A box around its origin, with its sides in metres."""

    size: Vector


@dataclass(frozen=True, slots=True)
class Cylinder:
    """A cylinder around its origin, along z, in metres."""

    radius: float
    length: float


@dataclass(frozen=True, slots=True)
class Sphere:
    """A sphere around its origin, in metres."""

    radius: float


@dataclass(frozen=True, slots=True)
class Mesh:
    """A file of triangles: its name in the URDF, its path, and its scale along x, y and z.

    `file` may not exist; it is None if the name says nothing of this machine, such as an
    address, or a path of a description that came without its folder.
    """

    name: str
    file: Path | None
    scale: Vector = (1.0, 1.0, 1.0)

    @property
    def package(self) -> str:
        """The package in its name, "" if it has none."""
        return parts_of(self.name)[0]

    def beside(self, name: str) -> Path | None:
        """The file of a material, picture or buffer by its name, written as that of the mesh is.

        None if there is none in the mesh's package, or without a package in its folder.
        """
        return None if self.file is None else file_beside(self.name, self.file, name)


Shape = Box | Cylinder | Sphere | Mesh


@dataclass(frozen=True, slots=True)
class Visual:
    """A shape of a link as it looks, with `origin` its pose in the link's frame.

    `color` is red, green and blue from 0 to 255, `opacity` is from 0 to 1. Without a color a mesh
    has its own. `texture` is the image of its material, as the URDF names it.
    """

    link: str
    shape: Shape
    origin: Transform
    name: str = ""
    color: tuple[int, int, int] | None = None
    opacity: float = 1.0
    texture: str = ""


@dataclass(frozen=True, slots=True)
class Collision:
    """A shape of a link as it collides, with `origin` its pose in the link's frame."""

    link: str
    shape: Shape
    origin: Transform
    name: str = ""


@dataclass(frozen=True, slots=True)
class Link:
    """A rigid part of a robot, which has the frame of its name."""

    name: str
    visuals: tuple[Visual, ...] = ()
    collisions: tuple[Collision, ...] = ()


@dataclass(frozen=True, slots=True)
class JointLimits:
    """How far and how fast a joint may go: radians, metres, and these a second; Nm or N.

    `lower` and `upper` of a continuous joint are infinite, as is what the URDF does not limit.
    """

    lower: float = -inf
    upper: float = inf
    velocity: float = inf
    effort: float = inf


@dataclass(frozen=True, slots=True)
class Mimic:
    """A joint that follows another: its position is `multiplier` * that of `joint` + `offset`."""

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, slots=True)
class Joint:
    """The connection of a link to its parent, and the motion that it allows.

    `type` is "revolute", "continuous", "prismatic", "planar", "floating" or "fixed". `origin` is
    the pose of the joint's frame in the parent link, and of the child link at position 0. `axis` is
    a unit vector in the joint's frame: of rotation, of sliding, or the normal of a plane.
    `soft_limits`, lower and upper, are those of its safety controller.
    """

    name: str
    type: str
    parent: str
    child: str
    origin: Transform
    axis: Vector = (1.0, 0.0, 0.0)
    limits: JointLimits | None = None
    mimic: Mimic | None = None
    soft_limits: tuple[float, float] | None = None

    @property
    def position_size(self) -> int:
        """How many numbers its position has: 1; 3 of a planar joint (x, y, angle), 7 of a floating
        one (x y z qx qy qz qw), 0 of a fixed one.
        """
        return POSITION_SIZES[self.type]

    @property
    def is_free(self) -> bool:
        """Whether it has a position of its own: it is neither fixed nor a mimic."""
        return self.mimic is None and self.type != "fixed"

    @property
    def zero(self) -> float:
        """The position where it rests: 0; if 0 is outside of its limits their middle, or the
        only one that is finite.
        """
        if self.limits is None or self.limits.lower <= 0.0 <= self.limits.upper:
            return 0.0
        lower, upper = self.limits.lower, self.limits.upper
        if isfinite(lower) and isfinite(upper):
            # Not of their sum, which may be infinite.
            return 0.5 * lower + 0.5 * upper
        return lower if isfinite(lower) else upper

    @property
    def reach(self) -> tuple[float, float]:
        """From where to where a program moves it, in rad or m: finite, lower <= upper.

        These are its limits, or narrower soft ones; if it is not limited, half a turn or 1 m to
        either side, or beyond its only limit.
        """
        lower, upper = -inf, inf
        if self.limits is not None and self.limits.lower <= self.limits.upper:
            lower, upper = self.limits.lower, self.limits.upper
        if self.soft_limits is not None:
            narrow = max(lower, self.soft_limits[0]), min(upper, self.soft_limits[1])
            # Soft limits outside of the others are a mistake.
            lower, upper = narrow if narrow[0] < narrow[1] else (lower, upper)
        way = 1.0 if self.type == "prismatic" else pi
        if lower == -inf:
            lower = min(-way, upper - way)
        if upper == inf:
            upper = max(way, lower + way)
        return (lower, upper) if isfinite(upper - lower) else (-way, way)


@dataclass(frozen=True, slots=True)
class Model:
    """All that a URDF says of a robot.

    `links` and `joints` are in the order of the URDF, `down` are the joints from the root
    outwards. `warnings` are sentences on what the URDF leaves out and how it was read.
    """

    name: str
    root: str
    links: Mapping[str, Link]
    joints: Mapping[str, Joint]
    down: tuple[Joint, ...]
    warnings: tuple[str, ...] = ()
