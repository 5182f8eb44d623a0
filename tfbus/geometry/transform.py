"""Rigid motions: `Transform`, and `TransformStamped`, which adds its frames and stamp.

A transform takes points of a child frame into its parent: `p_parent = T @ p_child`. Written as
parent-from-child the letters cancel: `T_map_tool = T_map_base @ T_base_tool`. Lengths are in
metres, angles in radians, quaternions are x, y, z, w, times are integer nanoseconds since the
Unix epoch.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from math import atan2, hypot, isfinite, pi, radians
from operator import index
from typing import Any, TypeAlias, overload

from tfbus.base import lazy_numpy as np
from tfbus.base.arguments import SourceSignature, called_as
from tfbus.base.errors import InvalidArgumentException
from tfbus.base.lazy_numpy import ArrayLike, NDArray
from tfbus.base.stamps import LATEST_STAMP_NS
from tfbus.base.wording import mistake_in
from tfbus.geometry.kernel import (
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
from tfbus.geometry.rotations import (
    angles_of,
    euler_axes,
    is_rotation,
    looking,
    matrix_of,
    quaternion_about,
    quaternion_of_matrix,
    unit_quaternion,
)

try:
    import cython
except ImportError:
    from tfbus.base import cython_stub as cython

Floats: TypeAlias = "NDArray[np.float64]"
# The points of `T @ points`.
Points: TypeAlias = "NDArray[Any] | Sequence[float] | Sequence[Sequence[float]]"

# The tolerance of a homogeneous matrix's last row, 0 0 0 1.
LAST_ROW_WITHIN = 1e-9

_LARGEST = sys.float_info.max

_STAMP_COMES_FIRST = (
    "; the stamp comes first: TransformStamped(stamp_ns, frame_id, child_frame_id, transform), or "
    "without one TransformStamped(frame_id=..., child_frame_id=..., transform=...)"
)


@cython.freelist(256)
@cython.cclass
class Transform:
    """An immutable rigid motion: a rotation, then a translation.

    `xyz` is the translation (3,) in metres, `quat_xyzw` the rotation (4,) as a unit quaternion.
    A quaternion whose squared norm is within 0.01 of one is normalised; any other, and numbers
    that are not finite, raise InvalidArgumentException.

    `T @ points` takes points (3,) or (N, 3) into the parent, as `apply`; `~T` is the inverse;
    `np.asarray(T)` is the matrix (4, 4). `==` compares the seven numbers exactly; `is_close` asks
    whether two motions are the same.
    """

    __signature__ = SourceSignature()
    __slots__ = ("_pose",)

    # `array @ transform` is not for numpy to answer, which would take the transform's matrix.
    __array_ufunc__ = None

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
    @called_as("Transform.from_quat_wxyz((w, x, y, z), (x, y, z))")
    def from_quat_wxyz(quat_wxyz: ArrayLike, xyz: ArrayLike = (0, 0, 0)) -> "Transform":
        """From a quaternion (4,) with its scalar first: w, x, y, z, as Eigen's constructor, MuJoCo
        and pytransform3d have it. The order x, y, z, w is as in `Transform(xyz, quat_xyzw)`.
        """
        w, x, y, z = _numbers(quat_wxyz, 4, "quat_wxyz")
        return Transform(xyz, (x, y, z, w))

    @staticmethod
    def from_matrix(matrix: ArrayLike, xyz: ArrayLike | None = None) -> "Transform":
        """From a homogeneous matrix (4, 4), or (3, 4) without its last row; or from a rotation's
        matrix (3, 3) and a translation `xyz` (3,), by default 0.

        Raises InvalidArgumentException unless the left (3, 3) is a rotation (to 1e-5) and the
        last row is 0 0 0 1.
        """
        m = as_floats(matrix, "matrix")
        if m.shape == (3, 3):
            m = np.column_stack((m, _numbers((0, 0, 0) if xyz is None else xyz, 3, "xyz")))
        elif xyz is not None:
            raise InvalidArgumentException(
                f"matrix: expected shape (3, 3) beside xyz, got {m.shape}"
            )
        if m.shape not in ((4, 4), (3, 4)):
            raise InvalidArgumentException(
                f"matrix: expected shape (4, 4), (3, 4) or (3, 3), got {m.shape}"
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
    @called_as("Transform.from_rpy(roll, pitch, yaw, (x, y, z)), or Transform.from_rpy(*rpy)")
    def from_rpy(
        roll: float,
        pitch: float,
        yaw: float,
        xyz: ArrayLike = (0, 0, 0),
        *,
        degrees: bool = False,
    ) -> "Transform":
        """From roll, pitch and yaw in radians, or in degrees with `degrees=True`, about the fixed
        axes x, y and z in that order.

        The convention of URDF and of tf2's setRPY; the same as "xyz" of `from_euler`.
        """
        return Transform.from_euler("xyz", (roll, pitch, yaw), xyz, degrees=degrees)

    @staticmethod
    def from_euler(
        axes: str, angles: ArrayLike, xyz: ArrayLike = (0, 0, 0), *, degrees: bool = False
    ) -> "Transform":
        """From three angles (3,), in radians or degrees, about three axes, named as scipy names
        them.

        Lower case ("xyz") turns about the fixed axes of the parent in that order, upper case
        ("ZYX") about the axes of the turning frame. Neighbouring axes differ.
        """
        order, fixed = euler_axes(axes)
        rotation = Transform.identity()
        for axis, angle in zip(order, _angles(angles, "angles", degrees), strict=True):
            turn = Transform((0, 0, 0), quaternion_about(axis, angle))
            rotation = turn @ rotation if fixed else rotation @ turn
        return Transform(xyz, rotation._quaternion())

    @staticmethod
    @called_as("Transform.from_rotvec((rx, ry, rz), (x, y, z))")
    def from_rotvec(
        rotvec: ArrayLike, xyz: ArrayLike = (0, 0, 0), *, degrees: bool = False
    ) -> "Transform":
        """From a rotation vector (3,): the axis, as long as the angle in radians, or degrees."""
        x, y, z = _angles(rotvec, "rotvec", degrees)
        return Transform(xyz, exp_twist(0.0, 0.0, 0.0, x, y, z)[3:])

    @staticmethod
    def look_at(
        eye: ArrayLike,
        target: ArrayLike,
        up: ArrayLike = (0, 0, 1),
        *,
        convention: str = "robot",
    ) -> "Transform":
        """The pose of a frame at `eye` that looks at `target`, in the frame of these points (3,).

        With the convention "robot" x points at the target, y to the left and z upwards; with
        "camera", as of optical frames, z points at the target, x to the right and y downwards. The
        upper side is as near to `up` (3,) as that allows.

        Raises InvalidArgumentException if eye and target are the same point, or `up` is
        parallel to the line between them.
        """
        at = _numbers(eye, 3, "eye")
        ahead = np.array(_numbers(target, 3, "target")) - at
        rotation = looking(ahead, np.array(_numbers(up, 3, "up")), convention)
        return Transform(at, quaternion_of_matrix(rotation.tolist()))

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
        """Translation along this axis, in metres."""
        return self._pose[0]

    @property
    def y(self) -> float:
        """Translation along this axis, in metres."""
        return self._pose[1]

    @property
    def z(self) -> float:
        """Translation along this axis, in metres."""
        return self._pose[2]

    @property
    def qx(self) -> float:
        """A component of the quaternion; `qw` is the scalar."""
        return self._pose[3]

    @property
    def qy(self) -> float:
        """A component of the quaternion; `qw` is the scalar."""
        return self._pose[4]

    @property
    def qz(self) -> float:
        """A component of the quaternion; `qw` is the scalar."""
        return self._pose[5]

    @property
    def qw(self) -> float:
        """A component of the quaternion; `qw` is the scalar."""
        return self._pose[6]

    @property
    def xyz(self) -> Floats:
        """The translation, a read-only array (3,) in metres."""
        return _read_only(self._pose[0], self._pose[1], self._pose[2])

    @property
    def quat_xyzw(self) -> Floats:
        """The rotation, a read-only array (4,): the unit quaternion x, y, z, w."""
        return _read_only(*self._quaternion())

    @property
    def quat_wxyz(self) -> Floats:
        """The rotation, a read-only array (4,): the unit quaternion w, x, y, z."""
        return _read_only(self._pose[6], self._pose[3], self._pose[4], self._pose[5])

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

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """The homogeneous matrix (4, 4), for `np.asarray`."""
        return new_array(self.as_matrix(), dtype, copy)

    def as_rpy(self, *, degrees: bool = False) -> tuple[float, float, float]:
        """Roll, pitch and yaw in radians, or degrees, as `from_rpy` takes them.

        Pitch is from -pi/2 to pi/2; at either end (gimbal lock) yaw is 0.
        """
        return self.as_euler("xyz", degrees=degrees)

    def as_euler(self, axes: str, *, degrees: bool = False) -> tuple[float, float, float]:
        """Three angles in radians, or degrees, about the axes, as `from_euler` takes them.

        In gimbal lock one of the outer angles is free: the third is 0. Method: Bernardes and
        Viollet, Quaternion to Euler angles conversion, PLOS ONE 2022.
        """
        first, second, third = angles_of(axes, self._quaternion())
        unit = 180.0 / pi if degrees else 1.0
        return first * unit, second * unit, third * unit

    def as_rotvec(self, *, degrees: bool = False) -> Floats:
        """The rotation vector (3,): the axis, as long as the angle, 0 to pi radians, or 180
        degrees.
        """
        _, _, _, wx, wy, wz = log_pose(self._pose)
        rotvec = np.array((wx, wy, wz))
        return np.degrees(rotvec) if degrees else rotvec

    def log(self) -> Floats:
        """The constant twist (6,) that makes this motion in unit time: linear (m), angular (rad).

        The inverse of `exp`. The angle is at most half a turn.
        """
        return np.array(log_pose(self._pose))

    def to_dict(self) -> dict[str, list[float]]:
        """`xyz` and `quat_xyzw` as lists, for JSON, YAML or msgpack; `from_dict` reads it back."""
        return {"xyz": list(self._pose[:3]), "quat_xyzw": list(self._quaternion())}

    @staticmethod
    def from_dict(values: Mapping[str, Any]) -> "Transform":
        """From a map as `to_dict` returns it; other keys are not read.

        Raises InvalidArgumentException if a key is missing.
        """
        xyz, quat_xyzw = take(values, "xyz", "quat_xyzw")
        return Transform(xyz, quat_xyzw)

    @staticmethod
    def from_scipy(rotation: Any, xyz: ArrayLike = (0, 0, 0)) -> "Transform":
        """From a scipy Rotation with a translation, or from a scipy RigidTransform."""
        xyz, quat_xyzw = scipy_parts(rotation, xyz)
        return Transform(xyz, quat_xyzw)

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

    def __invert__(self) -> "Transform":
        """The motion back: `~T_a_b` is `T_b_a`."""
        return make_transform(invert(self._pose))

    @overload
    def __matmul__(self, other: "Transform") -> "Transform": ...

    @overload
    def __matmul__(self, other: "Points") -> Floats: ...

    def __matmul__(self, other: "Transform | Points") -> "Transform | Floats":
        """First `other`, then this: `T_a_c = T_a_b @ T_b_c`.

        Points (3,) or (N, 3) of the child frame are taken into the parent, as by `apply`.
        """
        if isinstance(other, Transform):
            return make_transform(normalised(compose(self._pose, pose_of(other))))
        if isinstance(other, list | tuple | np.ndarray):
            return self.apply(operand_points(other))
        return NotImplemented

    def __rmatmul__(self, other: object) -> Any:
        if isinstance(other, list | tuple | np.ndarray):
            raise InvalidArgumentException(POINTS_COME_SECOND)
        return NotImplemented

    def __mul__(self, other: object) -> Any:
        raise TypeError(APPLIED_WITH_AT)

    def __rmul__(self, other: object) -> Any:
        raise TypeError(APPLIED_WITH_AT)

    def apply(self, points: ArrayLike) -> Floats:
        """Points (3,) or (N, 3) of the child frame, taken into the parent.

        Any array (..., 3), such as the points of a depth image (H, W, 3), keeps its shape.
        """
        return self._rotated(points, "points") + self.xyz

    def rotate(self, vectors: ArrayLike) -> Floats:
        """Vectors (3,) or (N, 3), such as velocities, turned but not moved."""
        return self._rotated(vectors, "vectors")

    def _rotated(self, vectors: ArrayLike, what: str) -> Floats:
        array = as_floats(vectors, what)
        if array.ndim == 0 or array.shape[-1] != 3:
            raise InvalidArgumentException(
                f"{what}: expected shape (3,) or (N, 3), got {array.shape}"
            )
        rotated: Floats = array @ np.array(matrix_of(*self._quaternion())).T
        return rotated

    def distance(self, other: "Transform") -> float:
        """How far apart the origins of the two frames are, in metres."""
        x, y, z, _, _, _, _ = pose_of(checked_transform(other))
        return hypot(x - self._pose[0], y - self._pose[1], z - self._pose[2])

    def angle(self, other: "Transform", *, degrees: bool = False) -> float:
        """How far one is turned against the other: 0 to pi radians, or 180 degrees, about one
        axis.
        """
        _, _, _, qx, qy, qz, qw = relative(self._pose, pose_of(checked_transform(other)))
        angle = 2.0 * atan2(hypot(qx, qy, qz), abs(qw))
        return angle * (180.0 / pi) if degrees else angle

    def interpolate(self, other: "Transform", ratio: float) -> "Transform":
        """As tf2 does: the translation on a straight line, the rotation by slerp the short way
        round. `ratio` 0 is this one, 1 the other; it must be finite.
        """
        return make_transform(
            normalised(
                lerp_slerp(self._pose, pose_of(checked_transform(other)), _finite(ratio, "ratio"))
            )
        )

    def interpolate_screw(self, other: "Transform", ratio: float) -> "Transform":
        """Along the screw from this one (`ratio` 0) to the other (1), at constant speed.

        Unlike `interpolate`, the motion does not depend on where the frame's origin is.
        """
        return make_transform(
            sclerp(self._pose, pose_of(checked_transform(other)), _finite(ratio, "ratio"))
        )

    def is_close(self, other: "Transform", atol: float = 1e-9) -> bool:
        """Whether both are the same motion: translations within `atol` metres on each axis,
        rotations within `atol` radians. A quaternion and its negative are the same rotation.
        """
        _, _, _, qx, qy, qz, _ = relative(self._pose, pose_of(checked_transform(other)))
        atol = as_number(atol, "atol")
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
        # Adding 0.0 turns -0.0 into 0.0.
        x, y, z, qx, qy, qz, qw = (f"{number + 0.0:.9g}" for number in self._pose)
        return f"Transform(xyz=({x}, {y}, {z}), quat_xyzw=({qx}, {qy}, {qz}, {qw}))"


@cython.freelist(256)
@cython.no_gc
@cython.cclass
class TransformStamped:
    """A transform between two frames at one time; immutable.

    `frame_id` is the parent, `child_frame_id` the child; the transform takes points of the child
    into the parent. `stamp_ns` is nanoseconds since the Unix epoch; a static transform needs none.
    `extrapolated_ns` is how far the answer of a lookup lies beyond the samples it was made from.

    Raises InvalidArgumentException for frame ids that are empty or begin with a slash, and for a
    stamp that is no integer.
    """

    __signature__ = SourceSignature()
    # The pose is not kept as a Transform, which most lookups would make without need. `_child` is
    # the child frame's name, or a tuple of the name and `extrapolated_ns` where that is not 0: few
    # are extrapolated, and without a number for it a transform takes 96 bytes rather than 112.
    __slots__ = ("_child", "_frame_id", "_pose", "_stamp_ns")

    # Numpy would take it for a scalar of any type.
    __array_ufunc__ = None

    def __init__(
        self,
        stamp_ns: int = 0,
        frame_id: str = "",
        child_frame_id: str = "",
        transform: Transform | None = None,
        *,
        extrapolated_ns: int = 0,
    ) -> None:
        self._stamp_ns = check_stamp(stamp_ns, "stamp", _STAMP_COMES_FIRST)
        self._frame_id = check_frame_id(frame_id, "frame_id")
        # It may be the parent's name: so is the answer to a lookup of a frame from itself. Buffers
        # and broadcasters, which look at both anyway, refuse it.
        child = check_frame_id(child_frame_id, "child_frame_id")
        self._pose = pose_of(checked_transform(transform, "transform"))
        beyond = check_stamp(extrapolated_ns, "extrapolated_ns")
        self._child = (child, beyond) if beyond else child

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
        return child_name(self)

    @property
    def transform(self) -> Transform:
        """Takes points of the child frame into the parent."""
        return make_transform(self._pose)

    @property
    def extrapolated_ns(self) -> int:
        """How far the answer lies beyond the samples it was made from; 0 between them."""
        return 0 if isinstance(self._child, str) else self._child[1]

    def __matmul__(self, other: object) -> Any:
        raise InvalidArgumentException(
            "a TransformStamped has frames and a stamp: @ takes its .transform"
        )

    def to_dict(self) -> dict[str, Any]:
        """`stamp_ns`, `frame_id`, `child_frame_id`, `xyz` and `quat_xyzw`, for JSON, YAML or
        msgpack; `extrapolated_ns` only if it is not 0. `from_dict` reads it back.

        The names are the same as in `tfbus echo --format json`.
        """
        values = {
            "stamp_ns": self._stamp_ns,
            "frame_id": self._frame_id,
            "child_frame_id": self.child_frame_id,
            **self.transform.to_dict(),
        }
        if self.extrapolated_ns:
            values["extrapolated_ns"] = self.extrapolated_ns
        return values

    @staticmethod
    def from_dict(values: Mapping[str, Any]) -> "TransformStamped":
        """From a map as `to_dict` returns it, or a line of `tfbus echo --format json`; other keys
        are not read.

        Raises InvalidArgumentException if a key is missing; without `stamp_ns` the stamp is 0.
        """
        frame_id, child_frame_id = take(values, "frame_id", "child_frame_id")
        return TransformStamped(
            values.get("stamp_ns", 0),
            frame_id,
            child_frame_id,
            Transform.from_dict(values),
            extrapolated_ns=values.get("extrapolated_ns", 0),
        )

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, TransformStamped):
            return NotImplemented
        return self._fields() == other._fields()

    def __hash__(self) -> int:
        return hash(self._fields())

    def __reduce__(self) -> tuple[Any, ...]:
        return make_stamped, self._fields()

    def __repr__(self) -> str:
        beyond = f", extrapolated_ns={self.extrapolated_ns}" if self.extrapolated_ns else ""
        return (
            f"TransformStamped({self._stamp_ns}, {self._frame_id!r}, {self.child_frame_id!r}, "
            f"{self.transform!r}{beyond})"
        )

    def _fields(self) -> tuple[int, str, str, Pose, int]:
        return (
            self._stamp_ns,
            self._frame_id,
            child_name(self),
            self._pose,
            self.extrapolated_ns,
        )


def child_name(transform: TransformStamped) -> str:
    """`child_frame_id`, for compiled callers: a property is slower for them."""
    child = transform._child
    return child if isinstance(child, str) else child[0]


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


def checked_transform(value: Any, what: str = "other") -> Transform:
    """The transform. Raises InvalidArgumentException, which calls it `what`, for another type."""
    if not isinstance(value, Transform):
        hint = "; its .transform is one" if isinstance(value, TransformStamped) else ""
        if isinstance(value, tuple | list):
            hint = "; Transform((x, y, z), (qx, qy, qz, qw)) makes one"
        raise InvalidArgumentException(
            f"{what}: expected a tfbus.Transform, got {_type_of(value)}{hint}"
        )
    return value


def stamped_list(transforms: Any) -> list[TransformStamped]:
    """The transforms as a list. Raises InvalidArgumentException if one is of another type."""
    try:
        stamped = list(transforms)
    except TypeError:
        raise _not_stamped(transforms) from None
    for transform in stamped:
        if not isinstance(transform, TransformStamped):
            raise _not_stamped(transform)
    return stamped


def make_stamped(
    stamp_ns: int, frame_id: str, child_frame_id: str, pose: Pose, extrapolated_ns: int
) -> TransformStamped:
    """A TransformStamped from parts that were checked before."""
    self = TransformStamped.__new__(TransformStamped)
    self._stamp_ns = stamp_ns
    self._frame_id = frame_id
    if extrapolated_ns:
        self._child = (child_frame_id, extrapolated_ns)
    else:
        self._child = child_frame_id
    self._pose = pose
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


def check_text(text: object, what: str) -> str:
    """The text as a plain str. Raises InvalidArgumentException for anything but a text."""
    if not isinstance(text, str):
        raise InvalidArgumentException(f"{what} must be a str, not {type(text).__name__}")
    return plain(text)


def check_stamp(stamp_ns: object, what: str = "stamp", of_text: str = "") -> int:
    """The stamp as an int. Raises InvalidArgumentException if it cannot be one, which says
    `of_text` of a str.
    """
    try:
        if type(stamp_ns) is not int and _is_masked(stamp_ns):
            raise TypeError
        stamp = index(stamp_ns)  # type: ignore[arg-type]  # judged by index itself
    except TypeError:
        hint = of_text if isinstance(stamp_ns, str) else "; tfbus.stamp_ns(...) converts it"
        raise InvalidArgumentException(
            f"a {what} must be an integer, nanoseconds since the Unix epoch, not {stamp_ns!r}{hint}"
        ) from None
    if not -LATEST_STAMP_NS <= stamp <= LATEST_STAMP_NS:
        raise InvalidArgumentException(
            f"the {what} {stamp} is not within 146 years of 1970: it must count nanoseconds"
        )
    return stamp


def _is_masked(value: object) -> bool:
    """Whether it is a masked array's missing value, which numpy takes for a number."""
    return "numpy" in sys.modules and bool(np.ma.is_masked(value))


