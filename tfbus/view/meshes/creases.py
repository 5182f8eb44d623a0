"""Sharp edges of meshes.

A browser shades each vertex by the mean of its triangles: a box of 8 vertices looks like a ball. So
vertices are shared only by triangles that belong to one smooth surface.
"""

import numpy as np
from numpy.typing import NDArray

# Edges that bend by more than this are sharp.
_SHARP_DEG = 35.0


def with_creases(
    vertices: NDArray[np.float32], faces: NDArray[np.uint32]
) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    """The same triangles, with vertices shared along smooth edges and no others.

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
    surface = _joined(faces.size, one, other)
    # Corners that are not joined but equal all the same become one vertex: they are at one place
    # of one surface only if an edge joins them.
    first, corner = np.unique(surface, return_inverse=True)
    return vertices[faces.reshape(-1)[first]], corner.reshape(-1, 3).astype(np.uint32)


def _places(vertices: NDArray[np.float32]) -> NDArray[np.int64]:
    """A number for each vertex (V,), the same for those at one place."""
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


def _joined(count: int, one: NDArray[np.int64], other: NDArray[np.int64]) -> NDArray[np.int64]:
    """The least number of those that each of `count` numbers is joined with, by pairs."""
    label = np.arange(count)
    while True:
        least = np.minimum(label[one], label[other])
        former = label.copy()
        np.minimum.at(label, one, least)
        np.minimum.at(label, other, least)
        label = label[label]
        if np.array_equal(label, former):
            return label
