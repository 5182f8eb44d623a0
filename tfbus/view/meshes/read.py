"""Reads the bytes of a mesh file, with trimesh, and the files of its package that it names.

`main` does so in a process of its own: a file of a stranger can make a reader take all memory, or
for ever, which ends that process, and not the page. It also leaves the page's own thread free.
Requests come on standard input, answers go to standard output.
"""

import io
import logging
import os
import re
import sys
from collections.abc import Iterator, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray
from trimesh.resolvers import Resolver

from tfbus.base.installation import install_command
from tfbus.base.limited_process import limit_this_process
from tfbus.robot.mesh_files import BESIDE
from tfbus.view.meshes.mesh import (
    KINDS,
    MOST_BYTES,
    MOST_MEMORY,
    MOST_TRIANGLES,
    Color,
    MeshError,
    MeshPart,
    MeshRequest,
    check,
    receive,
    send,
    small_picture,
)


class References(Resolver):
    """The files beside a mesh file: sent `beside` it, by their names, or in its `folder` and inside
    of `root`.

    `refused` says of each file that cannot be had why, by its name.
    """

    def __init__(
        self,
        folder: Path | None = None,
        root: Path | None = None,
        beside: Mapping[str, bytes] | None = None,
    ) -> None:
        self.refused: dict[str, str] = {}
        self._folder = folder
        self._root = root
        self._beside = beside or {}

    def get(self, key: str) -> bytes:
        """The content of a file. Raises FileNotFoundError if it cannot be had."""
        name = unquote(str(key)).removeprefix("file://").removeprefix("./").replace("\\", "/")
        if name in self._beside:
            return self._beside[name]
        try:
            return self._read(name)
        except OSError as error:
            why = error.strerror or str(error)
            self.refused.setdefault(name, why)
            raise FileNotFoundError(why) from error

    def _read(self, name: str) -> bytes:
        if self._folder is None or self._root is None:
            raise FileNotFoundError("it did not come with the mesh")
        file = (self._folder / name).resolve()
        if not file.is_relative_to(self._root.resolve()):
            raise FileNotFoundError("it is outside of the mesh's package")
        if file.suffix.lower() not in BESIDE:
            raise FileNotFoundError("it is no picture, material or buffer")
        if not file.is_file():
            raise FileNotFoundError("no such file")
        if file.stat().st_size > MOST_BYTES:
            raise FileNotFoundError(f"it has more than {MOST_BYTES // 10**6} MB")
        return file.read_bytes()

    def write(self, name: str, data: object) -> None:
        """Nothing is written."""
        raise PermissionError(name)

    def namespaced(self, namespace: str) -> "References":
        """The same."""
        return self

    def keys(self) -> list[str]:
        """None are known in advance."""
        return []


# Exporters that write no transparency write all of it.
_LEAST_OPACITY = 0.05


def read_mesh(
    kind: str,
    data: bytes,
    references: References,
    texture: tuple[str, bytes] | None = None,
    heeds_up_axis: bool = False,
) -> list[MeshPart]:
    """The parts of a mesh file of a kind, such as "stl", in metres if it states its unit.

    A `texture`, by its name, is the picture of the parts that have texture coordinates and no look
    of their own; if it cannot be, `references.refused` says why. With `heeds_up_axis` a DAE is
    turned by the up axis that it states.

    Raises MeshError, and any error of a mesh reader.
    """
    if kind not in KINDS:
        raise MeshError(f"no reader for .{kind}: convert it to {', '.join(KINDS[:3])} or GLB")
    check(kind, data)
    # Its functions have no exact types.
    trimesh: Any = import_module("trimesh")
    if kind not in trimesh.available_formats():
        raise MeshError(f"no installed package reads .{kind}: {install_command('robot')}")
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)
    scene = trimesh.load_scene(io.BytesIO(data), file_type=kind, resolver=references, process=False)
    own = _Texture(trimesh, *texture) if texture else None
    turn = _turn(data) if heeds_up_axis and kind == "dae" else None
    solids: list[MeshPart] = []
    textured: list[MeshPart] = []
    triangles = 0
    for mesh, matrix in _instances(scene):
        triangles += len(mesh.faces)
        if triangles > MOST_TRIANGLES:
            raise MeshError(f"it has more than {MOST_TRIANGLES:,} triangles")
        placed = _placed(mesh, matrix if turn is None else turn @ matrix, _unit_m(trimesh, mesh))
        if own is not None:
            own.put_on(placed)
        if _is_textured(placed):
            textured.append(_textured(trimesh, placed))
        else:
            color, opacity = _look(placed, is_linear=kind in ("glb", "gltf"))
            vertices = np.asarray(placed.vertices, np.float32)
            solids.append(MeshPart(vertices, np.asarray(placed.faces, np.uint32), color, opacity))
    if not triangles:
        raise MeshError("it has no triangles")
    if own is not None and own.mistake:
        references.refused.setdefault(own.name, own.mistake)
    return [*_merged(solids), *textured]


