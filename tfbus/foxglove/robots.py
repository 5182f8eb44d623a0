"""Descriptions of robots as Foxglove's 3D panel reads them, and the files of their meshes.

The panel shows a topic of std_msgs/String with a URDF. It takes the names of links for frames,
fetches meshes by `package://` only, and shows nothing of a robot with a mesh that has no such name.
"""

import posixpath
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any
from urllib.parse import quote, unquote
from xml.sax.saxutils import quoteattr

from tfbus.base.bounded import Bounded
from tfbus.base.errors import TfbusError, UrdfError
from tfbus.base.log import LogOnce
from tfbus.base.wording import listed, printable
from tfbus.foxglove.server import Server
from tfbus.foxglove.topics import ServedTopic
from tfbus.messages import RobotDescription
from tfbus.node.robot_meshes import MOST_BYTES
from tfbus.robot.mesh_files import BESIDE, parts_of
from tfbus.robot.model import Collision, Mesh, Visual
from tfbus.robot.robot import Robot, read_described, remedy_of_missing
from tfbus.robot.xml import Element, read_xml
from tfbus.ros.schema import MessageCodecs
from tfbus.wire.codec import as_map
from tfbus.wire.fleet import FrameNames

_SCHEME = "package://"

# Descriptions come from anyone on the bus: this many robots are known.
_MOST_ROBOTS = 200

# A file beside a mesh, such as a picture, is looked for by as many names.
_MOST_NAMES = 16

# `fetch(origin, name)` is the content of a mesh of another machine; it raises TfbusError.
Fetch = Callable[[str, str], bytes]


@dataclass(frozen=True)
class _Known:
    """A robot as described, as clients get it, and its meshes by the path of their URIs."""

    given: Mapping[str, Any]
    shown: Mapping[str, Any]
    meshes: Mapping[str, Mesh]
    origin: str


