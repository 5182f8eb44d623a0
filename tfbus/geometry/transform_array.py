"""Many transforms as arrays: the answer to a lookup of many stamps, and its arithmetic."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from operator import index
from typing import Any, ClassVar, TypeAlias, overload

from tfbus.base import lazy_numpy as np
from tfbus.base.errors import InvalidArgumentException
from tfbus.base.lazy_numpy import ArrayLike, NDArray
from tfbus.geometry.kernel import QUATERNION_TOLERANCE, UNIT_TO_THE_LAST_BIT
from tfbus.geometry.rotations import (
    angles_of_rows,
    are_rotations,
    looking,
    matrices_of,
    product,
    quaternions_of_angles,
    quaternions_of_matrices,
)
from tfbus.geometry.transform import (
    LAST_ROW_WITHIN,
    POINTS_COME_SECOND,
    Points,
    Transform,
    as_floats,
    as_number,
    checked_transform,
    new_array,
    operand_points,
    scipy_parts,
    take,
)

Floats: TypeAlias = "NDArray[np.float64]"
# A choice of rows: a slice, a mask (N,), or indices.
Rows: TypeAlias = "slice | NDArray[np.bool_] | NDArray[np.intp] | Sequence[bool] | Sequence[int]"

# Below this angle quotients of sines lose digits, and the first terms of their series do not.
_SMALL_ANGLE = 1e-3
# Of more rows than twice this, `repr` shows only the first and the last.
_SHOWN = 3


class TransformArray(Sequence[Transform]):
    """A sequence of N transforms: `xyz` (N, 3) in metres, `quat_xyzw` (N, 4) unit quaternions.

    `len`, iteration and `array[i]` give each `Transform`; a slice, a mask (N,) or indices give a
    `TransformArray`. All methods work row by row, with arrays of N rows for one; a single
    `Transform` is combined with each row. `==` compares all numbers exactly.

    Either array may be a single row, (3,) or (4,), for all rows of the other; both are
    kept without a copy if they can be. A row of NaN is an unknown transform, as
    `Buffer.lookup_known_transforms` returns it. Raises InvalidArgumentException as `Transform`.
    """

    __slots__ = ("_quat_xyzw", "_xyz")

    # `array @ transforms` is not for numpy to answer, which would take their matrices.
    __array_ufunc__: ClassVar[None] = None

    def __init__(self, xyz: ArrayLike, quat_xyzw: ArrayLike = (0, 0, 0, 1)) -> None:
        translations, quaternions = as_floats(xyz, "xyz"), as_floats(quat_xyzw, "quat_xyzw")
        if translations.shape == (3,) and quaternions.ndim == 2:
            translations = np.tile(translations, (len(quaternions), 1))
        if quaternions.shape == (4,) and translations.ndim == 2:
            quaternions = np.tile(quaternions, (len(translations), 1))
        self._xyz = _rows(translations, (3,), "xyz")
        self._quat_xyzw = _rows(quaternions, (4,), "quat_xyzw")
        if len(translations) != len(quaternions):
            raise InvalidArgumentException(
                f"xyz has {len(translations)} rows, quat_xyzw {len(quaternions)}; expected as many"
            )
        self._normalise()

    def _normalise(self) -> None:
        """Make the quaternions unit ones, as `Transform` does."""
        square = np.sum(self._quat_xyzw * self._quat_xyzw, axis=1)
        off = np.abs(square - 1.0)
        wrong = ~((off < QUATERNION_TOLERANCE) & np.isfinite(self._xyz).all(axis=1))
        for i in np.flatnonzero(wrong & ~self._unknown()).tolist():
            try:
                Transform(self._xyz[i], self._quat_xyzw[i])
            except InvalidArgumentException as error:
                raise InvalidArgumentException(f"row {i}: {error}") from None
        inexact = off > UNIT_TO_THE_LAST_BIT
        if inexact.any():
            norm = np.where(inexact, np.sqrt(square), 1.0)
            self._quat_xyzw = self._quat_xyzw / norm[:, np.newaxis]

    def _unknown(self) -> NDArray[np.bool_]:
        is_nan = np.isnan(np.hstack((self._xyz, self._quat_xyzw)))
        is_unknown: NDArray[np.bool_] = np.all(is_nan, axis=1)
        return is_unknown

    # Making them

    @staticmethod
    def of(transforms: Iterable[Transform]) -> "TransformArray":
        """The transforms as the rows of one array."""
        poses = np.array(
            [checked_transform(each, "transforms").as_pose() for each in transforms]
        ).reshape(-1, 7)
        return make_array(poses[:, :3], poses[:, 3:])

    @staticmethod
    def concatenate(parts: "Iterable[TransformArray | Transform]") -> "TransformArray":
        """The rows of all parts, one part after the other; a single `Transform` is one row."""
        arrays = [_as_array(part, "parts") for part in parts]
        nothing = make_array(np.empty((0, 3)), np.empty((0, 4)))
        return make_array(
            np.concatenate([nothing.xyz, *(array.xyz for array in arrays)]),
            np.concatenate([nothing.quat_xyzw, *(array.quat_xyzw for array in arrays)]),
        )

    @staticmethod
    def from_quat_wxyz(quat_wxyz: ArrayLike, xyz: ArrayLike = (0, 0, 0)) -> "TransformArray":
        """From quaternions (N, 4) with their scalar first, as `Transform.from_quat_wxyz`; `xyz` is
        (N, 3) or (3,).
        """
        return TransformArray(xyz, _rows(quat_wxyz, (4,), "quat_wxyz")[:, [1, 2, 3, 0]])

    @staticmethod
    def from_matrix(matrices: ArrayLike, xyz: ArrayLike | None = None) -> "TransformArray":
        """From homogeneous matrices (N, 4, 4), or (N, 3, 4) without their last rows; or from
        rotations' matrices (N, 3, 3) and translations `xyz`, (N, 3) or (3,).

        Raises as `Transform.from_matrix`.
        """
        rows = as_floats(matrices, "matrices")
        if rows.ndim != 3 or rows.shape[1:] not in ((4, 4), (3, 4), (3, 3)):
            raise InvalidArgumentException(
                f"matrices: expected shape (N, 4, 4), (N, 3, 4) or (N, 3, 3), got {rows.shape}"
            )
        if xyz is not None and rows.shape[1:] != (3, 3):
            raise InvalidArgumentException(
                f"matrices: expected shape (N, 3, 3) beside xyz, got {rows.shape}"
            )
        rotations = rows[:, :3, :3]
        wrong = ~np.isfinite(rows).all(axis=(1, 2))
        if rows.shape[1] == 4:
            wrong |= ~np.isclose(rows[:, 3], (0, 0, 0, 1), atol=LAST_ROW_WITHIN).all(axis=1)
        if not wrong.any():
            wrong = ~are_rotations(rotations)
        for row in rows[wrong]:
            Transform.from_matrix(row)  # raises, with the reason
        if rows.shape[2] == 4:
            return make_array(rows[:, :3, 3].copy(), quaternions_of_matrices(rotations))
        return _moved(quaternions_of_matrices(rotations), (0, 0, 0) if xyz is None else xyz)

    @staticmethod
    def from_euler(
        axes: str, angles: ArrayLike, xyz: ArrayLike = (0, 0, 0), *, degrees: bool = False
    ) -> "TransformArray":
        """From three angles a row (N, 3), in radians or degrees, as `Transform.from_euler`; `xyz`
        is (N, 3) or (3,).
        """
        rows = _rows(angles, (3,), "angles")
        for row in rows[~np.isfinite(rows).all(axis=1)]:
            Transform.from_euler(axes, row)  # raises, with the reason
        return _moved(quaternions_of_angles(axes, np.radians(rows) if degrees else rows), xyz)

    @staticmethod
    def from_rpy(
        rpy: ArrayLike, xyz: ArrayLike = (0, 0, 0), *, degrees: bool = False
    ) -> "TransformArray":
        """From roll, pitch and yaw (N, 3), in radians or degrees, as `Transform.from_rpy`; `xyz` is
        (N, 3) or (3,).
        """
        return TransformArray.from_euler("xyz", rpy, xyz, degrees=degrees)

    @staticmethod
    def from_rotvec(
        rotvecs: ArrayLike, xyz: ArrayLike = (0, 0, 0), *, degrees: bool = False
    ) -> "TransformArray":
        """From rotation vectors (N, 3), each as long as its angle in radians, or degrees; `xyz` is
        (N, 3) or (3,).
        """
        turns = _rows(rotvecs, (3,), "rotvecs")
        if degrees:
            turns = np.radians(turns)
        return _moved(TransformArray.exp(np.hstack((np.zeros_like(turns), turns))).quat_xyzw, xyz)

    @staticmethod
    def look_at(
        eye: ArrayLike,
        target: ArrayLike,
        up: ArrayLike = (0, 0, 1),
        *,
        convention: str = "robot",
    ) -> "TransformArray":
        """The poses of frames at `eye` that look at `target`, each (N, 3), or (3,) for all of them,
        as `Transform.look_at`.
        """
        at, to = np.atleast_2d(_finite(eye, "eye"), _finite(target, "target"))
        above = _finite(up, "up")
        if at.shape[1:] != (3,) or to.shape[1:] != (3,) or above.shape != (3,):
            raise InvalidArgumentException(
                f"expected eye and target of shape (N, 3) or (3,) and up of shape (3,), got "
                f"{np.shape(eye)}, {np.shape(target)} and {above.shape}"
            )
        at, to = _paired(at, to, "eyes", "targets")
        return make_array(at.copy(), quaternions_of_matrices(looking(to - at, above, convention)))

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
        return make_array(xyz, np.hstack((angular * half, np.cos(0.5 * angle))))

    @staticmethod
    def from_scipy(rotation: Any, xyz: ArrayLike = (0, 0, 0)) -> "TransformArray":
        """From scipy's Rotation of N with translations (N, 3) or (3,), or its RigidTransform."""
        xyz, quat_xyzw = scipy_parts(rotation, xyz)
        return _moved(np.atleast_2d(quat_xyzw), xyz)

    @staticmethod
    def from_dict(values: Mapping[str, Any]) -> "TransformArray":
        """From a map with `xyz` (N, 3) and `quat_xyzw` (N, 4), as `to_dict` returns it."""
        xyz, quat_xyzw = take(values, "xyz", "quat_xyzw")
        return TransformArray(np.reshape(xyz, (-1, 3)), np.reshape(quat_xyzw, (-1, 4)))

    # Reading them

    @property
    def xyz(self) -> Floats:
        """The translations (N, 3) in metres."""
        return self._xyz

    @property
    def quat_xyzw(self) -> Floats:
        """The rotations (N, 4): unit quaternions x, y, z, w."""
        return self._quat_xyzw

    @property
    def quat_wxyz(self) -> Floats:
        """A copy of the rotations (N, 4) with their scalar first: w, x, y, z."""
        return self._quat_xyzw[:, [3, 0, 1, 2]]

    def __len__(self) -> int:
        return len(self._xyz)

    @overload
    def __getitem__(self, rows: int) -> Transform: ...

    @overload
    def __getitem__(self, rows: "Rows") -> "TransformArray": ...

    def __getitem__(self, rows: Any) -> "Transform | TransformArray":
        """Transform i; or the transforms of a slice, of a mask (N,), or of indices.

        Raises IndexError as numpy does, and InvalidArgumentException for transform i if that is
        unknown.
        """
        xyz, quat_xyzw = self._xyz[rows], self._quat_xyzw[rows]
        if xyz.shape == (3,):
            return _single(xyz.tolist(), quat_xyzw.tolist())
        if xyz.ndim != 2 or isinstance(rows, tuple):
            raise IndexError(
                "expected one index, a slice, a mask (N,) or indices; columns are those of .xyz "
                "and .quat_xyzw"
            )
        return make_array(xyz, quat_xyzw)

    def __iter__(self) -> Iterator[Transform]:
        """Each transform. Raises InvalidArgumentException at one that is unknown."""
        for xyz, quat_xyzw in zip(self._xyz.tolist(), self._quat_xyzw.tolist(), strict=True):
            yield _single(xyz, quat_xyzw)

    def row(self, i: int) -> Transform:
        """The same as `array[i]`."""
        return self[index(i)]

    def rows(self, chosen: "Rows") -> "TransformArray":
        """The same as `array[chosen]`, of a mask (N,), of indices, or of a slice."""
        return self[chosen]

    def as_matrix(self) -> Floats:
        """The homogeneous matrices (N, 4, 4)."""
        matrices = np.zeros((len(self.xyz), 4, 4))
        matrices[:, :3, :3] = matrices_of(self.quat_xyzw)
        matrices[:, :3, 3] = self.xyz
        matrices[:, 3, 3] = 1.0
        return matrices

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """The homogeneous matrices (N, 4, 4), for `np.asarray`."""
        return new_array(self.as_matrix(), dtype, copy)

    def as_euler(self, axes: str, *, degrees: bool = False) -> Floats:
        """Three angles a row (N, 3), in radians or degrees, as `Transform.as_euler`."""
        angles = angles_of_rows(axes, self.quat_xyzw)
        return np.degrees(angles) if degrees else angles

    def as_rpy(self, *, degrees: bool = False) -> Floats:
        """Roll, pitch and yaw (N, 3), in radians or degrees, as `Transform.as_rpy`."""
        return self.as_euler("xyz", degrees=degrees)

    def as_rotvec(self, *, degrees: bool = False) -> Floats:
        """The rotation vectors (N, 3), each as long as its angle: 0 to pi radians, or 180
        degrees.
        """
        rotvecs = _rotvec(self.quat_xyzw)
        return np.degrees(rotvecs) if degrees else rotvecs

    def to_dict(self) -> dict[str, list[list[float]]]:
        """`xyz` and `quat_xyzw` as lists of rows, as `Transform.to_dict`."""
        return {"xyz": self._xyz.tolist(), "quat_xyzw": self._quat_xyzw.tolist()}

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
        return make_array(-rotate(back, self.xyz), back)

    def __invert__(self) -> "TransformArray":
        """Each motion back."""
        return self.inverse()

    @overload
    def __matmul__(self, other: "TransformArray | Transform") -> "TransformArray": ...

    @overload
    def __matmul__(self, other: "Points") -> Floats: ...

    def __matmul__(self, other: "TransformArray | Transform | Points") -> "TransformArray | Floats":
        """First `other`, then this, row by row: `T_a_c = T_a_b @ T_b_c`.

        Points (N, 3), or one point (3,), of the child frame are taken into the parent, as by
        `apply`.
        """
        if isinstance(other, TransformArray | Transform):
            mine, others = self._paired(other)
            turned = product(mine.quat_xyzw, others.quat_xyzw)
            return make_array(rotate(mine.quat_xyzw, others.xyz) + mine.xyz, turned)
        if isinstance(other, list | tuple | np.ndarray):
            return self.apply(operand_points(other))
        return NotImplemented

    def __rmatmul__(self, other: Transform) -> "TransformArray":
        """A transform after each of these."""
        if isinstance(other, Transform):
            return _as_array(other) @ self
        if isinstance(other, list | tuple | np.ndarray):
            raise InvalidArgumentException(POINTS_COME_SECOND)
        return NotImplemented

    def apply(self, points: ArrayLike) -> Floats:
        """Point i of (N, 3), or one point (3,), taken by transform i from the child into the
        parent: (N, 3).
        """
        return self._rotated(points, "points") + self.xyz

    def rotate(self, vectors: ArrayLike) -> Floats:
        """Vector i of (N, 3), or one vector (3,), such as a velocity, turned by transform i but not
        moved: (N, 3).
        """
        return self._rotated(vectors, "vectors")

    def _rotated(self, vectors: ArrayLike, what: str) -> Floats:
        array = _rows(np.atleast_2d(as_floats(vectors, what)), (3,), what)
        return rotate(*_paired(self.quat_xyzw, array, "transforms", what))

    def distance(self, other: "TransformArray | Transform") -> Floats:
        """How far apart the origins of each two frames are (N,), in metres."""
        mine, others = self._paired(other)
        apart: Floats = np.linalg.norm(mine.xyz - others.xyz, axis=1)
        return apart

    def angle(self, other: "TransformArray | Transform", *, degrees: bool = False) -> Floats:
        """How far each is turned against its other (N,): 0 to pi radians, or 180 degrees."""
        mine, others = self._paired(other)
        turn = product(_conjugate(mine.quat_xyzw), others.quat_xyzw)
        angle: Floats = 2.0 * np.arctan2(np.linalg.norm(turn[:, :3], axis=1), np.abs(turn[:, 3]))
        return np.degrees(angle) if degrees else angle

    def is_close(
        self, other: "TransformArray | Transform", atol: float = 1e-9
    ) -> NDArray[np.bool_]:
        """Which rows (N,) are the same motion as their other, as `Transform.is_close`."""
        mine, others = self._paired(other)
        atol = as_number(atol, "atol")
        near = (np.abs(mine.xyz - others.xyz) <= atol).all(axis=1)
        is_close: NDArray[np.bool_] = near & (mine.angle(others) <= atol)
        return is_close

    def _paired(
        self, other: "TransformArray | Transform"
    ) -> tuple["TransformArray", "TransformArray"]:
        """This and the other, each with as many rows or one."""
        others = _as_array(other)
        _check_paired(len(self), len(others), "transforms", "others")
        return self, others

    def interpolate(
        self, other: "TransformArray | Transform", ratio: ArrayLike
    ) -> "TransformArray":
        """As tf2 does: translations on a straight line, rotations by slerp the short way round.

        `ratio` is one number or (N,), finite: 0 is this one, 1 the other.
        """
        mine, others = self._paired(other)
        part = _ratios(ratio, max(len(mine), len(others)))
        # A part of the rotation from this to the other, which is at most half a turn.
        turn = product(_conjugate(mine.quat_xyzw), others.quat_xyzw)
        some = TransformArray.from_rotvec(_rotvec(turn) * part).quat_xyzw
        straight = (1.0 - part) * mine.xyz + part * others.xyz
        return make_array(straight, product(mine.quat_xyzw, some))

    def interpolate_screw(
        self, other: "TransformArray | Transform", ratio: ArrayLike
    ) -> "TransformArray":
        """Along the screw from each (`ratio` 0) to its other (1), at constant speed."""
        mine, others = self._paired(other)
        part = _ratios(ratio, max(len(mine), len(others)))
        return self @ TransformArray.exp((self.inverse() @ other).log() * part)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, TransformArray):
            return NotImplemented
        return np.array_equal(self._xyz, other._xyz, equal_nan=True) and np.array_equal(
            self._quat_xyzw, other._quat_xyzw, equal_nan=True
        )

    # Its arrays can be written to.
    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        if not len(self):
            return "TransformArray of 0"
        is_long = len(self) > 2 * _SHOWN
        shown = [*range(_SHOWN), *range(-_SHOWN, 0)] if is_long else slice(None)
        poses = np.hstack((self._xyz[shown], self._quat_xyzw[shown]))
        lines = np.array2string(
            poses, precision=6, suppress_small=True, max_line_width=200
        ).splitlines()
        if is_long:
            lines.insert(_SHOWN, " ...")
        return "\n".join((f"TransformArray of {len(self)}, x y z qx qy qz qw:", *lines))


