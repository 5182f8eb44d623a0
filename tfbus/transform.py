"""Rigid motions: `Transform`, and `TransformStamped`, which says between which frames and when.

A transform takes points of a child frame into its parent: `p_parent = T @ p_child`. Written as
parent-from-child the letters cancel: `T_map_tool = T_map_base @ T_base_tool`. Lengths are in
metres, angles in radians, quaternions are x, y, z, w, times are integer nanoseconds since the
Unix epoch.
"""

from collections.abc import Sequence
from math import acos, atan2, cos, fsum, hypot, isfinite, pi, sin, sqrt, tan
from operator import index
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tfbus.errors import InvalidArgumentException

Floats = NDArray[np.float64]

# tf2's tolerance (TF2 "TF_DENORMALIZED_QUATERNION"): the squared norm is within 0.01 of one.
QUATERNION_TOLERANCE = 0.01

# Below this angle the closed forms of exp and log lose digits, and their series has all of them.
_SMALL_ANGLE = 1e-3


class Transform:
    """An immutable rigid motion: a rotation, then a translation.

    `xyz` is the translation (3,) in metres, `quat_xyzw` the rotation (4,) as a unit quaternion.
    A quaternion whose squared norm is within 0.01 of one is normalised; any other, and numbers
    that are not finite, raise InvalidArgumentException.

    `==` compares the seven numbers exactly; `is_close` asks whether two motions are the same.
    """

    __slots__ = ("_qw", "_qx", "_qy", "_qz", "_x", "_y", "_z")

    def __init__(self, xyz: ArrayLike = (0, 0, 0), quat_xyzw: ArrayLike = (0, 0, 0, 1)) -> None:
        self._x: float
        self._x, self._y, self._z = _numbers(xyz, 3, "xyz")
        x, y, z, w = _numbers(quat_xyzw, 4, "quat_xyzw")
        self._qx, self._qy, self._qz, self._qw = _unit_quaternion(x, y, z, w)

    # Making one

    @staticmethod
    def identity() -> "Transform":
        """The motion that moves nothing."""
        return make_transform(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)

    @staticmethod
    def from_pose(pose: ArrayLike) -> "Transform":
        """From seven numbers: x y z, then the quaternion x y z w."""
        numbers = _numbers(pose, 7, "pose")
        return Transform(numbers[:3], numbers[3:])

    @staticmethod
    def from_matrix(matrix: ArrayLike) -> "Transform":
        """From a homogeneous (4, 4) matrix, or (3, 4) without its last row.

        Raises InvalidArgumentException unless the left (3, 3) is a rotation (to 1e-6) and the
        last row is 0 0 0 1.
        """
        m = np.asarray(matrix, dtype=np.float64)
        if m.shape not in ((4, 4), (3, 4)):
            raise InvalidArgumentException(f"a matrix of shape {m.shape}; (4, 4) is wanted")
        if m.shape == (4, 4) and not np.allclose(m[3], (0, 0, 0, 1), atol=1e-9):
            raise InvalidArgumentException("the last row of a rigid motion's matrix is 0 0 0 1")
        rotation = m[:3, :3]
        is_rotation = np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6)
        if not is_rotation or np.linalg.det(rotation) < 0:
            raise InvalidArgumentException(
                "the (3, 3) part of the matrix is not a rotation: its columns are to be "
                "orthogonal unit vectors, right-handed"
            )
        return Transform(m[:3, 3], _quaternion_of_matrix(rotation.tolist()))

    @staticmethod
    def from_rpy(roll: float, pitch: float, yaw: float, xyz: ArrayLike = (0, 0, 0)) -> "Transform":
        """From roll, pitch and yaw in radians, about the fixed axes x, y and z in that order.

        The convention of URDF and of tf2's setRPY; the same as "xyz" of `from_euler`.
        """
        return Transform.from_euler("xyz", (roll, pitch, yaw), xyz)

    @staticmethod
    def from_euler(axes: str, angles_rad: ArrayLike, xyz: ArrayLike = (0, 0, 0)) -> "Transform":
        """From three angles (3,) about three axes, named as scipy names them.

        Lower case ("xyz") turns about the fixed axes of the parent in that order, upper case
        ("ZYX") about the axes of the turning frame. Neighbouring axes differ.
        """
        order, fixed = _axes(axes)
        rotation = Transform.identity()
        for axis, angle in zip(order, _numbers(angles_rad, 3, "angles_rad"), strict=True):
            turn = _about_axis(axis, angle)
            rotation = turn @ rotation if fixed else rotation @ turn
        return Transform(xyz, rotation._quaternion())

    @staticmethod
    def from_rotvec(rotvec: ArrayLike, xyz: ArrayLike = (0, 0, 0)) -> "Transform":
        """From a rotation vector (3,): the axis, as long as the angle in radians."""
        x, y, z = _numbers(rotvec, 3, "rotvec")
        return Transform(xyz, _quaternion_of_rotvec(x, y, z))

    @staticmethod
    def exp(twist: ArrayLike) -> "Transform":
        """The motion that a constant twist (6,) makes in unit time: a screw.

        `twist` is linear velocity (m), then angular velocity (rad), both as seen in the moving
        frame. The inverse of `log`. Formulas: Barfoot, State Estimation for Robotics, 7.1.
        """
        vx, vy, vz, wx, wy, wz = _numbers(twist, 6, "twist")
        angle = sqrt(wx * wx + wy * wy + wz * wz)
        if angle < _SMALL_ANGLE:
            square = angle * angle
            a = 0.5 - square / 24.0
            b = 1.0 / 6.0 - square / 120.0
        else:
            a = 2.0 * (sin(0.5 * angle) / angle) ** 2
            b = (angle - sin(angle)) / angle**3
        ax, ay, az = _cross(wx, wy, wz, vx, vy, vz)
        bx, by, bz = _cross(wx, wy, wz, ax, ay, az)
        qx, qy, qz, qw = _quaternion_of_rotvec(wx, wy, wz)
        return make_transform(
            vx + a * ax + b * bx, vy + a * ay + b * by, vz + a * az + b * bz, qx, qy, qz, qw
        )

    # Reading it

    @property
    def x(self) -> float:
        """Translation along x, in metres."""
        return self._x

    @property
    def y(self) -> float:
        """Translation along y, in metres."""
        return self._y

    @property
    def z(self) -> float:
        """Translation along z, in metres."""
        return self._z

    @property
    def qx(self) -> float:
        """First component of the quaternion."""
        return self._qx

    @property
    def qy(self) -> float:
        """Second component of the quaternion."""
        return self._qy

    @property
    def qz(self) -> float:
        """Third component of the quaternion."""
        return self._qz

    @property
    def qw(self) -> float:
        """Scalar component of the quaternion, its last."""
        return self._qw

    @property
    def xyz(self) -> Floats:
        """The translation, a read-only array (3,) in metres."""
        return _read_only((self._x, self._y, self._z))

    @property
    def quat_xyzw(self) -> Floats:
        """The rotation, a read-only array (4,): the unit quaternion x, y, z, w."""
        return _read_only(self._quaternion())

    def _quaternion(self) -> tuple[float, float, float, float]:
        return self._qx, self._qy, self._qz, self._qw

    def as_pose(self) -> tuple[float, float, float, float, float, float, float]:
        """The seven numbers x y z qx qy qz qw."""
        return self._x, self._y, self._z, self._qx, self._qy, self._qz, self._qw

    def as_matrix(self) -> Floats:
        """The homogeneous matrix (4, 4)."""
        matrix = np.eye(4)
        matrix[:3, :3] = _matrix_of_quaternion(*self._quaternion())
        matrix[:3, 3] = self._x, self._y, self._z
        return matrix

    def as_rpy(self) -> tuple[float, float, float]:
        """Roll, pitch and yaw in radians, as `from_rpy` takes them.

        Pitch is within half a turn's half; where it is +-pi/2 (gimbal lock) yaw is 0.
        """
        return self.as_euler("xyz")

    def as_euler(self, axes: str) -> tuple[float, float, float]:
        """Three angles in radians about the axes, as `from_euler` takes them.

        In gimbal lock one of the outer angles is free: the third is 0. Method: Bernardes and
        Viollet, Quaternion to Euler angles conversion, PLOS ONE 2022.
        """
        order, fixed = _axes(axes)
        first, second, third = _fixed_axes_angles(
            self._quaternion(), order if fixed else order[::-1], free_last=fixed
        )
        return (first, second, third) if fixed else (third, second, first)

    def as_rotvec(self) -> Floats:
        """The rotation vector (3,): the axis, as long as the angle (0 to pi radians)."""
        return np.array(_rotvec_of_quaternion(*self._quaternion()))

    def log(self) -> Floats:
        """The constant twist (6,) that makes this motion in unit time: linear (m), angular (rad).

        The inverse of `exp`. The angle is at most half a turn.
        """
        wx, wy, wz = _rotvec_of_quaternion(*self._quaternion())
        square = wx * wx + wy * wy + wz * wz
        if square < _SMALL_ANGLE * _SMALL_ANGLE:
            c = 1.0 / 12.0 + square / 720.0
        else:
            half = 0.5 * sqrt(square)
            c = (1.0 - half / tan(half)) / square
        ax, ay, az = _cross(wx, wy, wz, self._x, self._y, self._z)
        bx, by, bz = _cross(wx, wy, wz, ax, ay, az)
        return np.array(
            (
                self._x - 0.5 * ax + c * bx,
                self._y - 0.5 * ay + c * by,
                self._z - 0.5 * az + c * bz,
                wx,
                wy,
                wz,
            )
        )

    # Working with it

    def inverse(self) -> "Transform":
        """The motion back."""
        x, y, z = _rotated(-self._qx, -self._qy, -self._qz, self._qw, -self._x, -self._y, -self._z)
        return make_transform(x, y, z, -self._qx, -self._qy, -self._qz, self._qw)

    def __matmul__(self, other: "Transform") -> "Transform":
        """First `other`, then this: `T_a_c = T_a_b @ T_b_c`."""
        if not isinstance(other, Transform):
            return NotImplemented
        x, y, z = _rotated(self._qx, self._qy, self._qz, self._qw, other._x, other._y, other._z)
        ax, ay, az, aw = self._qx, self._qy, self._qz, self._qw
        bx, by, bz, bw = other._qx, other._qy, other._qz, other._qw
        qx = aw * bx + ax * bw + ay * bz - az * by
        qy = aw * by - ax * bz + ay * bw + az * bx
        qz = aw * bz + ax * by - ay * bx + az * bw
        qw = aw * bw - ax * bx - ay * by - az * bz
        # Each product adds a rounding error to the norm; one Newton step takes it off again.
        scale = 1.5 - 0.5 * (qx * qx + qy * qy + qz * qz + qw * qw)
        return make_transform(
            self._x + x, self._y + y, self._z + z, qx * scale, qy * scale, qz * scale, qw * scale
        )

    def apply(self, points: ArrayLike) -> Floats:
        """Points (3,) or (N, 3) of the child frame, taken into the parent."""
        return self.rotate(points) + np.array((self._x, self._y, self._z))

    def rotate(self, vectors: ArrayLike) -> Floats:
        """Vectors (3,) or (N, 3), such as velocities, turned but not moved."""
        array = np.asarray(vectors, dtype=np.float64)
        if array.ndim == 0 or array.shape[-1] != 3:
            raise InvalidArgumentException(f"points of shape {array.shape}; (N, 3) is wanted")
        rotated: Floats = array @ np.array(_matrix_of_quaternion(*self._quaternion())).T
        return rotated

    def interpolate(self, other: "Transform", ratio: float) -> "Transform":
        """As tf2 blends: the translation on a straight line, the rotation the short way round.

        `ratio` 0 is this one, 1 the other.
        """
        a, b = self._quaternion(), other._quaternion()
        qx, qy, qz, qw = _slerp(a, b, ratio)
        return make_transform(
            self._x + (other._x - self._x) * ratio,
            self._y + (other._y - self._y) * ratio,
            self._z + (other._z - self._z) * ratio,
            qx,
            qy,
            qz,
            qw,
        )

    def interpolate_screw(self, other: "Transform", ratio: float) -> "Transform":
        """Along the screw that leads from this one (`ratio` 0) to the other (1), at even speed.

        Unlike `interpolate`, the way between does not depend on where the frame's origin is.
        """
        return self @ Transform.exp((self.inverse() @ other).log() * ratio)

    def is_close(self, other: "Transform", atol: float = 1e-9) -> bool:
        """Whether both are the same motion: translations within `atol` metres on each axis,
        rotations within `atol` radians. A quaternion and its negative are the same rotation.
        """
        turn = self.inverse() @ other
        near = all(
            abs(a - b) <= atol
            for a, b in ((self._x, other._x), (self._y, other._y), (self._z, other._z))
        )
        return near and 2.0 * hypot(turn._qx, turn._qy, turn._qz) <= atol

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Transform):
            return NotImplemented
        return self.as_pose() == other.as_pose()

    def __hash__(self) -> int:
        return hash(self.as_pose())

    def __reduce__(self) -> tuple[Any, ...]:
        return make_transform, self.as_pose()

    def __repr__(self) -> str:
        x, y, z, qx, qy, qz, qw = (f"{number:.9g}" for number in self.as_pose())
        return f"Transform(xyz=({x}, {y}, {z}), quat_xyzw=({qx}, {qy}, {qz}, {qw}))"


