"""Many transforms as arrays: the answer to a lookup of many stamps, and its arithmetic."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, NamedTuple

from tfbus.errors import InvalidArgumentException
from tfbus.geometry.rotations import (
    angles_of_rows,
    are_rotations,
    matrices_of,
    product,
    quaternions_of_angles,
    quaternions_of_matrices,
)
from tfbus.geometry.transform import LAST_ROW_WITHIN, Transform

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]
else:
    from tfbus.core import lazy_numpy as np


# Below this angle quotients of sines lose digits, and the first terms of their series do not.
_SMALL_ANGLE = 1e-3


class TransformArray(NamedTuple):
    """N transforms: `xyz` (N, 3) in metres, `quat_xyzw` (N, 4) unit quaternions x, y, z, w.

    It unpacks into the two arrays: `xyz, quat_xyzw = buffer.lookup_transforms(...)`. All methods
    work row by row; one of N = 1, or a single `Transform`, is combined with each row of another.
    The conventions are those of `Transform`.
    """

    xyz: Floats
    quat_xyzw: Floats

    # Making them

    @staticmethod
    def of(transforms: Iterable[Transform]) -> "TransformArray":
        """The transforms as the rows of arrays."""
        poses = np.array([transform.as_pose() for transform in transforms]).reshape(-1, 7)
        return TransformArray(poses[:, :3], poses[:, 3:])

    @staticmethod
    def from_matrix(matrices: ArrayLike) -> "TransformArray":
        """From homogeneous matrices (N, 4, 4). Raises as `Transform.from_matrix`."""
        rows = _rows(matrices, (4, 4), "matrices")
        rotations = rows[:, :3, :3]
        wrong = ~np.isfinite(rows).all(axis=(1, 2))
        wrong |= ~np.isclose(rows[:, 3], (0, 0, 0, 1), atol=LAST_ROW_WITHIN).all(axis=1)
        if not wrong.any():
            wrong = ~are_rotations(rotations)
        for row in rows[wrong]:
            Transform.from_matrix(row)  # raises, with the reason
        return TransformArray(rows[:, :3, 3].copy(), quaternions_of_matrices(rotations))

    @staticmethod
    def from_euler(
        axes: str, angles_rad: ArrayLike, xyz: ArrayLike = (0, 0, 0)
    ) -> "TransformArray":
        """From three angles a row (N, 3), as `Transform.from_euler`; `xyz` is (N, 3) or (3,)."""
        angles = _rows(angles_rad, (3,), "angles_rad")
        for row in angles[~np.isfinite(angles).all(axis=1)]:
            Transform.from_euler(axes, row)  # raises, with the reason
        return _moved(quaternions_of_angles(axes, angles), xyz)

    @staticmethod
    def from_rpy(rpy_rad: ArrayLike, xyz: ArrayLike = (0, 0, 0)) -> "TransformArray":
        """From roll, pitch and yaw (N, 3), as `Transform.from_rpy`; `xyz` is (N, 3) or (3,)."""
        return TransformArray.from_euler("xyz", rpy_rad, xyz)

    @staticmethod
    def from_rotvec(rotvecs: ArrayLike, xyz: ArrayLike = (0, 0, 0)) -> "TransformArray":
        """From rotation vectors (N, 3), each as long as its angle; `xyz` is (N, 3) or (3,)."""
        turns = _rows(rotvecs, (3,), "rotvecs")
        return _moved(TransformArray.exp(np.hstack((np.zeros_like(turns), turns))).quat_xyzw, xyz)

    @staticmethod
    def exp(twists: ArrayLike) -> "TransformArray":
        """The motions that constant twists (N, 6), linear then angular, make in unit time.

        Formulas: Barfoot, State Estimation for Robotics, 7.1.
        """
        rows = _rows(twists, (6,), "twists")
        linear, angular = rows[:, :3], rows[:, 3:]
        angle = np.linalg.norm(angular, axis=1, keepdims=True)
        square = angle * angle
        small = angle < _SMALL_ANGLE
        safe = np.where(small, 1.0, angle)
        half = np.where(small, 0.5 - square / 48.0, np.sin(0.5 * safe) / safe)
        first = np.where(small, 0.5 - square / 24.0, 2.0 * half * half)
        second = np.where(small, 1 / 6 - square / 120.0, (safe - np.sin(safe)) / safe**3)
        aside = np.cross(angular, linear)
        xyz = linear + first * aside + second * np.cross(angular, aside)
        return TransformArray(xyz, np.hstack((angular * half, np.cos(0.5 * angle))))

    @staticmethod
    def from_scipy(rotation: Any, xyz: ArrayLike = (0, 0, 0)) -> "TransformArray":
        """From scipy's Rotation of N with translations (N, 3) or (3,), or its RigidTransform."""
        if hasattr(rotation, "as_components"):
            xyz, rotation = rotation.as_components()
        return _moved(np.atleast_2d(rotation.as_quat()), xyz)

    # Reading them

    def row(self, i: int) -> Transform:
        """Transform i."""
        return Transform(self.xyz[i], self.quat_xyzw[i])

    def rows(self, chosen: NDArray[np.bool_] | NDArray[np.intp] | slice) -> "TransformArray":
        """Those of a mask (N,), of indices, or of a slice."""
        return TransformArray(self.xyz[chosen], self.quat_xyzw[chosen])

    def as_matrix(self) -> Floats:
        """The homogeneous matrices (N, 4, 4)."""
        matrices = np.zeros((len(self.xyz), 4, 4))
        matrices[:, :3, :3] = matrices_of(self.quat_xyzw)
        matrices[:, :3, 3] = self.xyz
        matrices[:, 3, 3] = 1.0
        return matrices

    def as_euler(self, axes: str) -> Floats:
        """Three angles in radians a row (N, 3), as `Transform.as_euler`."""
        return angles_of_rows(axes, self.quat_xyzw)

    def as_rpy(self) -> Floats:
        """Roll, pitch and yaw in radians (N, 3), as `Transform.as_rpy`."""
        return self.as_euler("xyz")

    def as_rotvec(self) -> Floats:
        """The rotation vectors (N, 3), each as long as its angle (0 to pi radians)."""
        return _rotvec(self.quat_xyzw)

    def log(self) -> Floats:
        """The constant twists (N, 6) that make these motions in unit time: linear, then angular.

        The inverse of `exp`; the angles are at most half a turn.
        """
        angular = self.as_rotvec()
        half = 0.5 * np.linalg.norm(angular, axis=1, keepdims=True)
        small = half < _SMALL_ANGLE
        safe = np.where(small, 1.0, half)
        series = 1 / 12 + half * half / 180.0
        weight = np.where(small, series, (1.0 - safe / np.tan(safe)) / (4.0 * safe * safe))
        aside = np.cross(angular, self.xyz)
        linear = self.xyz - 0.5 * aside + weight * np.cross(angular, aside)
        return np.hstack((linear, angular))

    def as_scipy_rotation(self) -> Any:
        """The rotations as scipy's Rotation of N; needs scipy."""
        from scipy.spatial.transform import Rotation

        return Rotation.from_quat(self.quat_xyzw)

    def as_scipy(self) -> Any:
        """As N scipy RigidTransforms; needs scipy 1.16 or newer."""
        from scipy.spatial.transform import RigidTransform

        return RigidTransform.from_components(self.xyz, self.as_scipy_rotation())

    # Working with them

    def inverse(self) -> "TransformArray":
        """Each motion back."""
        back = _conjugate(self.quat_xyzw)
        return TransformArray(-rotate(back, self.xyz), back)

    def __matmul__(self, other: "TransformArray | Transform") -> "TransformArray":
        """First `other`, then this, row by row: `T_a_c = T_a_b @ T_b_c`."""
        if not isinstance(other, TransformArray | Transform):
            return NotImplemented
        xyz, quat_xyzw = _as_array(other)
        turned = product(self.quat_xyzw, quat_xyzw)
        return TransformArray(rotate(self.quat_xyzw, xyz) + self.xyz, turned)

    def __rmatmul__(self, other: Transform) -> "TransformArray":
        """One transform after each of these."""
        if not isinstance(other, Transform):
            return NotImplemented
        return _as_array(other) @ self

    def apply(self, points: ArrayLike) -> Floats:
        """Point i of (N, 3), taken by transform i from the child into the parent."""
        return self.rotate(points) + self.xyz

    def rotate(self, vectors: ArrayLike) -> Floats:
        """Vector i of (N, 3), such as a velocity, turned by transform i but not moved."""
        return rotate(self.quat_xyzw, _rows(vectors, (3,), "vectors"))

    def interpolate(
        self, other: "TransformArray | Transform", ratio: ArrayLike
    ) -> "TransformArray":
        """As tf2 does: translations on a straight line, rotations by slerp the short way round.

        `ratio` is one number or (N,): 0 is this one, 1 the other.
        """
        xyz, quat_xyzw = _as_array(other)
        part = np.asarray(ratio, dtype=np.float64).reshape(-1, 1)
        # A part of the rotation from this to the other, which is at most half a turn.
        turn = product(_conjugate(self.quat_xyzw), quat_xyzw)
        some = TransformArray.from_rotvec(_rotvec(turn) * part).quat_xyzw
        straight = (1.0 - part) * self.xyz + part * xyz
        return TransformArray(straight, product(self.quat_xyzw, some))

    def interpolate_screw(
        self, other: "TransformArray | Transform", ratio: ArrayLike
    ) -> "TransformArray":
        """Along the screw from each (`ratio` 0) to its other (1), at constant speed."""
        part = np.asarray(ratio, dtype=np.float64).reshape(-1, 1)
        return self @ TransformArray.exp((self.inverse() @ other).log() * part)


