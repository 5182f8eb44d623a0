"""A browser's camera: the part of the scene it sees, its start, and the first hits of its rays."""

import math
import time
from collections import defaultdict, deque
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

from tfbus.geometry.transform import Transform
from tfbus.view.frames import Floats, Placed
from tfbus.view.scene.drawn import Region

# A point is met by a ray that passes it within so many pixels; of points that are nearly as near as
# the first, by this factor, it meets the one that it passes closest.
_NEAR_PX = 6.0
_AS_NEAR = 1.02
# A ray meets the ground no farther away than this many times the height of the camera.
_FARTHEST = 1e3


@dataclass(frozen=True, eq=False)
class Ray:
    """A ray from `origin` (3,) along the unit vector `direction` (3,); a pixel of its picture is
    `pixel_rad` wide.
    """

    origin: Floats
    direction: Floats
    pixel_rad: float = 1e-3

    def at(self, depth_m: float) -> Floats:
        """The point (3,) that is so far along the ray."""
        return self.origin + depth_m * self.direction

    def apart_px(self, other: "Ray") -> float:
        """How far apart two rays of one picture are in it."""
        return float(np.linalg.norm(self.direction - other.direction)) / self.pixel_rad

    def seen_from(self, pose: Transform) -> "Ray":
        """The ray in the coordinates of a pose; the pose is in the ray's former ones."""
        back = pose.inverse()
        return Ray(back.apply(self.origin), back.rotate(self.direction), self.pixel_rad)

    def to_ground(self) -> float:
        """The way in m to the plane z = 0; infinity for a ray beside it, or nearly so."""
        down = -self.direction[2] * math.copysign(1.0, self.origin[2])
        if down * _FARTHEST <= 1.0:
            return math.inf
        return float(abs(self.origin[2]) / down)

    def first_of(self, xyz: NDArray[np.floating]) -> tuple[int, float] | None:
        """The row of the first of points (N, 3) and the way to it in m; None if none is met."""
        seen = xyz - self.origin
        depths = seen @ self.direction
        aside = np.linalg.norm(seen - depths[:, None] * self.direction, axis=1)
        met = np.flatnonzero((depths > 0.0) & (aside <= depths * (_NEAR_PX * self.pixel_rad)))
        if not len(met):
            return None
        first = met[depths[met] <= _AS_NEAR * depths[met].min()]
        row = first[np.argmin(aside[first] / depths[first])]
        return int(row), float(depths[row])

    def to_points(self, xyz: NDArray[np.floating]) -> float:
        """The way in m to the first of points (N, 3); infinity if none is met."""
        found = self.first_of(xyz)
        return found[1] if found else math.inf

    def to_triangles(self, vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> float:
        """The way in m to the nearest of triangles, faces (F, 3) of vertices (V, 3), seen from
        either side; infinity if none is met.
        """
        first, second, third = vertices[faces].astype(np.float64).transpose(1, 0, 2)
        one, other = second - first, third - first
        across = np.cross(self.direction, other)
        turned = np.einsum("ij,ij->i", one, across)
        with np.errstate(divide="ignore", invalid="ignore"):
            from_first = self.origin - first
            u = np.einsum("ij,ij->i", from_first, across) / turned
            upward = np.cross(from_first, one)
            v = upward @ self.direction / turned
            depths = np.einsum("ij,ij->i", other, upward) / turned
            met = depths[(u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (depths > 0.0)]
        return float(met.min()) if len(met) else math.inf


# The first look is from behind, a little from the side, and from above: a unit vector.
_FROM = np.array((-0.26, -0.71, 0.65)) / math.sqrt(0.26**2 + 0.71**2 + 0.65**2)

# Robots look along x: they are seen from the front, as in RViz.
FRONT = np.array((0.74, 0.52, 0.43)) / math.sqrt(0.74**2 + 0.52**2 + 0.43**2)

# A window that is narrower than this, width by height, is a telephone's.
_NARROW = 0.75

# Frames that come later than this do not move the camera. Robots do, whenever more of them is
# there: cameras that were not moved by hand.
_SETTLE_S = 3.0

# A browser may be behind by this many moves of its camera.
_MOST_BEHIND = 32

# Of a frame whose x axis, of length 1, is nearer to the vertical the heading is not known.
_LEAST_HEADING = 0.05

# viser's default, from top to bottom.
_FOV_RAD = math.radians(75.0)

# A view from above is from so far away that heights hardly lean outwards; y is up in the picture.
_FOV_FROM_ABOVE_RAD = math.radians(20.0)
_FROM_ABOVE = np.array((0.0, -1e-4, 1.0))


_NO_MOTION = Transform((0.0, 0.0, 0.0))


@dataclass(frozen=True, eq=False)
class Viewport:
    """A browser's canvas, `size_px` wide and high, and the camera that draws it.

    The camera looks along its z; its y is down. `fov_rad` is from top to bottom.
    """

    position: Floats
    rotation: Floats
    fov_rad: float
    size_px: tuple[int, int]

    @staticmethod
    def of(camera: Any, fixed: Transform = _NO_MOTION) -> "Viewport":
        """The window of a client of viser, seen from the fixed frame, which is there in the scene
        of viser.
        """
        w, x, y, z = camera.wxyz
        back = fixed.inverse()
        turn = back @ Transform((0.0, 0.0, 0.0), (x, y, z, w))
        size_px = (camera.image_width, camera.image_height)
        return Viewport(back.apply(camera.position), turn.as_matrix()[:3, :3], camera.fov, size_px)

    def ray(self, part: tuple[float, float]) -> Ray:
        """The ray through a place of the picture: parts of its width and height from the upper left
        corner, 0 to 1.
        """
        width, height = self.size_px
        pixel = 2.0 * math.tan(self.fov_rad / 2.0) / height
        x, y = (part[0] - 0.5) * width * pixel, (part[1] - 0.5) * height * pixel
        direction = self.rotation @ np.array((x, y, 1.0))
        return Ray(self.position, direction / np.linalg.norm(direction), pixel)

    def project(self, xyz: Floats) -> tuple[Floats, Floats]:
        """Pixels (N, 2) from the upper left corner, and distances (N,) ahead of the camera in m."""
        seen = (xyz - self.position) @ self.rotation
        depth_m = seen[:, 2]
        focal_px = self.size_px[1] / 2.0 / math.tan(self.fov_rad / 2.0)
        ahead = np.where(depth_m > 0.0, depth_m, np.nan)
        pixels: Floats = seen[:, :2] / ahead[:, None] * focal_px + np.array(self.size_px) / 2.0
        return pixels, depth_m

    def sees(self, pixels: Floats, depth_m: Floats) -> NDArray[np.bool_]:
        """Which of these points (N,) are in the picture."""
        with np.errstate(invalid="ignore"):
            inside = np.all((pixels >= 0.0) & (pixels <= np.array(self.size_px)), axis=1)
        seen: NDArray[np.bool_] = inside & (depth_m > 0.0)
        return seen


def overview(
    middle: Floats,
    radius_m: float,
    aspect: float = 1.0,
    toward: Floats | None = None,
    fov_rad: float = _FOV_RAD,
) -> tuple[Floats, Floats]:
    """The place to look from, and the point to look at, to see a ball whole; `toward` points to the
    camera, whose picture is `fov_rad` high.

    In a window much higher than wide the ball is in the upper half, above the panel.
    """
    toward = _FROM if toward is None else toward
    distance_m = radius_m / math.sin(fov_rad / 2.0) / min(1.0, aspect)
    if aspect >= _NARROW:
        return middle + distance_m * toward, middle
    # Upwards in the picture; from straight above, along y.
    up = np.array((0.0, 0.0, 1.0)) - toward[2] * toward
    size = float(np.linalg.norm(up))
    up = up / size if size > 1e-6 else np.array((0.0, 1.0, 0.0))
    look_at = middle - up * (0.5 * distance_m * math.tan(fov_rad / 2.0))
    return look_at + distance_m * toward, look_at


def region_of(placed: Placed) -> Region:
    """The ball around frames, at least 0.85 m large; that around the origin without any."""
    if not len(placed.names):
        return Region(np.zeros(3), 0.85)
    middle = (placed.xyz.min(axis=0) + placed.xyz.max(axis=0)) / 2.0
    return Region(middle, 0.85 * max(placed.extent_m(), 1.0))


def region_of_points(xyz: Floats) -> Region:
    """The ball in which points (N, 3) lie, by the box around them; at least 0.05 m large."""
    low, high = xyz.min(axis=0), xyz.max(axis=0)
    radius_m = 0.5 * float(np.linalg.norm(high - low))
    return Region((low + high) / 2.0, max(radius_m, 0.05), FRONT)


def around(one: Region, other: Region) -> Region:
    """The smallest ball around two; it is first seen from where the first one is."""
    apart_m = float(np.linalg.norm(other.middle - one.middle))
    if apart_m + other.radius_m <= one.radius_m:
        return one
    if apart_m + one.radius_m <= other.radius_m:
        return replace(other, toward=one.toward)
    radius_m = (apart_m + one.radius_m + other.radius_m) / 2.0
    part = (radius_m - one.radius_m) / apart_m
    return Region(one.middle + part * (other.middle - one.middle), radius_m, one.toward)


# Farther from the middle of frames than so many radii they would be lost in the view.
_LOST = 8.0


def with_points(frames: Region, xyz: Floats) -> Region:
    """The ball around frames and the points (N, 3) of messages; points very far away from the
    frames, as a single wrong one may be, are left out.
    """
    apart_m = np.linalg.norm(xyz - frames.middle, axis=1)
    near = xyz[apart_m <= _LOST * frames.radius_m]
    if not len(near):
        return frames
    return around(frames, region_of_points(near))


class Cameras:
    """The cameras of all browsers.

    They start where they see everything, and later move only on request or with the fixed frame.
    To follow a frame they stay where they are, and everything else moves: `fixed` is the pose of
    the fixed frame in the scene of viser, so that browsers turn their cameras undisturbed.
    """

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self.fixed = _NO_MOTION
        self._followed: tuple[str, bool | None] = ("", None)
        self._held = _NO_MOTION
        self._heading_rad = 0.0
        self._seen = (False, 0)
        self._built: tuple[int, ...] = (0, 0, 0)
        self._settled_at_s = 0.0
        self._placed: set[int] = set()
        self._put_at: defaultdict[int, deque[Floats]] = defaultdict(_last_positions)
        self._starts = _last_positions()
        # Before any browser is there: one that is open takes the first start that it learns of,
        # whatever was done with its camera.
        self._start_at(Region(np.zeros(3), 1.0))

    def aim(
        self, region: Region, has_guest: bool, frames: int, built: tuple[int, ...] = (0, 0, 0)
    ) -> None:
        """Take the ball around all that is shown now.

        Open browsers follow it for 3 s after the first frame, or after a guest, has appeared.
        Browsers whose camera is where it was left also follow it later, each time that `built` has
        grown: of how many topics messages are drawn, how many robots have frames, and how many of
        their parts are there. Cameras that follow a frame stay.
        """
        now_s = time.monotonic()
        clients = self._server.get_clients()
        for gone in self._put_at.keys() - clients.keys():
            del self._put_at[gone]
        what, before = (has_guest, frames), self._seen
        if not before[1] or has_guest > before[0]:
            self._settled_at_s = now_s + _SETTLE_S
        is_settling = what > before and now_s < self._settled_at_s
        is_growing = built > self._built
        self._seen, self._built = max(what, before), built
        if self._followed[0]:
            self._placed = set(clients)
            return
        if is_settling or is_growing or not clients:
            self._start_at(region)
        for number, client in clients.items():
            camera = client.camera
            is_first = number not in self._placed and _aspect(camera) < _NARROW
            follows = is_settling or (is_growing and self._is_left(number, camera))
            if is_first or follows:
                self._show(number, camera, region)
            elif number not in self._placed:
                self._put_at[number].append(np.array(camera.position))
        self._placed = set(clients)

    def _is_left(self, number: int, camera: Any) -> bool:
        """Whether a camera is where it was put: it was not moved by hand."""
        # A browser that is behind still tells one of the positions before.
        put_at = (*self._put_at[number], *self._starts)
        return any(np.allclose(camera.position, at, atol=1e-3) for at in put_at)

    def window(self, client: int) -> Viewport | None:
        """The window of one browser, in the fixed frame; None if it has left."""
        handle = self._server.get_clients().get(client)
        return None if handle is None else Viewport.of(handle.camera, self.fixed)

    def show(self, client: int, region: Region) -> None:
        """Let one browser see this ball whole, from where cameras start."""
        if handle := self._server.get_clients().get(client):
            self._show(client, handle.camera, region)

    def show_from_above(self, client: int, region: Region) -> None:
        """Let one browser see this ball whole from straight above, nearly without perspective."""
        if handle := self._server.get_clients().get(client):
            seen, camera = self._in_scene(region), handle.camera
            camera.fov = _FOV_FROM_ABOVE_RAD
            above = self.fixed.rotate(_FROM_ABOVE)
            _move(camera, *overview(seen.middle, seen.radius_m, _aspect(camera), above, camera.fov))

    def _show(self, number: int, camera: Any, region: Region) -> None:
        camera.fov = _FOV_RAD
        _move(camera, *_overview(self._in_scene(region), _aspect(camera)))
        self._put_at[number].append(np.array(camera.position))

    def focus(self, client: int, region: Region) -> None:
        """Let one browser look at the middle of this ball, from the side where its camera is.

        The camera comes near enough for the ball to fill the picture; a nearer one stays so.
        """
        handle = self._server.get_clients().get(client)
        if handle is None:
            return
        camera = handle.camera
        away = self.fixed.inverse().rotate(camera.position - camera.look_at)
        distance_m = float(np.linalg.norm(away))
        near_m = distance_m * math.sin(camera.fov / 2.0) * min(1.0, _aspect(camera))
        radius_m = min(region.radius_m, near_m)
        position, look_at = overview(
            region.middle, radius_m, _aspect(camera), away / distance_m, camera.fov
        )
        _move(camera, self.fixed.apply(position), self.fixed.apply(look_at))

    def carry(self, moved: Transform) -> None:
        """Keep the views of all browsers, when the fixed frame has another place in the scene.

        `moved` is the pose of the former fixed frame in the new one.
        """
        before, self.fixed = self.fixed, _NO_MOTION
        self._followed = (self._followed[0], None)
        moved = moved @ before.inverse()
        for number, client in self._server.get_clients().items():
            camera = client.camera
            is_left = self._is_left(number, camera)
            _move(camera, moved.apply(camera.position), moved.apply(camera.look_at))
            if is_left:
                self._put_at[number].append(np.array(camera.position))
        self._start_at(Region(moved.apply(self._start.middle), self._start.radius_m))

    def follow(self, name: str, pose: Transform | None, radius_m: float, *, turns: bool) -> None:
        """Keep a frame, whose pose in the fixed frame this is, where it is in all pictures; if it
        `turns`, its heading too. "" for no frame; one without a pose stays where it was.

        At first the cameras look at it, near enough for a ball of this radius to fill the picture.
        """
        if not name:
            self._followed = ("", None)
            return
        if pose is None:
            return
        heading_rad = 0.0
        if turns:
            ahead = pose.rotate((1.0, 0.0, 0.0))
            # Straight up or down it has no heading: the last one stays.
            if math.hypot(ahead[0], ahead[1]) > _LEAST_HEADING:
                self._heading_rad = math.atan2(ahead[1], ahead[0])
            heading_rad = self._heading_rad
        at = Transform.from_rpy(0.0, 0.0, heading_rad, tuple(pose.xyz))
        if self._followed != (name, turns):
            is_new = self._followed[0] != name
            self._followed = (name, turns)
            self._held = self.fixed @ at
            if is_new:
                region = Region(np.array(pose.xyz), radius_m)
                for number in self._server.get_clients():
                    self.focus(number, region)
                self._start_at(region)
        self.fixed = self._held @ at.inverse()

    def refit(self, region: Region) -> None:
        """Let all browsers see this ball whole: it has nothing to do with their former views."""
        for client in self._server.get_clients():
            self.show(client, region)
        self._start_at(region)

    def _in_scene(self, region: Region) -> Region:
        """A ball of the fixed frame in the scene of viser."""
        toward = None if region.toward is None else self.fixed.rotate(region.toward)
        return Region(self.fixed.apply(region.middle), region.radius_m, toward)

    def _start_at(self, region: Region) -> None:
        """The camera of browsers that are opened later, and of viser's Reset View."""
        self._start = self._in_scene(region)
        initial: Any = self._server.initial_camera
        initial.position, initial.look_at = _overview(self._start)
        self._starts.append(np.array(initial.position))


def _aspect(camera: Any) -> float:
    """Width by height of a canvas; 1 for one without a size, as in a frame that is hidden."""
    try:
        return float(camera.aspect) or 1.0
    except ZeroDivisionError:
        return 1.0


def _last_positions() -> deque[Floats]:
    return deque(maxlen=_MOST_BEHIND)


def _overview(region: Region, aspect: float = 1.0) -> tuple[Floats, Floats]:
    return overview(region.middle, region.radius_m, aspect, region.toward)


def _move(camera: Any, position: Floats, look_at: Floats) -> None:
    # In this order: viser moves the point that a camera looks at with its position.
    camera.position, camera.look_at = position, look_at
