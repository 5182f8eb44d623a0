"""Markers as items: each kind that RViz draws."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from tfbus.messages import Marker
from tfbus.view.data.shapes import (
    MOST_POINTS,
    MOST_SHAPES,
    Bodies,
    Item,
    Lines,
    MeshFromFile,
    Points,
    Shape,
    Text,
    Triangles,
    transform_of,
)

_BODIES = {
    Marker.CUBE: "cube",
    Marker.SPHERE: "sphere",
    Marker.CYLINDER: "cylinder",
    Marker.CUBE_LIST: "cube",
    Marker.SPHERE_LIST: "sphere",
}
_LONGEST_TEXT = 500
_FARTHEST = 1e15


def item_of(marker: Marker) -> Item:
    """The item of a marker that is added. Raises ValueError for one that cannot be drawn."""
    return Item(
        (marker.ns, marker.id),
        marker.frame_id,
        marker.stamp_ns,
        tuple(_shapes(marker)),
        transform_of(marker.pose),
        marker.frame_locked,
        marker.lifetime_ns / 1e9,
    )


def _shapes(marker: Marker) -> Iterator[Shape]:
    kind = marker.type
    scale = np.array((marker.scale.x, marker.scale.y, marker.scale.z), np.float64)
    if np.abs(scale).max() > _FARTHEST:
        raise ValueError("the scale of the marker is too large to be drawn")
    if kind == Marker.MESH_RESOURCE:
        if not marker.mesh_resource:
            raise ValueError("the marker names no mesh_resource")
        [(red, green, blue)] = _rgb(marker, 1).tolist()
        # RViz's own rule: without a colour the mesh has its own.
        has_own = marker.mesh_use_embedded_materials
        yield MeshFromFile(
            marker.mesh_resource[:_LONGEST_TEXT],
            (float(scale[0]), float(scale[1]), float(scale[2])),
            None if has_own else (red, green, blue),
            1.0 if has_own else _opacity(marker),
        )
        return
    if kind == Marker.TEXT_VIEW_FACING:
        [(red, green, blue)] = _rgb(marker, 1).tolist()
        height_m, opacity = max(float(scale[2]), 0.01), _opacity(marker)
        yield Text(marker.text[:_LONGEST_TEXT], height_m, (red, green, blue), opacity)
        return
    if kind == Marker.ARROW and len(marker.points) < 2:
        yield _bodies("arrow", np.zeros((1, 3)), scale, _rgb(marker, 1), _opacity(marker))
        return
    if kind in (Marker.CUBE, Marker.SPHERE, Marker.CYLINDER):
        yield _bodies(_BODIES[kind], np.zeros((1, 3)), scale, _rgb(marker, 1), _opacity(marker))
        return
    points = marker.points
    if not len(points):
        return
    if np.abs(points).max() > _FARTHEST:
        raise ValueError("the points of the marker are too far away to be drawn")
    most = MOST_POINTS if kind == Marker.POINTS else MOST_SHAPES
    count = len(points)
    if kind in _BODIES or kind == Marker.POINTS:
        step = max(1, -(-count // most))
        xyz, rgb = points[::step], _rgb(marker, count)[::step]
        if kind == Marker.POINTS:
            yield Points(xyz.astype(np.float32), rgb, max(float(scale[0]), 1e-3))
        else:
            yield _bodies(_BODIES[kind], xyz, scale, rgb, _opacity(marker))
        return
    points = points[: 3 * most]
    rgb = _rgb(marker, count)[: len(points)]
    if kind == Marker.TRIANGLE_LIST:
        whole = len(points) - len(points) % 3
        yield Triangles(points[:whole].astype(np.float32), _corner_colors(marker, count)[:whole])
    elif kind == Marker.LINE_STRIP:
        yield _lines(points[:-1], points[1:], rgb[:-1], rgb[1:], scale)
    elif kind == Marker.LINE_LIST:
        even = len(points) - len(points) % 2
        yield _lines(points[:even:2], points[1:even:2], rgb[:even:2], rgb[1:even:2], scale)
    elif kind == Marker.ARROW:
        yield _arrows(points[:1], points[1:2], rgb[:1], scale, _opacity(marker))
    elif kind == Marker.ARROW_STRIP:
        yield _arrows(points[:-1], points[1:], rgb[:-1], scale, _opacity(marker))


def _rgb(marker: Marker, count: int) -> NDArray[np.uint8]:
    """A colour (N, 3) for each of so many points."""
    if len(marker.colors) == count and len(marker.points) == count:
        return _bytes(marker.colors[:, :3])
    own = (marker.color.r, marker.color.g, marker.color.b)
    return np.tile(_bytes(np.array(own)), (count, 1))


def _corner_colors(marker: Marker, count: int) -> NDArray[np.uint8]:
    if len(marker.colors) == count:
        return _bytes(marker.colors)
    if len(marker.colors) and len(marker.colors) == count // 3:
        return np.repeat(_bytes(marker.colors), 3, axis=0)
    own = (marker.color.r, marker.color.g, marker.color.b, marker.color.a)
    return np.tile(_bytes(np.array(own)), (count, 1))


def _bytes(parts: NDArray[np.floating]) -> NDArray[np.uint8]:
    levels: NDArray[np.uint8] = (np.clip(parts, 0.0, 1.0) * 255.0).astype(np.uint8)
    return levels


def _opacity(marker: Marker) -> float:
    return min(max(marker.color.a, 0.0), 1.0)


def _bodies(
    kind: str,
    xyz: NDArray[np.floating],
    scale: NDArray[np.float64],
    rgb: NDArray[np.uint8],
    opacity: float,
) -> Bodies:
    count = len(xyz)
    return Bodies(
        kind,
        xyz.astype(np.float32),
        np.tile(np.array((1.0, 0.0, 0.0, 0.0), np.float32), (count, 1)),
        np.tile(np.maximum(scale, 1e-6).astype(np.float32), (count, 1)),
        rgb,
        opacity,
    )


def _lines(
    starts: NDArray[np.floating],
    ends: NDArray[np.floating],
    of_starts: NDArray[np.uint8],
    of_ends: NDArray[np.uint8],
    scale: NDArray[np.float64],
) -> Lines:
    both = np.stack((starts, ends), axis=1).astype(np.float32)
    return Lines(both, np.stack((of_starts, of_ends), axis=1), max(float(scale[0]), 1e-3))


def _arrows(
    starts: NDArray[np.floating],
    ends: NDArray[np.floating],
    rgb: NDArray[np.uint8],
    scale: NDArray[np.float64],
    opacity: float,
) -> Bodies:
    """Arrows from points to points; `scale` has the widths of the shaft and the head."""
    along = (ends - starts).astype(np.float64)
    lengths = np.linalg.norm(along, axis=1)
    kept = lengths > 1e-6
    along, lengths = along[kept], lengths[kept]
    # The shortest turn from x to the arrow.
    unit = along / lengths[:, None]
    w, y, z = 1.0 + unit[:, 0], -unit[:, 2], unit[:, 1]
    quat_wxyz = np.stack((w, np.zeros_like(w), y, z), axis=1)
    backward = w < 1e-9
    quat_wxyz[backward] = (0.0, 0.0, 0.0, 1.0)
    quat_wxyz /= np.linalg.norm(quat_wxyz, axis=1, keepdims=True)
    wide = max(float(scale[1]), 2.0 * float(scale[0]), 1e-3)
    scales = np.stack((lengths, np.full_like(lengths, wide), np.full_like(lengths, wide)), axis=1)
    return Bodies(
        "arrow",
        starts[kept].astype(np.float32),
        quat_wxyz.astype(np.float32),
        scales.astype(np.float32),
        rgb[kept],
        opacity,
    )
