"""Rigid motions: `Transform`, and `TransformStamped`, which adds its frames and stamp.

A transform takes points of a child frame into its parent: `p_parent = T @ p_child`. Written as
parent-from-child the letters cancel: `T_map_tool = T_map_base @ T_base_tool`. Lengths are in
metres, angles in radians, quaternions are x, y, z, w, times are integer nanoseconds since the
Unix epoch.
"""

from math import hypot, isfinite
from operator import index
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tfbus.core.kernel import (
    IDENTITY,
    Pose,
    compose,
    exp_twist,
    invert,
    lerp_slerp,
    log_pose,
    normalised,
    relative,
    sclerp,
)
from tfbus.errors import InvalidArgumentException
from tfbus.geometry.rotations import (
    angles_of,
    euler_axes,
    is_rotation,
    matrix_of,
    quaternion_about,
    quaternion_of_matrix,
    unit_quaternion,
)
from tfbus.names import mistake_in
from tfbus.runtime.signature import SourceSignature

try:
    import cython
except ImportError:
    from tfbus.core import cython_stub as cython

Floats = NDArray[np.float64]

# Differences of stamps up to this fit 64 bits.
LATEST_STAMP_NS = 2**62 - 1

# The tolerance of a homogeneous matrix's last row, 0 0 0 1.
LAST_ROW_WITHIN = 1e-9


