"""Shapes in the browser: drawn, changed in place and removed, and met by a ray."""

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from itertools import count
from typing import Any

import numpy as np
import trimesh
import viser

from tfbus.base.wording import printable
from tfbus.geometry.transform import Transform
from tfbus.view.data.layer import PlacedItem
from tfbus.view.data.shapes import (
    Bodies,
    Frustum,
    Item,
    Lines,
    MeshFromFile,
    Points,
    Shape,
    Text,
    Texture,
    Triangles,
)
from tfbus.view.frames import Floats
from tfbus.view.meshes.loader import ReadMesh
from tfbus.view.scene.camera import Ray
from tfbus.view.scene.drawn import FIXED_NODE, place_of, scale_of_depth, unit_mesh

# A topic, and which of its items.
Place = tuple[str, object]


@dataclass(eq=False)
class _DrawnItem:
    placed: PlacedItem
    size: float
    node: Any
    handles: list[Any]

    @property
    def awaits(self) -> bool:
        """Whether its mesh is not loaded yet."""
        return not self.handles and any(
            isinstance(shape, MeshFromFile) for shape in self.placed.item.shapes
        )


class NotDrawnError(ValueError):
    """A message asks for something that is not drawn; the text names it."""


MeshNamed = Callable[[str, Callable[[], Collection[str]]], ReadMesh | str | None]


class DrawnItems:
    """The items of messages in the scene, by their places; for one thread.

    `mesh_named(name, drawn)` is the mesh of a file, why there is none, or None while it is loaded;
    `drawn()` are the names of all that are drawn.
    """

    def __init__(self, server: viser.ViserServer, mesh_named: MeshNamed) -> None:
        self._server = server
        self._mesh_named = mesh_named
        self._drawn: dict[Place, _DrawnItem] = {}
        # How many shapes of items have the mesh of a file, by the names of the files.
        self._meshes: Counter[str] = Counter()
        self._numbers = count(1)

    @property
    def _scene(self) -> viser.SceneApi:
        return self._server.scene

    def places(self) -> set[Place]:
        """The places of all items."""
        return {*self._drawn}

    def draw(self, at: Place, placed: PlacedItem, size: float, *, is_shown: bool) -> None:
        """Draw the item of this place as it is now, points in the given size in cm; hidden unless
        it `is_shown`. Raises NotDrawnError.
        """
        drawn = self._drawn_as(at, placed, size)
        if drawn.node.visible != is_shown:
            drawn.node.visible = is_shown

    def remove(self, at: Place) -> None:
        """Draw it no longer. Twice is fine."""
        if (ended := self._drawn.pop(at, None)) is not None:
            self._count_meshes(ended.placed.item, -1)
            for handle in (*ended.handles, ended.node):
                handle.remove()

    def _count_meshes(self, item: Item, change: int) -> None:
        """Count its meshes once more, or less: to collect the names for each marker anew takes a
        time that grows with the square of their number.
        """
        for shape in item.shapes:
            if isinstance(shape, MeshFromFile):
                self._meshes[shape.name] += change
                if not self._meshes[shape.name]:
                    del self._meshes[shape.name]

    def _drawn_as(self, at: Place, placed: PlacedItem, size: float) -> _DrawnItem:
        drawn = self._drawn.get(at)
        if drawn is None:
            node = self._scene.add_frame(
                f"{FIXED_NODE}/data/{next(self._numbers)}", show_axes=False, **place_of(placed.pose)
            )
            drawn = self._drawn[at] = _DrawnItem(placed, size, node, [])
            self._count_meshes(placed.item, 1)
            drawn.handles = self._made(placed, node.name, size)
            return drawn
        if drawn.placed.pose != placed.pose:
            put = place_of(placed.pose)
            drawn.node.position, drawn.node.wxyz = put["position"], put["wxyz"]
        if drawn.placed.item is not placed.item or drawn.size != size or drawn.awaits:
            former, former_handles = drawn.placed, drawn.handles
            drawn.handles = self._made(placed, drawn.node.name, size, former, former_handles)
            for handle in former_handles[len(drawn.handles) :]:
                handle.remove()
            drawn.size = size
        if drawn.placed.item is not placed.item:
            self._count_meshes(drawn.placed.item, -1)
            self._count_meshes(placed.item, 1)
        drawn.placed = placed
        return drawn

    def _made(
        self,
        placed: PlacedItem,
        path: str,
        size: float,
        former: PlacedItem | None = None,
        handles: list[Any] | None = None,
    ) -> list[Any]:
        """Add the shapes, in the place of the `former` item's, which have these handles."""
        there = [shape for shape in former.item.shapes if not _is_empty(shape)] if former else []
        made: list[Any] = []
        for shape in placed.item.shapes:
            if _is_empty(shape):
                continue
            at = len(made)
            before = there[at] if at < len(there) else None
            if isinstance(shape, MeshFromFile):
                mesh = self._mesh_named(shape.name, self._meshes.keys)
                if isinstance(mesh, str):
                    raise NotDrawnError(f"mesh {printable(shape.name)}: {mesh}")
                made += [] if mesh is None else [_mesh(self._scene, f"{path}/{at}", shape, mesh)]
            elif handles and isinstance(shape, Bodies) and _is_alike(shape, before):
                _move(handles[at], shape)
                made.append(handles[at])
            else:
                make = _MAKERS[type(shape)]
                made.append(make(self._scene, f"{path}/{at}", shape, size))
        return made


