"""The positions of a robot's joints, within their limits; any thread may read and set them."""

import threading
from collections.abc import Mapping
from dataclasses import dataclass, field

from tfbus import Robot

from .motions import random_places
from .ranges import Range, ranges_of


@dataclass(frozen=True, eq=False)
class Posture:
    """A robot, and where its joints are; `ranges` and `positions` are in the robot's order."""

    robot: Robot | None = None
    ranges: Mapping[str, Range] = field(default_factory=dict)
    positions: Mapping[str, float] = field(default_factory=dict)


class Board:
    """A position for each joint; `rests` are positions of rest other than the robot's.

    Each change replaces `posture` as a whole, so that its parts always fit each other.
    """

    def __init__(self, rests: Mapping[str, float] | None = None) -> None:
        self._rests = dict(rests or {})
        self._changes = threading.Lock()
        self.posture = Posture()

    def take_robot(self, robot: Robot) -> None:
        """Have the joints of this robot; the former robot's joints of the same name stay where they
        are.
        """
        ranges = ranges_of(robot, self._rests)
        with self._changes:
            former = self.posture.positions
            positions = {
                name: each.clamped(former.get(name, each.rest)) for name, each in ranges.items()
            }
            self.posture = Posture(robot, ranges, positions)

    def set(self, positions: Mapping[str, float]) -> list[str]:
        """Move joints to these positions, or to their nearest limits. Returns the names that are of
        no joint.
        """
        with self._changes:
            former = self.posture
            ranges = former.ranges
            moved = {
                name: ranges[name].clamped(position)
                for name, position in positions.items()
                if name in ranges
            }
            self.posture = Posture(former.robot, ranges, {**former.positions, **moved})
        return [name for name in positions if name not in ranges]

    def rest(self) -> None:
        """Move all joints to where they rest."""
        self.set({name: each.rest for name, each in self.posture.ranges.items()})

    def randomise(self) -> None:
        """Move all joints to random positions."""
        self.set(random_places(self.posture.ranges.values()))