@cython.freelist(256)
@cython.cclass
class Transform:
    """An immutable rigid motion: a rotation, then a translation.

    `xyz` is the translation (3,) in metres, `quat_xyzw` the rotation (4,) as a unit quaternion.
    A quaternion whose squared norm is within 0.01 of one is normalised; any other, and numbers
    that are not finite, raise InvalidArgumentException.

    `==` compares the seven numbers exactly; `is_close` asks whether two motions are the same.
    """

    __signature__ = SourceSignature()
    __slots__ = ("_pose",)

    def __init__(self, xyz: ArrayLike = (0, 0, 0), quat_xyzw: ArrayLike = (0, 0, 0, 1)) -> None:
        x, y, z = _numbers(xyz, 3, "xyz")
        qx, qy, qz, qw = _numbers(quat_xyzw, 4, "quat_xyzw")
        pose: Pose = (x, y, z, *unit_quaternion(qx, qy, qz, qw))
        self._pose = pose

    # Making one

    @staticmethod
    def identity() -> "Transform":
        """The motion that changes nothing."""
        return make_transform(IDENTITY)

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
            raise InvalidArgumentException(
                f"matrix: expected shape (4, 4) or (3, 4), got {m.shape}"
            )
        if m.shape == (4, 4) and not np.allclose(m[3], (0, 0, 0, 1), atol=LAST_ROW_WITHIN):
            raise InvalidArgumentException("the last row of the matrix must be 0 0 0 1")
        rotation = m[:3, :3]
        if not is_rotation(rotation):
            raise InvalidArgumentException(
                "the (3, 3) part of the matrix is not a rotation: its columns must be orthogonal "
                "unit vectors, right-handed"
            )
        return Transform(m[:3, 3], quaternion_of_matrix(rotation.tolist()))

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
        order, fixed = euler_axes(axes)
        rotation = Transform.identity()
        for axis, angle in zip(order, _numbers(angles_rad, 3, "angles_rad"), strict=True):
            turn = Transform((0, 0, 0), quaternion_about(axis, angle))
            rotation = turn @ rotation if fixed else rotation @ turn
        return Transform(xyz, rotation._quaternion())

    @staticmethod
    def from_rotvec(rotvec: ArrayLike, xyz: ArrayLike = (0, 0, 0)) -> "Transform":
        """From a rotation vector (3,): the axis, as long as the angle in radians."""
        x, y, z = _numbers(rotvec, 3, "rotvec")
        return Transform(xyz, exp_twist(0.0, 0.0, 0.0, x, y, z)[3:])

    @staticmethod
    def exp(twist: ArrayLike) -> "Transform":
        """The motion that a constant twist (6,) makes in unit time: a screw.

        `twist` is linear velocity (m), then angular velocity (rad), both as seen in the moving
        frame. The inverse of `log`. Formulas: Barfoot, State Estimation for Robotics, 7.1.
        """
        vx, vy, vz, wx, wy, wz = _numbers(twist, 6, "twist")
        return make_transform(exp_twist(vx, vy, vz, wx, wy, wz))

    # Reading it

    @property
    def x(self) -> float:
        """Translation along x, in metres."""
        return self._pose[0]

    @property
    def y(self) -> float:
        """Translation along y, in metres."""
        return self._pose[1]

    @property
    def z(self) -> float:
        """Translation along z, in metres."""
        return self._pose[2]

    @property
    def qx(self) -> float:
        """First component of the quaternion."""
        return self._pose[3]

    @property
    def qy(self) -> float:
        """Second component of the quaternion."""
        return self._pose[4]

    @property
    def qz(self) -> float:
        """Third component of the quaternion."""
        return self._pose[5]

    @property
    def qw(self) -> float:
        """Scalar component of the quaternion, its last."""
        return self._pose[6]

    @property
    def xyz(self) -> Floats:
        """The translation, a read-only array (3,) in metres."""
        return _read_only(self._pose[0], self._pose[1], self._pose[2])

    @property
    def quat_xyzw(self) -> Floats:
        """The rotation, a read-only array (4,): the unit quaternion x, y, z, w."""
        return _read_only(*self._quaternion())

    def _quaternion(self) -> tuple[float, float, float, float]:
        return self._pose[3], self._pose[4], self._pose[5], self._pose[6]

    def as_pose(self) -> Pose:
        """The seven numbers x y z qx qy qz qw."""
        return self._pose

    def as_matrix(self) -> Floats:
        """The homogeneous matrix (4, 4)."""
        matrix = np.eye(4)
        matrix[:3, :3] = matrix_of(*self._quaternion())
        matrix[:3, 3] = self._pose[0], self._pose[1], self._pose[2]
        return matrix

    def as_rpy(self) -> tuple[float, float, float]:
        """Roll, pitch and yaw in radians, as `from_rpy` takes them.

        Pitch is from -pi/2 to pi/2; at either end (gimbal lock) yaw is 0.
        """
        return self.as_euler("xyz")

    def as_euler(self, axes: str) -> tuple[float, float, float]:
        """Three angles in radians about the axes, as `from_euler` takes them.

        In gimbal lock one of the outer angles is free: the third is 0. Method: Bernardes and
        Viollet, Quaternion to Euler angles conversion, PLOS ONE 2022.
        """
        return angles_of(axes, self._quaternion())

    def as_rotvec(self) -> Floats:
        """The rotation vector (3,): the axis, as long as the angle (0 to pi radians)."""
        _, _, _, wx, wy, wz = log_pose(self._pose)
        return np.array((wx, wy, wz))

    def log(self) -> Floats:
        """The constant twist (6,) that makes this motion in unit time: linear (m), angular (rad).

        The inverse of `exp`. The angle is at most half a turn.
        """
        return np.array(log_pose(self._pose))

    @staticmethod
    def from_scipy(rotation: Any, xyz: ArrayLike = (0, 0, 0)) -> "Transform":
        """From a scipy Rotation with a translation, or from a scipy RigidTransform."""
        if hasattr(rotation, "as_components"):
            xyz, rotation = rotation.as_components()
        return Transform(xyz, rotation.as_quat())

    def as_scipy_rotation(self) -> Any:
        """The rotation as scipy's Rotation; needs scipy."""
        from scipy.spatial.transform import Rotation

        return Rotation.from_quat(self._quaternion())

    def as_scipy(self) -> Any:
        """As scipy's RigidTransform; needs scipy 1.16 or newer."""
        from scipy.spatial.transform import RigidTransform

        return RigidTransform.from_components(self.xyz, self.as_scipy_rotation())

    # Working with it

    def inverse(self) -> "Transform":
        """The motion back."""
        return make_transform(invert(self._pose))

    def __matmul__(self, other: "Transform") -> "Transform":
        """First `other`, then this: `T_a_c = T_a_b @ T_b_c`."""
        if not isinstance(other, Transform):
            return NotImplemented
        return make_transform(normalised(compose(self._pose, pose_of(other))))

    def apply(self, points: ArrayLike) -> Floats:
        """Points (3,) or (N, 3) of the child frame, taken into the parent."""
        return self.rotate(points) + self.xyz

    def rotate(self, vectors: ArrayLike) -> Floats:
        """Vectors (3,) or (N, 3), such as velocities, turned but not moved."""
        array = np.asarray(vectors, dtype=np.float64)
        if array.ndim == 0 or array.shape[-1] != 3:
            raise InvalidArgumentException(
                f"points: expected shape (3,) or (N, 3), got {array.shape}"
            )
        rotated: Floats = array @ np.array(matrix_of(*self._quaternion())).T
        return rotated

    def interpolate(self, other: "Transform", ratio: float) -> "Transform":
        """As tf2 does: the translation on a straight line, the rotation by slerp the short way
        round. `ratio` 0 is this one, 1 the other.
        """
        return make_transform(normalised(lerp_slerp(self._pose, pose_of(other), ratio)))

    def interpolate_screw(self, other: "Transform", ratio: float) -> "Transform":
        """Along the screw from this one (`ratio` 0) to the other (1), at constant speed.

        Unlike `interpolate`, the motion does not depend on where the frame's origin is.
        """
        return make_transform(sclerp(self._pose, pose_of(other), ratio))

    def is_close(self, other: "Transform", atol: float = 1e-9) -> bool:
        """Whether both are the same motion: translations within `atol` metres on each axis,
        rotations within `atol` radians. A quaternion and its negative are the same rotation.
        """
        _, _, _, qx, qy, qz, _ = relative(self._pose, pose_of(other))
        near = np.allclose(self.xyz, other.xyz, rtol=0.0, atol=atol)
        return bool(near) and 2.0 * hypot(qx, qy, qz) <= atol

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Transform):
            return NotImplemented
        return self._pose == pose_of(other)

    def __hash__(self) -> int:
        return hash(self._pose)

    def __reduce__(self) -> tuple[Any, ...]:
        return make_transform, (self._pose,)

    def __repr__(self) -> str:
        x, y, z, qx, qy, qz, qw = (f"{number:.9g}" for number in self._pose)
        return f"Transform(xyz=({x}, {y}, {z}), quat_xyzw=({qx}, {qy}, {qz}, {qw}))"


