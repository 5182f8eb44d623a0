"""A browser's camera: which part of the scene it sees, and where it starts."""

import math
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

from tfbus.geometry.transform import Transform
from tfbus.view.model.placement import Floats

# The first look is from behind, a little from the side, and from above: a unit vector.
_FROM = np.array((-0.26, -0.71, 0.65)) / math.sqrt(0.26**2 + 0.71**2 + 0.65**2)

# A window that is narrower than this, width by height, is a telephone's.
_NARROW = 0.75

# Frames that come later than this do not move the camera.
_SETTLE_S = 3.0

# viser's default, from top to bottom.
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
        """The window of a client of viser."""
        w, x, y, z = camera.wxyz
        rotation = Transform((0.0, 0.0, 0.0), (x, y, z, w)).as_matrix()[:3, :3]
        size_px = (camera.image_width, camera.image_height)
        return Window(camera.position, rotation, camera.fov, size_px)

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


def overview(middle: Floats, radius_m: float, aspect: float = 1.0) -> tuple[Floats, Floats]:
    """Where to look from, and at which point, to see a ball whole.

    In a window much higher than wide the ball is in the upper half, above the panel.
    """
    distance_m = radius_m / math.sin(_FOV_RAD / 2.0) / min(1.0, aspect)
    up = np.array((0.0, 0.0, 1.0)) - _FROM[2] * _FROM
    below_m = 0.5 * distance_m * math.tan(_FOV_RAD / 2.0) if aspect < _NARROW else 0.0
    look_at = middle - up / np.linalg.norm(up) * below_m
    return look_at + distance_m * _FROM, look_at


class FirstLook:
    """Starts browsers where they see everything; later leaves their cameras alone."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self._seen = (False, 0)
        self._settled_at_s = 0.0
        self._placed: set[int] = set()

    def aim(self, middle: Floats, radius_m: float, has_guest: bool, frames: int) -> None:
        """Take the ball around all that is shown now.

        Open browsers follow it for 3 s after the first frame, or after a guest, has appeared.
        """
        now_s = time.monotonic()
        clients = self._server.get_clients()
        what, before = (has_guest, frames), self._seen
        if not before[1] or has_guest > before[0]:
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