class TransformStamped:
    """A transform between two frames at one time; immutable.

    `frame_id` is the parent, `child_frame_id` the child; the transform takes points of the child
    into the parent. `stamp_ns` is nanoseconds since the Unix epoch. `extrapolated_ns` is how far
    the answer of a lookup lies beyond the samples it was made from: 0 unless the caller asked
    for more than interpolation.

    Raises InvalidArgumentException for frame ids that are empty or begin with a slash.
    """

    __slots__ = ("_child_frame_id", "_extrapolated_ns", "_frame_id", "_stamp_ns", "_transform")

    def __init__(
        self,
        stamp_ns: int,
        frame_id: str,
        child_frame_id: str,
        transform: Transform,
        *,
        extrapolated_ns: int = 0,
    ) -> None:
        check_frame_id(frame_id, "frame_id")
        check_frame_id(child_frame_id, "child_frame_id")
        if not isinstance(transform, Transform):
            raise InvalidArgumentException(
                f"the transform is a {type(transform).__name__}; a tfbus.Transform is wanted"
            )
        self._stamp_ns = check_stamp(stamp_ns)
        self._frame_id = frame_id
        self._child_frame_id = child_frame_id
        self._transform = transform
        self._extrapolated_ns = extrapolated_ns

    @property
    def stamp_ns(self) -> int:
        """The time, in nanoseconds since the Unix epoch."""
        return self._stamp_ns

    @property
    def frame_id(self) -> str:
        """The parent frame."""
        return self._frame_id

    @property
    def child_frame_id(self) -> str:
        """The child frame."""
        return self._child_frame_id

    @property
    def transform(self) -> Transform:
        """Takes points of the child frame into the parent."""
        return self._transform

    @property
    def extrapolated_ns(self) -> int:
        """How far the answer lies beyond the samples it was made from; 0: between them."""
        return self._extrapolated_ns

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, TransformStamped):
            return NotImplemented
        return self._fields() == other._fields()

    def __hash__(self) -> int:
        return hash(self._fields())

    def __reduce__(self) -> tuple[Any, ...]:
        return make_stamped, self._fields()

    def __repr__(self) -> str:
        beyond = f", extrapolated_ns={self._extrapolated_ns}" if self._extrapolated_ns else ""
        return (
            f"TransformStamped({self._stamp_ns}, {self._frame_id!r}, {self._child_frame_id!r}, "
            f"{self._transform!r}{beyond})"
        )

    def _fields(self) -> tuple[int, str, str, Transform, int]:
        return (
            self._stamp_ns,
            self._frame_id,
            self._child_frame_id,
            self._transform,
            self._extrapolated_ns,
        )


