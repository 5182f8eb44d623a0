"""The shapes of a robot's links, read from a URDF file; the poses of the links come by the bus."""

from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from tfbus import TfbusError, Transform

Vector = tuple[float, float, float]

_GREY = (160, 160, 165)


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
    """A file of triangles, and how much larger it is to be along x, y and z."""

    file: Path
    scale: Vector


Shape = Box | Cylinder | Sphere | Mesh


@dataclass(frozen=True)
class Visual:
    """One shape of a link: `origin` takes it into the link's frame. `opacity` is from 0 to 1."""

    link: str
    shape: Shape
    origin: Transform
    color: tuple[int, int, int] = _GREY
    opacity: float = 1.0


def read_urdf(path: Path) -> list[Visual]:
    """The visuals of all links. Raises UrdfError where the file is no URDF."""
    try:
        robot = ElementTree.parse(path).getroot()
    except OSError as error:
        raise UrdfError(f"{path} cannot be read: {error.strerror}") from error
    except ElementTree.ParseError as error:
        raise UrdfError(
            f"{path} is not XML ({error}); of a xacro file, pass what xacro makes of it"
        ) from error
    if robot.tag != "robot":
        raise UrdfError(f"{path} is no URDF: its first element is <{robot.tag}>, not <robot>")
    materials = {
        material.get("name", ""): color
        for material in robot.iter("material")
        if (color := material.find("color")) is not None
    }
    try:
        return [
            _visual(link.get("name", ""), visual, materials, path.parent)
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
) -> Visual:
    origin = visual.find("origin")
    xyz, rpy = _vector(origin, "xyz", "0 0 0"), _vector(origin, "rpy", "0 0 0")
    r, g, b, alpha = _color(visual.find("material"), materials)
    return Visual(
        link,
        _shape(link, visual.find("geometry"), folder),
        Transform.from_rpy(*rpy, xyz=xyz),
        (round(255 * r), round(255 * g), round(255 * b)),
        alpha,
    )


def _shape(link: str, geometry: ElementTree.Element | None, folder: Path) -> Shape:
    for shape in () if geometry is None else geometry:
        if shape.tag == "box":
            return Box(_vector(shape, "size"))
        if shape.tag == "cylinder":
            return Cylinder(_number(shape, "radius"), _number(shape, "length"))
        if shape.tag == "sphere":
            return Sphere(_number(shape, "radius"))
        if shape.tag == "mesh":
            return Mesh(_file(shape, folder), _vector(shape, "scale", "1 1 1"))
    raise ValueError(f"link {link!r} has a visual without a box, cylinder, sphere or mesh")


def _color(
    material: ElementTree.Element | None, materials: dict[str, ElementTree.Element]
) -> tuple[float, ...]:
    color = None
    if material is not None:
        color = material.find("color")
        if color is None:
            color = materials.get(material.get("name", ""))
    if color is None:
        return (*(part / 255 for part in _GREY), 1.0)
    return _numbers(color, "rgba", 4)


def _file(mesh: ElementTree.Element, folder: Path) -> Path:
    """Where a mesh is: `package://p/...` is looked for below the folders above the URDF."""
    name = mesh.get("filename", "")
    if name.startswith("package://"):
        inside = Path(name.removeprefix("package://"))
        for above in (folder, *folder.resolve().parents):
            for candidate in (above / inside, above / Path(*inside.parts[1:])):
                if candidate.is_file():
                    return candidate
        return folder / inside
    return folder / name.removeprefix("file://")


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
        raise ValueError(f"{attribute}{tag} is {text!r}; {count} numbers are wanted")
    return numbers
