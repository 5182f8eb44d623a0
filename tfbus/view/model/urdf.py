"""The shapes of a robot's links, read from a URDF file; their poses come over the bus."""

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from tfbus.errors import TfbusError
from tfbus.geometry.transform import Transform
from tfbus.wording import counted

Vector = tuple[float, float, float]

_PACKAGE = "package://"


class UrdfError(TfbusError):
    """A URDF file that cannot be read; the message says why."""


@dataclass(frozen=True)
class Box:
    """A box around its origin, with its sides in metres."""

    size: Vector


@dataclass(frozen=True)
class Cylinder:
    """A cylinder around its origin, along z, in metres."""

    radius: float
    length: float


@dataclass(frozen=True)
class Sphere:
    """A sphere around its origin, in metres."""

    radius: float


@dataclass(frozen=True)
class Mesh:
    """A file of triangles: its name in the URDF, its path, and its scale along x, y and z.

    `file` may not exist.
    """

    name: str
    file: Path
    scale: Vector


Shape = Box | Cylinder | Sphere | Mesh


@dataclass(frozen=True)
class Visual:
    """One shape of a link, with `origin` its pose in the link's frame. `opacity` is from 0 to 1.

    Without a `color` a mesh has its own.
    """

    link: str
    shape: Shape
    origin: Transform
    color: tuple[int, int, int] | None = None
    opacity: float = 1.0


def read_urdf(path: Path, package_path: Sequence[Path] = ()) -> list[Visual]:
    """The visuals of all links. Raises UrdfError if the file is not a URDF.

    Searches the packages of meshes in `package_path`, in the folders of the environment variable
    ROS_PACKAGE_PATH, and then in those above the URDF.
    """
    try:
        robot = ElementTree.parse(path).getroot()
    except OSError as error:
        raise UrdfError(f"cannot read {path}: {error.strerror}") from error
    except ElementTree.ParseError as error:
        raise UrdfError(
            f"{path} is not XML ({error}); expand a xacro file with xacro first"
        ) from error
    if robot.tag != "robot":
        raise UrdfError(f"{path} is not a URDF: its root element is <{robot.tag}>, not <robot>")
    materials = {
        material.get("name", ""): color
        for material in robot.iter("material")
        if (color := material.find("color")) is not None
    }
    try:
        return [
            _visual(link.get("name", ""), visual, materials, path.parent, package_path)
            for link in robot.findall("link")
            for visual in link.findall("visual")
        ]
    except ValueError as error:
        raise UrdfError(f"{path}: {error}") from error


def _visual(
    link: str,
    visual: ElementTree.Element,
    materials: dict[str, ElementTree.Element],
    folder: Path,
    package_path: Sequence[Path],
) -> Visual:
    origin = visual.find("origin")
    xyz, rpy = _vector(origin, "xyz", "0 0 0"), _vector(origin, "rpy", "0 0 0")
    shape = _shape(link, visual.find("geometry"), folder, package_path)
    pose = Transform.from_rpy(*rpy, xyz=xyz)
    color = _color(visual.find("material"), materials)
    if color is None:
        return Visual(link, shape, pose)
    r, g, b, alpha = _numbers(color, "rgba", 4)
    return Visual(link, shape, pose, (round(255 * r), round(255 * g), round(255 * b)), alpha)


def _shape(
    link: str,
    geometry: ElementTree.Element | None,
    folder: Path,
    package_path: Sequence[Path],
) -> Shape:
    for shape in () if geometry is None else geometry:
        if shape.tag == "box":
            return Box(_vector(shape, "size"))
        if shape.tag == "cylinder":
            return Cylinder(_number(shape, "radius"), _number(shape, "length"))
        if shape.tag == "sphere":
            return Sphere(_number(shape, "radius"))
        if shape.tag == "mesh":
            name = shape.get("filename", "")
            file = mesh_file(name, folder, package_path)
            return Mesh(name, file, _vector(shape, "scale", "1 1 1"))
    raise ValueError(f"link {link!r} has a visual without a box, cylinder, sphere or mesh")


def _color(
    material: ElementTree.Element | None, materials: dict[str, ElementTree.Element]
) -> ElementTree.Element | None:
    if material is None:
        return None
    color = material.find("color")
    return materials.get(material.get("name", "")) if color is None else color


def mesh_file(name: str, folder: Path, package_path: Sequence[Path] = ()) -> Path:
    """The file of a mesh by its name in a URDF in `folder`: a path, or `package://robot/arm.stl`.

    If there is none, the first place where it should be.
    """
    if not name.startswith(_PACKAGE):
        return folder / name.removeprefix("file://")
    inside = Path(name.removeprefix(_PACKAGE))
    candidates = list(_in_packages(inside, folder, package_path))
    return next((file for file in candidates if file.is_file()), candidates[0])


def _in_packages(inside: Path, folder: Path, package_path: Sequence[Path]) -> Iterator[Path]:
    """The files that `inside`, a package and a path in it, can stand for."""
    from_ros = os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)
    named = [*package_path, *(Path(place) for place in from_ros if place)]
    for place in (*named, *folder.resolve().parents, folder.resolve()):
        yield place / inside
    # A package may lie in a folder of another name.
    for place in (*named, folder.resolve(), *folder.resolve().parents):
        yield place / Path(*inside.parts[1:])


def _vector(element: ElementTree.Element | None, attribute: str, default: str = "") -> Vector:
    x, y, z = _numbers(element, attribute, 3, default)
    return x, y, z


def _number(element: ElementTree.Element, attribute: str) -> float:
    return _numbers(element, attribute, 1)[0]


def _numbers(
    element: ElementTree.Element | None, attribute: str, count: int, default: str = ""
) -> tuple[float, ...]:
    text = default if element is None else element.get(attribute, default)
    try:
        numbers = tuple(float(part) for part in text.split())
    except ValueError:
        numbers = ()
    if len(numbers) != count:
        tag = "" if element is None else f" of <{element.tag}>"
        raise ValueError(f"{attribute}{tag} must be {counted(count, 'number')}, got {text!r}")
    return numbers
