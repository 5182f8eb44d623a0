"""A mesh file: the request for it, its parts, their limits, and the checks before it is read.

Requests and parts go through pipes, to a process that reads files and back.
"""

import json
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any
from xml.parsers import expat

import msgpack
import numpy as np
from numpy.typing import NDArray

from tfbus.base.errors import TfbusError

# The largest file, and the most triangles in it.
MOST_BYTES = 100_000_000
MOST_TRIANGLES = 2_000_000

# A picture of more pixels is not opened; the sides of others are made at most this long.
MOST_PIXELS = 8192 * 8192
LONGEST_SIDE_PX = 1024

# How long it may take to read one, and with how much memory.
LONGEST_S = 60.0
MOST_MEMORY = 4_000_000_000

# By their suffixes.
KINDS = ("stl", "dae", "obj", "ply", "off", "glb", "gltf")


@dataclass(frozen=True)
class MeshRequest:
    """A mesh file at `path`, which may name files inside of `root`; or with `data`, as it came from
    another machine, and files that came `beside` it. `kind` is its suffix, such as "stl".

    `texture` is the picture that the URDF gives it, by its name, for triangles without a look of
    their own. With `heeds_up_axis` a DAE is turned by the up axis that it states.
    """

    kind: str
    path: Path | None = None
    root: Path | None = None
    data: bytes = b""
    beside: Mapping[str, bytes] = field(default_factory=dict)
    texture: tuple[str, bytes] | None = None
    heeds_up_axis: bool = False

    def as_map(self) -> dict[str, Any]:
        """It as msgpack can have it."""
        return {
            "kind": self.kind,
            "path": None if self.path is None else str(self.path),
            "root": None if self.root is None else str(self.root),
            "data": self.data,
            "beside": dict(self.beside),
            "texture": self.texture,
            "heeds_up_axis": self.heeds_up_axis,
        }

    @staticmethod
    def from_map(values: Mapping[str, Any]) -> "MeshRequest":
        """It again."""
        path, root, texture = values["path"], values["root"], values["texture"]
        return MeshRequest(
            values["kind"],
            None if path is None else Path(path),
            None if root is None else Path(root),
            values["data"],
            values["beside"],
            None if texture is None else (texture[0], texture[1]),
            values["heeds_up_axis"],
        )


Color = tuple[int, int, int]


@dataclass(frozen=True, eq=False)
class MeshPart:
    """Triangles of one look: `vertices` (V, 3) in metres, `faces` (F, 3).

    Without a `color` the file has none. `opacity` is from 0 to 1. `textured` is the same as GLB
    with its picture or the colours of its vertices, b"" without; `color` is then the mean.
    """

    vertices: NDArray[np.float32]
    faces: NDArray[np.uint32]
    color: Color | None = None
    opacity: float = 1.0
    textured: bytes = b""

    def as_map(self) -> dict[str, Any]:
        """It as msgpack can have it."""
        return {
            "vertices": self.vertices.tobytes(),
            "faces": self.faces.tobytes(),
            "color": self.color,
            "opacity": self.opacity,
            "textured": self.textured,
        }

    @staticmethod
    def from_map(values: Mapping[str, Any]) -> "MeshPart":
        """It again."""
        color = values["color"]
        return MeshPart(
            np.frombuffer(values["vertices"], np.float32).reshape(-1, 3),
            np.frombuffer(values["faces"], np.uint32).reshape(-1, 3),
            None if color is None else tuple(color),
            values["opacity"],
            values["textured"],
        )


def bounds_of(parts: Sequence[MeshPart]) -> NDArray[np.float64]:
    """The corners (2, 3) of the box around parts, least and most; zeros without any."""
    corners = [
        corner
        for part in parts
        if len(part.vertices)
        for corner in (part.vertices.min(axis=0), part.vertices.max(axis=0))
    ]
    if not corners:
        return np.zeros((2, 3))
    return np.array([np.min(corners, axis=0), np.max(corners, axis=0)], np.float64)


# A corner has at most this many numbers in a glTF file.
_MOST_COUNT = 3 * MOST_TRIANGLES
_MOST_NODES = 100_000

_GLB = b"glTF"
_JSON_CHUNK = 0x4E4F534A


class MeshError(TfbusError):
    """A mesh that cannot be shown; the message says why."""


def check(kind: str, data: bytes) -> None:
    """Raises MeshError for a file that must not be given to a reader."""
    if len(data) > MOST_BYTES:
        raise MeshError(f"it has {len(data) / 1e6:.0f} MB, at most {MOST_BYTES / 1e6:.0f} are read")
    if not data:
        raise MeshError("it is empty")
    if kind == "dae":
        _check_xml(data)
    elif kind in ("glb", "gltf"):
        _check_gltf(_gltf_header(kind, data))
    elif kind == "stl":
        _check_stl(data)


