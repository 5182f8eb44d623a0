"""Rigid transforms: a rotation and a translation that take points of one frame into another.

Conventions, here and everywhere in tfbus: quaternions are x, y, z, w; lengths are metres and
angles radians; `a @ b` applies b first; roll, pitch and yaw turn about the fixed axes x, y, z in
this order, which is Rz(yaw) Ry(pitch) Rx(roll). A pose is seven floats, x y z qx qy qz qw.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tfbus.errors import InvalidArgumentException
from tfbus.pose import Pose, compose, invert, rotation_rows, unit_quaternion

Floats = NDArray[np.float64]


class Transform:
    """An immutable rigid transform.

    `xyz` is the translation in metres, `quat_xyzw` the rotation as a quaternion of norm 1 to
    within tf2's tolerance; it is renormalised. Raises InvalidArgumentException where a number is
    not finite or the quaternion is not of norm 1.
    """

    __slots__ = ("_pose",)
    _pose: Pose

    def __init__(
        self,
        xyz: Sequence[float] | Floats = (0.0, 0.0, 0.0),
        quat_xyzw: Sequence[float] | Floats = (0.0, 0.0, 0.0, 1.0),
    ):
        x, y, z = _floats(xyz, 3, "xyz")
        quat = _floats(quat_xyzw, 4, "quat_xyzw")
        object.__setattr__(self, "_pose", (x, y, z, *unit_quaternion(*quat)))

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(
            f"a Transform is immutable; make another one instead of setting {name}"
        )

    @classmethod
    def from_pose(cls, pose: Sequence[float] | Floats) -> "Transform":
        """The transform of a pose, x y z qx qy qz qw."""
        values = _floats(pose, 7, "pose")
        return cls(values[:3], values[3:])

    @classmethod
    def _trusted(cls, pose: Pose) -> "Transform":
        self = object.__new__(cls)
        object.__setattr__(self, "_pose", pose)
        return self

    @classmethod
    def identity(cls) -> "Transform":
        """The transform that changes nothing."""
        return cls._trusted((0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))

    @classmethod
    def from_rpy(
        cls,
        roll: float,
        pitch: float,
        yaw: float,
        xyz: Sequence[float] | Floats = (0.0, 0.0, 0.0),
    ) -> "Transform":
        """The rotation by roll, pitch and yaw in radians, and a translation."""
        cr, sr = math.cos(roll / 2), math.sin(roll / 2)
        cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
        cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
        return cls(
            xyz,
            (
                sr * cp * cy - cr * sp * sy,
                cr * sp * cy + sr * cp * sy,
                cr * cp * sy - sr * sp * cy,
                cr * cp * cy + sr * sp * sy,
            ),
        )

    @classmethod
    def from_matrix(cls, matrix: ArrayLike) -> "Transform":
        """The transform of a homogeneous matrix (4,4).

        Raises InvalidArgumentException where its rotation is not orthonormal to within 1e-6.
        The quaternion is taken from the largest of its four components (Shepperd 1978).
        """
        m = np.asarray(matrix, np.float64)
        if m.shape != (4, 4) or not np.isfinite(m).all():
            raise InvalidArgumentException("a matrix (4,4) of finite numbers is wanted")
        r = m[:3, :3]
        if not np.allclose(r @ r.T, np.eye(3), atol=1e-6) or np.linalg.det(r) < 0:
            raise InvalidArgumentException("the upper left 3 x 3 of the matrix is not a rotation")
        return cls(m[:3, 3], _quaternion_of(r))

    @property
    def xyz(self) -> Floats:
        """The translation in metres, (3,), read-only."""
        return _read_only(self._pose[:3])

    @property
    def quat_xyzw(self) -> Floats:
        """The rotation as a unit quaternion x, y, z, w, (4,), read-only."""
        return _read_only(self._pose[3:])

    def as_pose(self) -> Pose:
        """The seven floats x y z qx qy qz qw."""
        return self._pose

    def as_matrix(self) -> Floats:
        """The homogeneous matrix (4,4)."""
        matrix = np.eye(4)
        matrix[:3, :3] = rotation_rows(self._pose)
        matrix[:3, 3] = self._pose[:3]
        return matrix

    def as_rpy(self) -> tuple[float, float, float]:
        """Roll, pitch and yaw in radians, pitch within ±π/2; at a pitch of ±π/2 roll is 0."""
        rows = rotation_rows(self._pose)
        sine = -rows[2][0]
        if abs(sine) > 1 - 1e-12:
            yaw = math.atan2(-rows[0][1], rows[1][1])
            return 0.0, math.copysign(math.pi / 2, sine), yaw
        return (
            math.atan2(rows[2][1], rows[2][2]),
            math.asin(sine),
            math.atan2(rows[1][0], rows[0][0]),
        )

    def inverse(self) -> "Transform":
        """The transform the other way round."""
        return Transform._trusted(invert(self._pose))

    def __matmul__(self, other: "Transform") -> "Transform":
        """`other` first, then this one."""
        if not isinstance(other, Transform):
            return NotImplemented
        return Transform._trusted(compose(self._pose, other._pose))

    def apply(self, points: ArrayLike) -> Floats:
        """The points, (3,) or (N,3), taken by this transform; the same shape."""
        moved: Floats = self.rotate(points) + np.array(self._pose[:3])
        return moved

    def rotate(self, vectors: ArrayLike) -> Floats:
        """The vectors, (3,) or (N,3), turned by the rotation alone; the same shape."""
        turned: Floats = np.asarray(vectors, np.float64) @ np.array(rotation_rows(self._pose)).T
        return turned

    def is_close(self, other: "Transform", tolerance: float = 1e-9) -> bool:
        """Whether both do the same to within the tolerance, in metres and in quaternion."""
        a, b = np.array(self._pose), np.array(other._pose)
        b[3:] *= math.copysign(1.0, float(a[3:] @ b[3:]))
        return bool(np.allclose(a, b, rtol=0.0, atol=tolerance))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Transform) and self._pose == other._pose

    def __hash__(self) -> int:
        return hash(self._pose)

    def __repr__(self) -> str:
        xyz = ", ".join(f"{value:g}" for value in self._pose[:3])
        quat = ", ".join(f"{value:g}" for value in self._pose[3:])
        return f"Transform(xyz=({xyz}), quat_xyzw=({quat}))"

    def __reduce__(self) -> tuple[Any, ...]:
        return Transform, (self._pose[:3], self._pose[3:])


@dataclass(frozen=True)
class TransformStamped:
    """A transform at a time: it takes points of `child_frame_id` into `frame_id`, the parent.

    `stamp_ns` is an integer count of nanoseconds since the Unix epoch.
    """

    stamp_ns: int
    frame_id: str
    child_frame_id: str
    transform: Transform


def _floats(values: Any, count: int, what: str) -> tuple[float, ...]:
    try:
        floats = tuple(map(float, values))
    except (TypeError, ValueError) as error:
        raise InvalidArgumentException(f"{what} is {count} numbers, not {values!r}") from error
    if len(floats) != count:
        raise InvalidArgumentException(f"{what} is {count} numbers, not {len(floats)}")
    if not all(map(math.isfinite, floats)):
        raise InvalidArgumentException(f"{what} has a number that is not finite: {floats}")
    return floats


def _read_only(values: tuple[float, ...]) -> Floats:
    array = np.array(values)
    array.flags.writeable = False
    return array


def _quaternion_of(r: Floats) -> tuple[float, float, float, float]:
    trace = r[0, 0] + r[1, 1] + r[2, 2]
    candidates = (r[0, 0], r[1, 1], r[2, 2], trace)
    largest = int(np.argmax(candidates))
    quat = np.empty(4)
    if largest == 3:
        quat[:] = (r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], 1 + trace)
    else:
        i, j, k = largest, (largest + 1) % 3, (largest + 2) % 3
        quat[i] = 1 - trace + 2 * r[i, i]
        quat[j] = r[j, i] + r[i, j]
        quat[k] = r[k, i] + r[i, k]
        quat[3] = r[k, j] - r[j, k]
    x, y, z, w = (quat / np.linalg.norm(quat)).tolist()
    return x, y, z, w