def make_transform(
    x: float, y: float, z: float, qx: float, qy: float, qz: float, qw: float
) -> Transform:
    """A Transform from numbers that are known to be good; nothing is checked."""
    self = Transform.__new__(Transform)
    self._x = x
    self._y = y
    self._z = z
    self._qx = qx
    self._qy = qy
    self._qz = qz
    self._qw = qw
    return self


def make_stamped(
    stamp_ns: int, frame_id: str, child_frame_id: str, transform: Transform, extrapolated_ns: int
) -> TransformStamped:
    """A TransformStamped from parts that are known to be good; nothing is checked."""
    self = TransformStamped.__new__(TransformStamped)
    self._stamp_ns = stamp_ns
    self._frame_id = frame_id
    self._child_frame_id = child_frame_id
    self._transform = transform
    self._extrapolated_ns = extrapolated_ns
    return self


def check_frame_id(frame_id: object, what: str = "frame id") -> str:
    """The frame id, if it can be one; `what` it is called in the error."""
    if not isinstance(frame_id, str):
        raise InvalidArgumentException(
            f"{what} is a {type(frame_id).__name__}; a frame id is a text such as 'base_link'"
        )
    if not frame_id:
        raise InvalidArgumentException(f"{what} is empty; a frame id is a text like 'base_link'")
    if frame_id[0] == "/":
        raise InvalidArgumentException(
            f"{what} {frame_id!r} begins with a slash; write {frame_id.lstrip('/')!r}"
        )
    return frame_id