@cython.freelist(256)
@cython.cclass
class TransformStamped:
    """A transform between two frames at one time; immutable.

    `frame_id` is the parent, `child_frame_id` the child; the transform takes points of the child
    into the parent. `stamp_ns` is nanoseconds since the Unix epoch. `extrapolated_ns` is how far
    the answer of a lookup lies beyond the samples it was made from: 0 unless the caller asked
    for more than interpolation.

    Raises InvalidArgumentException for frame ids that are empty or begin with a slash.
    """

    __signature__ = SourceSignature()
    # The pose is not kept as a Transform, which most lookups would make without need.
    __slots__ = ("_child_frame_id", "_extrapolated_ns", "_frame_id", "_pose", "_stamp_ns")

    def __init__(
        self,
        stamp_ns: int,
        frame_id: str,
        child_frame_id: str,
        transform: Transform,
        *,
        extrapolated_ns: int = 0,
    ) -> None:
        self._frame_id = check_frame_id(frame_id, "frame_id")
        self._child_frame_id = check_frame_id(child_frame_id, "child_frame_id")
        if not isinstance(transform, Transform):
            raise InvalidArgumentException(
                f"transform: expected a tfbus.Transform, got a {type(transform).__name__}"
            )
        self._stamp_ns = check_stamp(stamp_ns)
        self._pose = pose_of(transform)
        self._extrapolated_ns = check_stamp(extrapolated_ns, "extrapolated_ns")

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
        return make_transform(self._pose)

    @property
    def extrapolated_ns(self) -> int:
        """How far the answer lies beyond the samples it was made from; 0 between them."""
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
            f"{self.transform!r}{beyond})"
        )

    def _fields(self) -> tuple[int, str, str, Pose, int]:
        return (
            self._stamp_ns,
            self._frame_id,
            self._child_frame_id,
            self._pose,
            self._extrapolated_ns,
        )


def make_transform(pose: Pose) -> Transform:
    """A Transform from a pose that was checked before."""
    self = Transform.__new__(Transform)
    self._pose = pose
    return self


def pose_of(transform: Transform) -> Pose:
    """The seven numbers of a transform. Raises InvalidArgumentException for anything else."""
    if not isinstance(transform, Transform):
        raise InvalidArgumentException(
            f"expected a tfbus.Transform, got a {type(transform).__name__}"
        )
    motion: Transform = transform
    return motion._pose


def make_stamped(
    stamp_ns: int, frame_id: str, child_frame_id: str, pose: Pose, extrapolated_ns: int
) -> TransformStamped:
    """A TransformStamped from parts that were checked before."""
    self = TransformStamped.__new__(TransformStamped)
    self._stamp_ns = stamp_ns
    self._frame_id = frame_id
    self._child_frame_id = child_frame_id
    self._pose = pose
    self._extrapolated_ns = extrapolated_ns
    return self


def check_frame_id(frame_id: object, what: str = "frame id") -> str:
    """The frame id as a plain str. Raises InvalidArgumentException, which calls it `what`, if it
    cannot be one.
    """
    if mistake := mistake_in(frame_id):
        raise InvalidArgumentException(f"{what} {mistake}")
    return plain(frame_id)  # type: ignore[arg-type]  # judged by mistake_in


def plain(text: str) -> str:
    """The text as a str and no subclass of it, such as a member of a StrEnum or numpy's str_."""
    return text if type(text) is str else str.__str__(text)


def check_stamp(stamp_ns: object, what: str = "stamp") -> int:
    """The stamp as an int. Raises InvalidArgumentException if it cannot be one."""
    try:
        if np.ma.is_masked(stamp_ns):
            raise TypeError
        stamp = index(stamp_ns)  # type: ignore[arg-type]  # judged by index itself
    except TypeError:
        raise InvalidArgumentException(
            f"a {what} must be an integer, nanoseconds since the Unix epoch, not {stamp_ns!r}"
        ) from None
    if not -LATEST_STAMP_NS <= stamp <= LATEST_STAMP_NS:
        raise InvalidArgumentException(
            f"the {what} {stamp} is not within 146 years of 1970: it must count nanoseconds"
        )
    return stamp


def _numbers(values: ArrayLike, count: int, what: str) -> Any:
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InvalidArgumentException(
            f"{what}: expected {count} numbers, got {values!r}"
        ) from None
    if array.shape != (count,):
        raise InvalidArgumentException(f"{what}: expected shape ({count},), got {array.shape}")
    numbers = array.tolist()
    if not all(map(isfinite, numbers)):
        raise InvalidArgumentException(f"{what} is {numbers}; all numbers must be finite")
    return numbers


def _read_only(*values: float) -> Floats:
    array = np.array(values)
    array.flags.writeable = False
    return array