# The error of both kinds of transforms for `points @ T`.
POINTS_COME_SECOND = "the points come second: T @ points, or T.apply(points)"
APPLIED_WITH_AT = "a Transform is applied with @: T @ points, T_a_b @ T_b_c"


def operand_points(points: Any) -> Floats:
    """The points of `T @ points`. Raises InvalidArgumentException if that is another array."""
    array = as_floats(points, "points")
    if array.shape != (3,) and (array.ndim != 2 or array.shape[1] != 3):
        raise InvalidArgumentException(
            f"T @ points: expected points of shape (3,) or (N, 3), got {array.shape}; "
            "T.apply(points) takes any shape (..., 3), and np.asarray(T) is the matrix (4, 4)"
        )
    return array


def take(values: Mapping[str, Any], *keys: str) -> list[Any]:
    """The values of these keys. Raises InvalidArgumentException if one is missing."""
    if not isinstance(values, Mapping):
        raise InvalidArgumentException(
            f"expected a dict with {' and '.join(keys)}, got {_type_of(values)}"
        )
    for key in keys:
        if key not in values:
            raise InvalidArgumentException(
                f"{key!r} is missing: expected a dict with {' and '.join(keys)}"
            )
    return [values[key] for key in keys]


def scipy_parts(rotation: Any, xyz: ArrayLike) -> tuple[ArrayLike, Any]:
    """The translation and the quaternion x, y, z, w of scipy's Rotation or RigidTransform.

    Raises InvalidArgumentException for another type.
    """
    if hasattr(rotation, "as_components"):
        xyz, rotation = rotation.as_components()
    if not hasattr(rotation, "as_quat"):
        raise InvalidArgumentException(
            "rotation: expected a Rotation or RigidTransform of scipy.spatial.transform, got "
            f"{_type_of(rotation)}"
        )
    return xyz, rotation.as_quat()


