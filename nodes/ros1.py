"""`tfbus ros1`: frames of the bus are frames of ROS 1, and frames of ROS 1 are frames of the bus.

Try it beside roscore: tfbus ros1
"""

import click

from tfbus import NodeSettings, node_options
from tfbus.ros.bridge.legs import LegSettings

from .ros_options import Crossing, crossing_options, ros_node_name, run_bridge


@click.command(
    epilog="Examples: tfbus ros1; tfbus ros1 --master http://robot:11311 --only-from-ros"
)
@click.option(
    "--master",
    default="",
    metavar="URI",
    help="The ROS master (default: ROS_MASTER_URI, or http://localhost:11311).",
)
@crossing_options
@node_options("ros1")
def main(settings: NodeSettings, master: str, crossing: Crossing) -> None:
    """Bridge to ROS 1: transforms, static ones, the clock, and topics that both know.

    Each node of ROS is a stream of the bus, ros1/NODE; static transforms reach late joiners on both
    sides. It needs the system's rospy.
    """
    leg = LegSettings(
        ros_node_name(settings),
        crossing.options.ros_namespace,
        connect=(master,) if master else (),
    )
    run_bridge(settings, crossing, "rospy", leg)


if __name__ == "__main__":
    main()