def check_stamp(stamp_ns: object) -> int:
    """The stamp, if it is an integer of 64 bits."""
    try:
        stamp = index(stamp_ns)  # type: ignore[arg-type]  # judged by index itself
    except TypeError:
        raise InvalidArgumentException(
            f"a stamp is a whole number of nanoseconds since the Unix epoch, not {stamp_ns!r}"
        ) from None
    if not -(2**63) <= stamp < 2**63:
        raise InvalidArgumentException(f"the stamp {stamp} does not fit into 64 bits")
    return stamp


def _numbers(values: ArrayLike, count: int, what: str) -> Any:
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InvalidArgumentException(
            f"{what} is {values!r}; {count} numbers are wanted"
        ) from None
    if array.shape != (count,):
        raise InvalidArgumentException(f"{what} has shape {array.shape}; ({count},) is wanted")
    numbers = array.tolist()
    if not all(map(isfinite, numbers)):
        raise InvalidArgumentException(f"{what} is {numbers}; all numbers are to be finite")
    return numbers


def _unit_quaternion(x: float, y: float, z: float, w: float) -> tuple[float, float, float, float]:
    square = fsum((x * x, y * y, z * z, w * w))
    if abs(square - 1.0) >= QUATERNION_TOLERANCE:
        raise InvalidArgumentException(
            f"the quaternion x={x:g} y={y:g} z={z:g} w={w:g} has norm {sqrt(square):.6g}; a "
            "rotation has norm 1" + (": was it never set?" if square == 0.0 else "")
        )
    if abs(square - 1.0) <= 4e-16:
        # Good to the last bit: leave it, so that what is sent and read back stays equal.
        return x, y, z, w
    norm = sqrt(square)
    return x / norm, y / norm, z / norm, w / norm


