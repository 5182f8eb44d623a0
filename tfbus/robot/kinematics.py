"""The poses of a robot's links, by the positions of its joints.

Each joint moves its child by a motion in the joint's frame: a revolute or continuous one turns
about its axis, a prismatic one slides along it; a planar one moves in the plane across its axis,
whose x and y come from the joint's frame by the shortest turn of z onto the axis; a
floating one moves freely. KDL and urdfdom have the same, if they have these joints.
In many configurations at once a rotation is a column of the quaternion's x y z w, a configuration
each. The effect that the origins of joints do to them is the same in all, so that it is a matrix,
and one product takes all: to turn by a fixed quaternion is linear in the quaternion, to turn a
fixed vector is linear in the ten products of its components.
"""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from math import cos, isfinite, sin
from typing import Any, TypeAlias

from tfbus.base import lazy_numpy as np
from tfbus.base.errors import InvalidArgumentException
from tfbus.base.lazy_numpy import ArrayLike, NDArray
from tfbus.base.wording import counted, did_you_mean
from tfbus.geometry.kernel import IDENTITY, Pose, compose, normalised
from tfbus.geometry.rotations import matrix_of, product
from tfbus.geometry.transform import Transform, as_floats
from tfbus.geometry.transform_array import TransformArray, make_array, rotate
from tfbus.robot.model import Joint, Vector

Floats: TypeAlias = "NDArray[np.float64]"


def local_pose(joint: Joint, origin: Pose, position: Any) -> Pose:
    """The child link's pose in the parent link: `position` is a number, or as many as the joint
    has.
    """
    kind = joint.type
    if kind == "fixed":
        return origin
    if kind == "prismatic":
        x, y, z = joint.axis
        return compose(origin, (x * position, y * position, z * position, 0.0, 0.0, 0.0, 1.0))
    if kind == "planar":
        return compose(origin, _in_plane(joint.axis, *position))
    if kind == "floating":
        return compose(origin, position)
    x, y, z = joint.axis
    half = 0.5 * position
    s = sin(half)
    return compose(origin, (0.0, 0.0, 0.0, x * s, y * s, z * s, cos(half)))


def _in_plane(normal: Vector, x: float, y: float, angle: float) -> Pose:
    across, along = plane_axes(normal)
    s = sin(0.5 * angle)
    return (
        x * across[0] + y * along[0],
        x * across[1] + y * along[1],
        x * across[2] + y * along[2],
        normal[0] * s,
        normal[1] * s,
        normal[2] * s,
        cos(0.5 * angle),
    )


def plane_axes(normal: Vector) -> tuple[Vector, Vector]:
    """The x and y of the plane of a planar joint, in the joint's frame: the frame's own x and y,
    turned by the shortest turn of z onto the normal.
    """
    x, y, z = normal
    if z < -1.0 + 1e-12:
        # Half a turn about x.
        return (1.0, 0.0, 0.0), (0.0, -1.0, 0.0)
    # Rodrigues' formula for the axis z cross normal, whose sine and cosine are in the normal.
    k = 1.0 / (1.0 + z)
    return (1.0 - k * x * x, -k * x * y, -x), (-k * x * y, 1.0 - k * y * y, -y)


class Steps:
    """The joints from the root outwards, ready to be followed.

    Link 0 is the root. A step is a joint, the number of its parent link, the pose of its origin and
    the number of its position.
    """

    def __init__(self, root: str, down: Sequence[Joint], position_of: dict[str, int]) -> None:
        self.links = [root, *(joint.child for joint in down)]
        self.index = {link: number for number, link in enumerate(self.links)}
        self.steps = [
            (
                joint,
                self.index[joint.parent],
                joint.origin.as_pose(),
                position_of.get(joint.name, -1),
            )
            for joint in down
        ]

    def poses(self, positions: Sequence[Any], wanted: Sequence[int] | None = None) -> list[Pose]:
        """The poses of all links in the root, by number; of `wanted` steps only, if given."""
        poses = [IDENTITY] * len(self.links)
        for number in range(len(self.steps)) if wanted is None else wanted:
            joint, parent, origin, place = self.steps[number]
            local = local_pose(joint, origin, positions[place] if place >= 0 else None)
            poses[number + 1] = normalised(compose(poses[parent], local))
        return poses

    def way_to(self, links: Sequence[int]) -> list[int]:
        """The steps that the poses of these links need, outwards."""
        needed = set()
        for link in links:
            while link and link - 1 not in needed:
                needed.add(link - 1)
                link = self.steps[link - 1][1]
        return sorted(needed)


