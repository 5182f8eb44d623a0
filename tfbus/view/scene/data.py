"""Messages in three dimensions: the shapes of topics that browsers look at, drawn by a thread of
their own, so that frames do not wait for clouds and images.
"""

import logging
import math
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import count, islice
from typing import Any

import numpy as np
import trimesh
import viser

from tfbus import messages
from tfbus.buffer.buffer import Buffer
from tfbus.discover.graph import TopicInfo
from tfbus.geometry.transform import Transform
from tfbus.runtime import scheduler
from tfbus.runtime.log import LogOnce
from tfbus.view.data.layer import PlacedItem, TopicLayer
from tfbus.view.data.shapes import (
    Bodies,
    Frustum,
    Lines,
    MeshFromFile,
    Points,
    Shape,
    Text,
    Texture,
    Triangles,
)
from tfbus.view.data.topics import MOST_TOPICS, DataSource, Waiting, camera_topic, drawn_type
from tfbus.view.frames import Floats, Frames
from tfbus.view.meshes.loader import ReadMesh
from tfbus.view.scene.camera import Ray
from tfbus.view.scene.drawn import FIXED_NODE, place_of, scale_of_depth, unit_mesh
from tfbus.view.settings import TopicSettings, ViewSettings
from tfbus.wording import counted, did_you_mean, listed, printable

_PERIOD_S = 1.0 / 30.0
# The pause after a drawing is so many times as long: data take two fifths of a core at most.
_RESTS_PER_DRAWING = 1.5
_END_S = 5.0
# Nodes that begin with the view have said what they publish by then.
_ABSENT_AFTER_S = 5.0


@dataclass(frozen=True)
class _Sight:
    """The buffer, the fixed frame and the settings to draw by; while `is_held` nothing changes."""

    buffer: Buffer
    fixed_frame: str
    settings: ViewSettings
    is_held: bool


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


class _NotDrawnError(ValueError):
    """A message asks for something that is not drawn; it says what."""