def _read_only(values: Sequence[float]) -> Floats:
    array = np.array(values)
    array.flags.writeable = False
    return array


def _cross(
    ax: float, ay: float, az: float, bx: float, by: float, bz: float
) -> tuple[float, float, float]:
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


def _rotated(
    qx: float, qy: float, qz: float, qw: float, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """v + 2w (q x v) + 2 q x (q x v), as 15 multiplications."""
    tx = 2.0 * (qy * z - qz * y)
    ty = 2.0 * (qz * x - qx * z)
    tz = 2.0 * (qx * y - qy * x)
    return (
        x + qw * tx + qy * tz - qz * ty,
        y + qw * ty + qz * tx - qx * tz,
        z + qw * tz + qx * ty - qy * tx,
    )


def _slerp(
    a: tuple[float, float, float, float], b: tuple[float, float, float, float], ratio: float
) -> tuple[float, float, float, float]:
    dot = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]
    sign = 1.0 if dot >= 0.0 else -1.0
    dot = abs(dot)
    if dot < 1.0 - 1e-9:
        angle = acos(dot)
        u = sin((1.0 - ratio) * angle)
        v = sign * sin(ratio * angle)
    else:
        u, v = 1.0 - ratio, sign * ratio
    x, y, z, w = (u * p + v * q for p, q in zip(a, b, strict=True))
    scale = 1.0 / sqrt(x * x + y * y + z * z + w * w)
    return x * scale, y * scale, z * scale, w * scale