# Configurations that are worked on at once: all that one link takes stays in the cache.
_BLOCK = 2048


class ManySteps:
    """The joints from the root outwards with the matrices of their origins."""

    def __init__(self, steps: Steps) -> None:
        self._links = len(steps.links)
        self._steps = [
            (_ManyStep(joint, origin), parent, place)
            for joint, parent, origin, place in steps.steps
        ]

    def poses(
        self, positions: Sequence[Any], count: int, links: Sequence[int], way: Sequence[int] | None
    ) -> list[TransformArray]:
        """The poses of these links in the root, `count` rows each; `way` are the steps to them,
        None for all.

        Each position is an array, (count,) or () for all configurations, or a tuple of as many as
        the joint's position has numbers.
        """
        rows = [(np.empty((count, 3)), np.empty((count, 4))) for _ in links]
        for start in range(0, count, _BLOCK):
            block = slice(start, start + _BLOCK)
            poses = self._block([_part(each, block) for each in positions], way)
            for link, (xyz, quat) in zip(links, rows, strict=True):
                poses[link].write(xyz[block], quat[block])
        return [make_array(xyz, quat) for xyz, quat in rows]

    def _block(self, positions: Sequence[Any], way: Sequence[int] | None) -> list[_Poses]:
        poses = [_Poses(np.zeros((3, 1)), np.array([[0.0], [0.0], [0.0], [1.0]]))] * self._links
        for number in range(len(self._steps)) if way is None else way:
            step, parent, place = self._steps[number]
            poses[number + 1] = step.child(poses[parent], positions[place] if place >= 0 else None)
        return poses


def _part(position: Any, block: slice) -> Any:
    if isinstance(position, tuple):
        return tuple(_part(each, block) for each in position)
    return position[block] if np.ndim(position) else position


class _Poses:
    """The poses of one link: `xyz` (3, N), `quat` (4, N); N is 1 if it does not move."""

    __slots__ = ("_products", "quat", "xyz")

    def __init__(self, xyz: Floats, quat: Floats) -> None:
        self.xyz = xyz
        self.quat = quat
        self._products: Floats | None = None

    def turned(self, vectors: Floats) -> Floats:
        """The rotations that a matrix of `_turning` makes of the rotations: vectors (3 n, N)."""
        if self._products is None:
            quat = self.quat
            self._products = np.empty((10, quat.shape[1]))
            np.multiply(quat, quat, out=self._products[:4])
            np.multiply(quat[0], quat[1:3], out=self._products[4:6])
            np.multiply(quat[1], quat[2], out=self._products[6])
            np.multiply(quat[3], quat[:3], out=self._products[7:])
        return vectors @ self._products

    def write(self, xyz: Floats, quat: Floats) -> None:
        """Write them as rows (N, 3) and (N, 4), the quaternions corrected for rounding."""
        xyz[:] = self.xyz.T
        quat[:] = (self.quat * (1.5 - 0.5 * np.einsum("in,in->n", self.quat, self.quat))).T


class _ManyStep:
    """A joint: makes the poses of its child of its parent's and its positions."""

    def __init__(self, joint: Joint, origin: Pose) -> None:
        self._kind = joint.type
        quat = np.array(origin[3:])
        axis = np.array((*joint.axis, 0.0))
        turns, moves = [quat], [np.array(origin[:3])]
        if joint.type in ("revolute", "continuous", "planar"):
            turns.append(_right(axis) @ quat)
        turned = np.array(matrix_of(*quat.tolist()))
        if joint.type == "prismatic":
            moves.append(turned @ axis[:3])
        if joint.type == "planar":
            moves += [turned @ np.array(each) for each in plane_axes(joint.axis)]
        self._turning = np.vstack([_right(each) for each in turns])
        self._moving = np.vstack([_turning(each) for each in moves])
        self._turns = not np.array_equal(quat, (0.0, 0.0, 0.0, 1.0)) or len(turns) > 1

    def child(self, parent: _Poses, position: Any) -> _Poses:
        moved = parent.turned(self._moving)
        quat = self._turning @ parent.quat if self._turns else parent.quat
        xyz = parent.xyz + moved[:3]
        if self._kind == "fixed":
            return _Poses(xyz, quat)
        if self._kind == "prismatic":
            return _Poses(xyz + position * moved[3:], quat)
        if self._kind == "floating":
            return _floating(xyz, quat, position)
        if self._kind == "planar":
            xyz = xyz + position[0] * moved[3:6] + position[1] * moved[6:]
            position = position[2]
        half = 0.5 * position
        return _Poses(xyz, np.cos(half) * quat[:4] + np.sin(half) * quat[4:])


