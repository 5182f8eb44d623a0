"""Meshes of triangles: vertices (V, 3) in metres and faces (F, 3)."""

import numpy as np
from numpy.typing import NDArray

Mesh = tuple[NDArray[np.float32], NDArray[np.uint32]]


def arm(axis: int, length_m: float, radius_m: float) -> Mesh:
    """A thin box from the origin along x (0), y (1) or z (2)."""
    low, high = np.full(3, -radius_m), np.full(3, radius_m)
    low[axis], high[axis] = 0.0, length_m
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    return (low + corners * (high - low)).astype(np.float32), _BOX


def octahedron(radius_m: float) -> Mesh:
    """An octahedron around the origin."""
    points = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)])
    corners = [(x, y, z) for x in (0, 1) for y in (2, 3) for z in (4, 5)]
    faces = [_outward(points, face) for face in corners]
    return (points * radius_m).astype(np.float32), np.array(faces, np.uint32)


def _outward(points: NDArray[np.int64], face: tuple[int, int, int]) -> tuple[int, int, int]:
    """The face with its corners counter-clockwise as seen from outside."""
    a, b, c = points[list(face)]
    return face if np.dot(np.cross(b - a, c - a), a + b + c) > 0 else (face[0], face[2], face[1])


_BOX = np.array(
    [
        (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
        (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
    ],
    np.uint32,
)  # fmt: skip