class _Texture:
    """The picture that a URDF gives a mesh; `mistake` says why it is nowhere to be seen."""

    def __init__(self, trimesh: Any, name: str, data: bytes) -> None:
        pillow: Any = import_module("PIL.Image")
        self.name = name
        self.mistake = "the mesh has no texture coordinates, or a look of its own"
        self._visuals = trimesh.visual
        self._picture = None
        try:
            picture = pillow.open(io.BytesIO(data))
            self._picture = small_picture(picture)
        except (MeshError, pillow.DecompressionBombError) as error:
            self.mistake = str(error)
        except (OSError, ValueError, SyntaxError):  # as Pillow's decoders raise them
            self.mistake = "it is not a picture"

    def put_on(self, mesh: Any) -> None:
        """Draw it on a mesh that can have it."""
        visual = mesh.visual
        if self._picture is None or visual.kind != "texture" or visual.uv is None:
            return
        if _picture(visual.material) is None and _base_color(visual.material) is None:
            material = self._visuals.material.SimpleMaterial(image=self._picture)
            mesh.visual = self._visuals.TextureVisuals(uv=visual.uv, material=material)
            self.mistake = ""


def _instances(scene: Any) -> Iterator[tuple[Any, Any]]:
    for node in scene.graph.nodes_geometry:
        matrix, name = scene.graph[node]
        mesh = scene.geometry[name]
        if len(getattr(mesh, "faces", ())):
            yield mesh, matrix


def _placed(mesh: Any, matrix: Any, unit_m: float) -> Any:
    placed = mesh.copy()
    placed.apply_transform(matrix)
    if unit_m != 1.0:
        placed.apply_scale(unit_m)
    vertices = np.asarray(placed.vertices)
    if not np.isfinite(vertices).all():
        raise MeshError("it has vertices that are not finite")
    if int(placed.faces.max()) >= len(vertices) or int(placed.faces.min()) < 0:
        raise MeshError("it has triangles of vertices that do not exist")
    return placed


def _turn(dae: bytes) -> Any:
    """The rotation that turns a DAE so that its up axis is z; None if that is so."""
    found = _UP_AXIS.search(dae)
    return _TURNS.get(found[1]) if found else None


# As Collada defines which ways are right, up and towards the viewer.
_UP_AXIS = re.compile(rb"<up_axis>\s*([XYZ])_UP\s*</up_axis>")
_TURNS = {
    b"X": np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]], float),
    b"Y": np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]], float),
}


def _unit_m(trimesh: Any, mesh: Any) -> float:
    """The unit of a DAE, the only format that states one."""
    unit = mesh.metadata.get("units")
    return float(trimesh.units.unit_conversion(unit, "meters")) if unit else 1.0


def _is_textured(mesh: Any) -> bool:
    visual = mesh.visual
    if visual.kind == "texture":
        return visual.uv is not None and _picture(visual.material) is not None
    if visual.kind == "vertex":
        colors = visual.vertex_colors
        return bool((colors != colors[0]).any())
    return False


def _picture(material: Any) -> Any:
    picture = getattr(material, "baseColorTexture", None)
    if picture is not None:
        return picture
    picture = getattr(material, "image", None)
    # That which the reader of OBJ makes up for a mesh without materials is from no file.
    return None if getattr(picture, "format", None) is None else picture


