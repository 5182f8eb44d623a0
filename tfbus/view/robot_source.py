"""The robots as the page needs them: which there are, their meshes, and their joints."""

from collections.abc import Mapping, Sequence
from typing import Protocol

from tfbus.view.meshes.guard import MeshError
from tfbus.view.model.shown_robot import ShownRobot


class Joints(Protocol):
    """The joints of one robot on the bus."""

    @property
    def positions(self) -> Mapping[str, float]:
        """Their last positions, in rad and m, those that are known."""

    @property
    def is_heard(self) -> bool:
        """Whether a process takes targets."""

    def send(self, targets: Mapping[str, float]) -> None:
        """Send targets to it, in rad and m."""


class RobotSource(Protocol):
    """The robots of a bus, a recording or a program; safe from any thread."""

    def robots(self) -> Sequence[ShownRobot]:
        """The robots now; one that has not changed is the same object."""

    def mistakes(self) -> Sequence[str]:
        """Why there are not more, in sentences that can be printed."""

    def joints(self, robot: ShownRobot) -> Joints | None:
        """The joints of a robot; None if nothing can move them."""

    def fetch(self, origin: str, mesh: str, within_s: float) -> bytes:
        """The content of a mesh that is not on this machine. Raises MeshError, also if it takes
        longer.
        """

    def close(self) -> None:
        """End it. Twice is fine."""


class GivenRobots:
    """The robots that a program has given."""

    def __init__(self, robots: Sequence[ShownRobot] = ()) -> None:
        self._robots = list(robots)

    def robots(self) -> Sequence[ShownRobot]:
        """The given robots."""
        return list(self._robots)

    def add(self, robot: ShownRobot) -> None:
        """Add a robot; it replaces one of the same title."""
        self._robots = [
            *(each for each in self._robots if each.title != robot.title),
            robot,
        ]

    def mistakes(self) -> Sequence[str]:
        """None."""
        return ()

    def joints(self, robot: ShownRobot) -> Joints | None:
        """None: nothing is on a bus."""
        return None

    def fetch(self, origin: str, mesh: str, within_s: float) -> bytes:
        """Nothing is fetched."""
        raise MeshError("it is not on this machine")

    def close(self) -> None:
        """Nothing to end."""