class ShownRobots:
    """The robots that clients were sent descriptions of; safe from any thread.

    `package_path` is as of `Robot.from_urdf`. `fetch` gets the meshes that are not on this machine.
    """

    def __init__(
        self, once: LogOnce, package_path: Sequence[Path] = (), fetch: Fetch | None = None
    ) -> None:
        self._once = once
        self._package_path = tuple(package_path)
        self._fetch = fetch
        self._lock = Lock()
        self._known: Bounded[tuple[str, str], _Known] = Bounded(_MOST_ROBOTS)

    def shown(
        self, values: Mapping[str, Any], names: FrameNames | None = None, origin: str = ""
    ) -> Mapping[str, Any]:
        """The values of a RobotDescription as clients need them; the same if it is none.

        `names` translates the frames of its namespace `origin`.
        """
        given = (values.get(_text_of(values)), values.get("prefix", ""), values.get("source", ""))
        urdf, prefix, source = (each if isinstance(each, str) else "" for each in given)
        slot = (origin, prefix)
        with self._lock:
            known = self._known.get(slot)
        if known is not None and known.given == values:
            return known.shown
        try:
            robot = read_described(urdf, source, self._package_path, "the robot_description")
        except UrdfError as error:
            reason = printable(str(error), 400)
            self._once.warning(("robot", origin), "A robot_description is no robot: %s", reason)
            # Clients may know more; of a text that is no XML to us they get nothing.
            return _with_text(values, _rewritten(urdf, {}, {}) if _is_xml(urdf) else "")
        if left := sorted({mesh.name for mesh in _meshes(robot) if not _is_served(mesh)}):
            which = listed([f"'{printable(name, 120)}'" for name in left])
            self._once.warning(
                ("address", origin),
                "Left out meshes with addresses on the network, which clients would fetch: %s",
                which,
            )
        return self._take(slot, values, robot, names or FrameNames(""))

    def given(self, robot: Robot) -> Mapping[str, Any]:
        """The values of a RobotDescription as clients need them, of a robot of a file here."""
        return self._take(("", ""), {}, robot, FrameNames(""), is_trusted=True)

    def asset(self, uri: str) -> bytes:
        """The content of a mesh of one of the robots, or of a picture or material beside it, by its
        URI. Raises TfbusError for any other.
        """
        path = unquote(uri.removeprefix(_SCHEME))
        with self._lock:
            known = list(self._known.values())
        for each in known if uri.startswith(_SCHEME) else ():
            if path in each.meshes:
                mesh = each.meshes[path]
                return self._content(each.origin, mesh.name, mesh.file)
        if posixpath.splitext(path)[1].lower() in BESIDE:
            for origin, name, file in _files_beside(path, known):
                try:
                    return self._content(origin, name, file)
                except TfbusError:
                    continue
        raise TfbusError(f"no robot has a mesh {printable(uri, 200)}")

    def _take(
        self,
        slot: tuple[str, str],
        given: Mapping[str, Any],
        robot: Robot,
        names: FrameNames,
        *,
        is_trusted: bool = False,
    ) -> Mapping[str, Any]:
        origin, prefix = slot
        meshes: dict[str, Mesh] = {}
        uris: dict[str, str] = {}
        for mesh in _meshes(robot):
            if _is_served(mesh):
                path = _path(origin, robot.name, mesh.name)
                meshes[path] = mesh
                uris[mesh.name] = f"{_SCHEME}{quote(path)}"
            elif is_trusted:
                uris[mesh.name] = mesh.name
        frames = {link: names.outside(f"{prefix}{link}") for link in robot.links}
        shown = _with_text(given, _rewritten(robot.text, frames, uris))
        with self._lock:
            self._known[slot] = _Known(dict(given), shown, meshes, origin)
        return shown

    def _content(self, origin: str, name: str, file: Path | None) -> bytes:
        if file is not None and file.is_file():
            try:
                if file.stat().st_size > MOST_BYTES:
                    raise TfbusError(f"it has more than {MOST_BYTES // 10**6} MB")
                return file.read_bytes()
            except OSError as error:
                raise TfbusError(f"it cannot be read: {error.strerror}") from error
        remedy = remedy_of_missing(parts_of(name)[0])
        if self._fetch is None:
            raise TfbusError(f"it is not on this machine: {remedy}")
        try:
            return self._fetch(origin, name)
        except TfbusError as error:
            raise TfbusError(f"{error}; {remedy}") from error


class GivenRobot:
    """The channel /robot_description with the robot of a file, in place of described robots."""

    def __init__(self, server: Server, robots: ShownRobots, robot: Robot) -> None:
        codecs = MessageCodecs(exact=False)
        self._channel = ServedTopic(server, codecs, "/robot_description", RobotDescription.__name__)
        self._shown = robots.given(robot)

    def have(self, channel_id: int) -> bool:
        """Whether a channel is this one."""
        channel = self._channel.channel
        return channel is not None and channel.id == channel_id

    def send(self, log_ns: int) -> None:
        """Send it to the clients that subscribe."""
        self._channel.send(self._shown, log_ns)

    def close(self) -> None:
        """Take the channel back. Twice is fine."""
        self._channel.close()


def _meshes(robot: Robot) -> Iterator[Mesh]:
    """The meshes of all links."""
    shapes: list[Visual | Collision] = [*robot.visuals, *robot.collisions]
    for each in shapes:
        if isinstance(each.shape, Mesh):
            yield each.shape


def _is_served(mesh: Mesh) -> bool:
    """Whether clients get a mesh from here. They would fetch one of a network's address themselves:
    it would tell a stranger that they look, and reach hosts that only they reach.
    """
    return "://" not in parts_of(mesh.name)[1]


def _path(origin: str, robot: str, mesh: str) -> str:
    """The path of a mesh's URI: its package, or the robot's name, and its path there."""
    package, path = parts_of(mesh)
    # A browser would take `..` out of the address.
    parts = ["up" if part == ".." else part for part in posixpath.normpath(path).split("/")]
    return "/".join(filter(None, (origin, package or robot or "robot", *parts)))