def _textured(trimesh: Any, mesh: Any) -> MeshPart:
    visual = mesh.visual
    if visual.kind == "texture":
        picture = small_picture(_picture(visual.material))
        mean = np.asarray(picture.convert("RGB").resize((1, 1))).reshape(3)
        # Browsers draw no reflections here, and metal without them is black.
        material = trimesh.visual.material.PBRMaterial(
            baseColorTexture=picture,
            metallicFactor=0.0,
            roughnessFactor=0.9,
            doubleSided=True,
            alphaMode="BLEND" if picture.mode == "RGBA" else None,
        )
        mesh.visual = trimesh.visual.TextureVisuals(uv=visual.uv, material=material)
    else:
        mean = visual.vertex_colors[:, :3].mean(axis=0)
    r, g, b = (round(float(part)) for part in mean)
    return MeshPart(
        np.asarray(mesh.vertices, np.float32),
        np.asarray(mesh.faces, np.uint32),
        (r, g, b),
        1.0,
        mesh.export(file_type="glb"),
    )


def _look(mesh: Any, is_linear: bool) -> tuple[Color | None, float]:
    """The colour and the opacity of a mesh without a picture; None if it has no colour."""
    visual = mesh.visual
    if visual.kind == "texture":
        rgba = _base_color(visual.material)
    elif visual.kind == "vertex":
        rgba = np.asarray(visual.vertex_colors[0], float) / 255.0
    elif visual.kind == "face":
        rgba = np.asarray(visual.face_colors, float).mean(axis=0) / 255.0
    else:
        rgba = None
    if rgba is None:
        return None, 1.0
    rgb = np.clip(rgba[:3], 0.0, 1.0)
    if is_linear:
        rgb = np.where(rgb <= 0.0031308, 12.92 * rgb, 1.055 * rgb ** (1.0 / 2.4) - 0.055)
    r, g, b = (round(255.0 * float(part)) for part in rgb)
    opacity = float(rgba[3]) if len(rgba) > 3 else 1.0
    return (r, g, b), opacity if _LEAST_OPACITY <= opacity < 1.0 else 1.0


def _base_color(material: Any) -> Any:
    """The colour of a material from 0 to 1, None if the file has none."""
    base = getattr(material, "baseColorFactor", None)
    if base is not None:
        numbers = np.asarray(base)
        return numbers / 255.0 if np.issubdtype(numbers.dtype, np.integer) else numbers
    # Of an OBJ; its other fields are the reader's own where the file has none.
    named = getattr(material, "kwargs", {})
    if "kd" not in named:
        return None
    return np.array([*named["kd"][:3], *map(float, named.get("d", ())[:1])])


def _merged(parts: list[MeshPart]) -> list[MeshPart]:
    """The parts with one for each look, with their creases."""
    looks: dict[tuple[Color | None, float], list[MeshPart]] = {}
    for part in parts:
        looks.setdefault((part.color, part.opacity), []).append(part)
    return [_joined(same) for same in looks.values()]


def _joined(parts: list[MeshPart]) -> MeshPart:
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    vertices = np.concatenate([part.vertices for part in parts])
    pairs = zip(parts, starts, strict=False)
    faces = np.concatenate([part.faces + np.uint32(start) for part, start in pairs])
    return MeshPart(*with_creases(vertices, faces), parts[0].color, parts[0].opacity)


# Edges that bend by more than this are sharp.
_SHARP_DEG = 35.0


def with_creases(
    vertices: NDArray[np.float32], faces: NDArray[np.uint32]
) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    """The same triangles, with vertices shared along smooth edges and no others: a browser shades
    each vertex by the mean of its triangles, so that a box of 8 vertices looks like a ball.

    Takes vertices (V, 3), of which several may be at one place, and faces (F, 3). Triangles without
    an area are left out.
    """
    place = _places(vertices)[faces]
    kept = (
        (place[:, 0] != place[:, 1]) & (place[:, 1] != place[:, 2]) & (place[:, 2] != place[:, 0])
    )
    faces, place = faces[kept], place[kept]
    if not len(faces):
        return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32)
    one, other = _smooth_corners(place, _normals(vertices, faces))
    surface = _least_joined(faces.size, one, other)
    # Corners that are not joined but equal all the same become one vertex: they are at one place
    # of one surface only if an edge joins them.
    first, corner = np.unique(surface, return_inverse=True)
    return vertices[faces.reshape(-1)[first]], corner.reshape(-1, 3).astype(np.uint32)


