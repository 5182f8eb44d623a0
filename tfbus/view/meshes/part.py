"""The parts of a mesh file: triangles of one look each."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