def _files_beside(path: str, known: Sequence[_Known]) -> Iterable[tuple[str, str, Path | None]]:
    """The files at a path beside meshes: where their robots are, their names, and their paths; None
    if the mesh is not on this machine either.
    """
    found: dict[tuple[str, str], Path | None] = {}
    for each in known:
        for at, mesh in each.meshes.items():
            if at.partition("/")[0] == path.partition("/")[0] and len(found) < _MOST_NAMES:
                name = _beside(at, mesh.name, path)
                file = mesh.beside(name)
                if file is not None or mesh.file is None or not mesh.file.is_file():
                    found.setdefault((each.origin, name), file)
    return [(origin, name, file) for (origin, name), file in found.items()]


def _beside(at: str, mesh: str, path: str) -> str:
    """The name of the file at a path as the name `mesh` of the mesh at path `at` is written."""
    way = posixpath.relpath(path, posixpath.dirname(at))
    package, own = parts_of(mesh)
    name = posixpath.normpath(posixpath.join(posixpath.dirname(own), way))
    return f"{_SCHEME}{package}/{name}" if package else name


# Writing


def _text_of(values: Mapping[str, Any]) -> str:
    """The field of a description with its URDF: of ours, or of a string of ROS."""
    return "data" if "data" in values and "urdf" not in values else "urdf"


def _with_text(values: Mapping[str, Any], urdf: str) -> Mapping[str, Any]:
    """A description with this URDF; nothing else of ours, which ROS's string has as a comment."""
    field = _text_of(values)
    return as_map(RobotDescription(urdf)) if field == "urdf" else {**values, field: urdf}


_KEPT = ("link", "joint", "material")


def _is_xml(text: str) -> bool:
    try:
        return bool(read_xml(text, "").tag)
    except UrdfError:
        return False


def _rewritten(text: str, frames: Mapping[str, str], uris: Mapping[str, str]) -> str:
    """A URDF with these names of its links and of its meshes; only its visible parts, and of the
    shapes with meshes only the ones in `uris`.
    """
    robot = read_xml(text, "the robot_description")
    lines = ['<?xml version="1.0"?>', f"<robot{_attributes(robot.attributes)}>"]
    for each in robot.children:
        if each.tag in _KEPT:
            lines += _written(each, frames, uris)
    return "\n".join([*lines, "</robot>"])


def _written(each: Element, frames: Mapping[str, str], uris: Mapping[str, str]) -> list[str]:
    attributes = dict(each.attributes)
    if each.tag == "link" and "name" in attributes:
        attributes["name"] = frames.get(attributes["name"], attributes["name"])
    elif each.tag in ("parent", "child") and "link" in attributes:
        attributes["link"] = frames.get(attributes["link"], attributes["link"])
    elif each.tag == "mesh" and "filename" in attributes:
        attributes["filename"] = uris[attributes["filename"]]
    head = f"<{each.tag}{_attributes(attributes)}"
    kept = [child for child in each.children if not _is_left_out(child, uris)]
    if not kept:
        return [f"{head}/>"]
    inner = [line for child in kept for line in _written(child, frames, uris)]
    return [f"{head}>", *inner, f"</{each.tag}>"]


def _is_left_out(each: Element, uris: Mapping[str, str]) -> bool:
    """Whether an element, as a whole, is not for clients: a shape of a mesh that is not in `uris`,
    and a texture, which they do not draw, but may fetch from anywhere.
    """
    tag = each.tag.rpartition(":")[2]
    if tag == "texture":
        return True
    if tag == "mesh":
        return each.tag != tag or each.get("filename") not in uris
    is_shape = tag in ("visual", "collision", "geometry")
    return is_shape and any(_is_left_out(child, uris) for child in each.children)


def _attributes(attributes: Mapping[str, str]) -> str:
    return "".join(f" {name}={quoteattr(value)}" for name, value in attributes.items())
