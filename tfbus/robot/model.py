"""The parts of a robot as values, links with their shapes and joints; the tree that they make."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from math import inf, isfinite, pi
from pathlib import Path

from tfbus.base.errors import UrdfError
from tfbus.base.wording import MOST_LETTERS, did_you_mean, listed, printable
from tfbus.geometry.transform import Transform
from tfbus.robot.mesh_files import file_beside, parts_of
from tfbus.robot.xml import Element

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
        """The file of a material, picture or buffer by its name, written as the mesh's is.

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

    `lower` and `upper` of a continuous joint are infinite, as are limits that the URDF lacks.
    """

    lower: float = -inf
    upper: float = inf
    velocity: float = inf
    effort: float = inf


@dataclass(frozen=True, slots=True)
class Mimic:
    """A joint that follows another: its position is `multiplier` * `joint`'s + `offset`."""

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, slots=True)
class Joint:
    """The connection of a link to its parent, and the motion that it allows.

    `type` is "revolute", "continuous", "prismatic", "planar", "floating" or "fixed". `origin` is
    the pose of the joint's frame in the parent link, and of the child link at position 0. `axis` is
    a unit vector in the joint's frame: of rotation, of sliding, or the normal of a plane.
    Its safety controller has the `soft_limits`, lower and upper.
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
    outwards. `warnings` are sentences on parts that the URDF lacks and how it was read.
    """

    name: str
    root: str
    links: Mapping[str, Link]
    joints: Mapping[str, Joint]
    down: tuple[Joint, ...]
    warnings: tuple[str, ...] = ()


# To find the nearest of more names takes seconds.
_MOST_COMPARED = 5000


@dataclass(frozen=True, slots=True)
class PlacedJoint:
    """A joint and the element that describes it, whose line mistakes are to name."""

    joint: Joint
    element: Element


def from_the_root(
    robot: Element, links: Mapping[str, Link], joints: list[PlacedJoint]
) -> tuple[str, tuple[Joint, ...]]:
    """The root link, and the joints outwards from it: a joint after all that carry it.

    Raises UrdfError if a link has two parents, or the links are not one tree.
    """
    above: dict[str, PlacedJoint] = {}
    below: dict[str, list[Joint]] = defaultdict(list)
    for each in joints:
        joint = each.joint
        if joint.child in above:
            raise each.element.mistake(
                f"joint {_shown(joint.name)}: link {_shown(joint.child)} is already the child of "
                f"joint {_shown(above[joint.child].joint.name)}; a link has one parent"
            )
        above[joint.child] = each
        below[joint.parent].append(joint)
    roots = [name for name in links if name not in above]
    if len(roots) > 1:
        raise robot.mistake(
            f"{len(roots)} links have no parent: {listed([_shown(name) for name in roots])}; all "
            "links but one must be the child of a joint"
        )
    down: list[Joint] = []
    reached = list(roots)
    for link in reached:
        down += below[link]
        reached += [joint.child for joint in below[link]]
    if len(reached) < len(links):
        known = set(reached)
        raise _cycle(next(name for name in links if name not in known), above)
    return roots[0], tuple(down)


def _cycle(link: str, above: Mapping[str, PlacedJoint]) -> UrdfError:
    """The mistake that upwards of this link there is no end."""
    way = [link]
    seen = {link}
    while (link := above[link].joint.parent) not in seen:
        way.append(link)
        seen.add(link)
    cycle = [*way[way.index(link) :], link]
    names = " -> ".join(_shown(name) for name in cycle[:8]) + (" ..." if len(cycle) > 8 else "")
    at = above[link]
    return at.element.mistake(f"joint {_shown(at.joint.name)} closes a cycle of links: {names}")


def check_mimics(joints: Mapping[str, PlacedJoint]) -> None:
    """Raise UrdfError if a joint mimics one that is none, has no position, or mimics it."""
    checked: set[str] = set()
    for each in joints.values():
        joint, way = each.joint, dict.fromkeys([each.joint.name])
        while joint.mimic is not None and joint.name not in checked:
            known = joints.get(joint.mimic.joint)
            if known is None:
                others = set(joints) - {joint.name}
                raise _mimic_mistake(
                    joints[joint.name],
                    f"no joint {_shown(joint.mimic.joint)}{near(joint.mimic.joint, others)}",
                )
            joint = known.joint
            if joint.name in way:
                names = " -> ".join(_shown(name) for name in [*way, joint.name][:8])
                raise _mimic_mistake(each, f"a cycle: {names}")
            way[joint.name] = None
        if joint.mimic is None and joint is not each.joint and joint.position_size != 1:
            raise _mimic_mistake(
                each,
                f"joint {_shown(joint.name)}, which is {joint.type}: it has no single position",
            )
        checked.update(way)


def _mimic_mistake(at: PlacedJoint, reason: str) -> UrdfError:
    element = at.element.find("mimic") or at.element
    return element.mistake(f"joint {_shown(at.joint.name)} mimics {reason}")


def near(name: str, known: Collection[str]) -> str:
    """The end of a sentence about a name that is not known: `; did you mean ...`."""
    if not 0 < len(name) <= MOST_LETTERS or len(known) > _MOST_COMPARED:
        return ""
    return did_you_mean(name, known)


def _shown(name: str) -> str:
    return f"'{printable(name, 60)}'"