def _places(vertices: NDArray[np.float32]) -> NDArray[np.int64]:
    """A number for each vertex (V,), the same for vertices at one place."""
    # Adding 0 makes -0 to 0.
    bits = (vertices + np.float32(0.0)).view(np.uint32).astype(np.uint64)
    with np.errstate(over="ignore"):
        mixed = bits[:, 0] * np.uint64(0x9E3779B97F4A7C15)
        mixed = (mixed ^ (mixed >> np.uint64(29))) + bits[:, 1] * np.uint64(0xBF58476D1CE4E5B9)
        mixed = (mixed ^ (mixed >> np.uint64(31))) + bits[:, 2] * np.uint64(0x94D049BB133111EB)
    return np.unique(mixed, return_inverse=True)[1].astype(np.int64)


def _normals(vertices: NDArray[np.float32], faces: NDArray[np.uint32]) -> NDArray[np.float64]:
    """The unit normal of each triangle (F, 3); zeros for a triangle without an area."""
    corners = vertices[faces].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    unit: NDArray[np.float64] = normals / np.where(lengths > 0.0, lengths, 1.0)
    return unit


def _smooth_corners(
    place: NDArray[np.int64], normals: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pairs of corners (of 3 F) that are the same end of a smooth edge."""
    count = len(place)
    # Each triangle's edges from corner k to k + 1, by the corners' numbers.
    start = np.arange(3 * count)
    end = np.roll(start.reshape(-1, 3), -1, axis=1).reshape(-1)
    flat = place.reshape(-1)
    low, high = np.minimum(flat[start], flat[end]), np.maximum(flat[start], flat[end])
    key = low * (int(flat.max()) + 1) + high
    order = np.argsort(key, kind="stable")
    same = key[order[1:]] == key[order[:-1]]
    first, second = order[:-1][same], order[1:][same]
    bend = np.einsum("ij,ij->i", normals[first // 3], normals[second // 3])
    smooth = bend > np.cos(np.radians(_SHARP_DEG))
    first, second = first[smooth], second[smooth]
    # Neighbours run along their edge in opposite directions, unless one is inside out.
    opposite = flat[start[first]] == flat[end[second]]
    of_start = np.where(opposite, end[second], start[second])
    of_end = np.where(opposite, start[second], end[second])
    return np.concatenate((start[first], end[first])), np.concatenate((of_start, of_end))


def _least_joined(
    count: int, one: NDArray[np.int64], other: NDArray[np.int64]
) -> NDArray[np.int64]:
    """For each of `count` numbers the least number that it is joined with, by pairs."""
    label = np.arange(count)
    while True:
        least = np.minimum(label[one], label[other])
        former = label.copy()
        np.minimum.at(label, one, least)
        np.minimum.at(label, other, least)
        label = label[label]
        if np.array_equal(label, former):
            return label


def answer(values: dict[str, Any]) -> dict[str, Any]:
    """The triangles of a request for a mesh, or `error` with a sentence."""
    request = MeshRequest.from_map(values)
    try:
        folder = None if request.path is None else request.path.parent
        references = References(folder, request.root, request.beside)
        data = request.data if request.path is None else _content(request.path)
        parts = read_mesh(request.kind, data, references, request.texture, request.heeds_up_axis)
    except (MeshError, OSError) as error:
        return {"error": str(error)}
    except MemoryError:
        return {"error": "it needs too much memory"}
    # Mesh readers raise all kinds of errors, ImportError among them.
    except Exception as error:
        return {
            "error": f"it is not a valid .{request.kind} file ({error or type(error).__name__})"
        }
    return {"parts": [part.as_map() for part in parts], "refused": references.refused}


def _content(path: Path) -> bytes:
    if not path.is_file():
        raise MeshError("no such file")
    if (size := path.stat().st_size) > MOST_BYTES:
        raise MeshError(f"it has {size / 1e6:.0f} MB, at most {MOST_BYTES / 1e6:.0f} are read")
    return path.read_bytes()


def main() -> None:
    """Answer until standard input ends."""
    # Readers may print; that must not be taken for an answer.
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    limit_this_process(memory_bytes=MOST_MEMORY)
    send(answers, {"ready": True})
    while (values := receive(sys.stdin.buffer)) is not None:
        send(answers, answer(values))