def make_array(xyz: Floats, quat_xyzw: Floats) -> TransformArray:
    """A TransformArray of arrays that were checked before."""
    self = TransformArray.__new__(TransformArray)
    self._xyz = xyz
    self._quat_xyzw = quat_xyzw
    return self


def are_valid(poses: Floats) -> NDArray[np.bool_]:
    """Which of the poses (N, 7) are finite, with a quaternion of norm 1: (N,)."""
    with np.errstate(all="ignore"):
        square = (poses[:, 3:] ** 2).sum(axis=1)
        are_finite = np.isfinite(poses).all(axis=1)
        valid: NDArray[np.bool_] = are_finite & (np.abs(square - 1.0) < QUATERNION_TOLERANCE)
    return valid


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


def _single(xyz: list[float], quat_xyzw: list[float]) -> Transform:
    if xyz[0] != xyz[0]:
        raise InvalidArgumentException(
            "this transform is unknown: its numbers are NaN; choose those that are known by the "
            "mask of lookup_known_transforms"
        )
    return Transform(xyz, quat_xyzw)


def _as_array(transforms: object, what: str = "other") -> TransformArray:
    if isinstance(transforms, TransformArray):
        return transforms
    if isinstance(transforms, Transform):
        return TransformArray.of([transforms])
    raise InvalidArgumentException(
        f"{what}: expected a TransformArray or Transform, got {type(transforms).__name__}"
    )


