"""Reads a URDF into a model of the robot, each mistake with its line.

The format: https://wiki.ros.org/urdf/XML, and if that is silent, as urdfdom reads it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import hypot, inf, isfinite, isnan

from tfbus.base.errors import UrdfError
from tfbus.base.wording import counted, listed, mistake_in, printable
from tfbus.geometry.transform import Transform
from tfbus.robot.mesh_files import MeshFiles, MeshPathError
from tfbus.robot.model import (
    POSITION_SIZES,
    Box,
    Collision,
    Cylinder,
    Joint,
    JointLimits,
    Link,
    Mesh,
    Mimic,
    Model,
    PlacedJoint,
    Shape,
    Sphere,
    Vector,
    Visual,
    check_mimics,
    from_the_root,
    near,
)
from tfbus.robot.xml import Element, read_xml

_TYPES = listed([f"'{each}'" for each in POSITION_SIZES])
_WITH_AXIS = ("revolute", "continuous", "prismatic", "planar")
_LIMITED = ("revolute", "prismatic")

# Colour, opacity and texture.
Look = tuple[tuple[int, int, int] | None, float, str]


def read_model(text: str, source: str, files: MeshFiles) -> Model:
    """The robot that a URDF's text describes; `source` is its name in mistakes.

    Raises UrdfError, with the line and the name of the wrong element.
    """
    return _UrdfReader(read_xml(text, source), files).read()


class _UrdfReader:
    """Reads the elements of one URDF."""

    def __init__(self, robot: Element, files: MeshFiles) -> None:
        self._robot = robot
        self._files = files
        self._warnings: list[str] = []
        self._materials: dict[str, Element] = {}

    def read(self) -> Model:
        robot = self._robot
        if robot.tag != "robot":
            raise robot.mistake(
                f"not a URDF: its root element is <{printable(robot.tag, 40)}>, not <robot>"
            )
        self._refuse_xacro()
        self._materials = _materials(robot)
        links: dict[str, Link] = {}
        for element in robot.find_all("link"):
            name = _new_name(element, links)
            links[name] = self._link(element, name)
        if not links:
            raise robot.mistake("the robot has no <link>")
        placed: dict[str, PlacedJoint] = {}
        for element in robot.find_all("joint"):
            name = _new_name(element, placed)
            placed[name] = PlacedJoint(self._joint(element, name, links), element)
        root, down = from_the_root(robot, links, list(placed.values()))
        check_mimics(placed)
        joints = {name: each.joint for name, each in placed.items()}
        return Model(robot.get("name"), root, links, joints, down, tuple(self._warnings))

    def _refuse_xacro(self) -> None:
        for element in self._robot.children:
            if element.tag.startswith("xacro:"):
                raise element.mistake(
                    f"<{printable(element.tag, 40)}> is xacro; name the file .xacro, or expand it "
                    "first"
                )

    def _warn(self, element: Element, text: str) -> None:
        self._warnings.append(f"{element.source}:{element.line}: {text}")

    # Links

    def _link(self, element: Element, name: str) -> Link:
        return Link(
            name, tuple(self._visuals(element, name)), tuple(self._collisions(element, name))
        )

    def _visuals(self, element: Element, link: str) -> Iterator[Visual]:
        where = f"visual of link {_shown(link)}"
        for each in element.find_all("visual"):
            origin, shape = _origin(each, where), self._shape(each, where)
            look = self._look(each.find("material"), where)
            if shape is not None:
                yield Visual(link, shape, origin, each.get("name"), *look)

    def _collisions(self, element: Element, link: str) -> Iterator[Collision]:
        where = f"collision of link {_shown(link)}"
        for each in element.find_all("collision"):
            origin, shape = _origin(each, where), self._shape(each, where)
            if shape is not None:
                yield Collision(link, shape, origin, each.get("name"))

    def _look(self, material: Element | None, where: str) -> Look:
        """The colour, opacity and texture of a material, which may be a name of a robot's."""
        if material is None:
            return None, 1.0, ""
        name = material.get("name")
        if not material.children and name in self._materials:
            material = self._materials[name]
        elif not material.children and name:
            self._warn(material, f"{where}: no <material> defines {_shown(name)}; it has no colour")
        texture = material.find("texture")
        image = "" if texture is None else texture.get("filename")
        color = material.find("color")
        if color is None:
            return None, 1.0, image
        red, green, blue, opacity = _numbers(color, "rgba", 4, where)
        return (_octet(red), _octet(green), _octet(blue)), min(max(opacity, 0.0), 1.0), image

    def _shape(self, element: Element, where: str) -> Shape | None:
        """The shape of a visual or a collision; None, and a warning, for one that URDF lacks."""
        geometry = element.find("geometry")
        shapes = [] if geometry is None else geometry.children
        for shape in shapes:
            if shape.tag == "box":
                return Box(_sizes(shape, "size", where))
            if shape.tag == "cylinder":
                return Cylinder(_size(shape, "radius", where), _size(shape, "length", where))
            if shape.tag == "sphere":
                return Sphere(_size(shape, "radius", where))
            if shape.tag == "mesh":
                return self._mesh(shape, where)
        if not shapes:
            raise (geometry or element).mistake(f"{where}: no box, cylinder, sphere or mesh")
        self._warn(
            shapes[0],
            f"{where}: <{printable(shapes[0].tag, 40)}> is none of box, cylinder, sphere and mesh; "
            "it is left out",
        )
        return None

    def _mesh(self, element: Element, where: str) -> Mesh:
        name = element.get("filename")
        if not name:
            raise element.mistake(f"{where}: <mesh> has no filename")
        try:
            file = self._files.find(name)
        except MeshPathError as error:
            raise element.mistake(f"{where}: mesh '{printable(name)}' {error}") from None
        return Mesh(name, file, _vector(element, "scale", where, "1 1 1"))

    # Joints

    def _joint(self, element: Element, name: str, links: Mapping[str, Link]) -> Joint:
        where = f"joint {_shown(name)}"
        kind = element.get("type")
        if kind not in POSITION_SIZES:
            said = f"type '{printable(kind, 40)}' is none" if kind else "has no type"
            raise element.mistake(f"{where}: {said}; allowed are {_TYPES}")
        parent = _end(element, "parent", where, links)
        child = _end(element, "child", where, links)
        if parent == child:
            raise element.mistake(f"{where}: link {_shown(parent)} is its parent and its child")
        origin = _origin(element, where)
        if kind == "fixed":
            return Joint(name, kind, parent, child, origin)
        return Joint(
            name,
            kind,
            parent,
            child,
            origin,
            self._axis(element, kind, where),
            self._limits(element, kind, where),
            _mimic(element, kind, where),
            _soft_limits(element, kind, where),
        )

    def _axis(self, element: Element, kind: str, where: str) -> Vector:
        if kind not in _WITH_AXIS:
            return 1.0, 0.0, 0.0
        axis = element.find("axis")
        if axis is None:
            self._warn(element, f"{where}: no <axis>; the default of URDF is used, 1 0 0")
            return 1.0, 0.0, 0.0
        x, y, z = _vector(axis, "xyz", where)
        length = hypot(x, y, z)
        if not 1e-9 < length < inf:
            raise axis.mistake(f"{where}: axis {x:g} {y:g} {z:g} has no direction; such as 0 0 1")
        return x / length, y / length, z / length

    def _limits(self, element: Element, kind: str, where: str) -> JointLimits | None:
        limit = element.find("limit")
        if limit is None:
            if kind in _LIMITED:
                self._warn(element, f"{where}: no <limit>; it is not limited")
            return None
        velocity = _limit(limit, "velocity", where, unlimited=inf, absent=inf)
        effort = _limit(limit, "effort", where, unlimited=inf, absent=inf)
        if kind not in _LIMITED:
            return JointLimits(velocity=velocity, effort=effort)
        lower = _limit(limit, "lower", where, unlimited=-inf, absent=0.0)
        upper = _limit(limit, "upper", where, unlimited=inf, absent=0.0)
        if lower > upper:
            self._warn(
                limit,
                f"{where}: lower limit {lower:g} is above upper limit {upper:g}; it is not limited",
            )
            lower, upper = -inf, inf
        return JointLimits(lower, upper, velocity, effort)


