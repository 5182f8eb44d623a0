"""The transforms of a robot's joints from joint states; which of them are due, and which joints are
missing or not known.
"""

from collections.abc import Sequence

from tfbus import Robot, TransformStamped, UrdfError
from tfbus.base.wording import printable
from tfbus.command.types import frame_mistake
from tfbus.messages import JointState

# A stamp that is older than the last of its joints by more than this is of a time that began again.
_RESTARTED_NS = 1_000_000_000


class JointFrames:
    """The frames of one robot, with `prefix` before their names; for one thread.

    `came` are the joints that joint states have named so far, `unknown` names in them that the
    robot does not have, at most a thousand. `restarts` counts how often stamps went back by more
    than a second. Raises UrdfError if a link with the prefix is no frame.
    """

    def __init__(self, robot: Robot, prefix: str = "") -> None:
        for link in robot.links:
            if mistake := frame_mistake(f"{prefix}{link}"):
                raise UrdfError(
                    f"link '{printable(link, 60)}' with the prefix '{printable(prefix, 60)}': "
                    f"{mistake}"
                )
        self.robot = robot
        self.prefix = prefix
        self.came: set[str] = set()
        self.unknown: set[str] = set()
        self.restarts = 0
        self._known = {name for name, joint in robot.joints.items() if joint.position_size == 1}
        self._last_ns: dict[str, int] = {}
        # Messages with the same names come one after the other.
        self._names: Sequence[str] = ()
        self._places: list[tuple[int, str]] = []

    @property
    def missing(self) -> list[str]:
        """The joints that no joint state has named so far, mimics left out."""
        return [
            joint.name
            for joint in self.robot.free_joints
            if joint.name in self._known and joint.name not in self.came
        ]

    @property
    def unsupported(self) -> list[str]:
        """The joints whose position is no number: planar and floating ones."""
        return [joint.name for joint in self.robot.free_joints if joint.position_size > 1]

    @property
    def edges(self) -> dict[str, str]:
        """The parent of each frame but the root's."""
        return {
            f"{self.prefix}{joint.child}": f"{self.prefix}{joint.parent}"
            for joint in self.robot.joints.values()
        }

    def take(
        self, state: JointState, stamp_ns: int, *, period_ns: int = 0, ignore_stamps: bool = False
    ) -> list[TransformStamped]:
        """The transforms of the joints in a state, and of their mimics, at its stamp.

        Empty if they are not due: one of the joints must have been sent `period_ns` before, or
        longer ago. With `ignore_stamps` they are always due.

        Raises InvalidArgumentException if a pose is not finite; the joints have not come then.
        """
        places = self._places_of(state.name)
        if not places or not state.position:
            return []
        last_ns = self._last_ns
        if not ignore_stamps:
            oldest_ns = min(last_ns.get(name, -1) for _, name in places)
            if stamp_ns < oldest_ns - _RESTARTED_NS:
                self.restarts += 1
            elif oldest_ns >= 0 and stamp_ns < oldest_ns + period_ns:
                return []
        positions = {name: state.position[at] for at, name in places}
        edges = self.robot.joint_transforms(positions, self.prefix)
        last_ns.update(dict.fromkeys(positions, stamp_ns))
        self.came.update(positions)
        return [
            TransformStamped(stamp_ns, parent, child, transform)
            for parent, child, transform in edges
        ]

    def static(self, stamp_ns: int) -> list[TransformStamped]:
        """The transforms of the fixed joints."""
        return [
            TransformStamped(stamp_ns, parent, child, transform)
            for parent, child, transform in self.robot.static_transforms(self.prefix)
        ]

    def _places_of(self, names: Sequence[str]) -> list[tuple[int, str]]:
        """The indices of the robot's joints among the names."""
        if names != self._names:
            self._names = names
            self._places = [(at, name) for at, name in enumerate(names) if name in self._known]
            if len(self._places) < len(names) and len(self.unknown) < 1000:
                self.unknown.update(name for name in names if name not in self.robot.joints)
        return self._places
