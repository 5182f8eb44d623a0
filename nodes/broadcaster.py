"""Broadcasts the frames of a turtle, and of a drone behind and above it, from the turtle's pose.

tfbus broadcaster --param turtlename=turtle1
"""

import click

from tfbus import (
    Node,
    NodeSettings,
    Transform,
    TransformBroadcaster,
    TransformStamped,
    node_options,
)
from tfbus.command.parameters import Declared, NodeCommand
from tfbus.messages import Pose

HALF_FIELD_M = 11.088889 / 2  # the world's origin is the middle of the field
TURTLE_TO_DRONE = Transform([-0.5, 0.0, 1.0])


TURTLE = Declared("turtlename", "turtle1", "The turtle whose frames are broadcast.")
DRONE = Declared("drone", "drone", "The name of the drone's frame.")


@click.command(
    cls=NodeCommand,
    declared=(TURTLE, DRONE),
    epilog="Example: tfbus broadcaster --param turtlename=turtle2 --param drone=drone2",
)
@node_options("broadcaster1")
def main(settings: NodeSettings) -> None:
    """Broadcast the frames of a turtle and its drone."""
    with Node.from_settings(settings) as node:
        turtle = TURTLE.on(node).value
        drone = DRONE.on(node).value
        broadcaster = TransformBroadcaster(node)

        def broadcast(pose: Pose) -> None:
            xyz = [pose.x - HALF_FIELD_M, pose.y - HALF_FIELD_M, 0.0]
            world_to_turtle = Transform.from_rpy(0.0, 0.0, pose.theta, xyz)
            broadcaster.send_transform(
                [
                    TransformStamped(pose.stamp_ns, "world", turtle, world_to_turtle),
                    TransformStamped(pose.stamp_ns, turtle, drone, TURTLE_TO_DRONE),
                ]
            )

        node.create_subscription(Pose, f"{turtle}/pose", broadcast)
        node.spin()


if __name__ == "__main__":
    main()