def new_array(array: Floats, dtype: Any, copy: bool | None) -> NDArray[Any]:
    """An array that was just made, for `__array__`: numpy must not be promised that it is not a
    copy.
    """
    if copy is False:
        raise ValueError("the matrix of a transform is always a new array: use np.asarray")
    return array if dtype is None else array.astype(dtype, copy=False)


def _not_stamped(value: object) -> InvalidArgumentException:
    hint = ": TransformStamped(stamp_ns, frame_id, child_frame_id, transform) adds its frames"
    return InvalidArgumentException(
        f"transforms: expected tfbus.TransformStamped, got {_type_of(value)}"
        f"{hint if isinstance(value, Transform) else ''}"
    )


def _type_of(value: object) -> str:
    return "None" if value is None else type(value).__name__


def _angles(values: ArrayLike, what: str, degrees: bool) -> Sequence[float]:
    """Three angles (3,) in radians."""
    angles: list[float] = _numbers(values, 3, what)
    return [radians(angle) for angle in angles] if degrees else angles


def as_floats(values: ArrayLike, what: str) -> Floats:
    """The values as an array. Raises InvalidArgumentException, which calls them `what`, if they
    are none.
    """
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InvalidArgumentException(
            f"{what}: expected an array of numbers, got {values!r:.60}"
        ) from None


def as_number(value: Any, what: str) -> float:
    """The number. Raises InvalidArgumentException, which calls it `what`, for another type."""
    if type(value) is float:
        return value
    try:
        if isinstance(value, str | bytes):
            raise TypeError
        return float(value)
    except (TypeError, ValueError, OverflowError):
        raise InvalidArgumentException(
            f"{what}: expected a number, got {_type_of(value)}"
        ) from None


def _finite(value: Any, what: str) -> float:
    number = as_number(value, what)
    if not isfinite(number):
        raise InvalidArgumentException(f"{what} must be a finite number, not {number}")
    return number


def _plain_numbers(values: Any, count: int) -> list[float] | None:
    """The numbers if they are Python's own, as most are: these need no numpy."""
    if type(values) not in (tuple, list) or len(values) != count:
        return None
    for value in values:
        if type(value) is not float and type(value) is not int:
            return None
        if not -_LARGEST <= value <= _LARGEST:
            return None
    return [float(value) for value in values]


def _numbers(values: ArrayLike, count: int, what: str) -> Any:
    numbers = _plain_numbers(values, count)
    if numbers is not None:
        return numbers
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
