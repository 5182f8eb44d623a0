"""A mesh file: the request for it, its parts, and the limits of both."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
class Part:
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
    def from_map(values: Mapping[str, Any]) -> "Part":
        """It again."""
        color = values["color"]
        return Part(
            np.frombuffer(values["vertices"], np.float32).reshape(-1, 3),
            np.frombuffer(values["faces"], np.uint32).reshape(-1, 3),
            None if color is None else tuple(color),
            values["opacity"],
            values["textured"],
        )


def bounds_of(parts: Sequence[Part]) -> NDArray[np.float64]:
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
