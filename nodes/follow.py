"""A turtle that follows a frame by lookups (tf2's listener tutorial).

    tfbus follow --param target_frame=carrot1
    tfbus follow --param delay=5.0

With a delay it goes to where the target was that many seconds ago: the time-travel lesson, a
lookup at two times by way of a fixed frame.
"""

from dataclasses import replace
from math import atan2, hypot

import click

from tfbus import (
    Buffer,
    Node,
    NodeSettings,
    ServiceError,
    TransformException,
    TransformListener,
    TransformStamped,
    node_options,
)
from tfbus.messages import Spawn, Twist, Vector3

START = Spawn.Request(x=4.0, y=2.0, theta=0.0)
TURN_PER_RAD = 1.0
SPEED_PER_M = 0.5
FIXED_FRAME = "world"
LONGEST_DELAY_S = 60.0


@click.command(epilog="Example: tfbus follow --param target_frame=turtle1 --param delay=5.0")
@node_options("listener")
def main(settings: NodeSettings) -> None:
    """Spawn a turtle that follows a frame."""
    with Node.from_settings(settings) as node:
        follower = node.declare_parameter(
            "source_frame", "turtle2", description="The turtle that follows, and its frame."
        ).value
        target = node.declare_parameter(
            "target_frame", "turtle1", description="The frame to follow."
        )
        delay_s = node.declare_parameter(
            "delay",
            0.0,
            description="Go to where the frame was this many seconds ago.",
            minimum=0.0,
            maximum=LONGEST_DELAY_S,
        )
        rate_hz = node.declare_parameter(
            "rate", 10.0, description="Lookups and commands per second.", minimum=0.1, maximum=100.0
        )
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

        _spawn(node, follower)
        node.create_timer(1.0 / rate_hz.value, follow)
        node.spin()


def towards(target: TransformStamped) -> Twist:
    """The command to turn and drive to a target in the follower's frame."""
    x, y = target.transform.x, target.transform.y
    return Twist(
        linear=Vector3(x=SPEED_PER_M * hypot(x, y)), angular=Vector3(z=TURN_PER_RAD * atan2(y, x))
    )


def _spawn(node: Node, name: str) -> None:
    spawning = node.create_client(Spawn, "spawn")
    node.log.info("Waiting for the service 'spawn' of the simulator")
    spawning.wait_for_service()
    try:
        spawning.call(replace(START, name=name))
    except ServiceError as error:
        # After a restart the turtle exists already.
        node.log.warning("%s", error)


if __name__ == "__main__":
    main()