def rotate(quat_xyzw: Floats, vectors: Floats) -> Floats:
    """Vectors (N, 3), each turned by the quaternion (N, 4) of its row."""
    axis, w = quat_xyzw[..., :3], quat_xyzw[..., 3:]
    twice = 2.0 * np.cross(axis, vectors)
    turned: Floats = vectors + w * twice + np.cross(axis, twice)
    return turned


def _rotvec(quat_xyzw: Floats) -> Floats:
    """The rotation vectors (N, 3) of at most half a turn."""
    axis, w = quat_xyzw[:, :3], quat_xyzw[:, 3:]
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    half = np.arctan2(sine, np.abs(w))
    small = half < _SMALL_ANGLE
    scale = np.where(small, 2.0 + half * half / 3.0, 2.0 * half / np.where(small, 1.0, sine))
    turned: Floats = np.where(w < 0.0, -axis, axis) * scale
    return turned


def _conjugate(quat_xyzw: Floats) -> Floats:
    back: Floats = quat_xyzw * np.array((-1.0, -1.0, -1.0, 1.0))
    return back


def _as_array(transforms: TransformArray | Transform) -> TransformArray:
    return TransformArray.of([transforms]) if isinstance(transforms, Transform) else transforms


def _moved(quat_xyzw: Floats, xyz: ArrayLike) -> TransformArray:
    """The rotations, each with its translation of (N, 3), or all with that of (3,)."""
    shape = (len(quat_xyzw), 3)
    try:
        translations = np.broadcast_to(np.asarray(xyz, dtype=np.float64), shape)
    except (TypeError, ValueError):
        raise InvalidArgumentException(
            f"xyz: expected shape {shape} or (3,), got {np.shape(xyz)}"
        ) from None
    return TransformArray(translations.copy(), quat_xyzw)


def _rows(values: ArrayLike, shape: tuple[int, ...], what: str) -> Floats:
    """The array, whose rows have this shape."""
    array = np.asarray(values, dtype=np.float64)
    if array.shape[1:] != shape or array.ndim != 1 + len(shape):
        expected = ", ".join(map(str, ("N", *shape)))
        raise InvalidArgumentException(f"{what}: expected shape ({expected}), got {array.shape}")
    return array