def _materials(robot: Element) -> dict[str, Element]:
    """The materials by name: the robot's, then the visuals' own, as in urdfdom."""
    found = {each.get("name"): each for each in robot.find_all("material")}
    for link in robot.find_all("link"):
        for visual in link.find_all("visual"):
            for each in visual.find_all("material"):
                if each.children:
                    found.setdefault(each.get("name"), each)
    return found


def _new_name(element: Element, known: Mapping[str, object]) -> str:
    """The name of a link or joint, which must be new."""
    name = element.get("name")
    mistake = mistake_in(name)
    if mistake:
        raise element.mistake(f"the name of a <{element.tag}> {mistake}")
    if name in known:
        raise element.mistake(f"a second {element.tag} {_shown(name)}; names must differ")
    return name


def _end(element: Element, tag: str, where: str, links: Mapping[str, Link]) -> str:
    """The name of a joint's parent or child."""
    end = element.find(tag)
    if end is None:
        raise element.mistake(f"{where}: no <{tag} link=...>")
    name = end.get("link")
    if name not in links:
        said = f"no link {_shown(name)}" if name else f"<{tag}> names no link"
        raise end.mistake(f"{where}: {said}{near(name, links)}")
    return name


def _mimic(element: Element, kind: str, where: str) -> Mimic | None:
    mimic = element.find("mimic")
    if mimic is None:
        return None
    if POSITION_SIZES[kind] != 1:
        raise mimic.mistake(f"{where}: a {kind} joint cannot mimic another")
    (multiplier,) = _numbers(mimic, "multiplier", 1, where, "1")
    (offset,) = _numbers(mimic, "offset", 1, where, "0")
    return Mimic(mimic.get("joint"), multiplier, offset)