def _floating(xyz: Floats, quat: Floats, position: Any) -> _Poses:
    moves, turns = np.array(position[:3]).reshape(3, -1), np.array(position[3:]).reshape(4, -1)
    return _Poses(xyz + rotate(quat.T, moves.T).T, product(quat.T, turns.T).T)


def _right(b: Floats) -> Floats:
    """The matrix (4, 4) that takes a quaternion `a` to the product `a` `b`."""
    x, y, z, w = b.tolist()
    return np.array([[w, z, -y, x], [-z, w, x, y], [y, -x, w, z], [-x, -y, -z, w]])


def _turning(vector: Floats) -> Floats:
    """The matrix (3, 10) that takes xx yy zz ww xy xz yz xw yw zw of a quaternion to the vector
    that it turns.
    """
    x, y, z = vector.tolist()
    return np.array(
        [
            [x, -x, -x, x, 2 * y, 2 * z, 0.0, 0.0, 2 * z, -2 * y],
            [-y, y, -y, y, 2 * x, 0.0, 2 * z, -2 * z, 0.0, 2 * x],
            [-z, -z, z, z, 0.0, 2 * x, 2 * y, 2 * y, -2 * x, 0.0],
        ]
    )


# A number; of a planar joint x, y and angle; of a floating one a Transform or its seven numbers.
Position = float | Sequence[float] | Transform


class Positions:
    """The joints of a robot that move, and their positions.

    Each joint that moves has a place in a list of positions: the free ones in order, then the
    mimics, each after its source. `mimics` are their places and names, and their sources.
    """

    def __init__(self, joints: Mapping[str, Joint], free: Sequence[Joint]) -> None:
        self._joints = joints
        self._free = free
        movable = [*free, *_mimics(joints)]
        self.places = {joint.name: place for place, joint in enumerate(movable)}
        self.mimics = [
            (place, joint.name, self.places[joint.mimic.joint], joint.mimic)
            for place, joint in enumerate(movable)
            if joint.mimic is not None
        ]
        self.zeros = [_zero(joint) for joint in free] + [0.0] * len(self.mimics)
        self._are_numbers = all(joint.position_size == 1 for joint in free)

    def of_one(self, given: Mapping[str, Position] | ArrayLike | None) -> list[Any]:
        """A position for each joint that moves, by place."""
        if given is None:
            given = {}
        if not isinstance(given, Mapping):
            return self._follow(self._of_array(given), ())
        positions = self.zeros.copy()
        places = self.places
        for name, value in given.items():
            place = places.get(name)
            if place is None:
                raise self._unknown(name)
            # Most are plain numbers, and finite.
            if type(value) is not float or not isfinite(value) or not self._are_numbers:
                value = _checked(self._joints[name], value)
            positions[place] = value
        return self._follow(positions, given)

    def _follow(self, positions: list[Any], given: Container[str]) -> list[Any]:
        """The positions, with computed ones of the mimics that are not given."""
        for place, name, source, mimic in self.mimics:
            if name not in given:
                position = mimic.multiplier * positions[source] + mimic.offset
                if not (isfinite if type(position) is float else _all_finite)(position):
                    raise InvalidArgumentException(
                        f"joint {name!r} mimics {mimic.joint!r} to a position that is not finite"
                    )
                positions[place] = position
        return positions

    def _of_array(self, given: Any) -> list[Any]:
        numbers = as_floats(given, "positions")
        size = sum(joint.position_size for joint in self._free)
        if numbers.shape != (size,):
            raise InvalidArgumentException(
                f"positions: expected shape ({size},), got {numbers.shape}"
            )
        if not np.isfinite(numbers).all():
            raise InvalidArgumentException("positions must be finite")
        row = numbers.tolist()
        if self._are_numbers:
            return [*row, *([0.0] * len(self.mimics))]
        positions: list[Any] = []
        for joint in self._free:
            part, row = row[: joint.position_size], row[joint.position_size :]
            positions.append(part[0] if len(part) == 1 else _checked(joint, part))
        return [*positions, *([0.0] * len(self.mimics))]

    def _unknown(self, name: object) -> InvalidArgumentException:
        if name in self._joints:
            return InvalidArgumentException(f"joint {name!r} is fixed: it has no position")
        return InvalidArgumentException(
            f"the robot has no joint {name!r}{did_you_mean(str(name), self.places)}"
        )

    def of_many(self, given: Mapping[str, ArrayLike] | ArrayLike) -> tuple[list[Any], int]:
        """A position for each joint that moves, of arrays (N,); and N."""
        counts = {}
        if not isinstance(given, Mapping):
            rows = as_floats(given, "positions")
            given, counts[""] = self._columns_of(rows), len(rows)
        positions: list[Any] = [
            _by_number(joint, np.array(zero))
            for joint, zero in zip(self._free, self.zeros, strict=False)
        ]
        positions += [0.0] * len(self.mimics)
        for name, value in given.items():
            if name not in self.places:
                raise self._unknown(name)
            joint = self._joints[name]
            array = _numbers(value, f"positions of joint {name!r}")
            if not np.isfinite(array).all():
                raise InvalidArgumentException(f"positions of joint {name!r} must be finite")
            row = () if joint.position_size == 1 else (joint.position_size,)
            if array.shape[1:] == row and array.ndim == 1 + len(row):
                counts[name] = len(array)
            elif array.shape != row:
                shape = f"(N, {joint.position_size})" if row else "(N,)"
                raise InvalidArgumentException(
                    f"positions of joint {name!r}: expected shape {shape}, got {array.shape}"
                )
            positions[self.places[name]] = _by_number(joint, array)
        if len(set(counts.values())) > 1:
            said = ", ".join(f"{name!r} {count}" for name, count in list(counts.items())[:8])
            raise InvalidArgumentException(f"positions must be of one length, got {said}")
        self._follow(positions, given)
        return positions, next(iter(counts.values()), 1)

    def _columns_of(self, array: Floats) -> dict[str, Floats]:
        size = sum(joint.position_size for joint in self._free)
        if array.ndim != 2 or array.shape[1] != size:
            raise InvalidArgumentException(
                f"positions: expected shape (N, {size}), got {array.shape}"
            )
        columns, start = {}, 0
        for joint in self._free:
            end = start + joint.position_size
            columns[joint.name] = array[:, start] if end - start == 1 else array[:, start:end]
            start = end
        return columns


