"""`tfbus ros1`: frames of ROS 1 are frames of the bus, and the other way round.

Try it beside roscore: tfbus ros1
"""

import re

import click

from tfbus import NodeSettings, node_options
from tfbus.bridge import LegSettings

from .ros_options import Crossing, crossing_options, run_bridge


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
    """Join the bus and ROS 1.

    Transforms, the clock and topics cross in both directions. It needs the rospy of the system, and
    is the node /tfbus_ros1 in ROS.
    """
    leg = LegSettings(
        node="tfbus_" + re.sub(r"\W", "_", settings.name, flags=re.ASCII),
        namespace=crossing.options.ros_namespace,
        connect=(master,) if master else (),
    )
    run_bridge(settings, crossing, "rospy", leg)


if __name__ == "__main__":
    main()
