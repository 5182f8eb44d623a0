"""A turtle that follows a frame by lookups (tf2's listener tutorial).

    tfbus follow --param target_frame=carrot1
    tfbus follow --param delay=5.0

With a delay it goes to where the target was that many seconds ago: the time-travel lesson, a
lookup at two times by way of a fixed frame. A reset of the simulator, or another simulator, takes
the turtle away: it is spawned again as soon as its poses stop.
"""

import time
from dataclasses import replace
from math import atan2, hypot

import click

from tfbus import (
    Buffer,
    Node,
    NodeSettings,
    ServiceError,
    SystemClock,
    TransformException,
    TransformListener,
    TransformStamped,
    node_options,
)
from tfbus.command.parameters import Declared, NodeCommand
from tfbus.messages import Pose, Spawn, Twist, Vector3

START = Spawn.Request(x=4.0, y=2.0, theta=0.0)
TURN_PER_RAD = 1.0
SPEED_PER_M = 0.5
FIXED_FRAME = "world"
LONGEST_DELAY_S = 60.0

# A turtle without a pose for this long, in real time, is gone: the simulator sends 60 a second.
SILENT_S = 1.0
ANSWER_S = 1.0


FOLLOWER = Declared("source_frame", "turtle2", "The turtle that follows, and its frame.")
TARGET = Declared("target_frame", "turtle1", "The frame to follow.")
DELAY = Declared(
    "delay",
    0.0,
    "Go to where the frame was this many seconds ago.",
    minimum=0.0,
    maximum=LONGEST_DELAY_S,
)
RATE = Declared("rate", 10.0, "Lookups and commands per second.", minimum=0.1, maximum=100.0)


@click.command(
    cls=NodeCommand,
    declared=(FOLLOWER, TARGET, DELAY, RATE),
    epilog="Example: tfbus follow --param target_frame=turtle1 --param delay=5.0",
)
@node_options("listener")
def main(settings: NodeSettings) -> None:
    """Spawn a turtle that follows a frame."""
    with Node.from_settings(settings) as node:
        follower = FOLLOWER.on(node).value
        target, delay_s, rate_hz = TARGET.on(node), DELAY.on(node), RATE.on(node)
        buffer = Buffer(cache_time_s=LONGEST_DELAY_S + 10.0)
        TransformListener(buffer, node)
        commands = node.create_publisher(Twist, f"{follower}/cmd_vel")
        complaint = ""

        def look_up() -> TransformStamped:
            if delay_s.value == 0.0:
                return buffer.lookup_transform(follower, target.value)
            then_ns = node.now_ns() - round(delay_s.value * 1e9)
            return buffer.lookup_transform_full(follower, None, target.value, then_ns, FIXED_FRAME)

        def follow() -> None:
            nonlocal complaint
            try:
                commands.publish(towards(look_up()))
                complaint = ""
            except TransformException as error:
                if type(error).__name__ != complaint:
                    node.log.info("Could not transform %s to %s: %s", follower, target.value, error)
                complaint = type(error).__name__

        turtle = Turtle(node, follower)
        turtle.spawn()
        node.create_timer(0.5 * SILENT_S, turtle.spawn_if_gone, clock=SystemClock())
        node.create_timer(1.0 / rate_hz.value, follow)
        node.spin()


def towards(target: TransformStamped) -> Twist:
    """The command to turn and drive to a target in the follower's frame."""
    x, y = target.transform.x, target.transform.y
    return Twist(
        linear=Vector3(x=SPEED_PER_M * hypot(x, y)), angular=Vector3(z=TURN_PER_RAD * atan2(y, x))
    )


class Turtle:
    """The turtle that follows: spawned at the start, and again whenever it is gone."""

    def __init__(self, node: Node, name: str) -> None:
        self._node = node
        self._name = name
        self._seen_s = -SILENT_S
        self._spawning = node.create_client(Spawn, "spawn")
        node.create_subscription(Pose, f"{name}/pose", self._see)

    def spawn(self) -> None:
        """Wait for the simulator, and spawn the turtle."""
        self._node.log.info("Waiting for the service 'spawn' of the simulator")
        self._spawning.wait_for_service()
        try:
            self._spawning.call(replace(START, name=self._name))
        except ServiceError as error:
            # After a restart of this node the turtle exists already.
            self._node.log.warning("%s", error)
        self._seen_s = time.monotonic()

    def spawn_if_gone(self) -> None:
        """Spawn the turtle again if a simulator runs and its poses have stopped."""
        if not self._spawning.served or time.monotonic() - self._seen_s < SILENT_S:
            return
        try:
            self._spawning.call(replace(START, name=self._name), timeout_s=ANSWER_S)
        except ServiceError as error:
            # A simulator whose time stands still sends no poses either, and has the turtle.
            self._node.log.debug("%s", error)
        else:
            self._node.log.info("%s was gone, as after a reset; spawned it again", self._name)
        self._seen_s = time.monotonic()

    def _see(self, pose: Pose) -> None:
        self._seen_s = time.monotonic()


if __name__ == "__main__":
    main()
