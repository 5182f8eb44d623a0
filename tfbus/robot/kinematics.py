"""Where the links are when the joints are somewhere: of one configuration and of many at once.

Each joint moves its child by a motion in the joint's frame: a revolute or continuous one turns
about its axis, a prismatic one slides along it; a planar one moves in the plane across its axis,
whose x and y come from those of the joint's frame by the shortest turn of z onto the axis; a
floating one moves freely. KDL and urdfdom have the same, where they have these joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, sin
from typing import TYPE_CHECKING, Any

from tfbus.core.kernel import IDENTITY, Pose, compose, normalised
from tfbus.robot.model import Joint, Vector

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
else:
    from tfbus.core import lazy_numpy as np

# A pose of many configurations: seven numbers, or arrays of one number a configuration.
Columns = tuple[Any, Any, Any, Any, Any, Any, Any]


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

    def columns(
        self, positions: Sequence[Any], wanted: Sequence[int] | None = None
    ) -> list[Columns]:
        """As `poses`, of many configurations: each position is an array (N,), or a tuple of as
        many as the joint's position has numbers.
        """
        poses: list[Columns] = [IDENTITY] * len(self.links)
        for number in range(len(self.steps)) if wanted is None else wanted:
            joint, parent, origin, place = self.steps[number]
            motion = _motions(joint, positions[place] if place >= 0 else None)
            at = compose_columns(poses[parent], origin)
            poses[number + 1] = at if motion is None else compose_columns(at, motion)
        return poses


def _motions(joint: Joint, position: Any) -> Columns | None:
    """The motions of a joint in its frame; None where it is fixed."""
    kind = joint.type
    x, y, z = joint.axis
    if kind == "fixed":
        return None
    if kind == "prismatic":
        return (x * position, y * position, z * position, 0.0, 0.0, 0.0, 1.0)
    if kind == "floating":
        return tuple(position)
    if kind == "planar":
        across, along = plane_axes(joint.axis)
        moved = [position[0] * across[i] + position[1] * along[i] for i in range(3)]
        half = 0.5 * position[2]
    else:
        moved = [0.0, 0.0, 0.0]
        half = 0.5 * position
    s = np.sin(half)
    return (*moved, *(each * s if each else 0.0 for each in (x, y, z)), np.cos(half))


def compose_columns(a: Columns, b: Columns) -> Columns:
    """First `b`, then `a`, of numbers or arrays; numbers that are 0 cost nothing."""
    ax, ay, az, qx, qy, qz, qw = a
    bx, by, bz, px, py, pz, pw = b
    # v + 2w (q x v) + 2 q x (q x v)
    tx = _sum(_times(qy, bz), _minus(_times(qz, by)))
    ty = _sum(_times(qz, bx), _minus(_times(qx, bz)))
    tz = _sum(_times(qx, by), _minus(_times(qy, bx)))
    tx, ty, tz = _times(2.0, tx), _times(2.0, ty), _times(2.0, tz)
    return (
        _sum(ax, bx, _times(qw, tx), _times(qy, tz), _minus(_times(qz, ty))),
        _sum(ay, by, _times(qw, ty), _times(qz, tx), _minus(_times(qx, tz))),
        _sum(az, bz, _times(qw, tz), _times(qx, ty), _minus(_times(qy, tx))),
        _sum(_times(qw, px), _times(qx, pw), _times(qy, pz), _minus(_times(qz, py))),
        _sum(_times(qw, py), _minus(_times(qx, pz)), _times(qy, pw), _times(qz, px)),
        _sum(_times(qw, pz), _times(qx, py), _minus(_times(qy, px)), _times(qz, pw)),
        _sum(
            _times(qw, pw), _minus(_times(qx, px)), _minus(_times(qy, py)), _minus(_times(qz, pz))
        ),
    )


def _is_zero(value: Any) -> bool:
    return type(value) is float and value == 0.0


def _times(a: Any, b: Any) -> Any:
    if _is_zero(a) or _is_zero(b):
        return 0.0
    if type(a) is float and a == 1.0:
        return b
    if type(b) is float and b == 1.0:
        return a
    return a * b


def _minus(a: Any) -> Any:
    return -a if not _is_zero(a) else 0.0


def _sum(*terms: Any) -> Any:
    total: Any = 0.0
    for term in terms:
        if not _is_zero(term):
            total = term if _is_zero(total) else total + term
    return total