def _quaternion_of_rotvec(x: float, y: float, z: float) -> tuple[float, float, float, float]:
    angle = sqrt(x * x + y * y + z * z)
    small = angle < _SMALL_ANGLE
    scale = 0.5 - angle * angle / 48.0 if small else sin(0.5 * angle) / angle
    return x * scale, y * scale, z * scale, cos(0.5 * angle)


def _rotvec_of_quaternion(x: float, y: float, z: float, w: float) -> tuple[float, float, float]:
    if w < 0.0:
        x, y, z, w = -x, -y, -z, -w
    sine = sqrt(x * x + y * y + z * z)
    small = sine < 0.5 * _SMALL_ANGLE
    scale = 2.0 + sine * sine / 3.0 if small else 2.0 * atan2(sine, w) / sine
    return x * scale, y * scale, z * scale


def _matrix_of_quaternion(x: float, y: float, z: float, w: float) -> tuple[tuple[float, ...], ...]:
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )


def _quaternion_of_matrix(m: list[list[float]]) -> list[float]:
    """Shepperd's method: divide by the largest component, so that nothing is lost."""
    trace = m[0][0] + m[1][1] + m[2][2]
    largest = max(range(4), key=(m[0][0], m[1][1], m[2][2], trace).__getitem__)
    if largest == 3:
        q = [m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1], 1.0 + trace]
    else:
        i, j, k = largest, (largest + 1) % 3, (largest + 2) % 3
        q = [0.0, 0.0, 0.0, m[k][j] - m[j][k]]
        q[i] = 1.0 + m[i][i] - m[j][j] - m[k][k]
        q[j] = m[j][i] + m[i][j]
        q[k] = m[k][i] + m[i][k]
    norm = hypot(*q)
    return [component / norm for component in q]


def _axes(axes: str) -> tuple[list[int], bool]:
    """Three axes as indices, and whether they stay fixed."""
    order = ["xyz".find(axis) for axis in axes.lower()]
    good = len(order) == 3 and -1 not in order and order[1] not in (order[0], order[2])
    if not good or axes not in (axes.lower(), axes.upper()):
        raise InvalidArgumentException(
            f"{axes!r} does not name axes: three of x, y, z, no two neighbours alike, such as "
            "'xyz' (fixed axes) or 'ZYX' (turning axes)"
        )
    return order, axes.islower()


def _about_axis(axis: int, angle_rad: float) -> Transform:
    quaternion = [0.0, 0.0, 0.0, cos(0.5 * angle_rad)]
    quaternion[axis] = sin(0.5 * angle_rad)
    return make_transform(0.0, 0.0, 0.0, *quaternion)


def _fixed_axes_angles(
    quaternion: Sequence[float], order: Sequence[int], *, free_last: bool
) -> tuple[float, float, float]:
    """Angles about three fixed axes; in gimbal lock the last is 0, or else the first."""
    i, j, k = order
    proper = i == k
    if proper:
        k = 3 - i - j
    sign = float((i - j) * (j - k) * (k - i) // 2)
    qi, qj, qk, w = quaternion[i], quaternion[j], quaternion[k] * sign, quaternion[3]
    a, b, c, d = (w, qi, qj, qk) if proper else (w - qj, qi + qk, qj + w, qk - qi)
    low, high = hypot(c, d), hypot(a, b)
    second = 2.0 * atan2(low, high)
    half_sum, half_difference = atan2(b, a), atan2(d, c)
    # At a lock one of the two is the angle of a vanishing vector: noise.
    if min(low, high) < 1e-8:
        lone = 2.0 * half_sum if low < high else -2.0 * half_difference
        if free_last:
            first, third = lone, 0.0
        else:
            first, third = 0.0, lone if low < high else -lone
    else:
        first, third = half_sum - half_difference, half_sum + half_difference
    if not proper:
        third *= sign
        # More exact near the lock than 2 atan2(...) - pi/2.
        second = second - 0.5 * pi
    return _wrapped(first), second, _wrapped(third)


def _wrapped(angle_rad: float) -> float:
    if angle_rad > pi:
        return angle_rad - 2.0 * pi
    if angle_rad < -pi:
        return angle_rad + 2.0 * pi
    return angle_rad