def _check_xml(data: bytes) -> None:
    """No archive, which the reader of DAE would unpack, no entities and no default attributes,
    which grow.
    """
    if data.startswith(b"PK"):
        raise MeshError("it is a ZIP archive, not XML")
    parser = expat.ParserCreate()

    def refuse(name: str, system: object, public: object, declares: int) -> None:
        if declares:
            raise MeshError("its DOCTYPE declares entities or attributes, which are not read")

    def stop(*_: object) -> None:
        raise _RootReached

    parser.StartDoctypeDeclHandler = refuse
    # A doctype is before the root element or nowhere.
    parser.StartElementHandler = stop
    try:
        parser.Parse(data, True)
    except _RootReached:
        pass
    except expat.ExpatError as error:
        raise MeshError(f"it is not XML: {error}") from error


class _RootReached(Exception):
    pass


def _gltf_header(kind: str, data: bytes) -> Mapping[str, Any]:
    if kind == "glb":
        if data[:4] != _GLB or len(data) < 20:
            raise MeshError("it is not a GLB file")
        length, chunk = struct.unpack_from("<II", data, 12)
        if chunk != _JSON_CHUNK:
            raise MeshError("it is not a GLB file of version 2")
        data = data[20 : 20 + length]
    try:
        header = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise MeshError(f"its description is not JSON: {error}") from error
    if not isinstance(header, dict):
        raise MeshError("its description is not a JSON object")
    return header


def _check_gltf(header: Mapping[str, Any]) -> None:
    """At most as many numbers as fit, and nodes that are trees."""
    required = header.get("extensionsRequired") or []
    if unknown := [name for name in required if "draco" in str(name) or "meshopt" in str(name)]:
        raise MeshError(f"it is compressed with {unknown[0]}, which is not read")
    counts = [each.get("count", 0) for each in _objects(header, "accessors")]
    if any(not isinstance(count, int) or count < 0 for count in counts):
        raise MeshError("the count of an accessor is no number")
    if max(counts, default=0) > _MOST_COUNT:
        raise MeshError(f"it has more than {MOST_TRIANGLES:,} triangles")
    nodes = _objects(header, "nodes")
    if len(nodes) > _MOST_NODES:
        raise MeshError(f"it has more than {_MOST_NODES:,} nodes")
    children = [child for node in nodes for child in node.get("children") or []]
    if len(set(map(str, children))) < len(children):
        raise MeshError("one of its nodes has two parents")


def _objects(header: Mapping[str, Any], name: str) -> list[Mapping[str, Any]]:
    found = header.get(name) or []
    if not isinstance(found, list) or not all(isinstance(each, dict) for each in found):
        raise MeshError(f"its {name} are no list of objects")
    return found


def _check_stl(data: bytes) -> None:
    """A binary file is as long as its header says."""
    if len(data) < 84 or data[:5].lower() == b"solid":
        return
    (count,) = struct.unpack_from("<I", data, 80)
    if 84 + 50 * count > len(data):
        raise MeshError(f"it is cut short: its header says {count:,} triangles")
    if count > MOST_TRIANGLES:
        raise MeshError(f"it has {count:,} triangles, at most {MOST_TRIANGLES:,} are shown")


def small_picture(picture: Any) -> Any:
    """A picture of Pillow's as it is sent to browsers. Raises MeshError if it is too large."""
    width, height = picture.size
    if width * height > MOST_PIXELS:
        raise MeshError(f"its picture has {width} x {height} pixels")
    picture = picture.convert("RGBA" if "A" in picture.getbands() else "RGB")
    longest = max(width, height)
    if longest > LONGEST_SIDE_PX:
        part = LONGEST_SIDE_PX / longest
        picture = picture.resize((max(1, round(width * part)), max(1, round(height * part))))
    # The format in which trimesh writes it: PNG takes ten times as long.
    picture.format = "PNG" if picture.mode == "RGBA" else "JPEG"
    return picture


_HEADER = struct.Struct(">I")


def send(pipe: IO[bytes], values: dict[str, Any]) -> None:
    """Write a message: its length in 4 bytes, and msgpack."""
    payload = msgpack.packb(values)
    pipe.write(_HEADER.pack(len(payload)))
    pipe.write(payload)
    pipe.flush()


def receive(pipe: IO[bytes]) -> dict[str, Any] | None:
    """Read a message; None at the end."""
    header = pipe.read(_HEADER.size)
    if len(header) < _HEADER.size:
        return None
    (length,) = _HEADER.unpack(header)
    payload = pipe.read(length)
    if len(payload) < length:
        return None
    values: dict[str, Any] = msgpack.unpackb(payload, strict_map_key=False)
    return values