_MOST_POINTS = 200


# A letter is about so wide, in parts of the height of a capital one.
_LETTER = 0.8


def some_points(shape: Shape) -> Floats:
    """Points of a shape (N, 3), at most 200."""
    xyz: Any
    match shape:
        case Points():
            xyz = shape.xyz
        case Bodies():
            half = shape.scales.max(axis=1, keepdims=True) / 2.0
            xyz = np.concatenate((shape.xyz - half, shape.xyz + half))
        case Text():
            longest = max(map(len, shape.text.splitlines()), default=0)
            half = _LETTER * longest * shape.height_m / 2.0
            xyz = half * np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0)])
        case Lines():
            xyz = shape.ends.reshape(-1, 3)
        case Triangles():
            xyz = shape.corners
        case Texture():
            xyz = np.array([(0.0, 0.0, 0.0), (shape.width_m, shape.height_m, 0.0)])
        case _:
            xyz = np.zeros((1, 3))
    points: Floats = xyz[:: max(1, len(xyz) // _MOST_POINTS)].astype(np.float64)
    return points


def way_to(ray: Ray, shape: Shape) -> float:
    """The way in m along a ray to a shape; of bodies to the balls around them. Infinity for none,
    and for lines, texts and cameras' views.
    """
    match shape:
        case Points():
            return ray.to_points(shape.xyz)
        case Bodies():
            return min(
                (
                    ray.seen_from(Transform(xyz, (x, y, z, w))).to_triangles(
                        vertices * scale, faces
                    )
                    for xyz, (w, x, y, z), scale in _nearest_bodies(ray, shape)
                    for vertices, faces in [unit_mesh(shape.kind)]
                ),
                default=math.inf,
            )
        case Triangles():
            return ray.to_triangles(shape.corners, np.arange(len(shape.corners)).reshape(-1, 3))
        case Texture():
            corners = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])
            wide = np.column_stack((corners * (shape.width_m, shape.height_m), np.zeros(4)))
            return ray.to_triangles(wide, np.array([(0, 1, 2), (0, 2, 3)]))
        case _:
            return math.inf


# Of so many bodies, the nearest that a ray comes near, their triangles are looked at.
_MOST_MET = 200


def _nearest_bodies(ray: Ray, bodies: Bodies) -> Iterator[tuple[Any, Any, Any]]:
    """The place, rotation (w first) and scale of each body whose ball the ray meets."""
    seen = bodies.xyz - ray.origin
    depths = seen @ ray.direction
    aside = np.linalg.norm(seen - depths[:, None] * ray.direction, axis=1)
    met = np.flatnonzero(aside <= np.linalg.norm(bodies.scales, axis=1))
    for row in met[np.argsort(depths[met])][:_MOST_MET]:
        yield bodies.xyz[row], bodies.quat_wxyz[row], bodies.scales[row]


def _is_empty(shape: Shape) -> bool:
    """Whether a shape adds nothing here; texts are drawn for each browser."""
    if isinstance(shape, Text):
        return True
    parts = {Points: "xyz", Lines: "ends", Bodies: "xyz", Triangles: "corners"}
    name = parts.get(type(shape))
    return bool(name) and not len(getattr(shape, name or ""))


# Browsers make colours of lines brighter, as if they were linear ones.
_LINEAR = np.round(255.0 * (np.arange(256) / 255.0) ** 2.2).astype(np.uint8)

# A line that is so long, or this part of how far away it begins, is as good as a point.
_DOT_M = 1e-4
_DOT_PART = 1e-6
# Nobody looks along it.
_DOT_ALONG = np.array((0.31, 0.47, 0.83), np.float32)


def _dots(scene: viser.SceneApi, path: str, points: Points) -> Any:
    """Points that are some pixels wide, as viser has lines only, which have round ends."""
    far = np.abs(points.xyz).max(axis=1, keepdims=True)
    ahead = points.xyz + np.maximum(_DOT_M, far * _DOT_PART) * _DOT_ALONG
    ends = np.stack((points.xyz, ahead), axis=1).astype(np.float32)
    colors = np.repeat(points.colors[:, None], 2, axis=1)
    return scene.add_line_segments(
        path, ends, _LINEAR[colors], thickness=points.size_px, thickness_units="screen"
    )


