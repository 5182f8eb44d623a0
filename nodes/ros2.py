"""`tfbus ros2`: frames of the bus are frames of ROS 2, and frames of ROS 2 are frames of the bus.

Try it: tfbus ros2 --via zenoh, beside ROS 2 with rmw_zenoh and its router.
"""

import socket
from contextlib import suppress
from importlib.util import find_spec

import click

from tfbus import NodeSettings, TfbusError, node_options
from tfbus.base.installation import install_command
from tfbus.ros.bridge.legs import LegSettings
from tfbus.ros.rmw import HIGHEST_DOMAIN, domain_of

from .ros_options import Crossing, crossing_options, ros_node_name, run_bridge

# Where rmw_zenoh has its router, and how long that may take to answer.
_ROUTER = ("localhost", 7447)
_ANSWER_WITHIN_S = 1.0


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
    "where ROS is sourced, else zenoh where a router answers at localhost:7447, else dds where "
    "cyclonedds is installed.",
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
    help="Where ROS is: zenoh's router as tcp/host:7447, for dds an interface or host as wlan0 or "
    "192.168.1.7; repeatable.",
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
        via, note = choose_way(ros_connect)
    leg = LegSettings(
        ros_node_name(settings),
        crossing.options.ros_namespace,
        _domain(domain),
        ros_connect,
        distro.lower(),
    )
    run_bridge(settings, crossing, via, leg, f", domain {leg.domain}{note}")


def choose_way(ros_connect: tuple[str, ...]) -> tuple[str, str]:
    """The middleware of `--via auto`, and why, as the end of a line."""
    if find_spec("rclpy") is not None:
        return "rclpy", "; by rclpy, since it is there (--via)"
    has_dds = find_spec("cyclonedds") is not None
    dds = "--via dds is for Fast DDS and Cyclone DDS"
    if not has_dds:
        dds += f" and needs {install_command('ros2')}"
    if ros_connect:
        # A host or an interface has no slash; an endpoint of Zenoh has.
        if any("/" in each for each in ros_connect):
            return "zenoh", f"; --ros-connect is an endpoint of Zenoh; {dds}"
        return "dds", "; --ros-connect is a host or an interface; --via zenoh is for rmw_zenoh"
    if has_router():
        return "zenoh", f"; a Zenoh router answers at localhost:7447; {dds}"
    if has_dds:
        return "dds", "; no Zenoh router answers at localhost:7447; --via zenoh is for rmw_zenoh"
    return "zenoh", f"; there is no rclpy here; {dds}"


def has_router() -> bool:
    with suppress(OSError):
        socket.create_connection(_ROUTER, _ANSWER_WITHIN_S).close()
        return True
    return False


def _domain(given: int | None) -> int:
    try:
        return domain_of(given)
    except TfbusError as error:
        raise click.UsageError(str(error)) from error


if __name__ == "__main__":
    main()