def _mimics(joints: Mapping[str, Joint]) -> list[Joint]:
    """The joints that mimic others, each after the one that it mimics."""
    ordered: dict[str, Joint] = {}
    for joint in joints.values():
        way = []
        while joint.mimic is not None and joint.name not in ordered:
            way.append(joint)
            joint = joints[joint.mimic.joint]
        ordered.update((each.name, each) for each in reversed(way))
    return list(ordered.values())


def _all_finite(array: Floats) -> bool:
    return bool(np.isfinite(array).all())


def _zero(joint: Joint) -> Any:
    if joint.type == "floating":
        return IDENTITY
    return (0.0, 0.0, 0.0) if joint.type == "planar" else joint.zero


def _checked(joint: Joint, value: Any) -> Any:
    """The position of a joint as a number, or as a tuple of as many as it has."""
    if joint.type == "floating":
        return (value if isinstance(value, Transform) else Transform.from_pose(value)).as_pose()
    try:
        numbers = np.array(np.nan if isinstance(value, str) else value, dtype=float)
    except (TypeError, ValueError):
        numbers = np.array(np.nan)
    if joint.position_size == 1 and numbers.shape == () and np.isfinite(numbers):
        return float(numbers)
    if joint.position_size == 3 and numbers.shape == (3,) and np.isfinite(numbers).all():
        return tuple(numbers.tolist())
    wanted = counted(joint.position_size, "finite number")
    raise InvalidArgumentException(
        f"the position of {joint.type} joint {joint.name!r} must be {wanted}, got {value!r}"
    )


def _numbers(value: Any, what: str) -> Floats:
    """Positions as an array; of transforms their seven numbers."""
    if isinstance(value, Transform):
        return np.array(value.as_pose())
    if isinstance(value, TransformArray):
        return np.hstack((value.xyz, value.quat_xyzw))
    return as_floats(value, what)


def _by_number(joint: Joint, array: Floats) -> Any:
    """An array of positions (N,), or of (N, numbers) a tuple of arrays (N,)."""
    if joint.position_size == 1:
        return array
    if joint.type == "floating":
        rows = array.reshape(-1, 7)
        # Checks and normalises the quaternions.
        checked = TransformArray(rows[:, :3], rows[:, 3:])
        array = np.hstack((checked.xyz, checked.quat_xyzw)).reshape(array.shape)
    return tuple(np.moveaxis(array, -1, 0))
