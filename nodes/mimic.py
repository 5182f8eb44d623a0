"""Moves one turtle as another (turtlesim's mimic).

tfbus mimic --remap input/pose:=turtle1/pose --remap output/cmd_vel:=turtle2/cmd_vel
"""

import click

from tfbus import Node, NodeSettings, node_options
from tfbus.messages import Pose, Twist, Vector3


@click.command(
    epilog="Example: tfbus mimic --remap input/pose:=turtle1/pose "
    "--remap output/cmd_vel:=turtle2/cmd_vel"
)
@node_options("turtle_mimic")
def main(settings: NodeSettings) -> None:
    """Copy the speeds of input/pose to output/cmd_vel."""
    with Node.from_settings(settings) as node:
        commands = node.create_publisher(Twist, "output/cmd_vel")

        def mimic(pose: Pose) -> None:
            linear, angular = Vector3(x=pose.linear_velocity), Vector3(z=pose.angular_velocity)
            commands.publish(Twist(linear, angular))

        node.create_subscription(Pose, "input/pose", mimic)
        node.spin()


if __name__ == "__main__":
    main()
