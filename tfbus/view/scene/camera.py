"""Where a browser looks from: what of the scene it sees, and where it begins."""

import math
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

from tfbus import Transform
from tfbus.view.model.placement import Floats

# At first one looks from behind, from the side a little, and from above: a unit vector.
_FROM = np.array((-0.26, -0.71, 0.65)) / math.sqrt(0.26**2 + 0.71**2 + 0.65**2)

# What is narrower than this is the window of a telephone.
_NARROW = 0.75

# The first frames come within this time, or are late.
_SETTLE_S = 3.0

# viser's own, from top to bottom.
_FOV_RAD = math.radians(75.0)


@dataclass(frozen=True, eq=False)
class Window:
    """A browser's canvas, `size_px` wide and high, and the camera that draws it.

    The camera looks along its z; its y is down. `fov_rad` is from top to bottom.
    """

    position: Floats
    rotation: Floats
    fov_rad: float
    size_px: tuple[int, int]

    @staticmethod
    def of(camera: Any) -> "Window":
        """That of a client of viser."""
        w, x, y, z = camera.wxyz
        rotation = Transform((0.0, 0.0, 0.0), (x, y, z, w)).as_matrix()[:3, :3]
        size_px = (camera.image_width, camera.image_height)
        return Window(camera.position, rotation, camera.fov, size_px)

    def project(self, xyz: Floats) -> tuple[Floats, Floats]:
        """Pixels (N, 2) from the upper left corner, and how far ahead of the camera, in metres."""
        seen = (xyz - self.position) @ self.rotation
        depth_m = seen[:, 2]
        focal_px = self.size_px[1] / 2.0 / math.tan(self.fov_rad / 2.0)
        ahead = np.where(depth_m > 0.0, depth_m, np.nan)
        pixels: Floats = seen[:, :2] / ahead[:, None] * focal_px + np.array(self.size_px) / 2.0
        return pixels, depth_m

    def sees(self, pixels: Floats, depth_m: Floats) -> NDArray[np.bool_]:
        """Which of these points are in the picture."""
        with np.errstate(invalid="ignore"):
            inside = np.all((pixels >= 0.0) & (pixels <= np.array(self.size_px)), axis=1)
        seen: NDArray[np.bool_] = inside & (depth_m > 0.0)
        return seen


def overview(middle: Floats, radius_m: float, aspect: float = 1.0) -> tuple[Floats, Floats]:
    """Where to look from, and at what, to see a ball whole: of a window that is much higher than
    wide, in the upper half, since it has the panel below.
    """
    distance_m = radius_m / math.sin(_FOV_RAD / 2.0) / min(1.0, aspect)
    up = np.array((0.0, 0.0, 1.0)) - _FROM[2] * _FROM
    below_m = 0.5 * distance_m * math.tan(_FOV_RAD / 2.0) if aspect < _NARROW else 0.0
    look_at = middle - up / np.linalg.norm(up) * below_m
    return look_at + distance_m * _FROM, look_at


class FirstLook:
    """Lets browsers begin where all of it can be seen; then cameras are left alone."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self._seen = (False, 0)
        self._settled_at_s = 0.0
        self._placed: set[int] = set()

    def aim(self, middle: Floats, radius_m: float, has_field: bool, frames: int) -> None:
        """This is where things are now.

        Who is there already is moved along while the first frames come, and where a field does.
        """
        now_s = time.monotonic()
        clients = self._server.get_clients()
        what, before = (has_field, frames), self._seen
        if not before[1] or has_field > before[0]:
            self._settled_at_s = now_s + _SETTLE_S
        is_new = what > before and now_s < self._settled_at_s
        self._seen = max(what, before)
        if is_new or not clients:
            camera: Any = self._server.initial_camera
            camera.position, camera.look_at = overview(middle, radius_m)
        for number, client in clients.items():
            camera = client.camera
            if is_new or (number not in self._placed and camera.aspect < _NARROW):
                camera.position, camera.look_at = overview(middle, radius_m, camera.aspect)
        self._placed = set(clients)