def _points(scene: viser.SceneApi, path: str, points: Points, size_cm: float) -> Any:
    if points.size_px:
        return _dots(scene, path, points)
    return scene.add_point_cloud(
        path,
        points.xyz,
        points.colors,
        point_size=points.size_m or size_cm / 100.0,
        point_shape="circle",
        precision="float32",
    )


def _lines(scene: viser.SceneApi, path: str, lines: Lines, size_cm: float) -> Any:
    thick: dict[str, Any] = {"thickness": lines.width_m}
    if not lines.width_m:
        thick = {"thickness": 2.5, "thickness_units": "screen"}
    return scene.add_line_segments(path, lines.ends, _LINEAR[lines.colors], **thick)


def _bodies(scene: viser.SceneApi, path: str, bodies: Bodies, size_cm: float) -> Any:
    vertices, faces = unit_mesh(bodies.kind)
    return scene.add_batched_meshes_simple(
        path,
        vertices,
        faces,
        bodies.quat_wxyz,
        bodies.xyz,
        batched_scales=bodies.scales,
        batched_colors=bodies.colors,
        lod="off",
        opacity=None if bodies.opacity >= 1.0 else bodies.opacity,
        cast_shadow=False,
        receive_shadow=False,
    )


def _is_alike(bodies: Bodies, before: Shape | None) -> bool:
    if not isinstance(before, Bodies):
        return False
    return (bodies.kind, bodies.opacity) == (before.kind, before.opacity)


def _move(handle: Any, bodies: Bodies) -> None:
    """Change bodies that are there: browsers take long to make others of their kind."""
    handle.batched_positions = bodies.xyz
    handle.batched_wxyzs = bodies.quat_wxyz
    handle.batched_scales = bodies.scales
    handle.batched_colors = bodies.colors


def _triangles(scene: viser.SceneApi, path: str, triangles: Triangles, size_cm: float) -> Any:
    faces = np.arange(len(triangles.corners)).reshape(-1, 3)
    both = np.concatenate((faces, faces[:, ::-1]))
    mesh = trimesh.Trimesh(
        triangles.corners, both, vertex_colors=triangles.rgba, process=False, validate=False
    )
    return scene.add_mesh_trimesh(path, mesh, cast_shadow=False, receive_shadow=False)


def _mesh(scene: viser.SceneApi, path: str, shape: MeshFromFile, mesh: ReadMesh) -> Any:
    node = scene.add_frame(path, show_axes=False)
    for number, part in enumerate(mesh.parts):
        if part.textured and shape.rgb is None:
            scene.add_glb(f"{path}/{number}", part.textured, scale=shape.scale)
            continue
        opacity = part.opacity if shape.rgb is None else shape.opacity
        scene.add_mesh_simple(
            f"{path}/{number}",
            part.vertices,
            part.faces,
            color=shape.rgb or part.color or (180, 182, 186),
            opacity=None if opacity >= 1.0 else opacity,
            scale=shape.scale,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
        )
    return node


# viser's images have y down.
_UPRIGHT = Transform.from_rpy(np.pi, 0.0, 0.0)


def _texture(scene: viser.SceneApi, path: str, texture: Texture, size_cm: float) -> Any:
    middle = Transform((texture.width_m / 2.0, texture.height_m / 2.0, 0.0)) @ _UPRIGHT
    return scene.add_image(
        path,
        np.ascontiguousarray(texture.rgba[::-1]),
        render_width=texture.width_m,
        render_height=texture.height_m,
        format="png",
        cast_shadow=False,
        receive_shadow=False,
        **place_of(middle),
    )


def _frustum(scene: viser.SceneApi, path: str, frustum: Frustum, size_cm: float) -> Any:
    aspect = frustum.picture.shape[1] / frustum.picture.shape[0]
    return scene.add_camera_frustum(
        path,
        fov=frustum.fov_y_rad,
        aspect=aspect,
        scale=frustum.depth_m * scale_of_depth(frustum.fov_y_rad, aspect),
        image=frustum.picture,
        format="jpeg",
        jpeg_quality=frustum.quality,
        thickness=0.01,
        cast_shadow=False,
        receive_shadow=False,
    )


_MAKERS: Mapping[type, Callable[[viser.SceneApi, str, Any, float], Any]] = {
    Points: _points,
    Lines: _lines,
    Bodies: _bodies,
    Triangles: _triangles,
    Texture: _texture,
    Frustum: _frustum,
}
