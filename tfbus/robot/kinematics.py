"""The poses of the links in one configuration of the joints.

Each joint moves its child by a motion in the joint's frame: a revolute or continuous one turns
about its axis, a prismatic one slides along it; a planar one moves in the plane across its axis,
whose x and y come from those of the joint's frame by the shortest turn of z onto the axis; a
floating one moves freely. KDL and urdfdom have the same, if they have these joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, sin
from typing import Any

from tfbus.core.kernel import IDENTITY, Pose, compose, normalised
from tfbus.robot.model import Joint, Vector


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