def _check_paired(count: int, other_count: int, what: str, others: str) -> None:
    if count != other_count and 1 not in (count, other_count):
        raise InvalidArgumentException(
            f"{count} {what} but {other_count} {others}; expected as many, or one"
        )


def _paired(a: Floats, b: Floats, what: str, others: str) -> tuple[Floats, Floats]:
    """Both arrays with as many rows; one row stands for all."""
    _check_paired(len(a), len(b), what, others)
    count = len(b) if len(a) == 1 else len(a)
    return (
        np.broadcast_to(a, (count, *a.shape[1:])),
        np.broadcast_to(b, (count, *b.shape[1:])),
    )


def _ratios(ratio: ArrayLike, count: int) -> Floats:
    """The ratio of all rows, or one for each, as a column; many may share one pair."""
    ratios = _finite(ratio, "ratio")
    if ratios.ndim > 1:
        raise InvalidArgumentException(
            f"ratio: expected one number or shape (N,), got {ratios.shape}"
        )
    _check_paired(count, ratios.size, "transforms", "ratios")
    return ratios.reshape(-1, 1)


def _moved(quat_xyzw: Floats, xyz: ArrayLike) -> TransformArray:
    """The rotations, each with its translation of (N, 3), or all with one of (3,)."""
    shape = (len(quat_xyzw), 3)
    translations = _finite(xyz, "xyz")
    try:
        return make_array(np.broadcast_to(translations, shape).copy(), quat_xyzw)
    except ValueError:
        raise InvalidArgumentException(
            f"xyz: expected shape {shape} or (3,), got {translations.shape}"
        ) from None


def _rows(values: ArrayLike, shape: tuple[int, ...], what: str) -> Floats:
    """The array, whose rows have this shape."""
    array = as_floats(values, what)
    if array.shape[1:] != shape or array.ndim != 1 + len(shape):
        expected = ", ".join(map(str, ("N", *shape)))
        raise InvalidArgumentException(f"{what}: expected shape ({expected}), got {array.shape}")
    return array


def _finite(values: ArrayLike, what: str) -> Floats:
    array = as_floats(values, what)
    if not np.isfinite(array).all():
        raise InvalidArgumentException(f"{what}: all numbers must be finite")
    return array
