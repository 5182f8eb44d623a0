"""Rays from a browser's camera into the scene, and what they meet first."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tfbus.geometry.transform import Transform
from tfbus.view.frames import Floats

# A point is met by a ray that passes it within so many pixels.
_NEAR_PX = 6.0
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
        """The ray in the coordinates of a pose, itself in those of the ray."""
        back = pose.inverse()
        return Ray(back.apply(self.origin), back.rotate(self.direction), self.pixel_rad)

    def to_ground(self) -> float:
        """The way in m to the plane z = 0; infinity for a ray beside it, or nearly so."""
        down = -self.direction[2] * math.copysign(1.0, self.origin[2])
        if down * _FARTHEST <= 1.0:
            return math.inf
        return float(abs(self.origin[2]) / down)

    def to_points(self, xyz: NDArray[np.floating], radius_m: float = 0.0) -> float:
        """The way in m to the nearest of points (N, 3) of this radius; infinity if none is met."""
        seen = xyz - self.origin
        depths = seen @ self.direction
        aside = np.linalg.norm(seen - depths[:, None] * self.direction, axis=1)
        wide = np.maximum(radius_m, depths * (_NEAR_PX * self.pixel_rad))
        met = depths[(depths > 0.0) & (aside <= wide)]
        return float(met.min()) if len(met) else math.inf

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
