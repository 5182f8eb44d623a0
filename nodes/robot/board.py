"""The positions of a robot's joints that people and programs set: within limits, by any thread."""

from collections.abc import Mapping

from tfbus import Robot

from .motions import random_places
from .ranges import Range, ranges_of


class Board:
    """One position for each joint; `rests` are positions of rest other than the robot's.

    `ranges` and `positions` are by joint, in the robot's order. `version` grows with each change.
    """

    def __init__(self, rests: Mapping[str, float] | None = None) -> None:
        self._rests = dict(rests or {})
        self.robot: Robot | None = None
        self.ranges: dict[str, Range] = {}
        self.positions: dict[str, float] = {}
        self.version = 0

    def take_robot(self, robot: Robot) -> None:
        """Have the joints of this robot; those of the former that have the same name stay where
        they are.
        """
        ranges = ranges_of(robot, self._rests)
        former = self.positions
        self.positions = {
            name: each.clamped(former.get(name, each.rest)) for name, each in ranges.items()
        }
        self.ranges = ranges
        self.robot = robot
        self.version += 1

    def set(self, positions: Mapping[str, float]) -> list[str]:
        """Move joints to these positions, or to their nearest limits. Returns the names that are of
        no joint.
        """
        unknown = []
        for name, position in positions.items():
            each = self.ranges.get(name)
            if each is None:
                unknown.append(name)
            else:
                self.positions[name] = each.clamped(position)
        self.version += 1
        return unknown

    def rest(self) -> None:
        """Move all joints to where they rest."""
        self.set({name: each.rest for name, each in self.ranges.items()})

    def randomise(self) -> None:
        """Move all joints to random positions."""
        self.set(random_places(self.ranges.values()))
