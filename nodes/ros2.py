"""`tfbus ros2`: frames of the bus are frames of ROS 2, and those of ROS 2 are frames of the bus.

Try it: tfbus ros2 --via zenoh, beside ROS 2 with rmw_zenoh and its router.
"""

from importlib.util import find_spec

import click

from tfbus import NodeSettings, TfbusError, node_options
from tfbus.bridge import HIGHEST_DOMAIN, LegSettings, domain_of

from .ros_options import Crossing, crossing_options, ros_node_name, run_bridge


@click.command(
    epilog="Examples: tfbus ros2 --via zenoh; tfbus ros2 --via dds --domain 5 --only-from-ros; "
    "tfbus ros2 --frame-prefix robot1/ --frames 'robot1/*'",
)
@click.option(
    "--via",
    type=click.Choice(["auto", "zenoh", "dds", "rclpy"]),
    default="auto",
    show_default=True,
    help="The middleware: zenoh as rmw_zenoh, dds by cyclonedds, or rclpy with any; auto: rclpy "
    "where ROS is sourced, else zenoh.",
)
@click.option(
    "--domain",
    type=click.IntRange(0, HIGHEST_DOMAIN),
    metavar="N",
    help="ROS's domain (default: ROS_DOMAIN_ID, or 0).",
)
@click.option(
    "--ros-connect",
    multiple=True,
    metavar="ENDPOINT",
    help="Where ROS is, as tcp/host:7447 for rmw_zenoh's router; repeatable.",
)
@click.option(
    "--distro",
    default="",
    metavar="NAME",
    help="ROS's distribution where its wire differs, such as humble.",
)
@crossing_options
@node_options("ros2")
def main(
    settings: NodeSettings,
    crossing: Crossing,
    via: str,
    domain: int | None,
    ros_connect: tuple[str, ...],
    distro: str,
) -> None:
    """Bridge to ROS 2: transforms, static ones, the clock, and topics that both know.

    Each node of ROS is a stream of the bus, ros2/NODE; static transforms reach late joiners on both
    sides. Nothing that has crossed comes back.
    """
    note = ""
    if via == "auto":
        has_rclpy = find_spec("rclpy") is not None
        via = "rclpy" if has_rclpy else "zenoh"
        note = "; by rclpy, since it is there" if has_rclpy else "; there is no rclpy here (--via)"
    leg = LegSettings(
        ros_node_name(settings),
        crossing.options.ros_namespace,
        _domain(domain),
        ros_connect,
        distro.lower(),
    )
    run_bridge(settings, crossing, via, leg, f", domain {leg.domain}{note}")


def _domain(given: int | None) -> int:
    try:
        return domain_of(given)
    except TfbusError as error:
        raise click.UsageError(str(error)) from error


if __name__ == "__main__":
    main()
