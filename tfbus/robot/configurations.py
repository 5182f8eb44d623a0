"""The poses of links in many configurations at once: as `kinematics`, with arrays.

A rotation is a column of the quaternion's x y z w, a configuration each. The effect that the
origins of joints do to them is the same in all configurations, so that it is a matrix, and one
product takes all: to turn by a fixed quaternion is linear in the quaternion, to turn a fixed vector
is linear in the ten products of its components.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from tfbus.core.kernel import Pose
from tfbus.geometry.rotations import matrix_of, product
from tfbus.geometry.transform_array import TransformArray, make_array, rotate
from tfbus.robot.kinematics import Steps, plane_axes
from tfbus.robot.model import Joint

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
else:
    from tfbus.core import lazy_numpy as np


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
    """A joint: how the poses of its parent and its positions make those of its child."""

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