def _soft_limits(element: Element, kind: str, where: str) -> tuple[float, float] | None:
    safety = element.find("safety_controller")
    if safety is None or kind not in _LIMITED:
        return None
    if "soft_lower_limit" not in safety.attributes and "soft_upper_limit" not in safety.attributes:
        return None
    lower = _limit(safety, "soft_lower_limit", where, unlimited=-inf, absent=-inf)
    upper = _limit(safety, "soft_upper_limit", where, unlimited=inf, absent=inf)
    return (lower, upper) if lower <= upper else None


# Numbers


def _origin(element: Element, where: str) -> Transform:
    origin = element.find("origin")
    if origin is None:
        return Transform.identity()
    xyz, rpy = _vector(origin, "xyz", where, "0 0 0"), _vector(origin, "rpy", where, "0 0 0")
    return Transform.from_rpy(*rpy, xyz=xyz)


def _octet(share: float) -> int:
    return round(255 * min(max(share, 0.0), 1.0))


def _size(element: Element, attribute: str, where: str) -> float:
    (size,) = _numbers(element, attribute, 1, where)
    if size < 0.0:
        raise element.mistake(f"{where}: {attribute} {size:g} is negative")
    return size


def _sizes(element: Element, attribute: str, where: str) -> Vector:
    sizes = _vector(element, attribute, where)
    if min(sizes) < 0.0:
        raise element.mistake(
            f"{where}: {attribute} {' '.join(map('{:g}'.format, sizes))} is negative"
        )
    return sizes


def _limit(
    element: Element, attribute: str, where: str, *, unlimited: float, absent: float
) -> float:
    """A limit: `unlimited` if it is infinite, of either sign, and `absent` without one."""
    text = element.attributes.get(attribute)
    if text is None:
        return absent
    number = _number(text)
    if number is None or isnan(number):
        raise _no_numbers(element, attribute, 1, where)
    return number if isfinite(number) else unlimited


def _vector(element: Element, attribute: str, where: str, default: str = "") -> Vector:
    x, y, z = _numbers(element, attribute, 3, where, default)
    return x, y, z


def _numbers(
    element: Element, attribute: str, count: int, where: str, default: str = ""
) -> tuple[float, ...]:
    """The numbers of an attribute, all finite."""
    parts = element.get(attribute, default).split(maxsplit=count)
    numbers = [_number(part) for part in parts]
    finite = tuple(number for number in numbers if number is not None and isfinite(number))
    if len(numbers) != count or len(finite) != count:
        raise _no_numbers(element, attribute, count, where)
    return finite


def _number(text: str) -> float | None:
    try:
        # Python's float knows 1_000, which no other reader of URDF does.
        return None if "_" in text else float(text)
    except ValueError:
        return None


def _no_numbers(element: Element, attribute: str, count: int, where: str) -> UrdfError:
    written = element.attributes.get(attribute)
    got = "it is missing" if written is None else f"got '{printable(written, 60)}'"
    hint = "; separate them with spaces" if written and "," in written else ""
    wanted = counted(count, "finite number")
    return element.mistake(f"{where}: {attribute} of <{element.tag}> must be {wanted}, {got}{hint}")


def _shown(name: str) -> str:
    return f"'{printable(name, 60)}'"