class DataScenes:
    """Draws the topics of a bus that have their box ticked, while a browser is there.

    `topics` are those that can be drawn, `layers` what is drawn of those that are wanted;
    `ever_drawn` are those that had something in the scene. Pictures
    of the panel are set by this thread too: `show_picture[topic](picture)`. `mesh_named(name)` is
    the mesh of a file of a robot, why there is none, or None while it is loaded.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        source: DataSource,
        log: logging.Logger,
        mesh_named: Callable[[str], ReadMesh | str | None] = lambda name: "there is no robot",
    ) -> None:
        self._server = server
        self._mesh_named = mesh_named
        self._source = source
        self._log = log
        self._log_once = LogOnce(log)
        self.topics: dict[str, TopicInfo] = {}
        self.layers: dict[str, TopicLayer] = {}
        self.ever_drawn: set[str] = set()
        self.show_picture: dict[str, Callable[[Any], object]] = {}
        self._all: Mapping[str, TopicInfo] = {}
        self._camera_of: dict[str, str] = {}
        self._cameras: dict[str, messages.CameraInfo] = {}
        self._shown_pictures: dict[str, int] = {}
        self._drawn: dict[tuple[str, object], _DrawnItem] = {}
        self._numbers = count(1)
        self._sight: _Sight | None = None
        self._is_held = False
        self._since_s = scheduler.monotonic()
        self._has_warned = False
        self._warned: set[str] = set()
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None

    # On the page's thread

    def see(
        self,
        buffer: Buffer,
        fixed_frame: str,
        settings: ViewSettings,
        *,
        is_held: bool,
        is_watched: bool,
    ) -> None:
        """Draw by these settings; ask for topics, and subscribe, only while somebody looks. Of
        those to draw from the start, it is said once which are not there.
        """
        shown = [each.topic for each in settings.topics if each.shown]
        if is_watched or (shown and not self._has_warned):
            self._all = self._source.topics()
            drawn = {name: info for name, info in self._all.items() if drawn_type(info)}
            self.topics = dict(sorted(drawn.items())[:MOST_TOPICS])
        if not self._has_warned and scheduler.monotonic() - self._since_s >= _ABSENT_AFTER_S:
            self._has_warned = True
            self.warn_of([topic for topic in shown if topic not in self.topics])
        shown = shown if is_watched else []
        wanted = {name: self.topics[name] for name in shown if name in self.topics}
        cameras = {
            name: camera_topic(name, self._all)
            for name, info in wanted.items()
            if drawn_type(info) in (messages.Image, messages.CompressedImage)
        }
        self._camera_of = {name: beside for name, beside in cameras.items() if beside}
        beside = {name: self._all[name] for name in self._camera_of.values()}
        self._source.want(wanted | beside)
        self._sight = _Sight(buffer, fixed_frame, settings, is_held)
        if wanted and self._thread is None:
            self._thread = threading.Thread(target=self._run, name="tfbus view data", daemon=True)
            self._thread.start()

    def points(self, most: int | None = None) -> Floats:
        """Some of the points of all that is drawn (N, 3), in the fixed frame; of at most so many
        items of a topic.
        """
        found = [
            placed.pose.apply(_some_points(shape))
            for layer in self.layers.copy().values()
            for placed in islice(layer.placed.copy().values(), most)
            for shape in placed.item.shapes
        ]
        return np.concatenate(found) if found else np.zeros((0, 3))

    def texts(self) -> dict[object, tuple[Text, Transform]]:
        """The texts that are shown, each at its pose in the fixed frame."""
        settings = self._sight.settings if self._sight else ViewSettings()
        return {
            (topic, key, at): (shape, placed.pose)
            for topic, layer in self.layers.copy().items()
            for key, placed in layer.placed.copy().items()
            for at, shape in enumerate(placed.item.shapes)
            if isinstance(shape, Text) and _is_shown(key, settings.of_topic(topic))
        }

    def met_by(self, ray: Ray) -> float:
        """The way in m along a ray of the fixed frame to what is drawn of messages; infinity for
        none.
        """
        ways = [
            _way(ray.seen_from(placed.pose), shape)
            for layer in self.layers.copy().values()
            for placed in layer.placed.copy().values()
            for shape in placed.item.shapes
        ]
        return min(ways, default=math.inf)

    def note(self, fixed_frame: str, frames: Frames) -> str:
        """The messages that wait for a transform to the fixed frame, and the frame to choose for
        them; "" if none does.
        """
        waits = [layer for layer in self.layers.copy().values() if layer.waits_in]
        if not waits:
            return ""
        count = counted(sum(max(layer.waiting_count, 1) for layer in waits), "message")
        lead = f"{count} wait for a transform to {printable(fixed_frame)}"
        own = frames[fixed_frame].root if fixed_frame in frames else ""
        names = {layer.waits_in for layer in waits}
        roots = sorted({frames[name].root for name in names if name in frames} - {own})
        if roots:
            return f"{lead}: choose as the fixed frame {listed([*map(printable, roots)], most=3)}"
        unknown = sorted(names - frames.by_name.keys())
        if unknown:
            return f"{lead}: there is no frame {listed([*map(printable, unknown)], most=3)}"
        return f"{lead}: see the tab Data"

    def subscribers(self, topic: str) -> int:
        """How many subscriptions a topic has on the bus, as it was known last."""
        info = self._all.get(topic)
        return len(info.subscribers or ()) if info else 0

    def close(self) -> None:
        """End the thread. Twice is fine."""
        self._ended.set()
        if self._thread is not None:
            self._thread.join(_END_S)
        self._source.close()

    def hold(self) -> None:
        """Leave everything as it is, for a picture."""
        self._is_held = True

    def warn_of(self, topics: Iterable[str]) -> None:
        """Log of each of these topics, once, why nothing of it is drawn, if nothing is."""
        for topic in topics:
            if topic not in self._warned and (why := self._why_not_drawn(topic)):
                self._warned.add(topic)
                self._log.warning("Topic %r is not drawn: %s", topic, why)

    def _why_not_drawn(self, topic: str) -> str:
        info = self._all.get(topic)
        if topic not in self.topics and info is not None and info.publishers:
            types = listed(sorted({printable(end.type) for end in info.publishers}), most=3)
            return f"it has {types}, which the view does not draw"
        if topic not in self.topics:
            near = did_you_mean(topic, self.topics, none="; there is none that can be")
            return f"there is no such topic of messages that are drawn{near}"
        layer = self.layers.get(topic)
        if layer is not None and (layer.placed or layer.picture is not None or layer.lines):
            return ""
        return (layer.trouble if layer is not None else "") or "no message has come"

    def rejected(self, topic: str) -> int:
        """How many messages of a topic could not be read."""
        return self._source.rejected(topic)

    # On its own thread

    def _run(self) -> None:
        rest_s = 0.0
        while not self._ended.wait(max(_PERIOD_S, rest_s)):
            begin_s = time.monotonic()
            try:
                self.step(begin_s)
            except Exception as error:
                if self._ended.is_set():
                    return
                self._log_once.exception((type(error), str(error)), "Could not draw messages")
            rest_s = _RESTS_PER_DRAWING * (time.monotonic() - begin_s)

    def step(self, now_s: float) -> None:
        """Take the messages that came, and draw them."""
        sight = self._sight
        if sight is None or self._is_held:
            return
        pace_s, now_s = now_s, self._source.catch_up(now_s)
        chosen = {each.topic: each for each in sight.settings.topics if each.shown}
        layers: dict[str, TopicLayer] = {}
        for topic in chosen:
            waiting = self._source.waiting(topic)
            if waiting is not None and topic in self.topics:
                layer = self.layers.get(topic)
                if (
                    layer is None
                    or layer.waiting is not waiting
                    or (
                        self._source.is_recorded
                        and not layer.is_by(sight.fixed_frame, chosen[topic])
                    )
                ):
                    layer = self._begun(topic, waiting, sight.fixed_frame, chosen[topic])
                layers[topic] = layer
        # A browser that comes back finds what it left.
        kept = {name: each for name, each in self.layers.items() if name in chosen}
        self.layers = kept | layers
        for topic, layer in layers.items():
            if sight.is_held:
                break
            camera = self._camera(topic)
            try:
                layer.step(
                    *(sight.buffer, sight.fixed_frame, now_s, chosen[topic], camera), pace_s=pace_s
                )
            except Exception as error:  # the other topics are drawn all the same
                layer.fail(error)
                self._log_once.exception((topic, type(error)), "Could not draw topic %r", topic)
        self.ever_drawn |= {topic for topic, layer in layers.items() if layer.placed}
        with self._server.atomic():
            self._draw(chosen)
        for topic, layer in layers.items():
            self._show_picture(topic, layer)
        self._server.flush()
        now_ns = self._source.now_ns()
        for layer in layers.values():
            layer.was_sent(now_ns)

    def _begun(
        self, topic: str, waiting: Waiting, fixed_frame: str, settings: TopicSettings
    ) -> TopicLayer:
        """A layer with what came before."""
        layer = TopicLayer(waiting)
        try:
            past = self._source.past(topic, settings)
            layer.recall(past, fixed_frame, settings, self._camera(topic))
        except Exception as error:  # the other topics are drawn all the same
            layer.fail(error)
            self._log_once.exception((topic, type(error)), "Could not draw topic %r", topic)
        return layer

    def _camera(self, topic: str) -> messages.CameraInfo | None:
        beside = self._camera_of.get(topic, "")
        waiting = self._source.waiting(beside) if beside else None
        if waiting is not None and (taken := waiting.take()):
            self._cameras[topic] = taken[-1]
        return self._cameras.get(topic) if beside else None

    def _show_picture(self, topic: str, layer: TopicLayer) -> None:
        show = self.show_picture.get(topic)
        if show is None or layer.picture is None:
            return
        if self._shown_pictures.get(topic) != id(layer.picture):
            self._shown_pictures[topic] = id(layer.picture)
            show(layer.picture)

    def _draw(self, chosen: Mapping[str, TopicSettings]) -> None:
        items = {
            (topic, key): placed
            for topic, layer in self.layers.items()
            for key, placed in layer.placed.items()
        }
        for gone in self._drawn.keys() - items.keys():
            self._remove(gone)
        for at, placed in items.items():
            topic, key = at
            try:
                settings = chosen[topic]
                drawn = self._draw_item(at, placed, settings.size)
                is_shown = _is_shown(key, settings)
                if drawn.node.visible != is_shown:
                    drawn.node.visible = is_shown
            except _NotDrawnError as error:
                self._remove(at)
                self.layers[topic].fail(error, key)
            except Exception as error:  # the others are drawn all the same
                self._remove(at)
                self.layers[topic].fail(error, key)
                self._log_once.exception((topic, type(error)), "Could not draw topic %r", topic)

    def _draw_item(self, at: tuple[str, object], placed: PlacedItem, size: float) -> _DrawnItem:
        drawn = self._drawn.get(at)
        if drawn is None:
            node = self._scene.add_frame(
                f"{FIXED_NODE}/data/{next(self._numbers)}", show_axes=False, **place_of(placed.pose)
            )
            drawn = self._drawn[at] = _DrawnItem(placed, size, node, [])
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
        drawn.placed = placed
        return drawn

    def _remove(self, at: tuple[str, object]) -> None:
        if (ended := self._drawn.pop(at, None)) is not None:
            for handle in (*ended.handles, ended.node):
                handle.remove()

    def _made(
        self,
        placed: PlacedItem,
        path: str,
        size: float,
        former: PlacedItem | None = None,
        handles: list[Any] | None = None,
    ) -> list[Any]:
        """Add the shapes, in the place of those of the `former` item, which have these handles."""
        there = [shape for shape in former.item.shapes if not _is_empty(shape)] if former else []
        made: list[Any] = []
        for shape in placed.item.shapes:
            if _is_empty(shape):
                continue
            at = len(made)
            before = there[at] if at < len(there) else None
            if isinstance(shape, MeshFromFile):
                mesh = self._mesh_named(shape.name)
                if isinstance(mesh, str):
                    raise _NotDrawnError(f"mesh {printable(shape.name)}: {mesh}")
                made += [] if mesh is None else [_mesh(self._scene, f"{path}/{at}", shape, mesh)]
            elif handles and isinstance(shape, Bodies) and _is_alike(shape, before):
                _move(handles[at], shape)
                made.append(handles[at])
            else:
                make = _MAKERS[type(shape)]
                made.append(make(self._scene, f"{path}/{at}", shape, size))
        return made

    @property
    def _scene(self) -> viser.SceneApi:
        return self._server.scene


def _is_shown(key: object, settings: TopicSettings) -> bool:
    """Whether the item of this key is not of a hidden namespace."""
    return not (isinstance(key, tuple) and key[0] in settings.hidden)


_MOST_POINTS = 200


# A letter is about so wide, in parts of the height of a capital one.
_LETTER = 0.8


def _some_points(shape: Shape) -> Floats:
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


def _way(ray: Ray, shape: Shape) -> float:
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
