"""Drives turtle1 along a square of 2 m, repeatedly (turtlesim's draw_square).

    tfbus draw_square

Four states: a side or a corner, until the turtle's pose reaches its target; then a stop.
"""

import logging
from dataclasses import dataclass
from enum import Enum
from math import cos, pi, remainder, sin

import click

from tfbus import Node, NodeSettings, node_options
from tfbus.command.parameters import Declared, NodeCommand
from tfbus.messages import Empty, Pose, Twist, Vector3

SIDE_M = 2.0
SPEED_M_S = 1.0
TURN_RAD_S = 0.4
POSITION_TOLERANCE_M = 0.1
HEADING_TOLERANCE_RAD = 0.01
STANDSTILL = 0.0001

STOP = Twist()
FORWARD = Twist(linear=Vector3(x=SPEED_M_S))
TURN = Twist(angular=Vector3(z=TURN_RAD_S))


class State(Enum):
    """The turtle's move, and the command for it."""

    FORWARD = 0
    STOP_FORWARD = 1
    TURN = 2
    STOP_TURN = 3

    @property
    def command(self) -> Twist:
        """The velocities to command in this state."""
        return {State.FORWARD: FORWARD, State.TURN: TURN}.get(self, STOP)

    @property
    def next(self) -> "State":
        """The state after this one."""
        return State((self.value + 1) % 4)


@dataclass(frozen=True)
class Target:
    """The end of a side or a corner."""

    x: float
    y: float
    theta: float

    @classmethod
    def ahead(cls, pose: Pose) -> "Target":
        """The end of a side that starts at this pose."""
        x, y = pose.x + cos(pose.theta) * SIDE_M, pose.y + sin(pose.theta) * SIDE_M
        return cls(x, y, pose.theta)

    @classmethod
    def to_the_left(cls, pose: Pose) -> "Target":
        """The end of a corner that starts at this pose."""
        return cls(pose.x, pose.y, remainder(pose.theta + pi / 2, 2 * pi))

    def reached(self, pose: Pose) -> bool:
        """Whether the pose is this one, within the tolerances."""
        return (
            abs(pose.x - self.x) < POSITION_TOLERANCE_M
            and abs(pose.y - self.y) < POSITION_TOLERANCE_M
            and abs(remainder(pose.theta - self.theta, 2 * pi)) < HEADING_TOLERANCE_RAD
        )


class Square:
    """Answers each pose with a command; independent of time and the bus."""

    def __init__(self, pose: Pose, log: logging.Logger) -> None:
        self.state = State.FORWARD
        self.target = Target.ahead(pose)
        self._log = log
        self._log_target()

    def command(self, pose: Pose) -> Twist:
        """The command for a turtle at `pose`."""
        if self.state in (State.FORWARD, State.TURN):
            if self.target.reached(pose):
                self.state = self.state.next
        elif pose.linear_velocity < STANDSTILL and abs(pose.angular_velocity) < STANDSTILL:
            self._log.info("Reached goal")
            after_side = self.state is State.STOP_FORWARD
            self.target = Target.to_the_left(pose) if after_side else Target.ahead(pose)
            self.state = self.state.next
            self._log_target()
        return self.state.command

    def _log_target(self) -> None:
        target = self.target
        self._log.info("New goal [%f %f, %f]", target.x, target.y, target.theta)


TURTLE = Declared("turtle", "turtle1", "The turtle to drive.")
RESET = Declared("reset", True, "Whether to reset the simulator first.")


@click.command(
    cls=NodeCommand,
    declared=(TURTLE, RESET),
    epilog="Example: tfbus draw_square --param turtle=turtle2 --param reset=false",
)
@node_options("draw_square")
def main(settings: NodeSettings) -> None:
    """Drive a turtle along a square."""
    with Node.from_settings(settings) as node:
        turtle, reset = TURTLE.on(node).value, RESET.on(node).value
        commands = node.create_publisher(Twist, f"{turtle}/cmd_vel")
        square: Square | None = None

        def drive(pose: Pose) -> None:
            nonlocal square
            square = square or Square(pose, node.log)
            commands.publish(square.command(pose))

        if reset:
            node.log.info("Waiting for the service 'reset' of the simulator")
            resetting = node.create_client(Empty, "reset")
            resetting.wait_for_service()
            resetting.call(Empty.Request())
        node.create_subscription(Pose, f"{turtle}/pose", drive)
        node.spin()


if __name__ == "__main__":
    main()
