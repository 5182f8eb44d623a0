"""The part that `tfbus ros2` and `tfbus ros1` share: options, and how they run."""

import functools
import re
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar, cast

import click

from tfbus import Node, NodeSettings, Number
from tfbus.command.types import frame_mistake
from tfbus.ros.bridge.bridge import Bridge
from tfbus.ros.bridge.common import BridgeOptions
from tfbus.ros.bridge.from_ros import with_odometry_frames
from tfbus.ros.bridge.legs import LegSettings, open_leg
from tfbus.ros.bridge.topics import TopicTable
from tfbus.ros.rmw import BRIDGE_PREFIX

F = TypeVar("F", bound=Callable[..., Any])

_CLOCKS = ("auto", "to-ros", "from-ros", "off")


@dataclass(frozen=True)
class Crossing:
    """Transforms, clock and topics that cross, as the command line has them; `topics_file` and
    `topics` are topics other than transforms.
    """

    options: BridgeOptions
    topics_file: Path | None
    topics: tuple[str, ...]
    odom_tf: bool


def crossing_options(function: F) -> F:
    """Add the options of the crossing to a click command, which gets a Crossing as `crossing`."""

    @functools.wraps(function)
    def command(
        *args: Any,
        only_to_ros: bool,
        only_from_ros: bool,
        ros_namespace: str,
        topics_file: Path | None,
        topics: tuple[str, ...],
        odom_tf: bool,
        **values: Any,
    ) -> Any:
        if only_to_ros and only_from_ros:
            raise click.UsageError(
                "--only-to-ros and --only-from-ros are mutually exclusive: give one, or none for "
                "both directions"
            )
        options = {name: values.pop(name) for name in _OF_BRIDGE}
        if only_from_ros and options["clock"] == "to-ros":
            raise click.UsageError("--only-from-ros and --clock to-ros are mutually exclusive")
        if only_to_ros and options["clock"] == "from-ros":
            raise click.UsageError("--only-to-ros and --clock from-ros are mutually exclusive")
        prefix = options["frame_prefix"]
        if prefix and (mistake := frame_mistake(prefix)):
            raise click.UsageError(f"--frame-prefix: {mistake}")
        namespace = ros_namespace.strip("/")
        if namespace and not re.fullmatch(r"[A-Za-z]\w*(/[A-Za-z]\w*)*", namespace, re.ASCII):
            raise click.UsageError(
                f"--ros-namespace {namespace!r} is none that ROS can have: use letters, digits and "
                "underscores, as in robot1"
            )
        if only_to_ros and odom_tf:
            raise click.UsageError(
                "--only-to-ros and --odom-tf are mutually exclusive: the Odometry comes from ROS"
            )
        if "" in options["frames"]:
            raise click.UsageError("--frames '' fits no frame: give a pattern such as 'robot1/*'")
        crossing = Crossing(
            BridgeOptions(
                to_ros=not only_from_ros,
                from_ros=not only_to_ros,
                ros_namespace=namespace,
                **options,
            ),
            topics_file,
            topics,
            odom_tf,
        )
        return function(*args, crossing=crossing, **values)

    decorated: Any = command
    for option in reversed(_OPTIONS):
        decorated = option(decorated)
    return cast(F, decorated)


def ros_node_name(settings: NodeSettings) -> str:
    """How the node is called in ROS: other bridges know one by it."""
    return BRIDGE_PREFIX + re.sub(r"\W", "_", settings.name, flags=re.ASCII)


def run_bridge(
    settings: NodeSettings, crossing: Crossing, via: str, leg: LegSettings, note: str = ""
) -> None:
    """Join the bus and ROS until a signal; `note` ends the line that says so. Raises TfbusError
    if ROS cannot be joined, or the topics are not clear.
    """
    table = TopicTable.of_file(crossing.topics_file, crossing.topics)
    _check_directions(crossing.options, table)
    with Node.from_settings(settings) as node:
        joined = open_leg(via, leg, node.log)
        with ExitStack() as opened:
            opened.callback(joined.close)
            if crossing.odom_tf:
                joined = with_odometry_frames(joined, table, leg.namespace)
            bridge = Bridge(node, joined, crossing.options, ros_node=leg.full_name, table=table)
            opened.callback(bridge.close)
            node.ready(f"{bridge.announcement}{note}")
            node.wait(None)


def _check_directions(options: BridgeOptions, table: TopicTable) -> None:
    """Refuse topics that can cross in the other direction only."""
    for name, line in table.names.items():
        if line.direction == "from-ros" and not options.from_ros:
            raise click.UsageError(
                f"--only-to-ros excludes topic {name!r}: its line in --topics has `direction: "
                "from-ros`"
            )
        if line.direction == "to-ros" and not options.to_ros:
            raise click.UsageError(
                f"--only-from-ros excludes topic {name!r}: its line in --topics has `direction: "
                "to-ros`"
            )


# The options that BridgeOptions has by the same names.
_OF_BRIDGE = ("frame_prefix", "frames", "rate_limit_hz", "clock")

_OPTIONS = (
    click.option(
        "--ros-namespace",
        default="",
        metavar="NS",
        help="The namespace in ROS: robot1 for /robot1/tf (--namespace is that of the bus).",
    ),
    click.option(
        "--frame-prefix",
        default="",
        metavar="PREFIX",
        help="Put before frames that come from ROS, as robot1/, and taken off on the way there.",
    ),
    click.option("--only-to-ros", is_flag=True, help="Send to ROS only."),
    click.option("--only-from-ros", is_flag=True, help="Take from ROS only."),
    click.option(
        "--frames",
        multiple=True,
        metavar="PATTERN",
        help="Only child frames of this name on the bus, such as 'robot1/*'; repeatable.",
    ),
    click.option(
        "--rate-limit",
        "rate_limit_hz",
        type=Number(least=0.01, most=10_000.0),
        metavar="HZ",
        help="Of each frame at most HZ transforms a second, in each direction; the newest goes.",
    ),
    click.option(
        "--clock",
        type=click.Choice(_CLOCKS),
        default="auto",
        show_default=True,
        help="Which way the simulated time goes; auto: from the side that has a clock.",
    ),
    click.option(
        "--topics",
        "topics_file",
        type=click.Path(exists=True, dir_okay=False, path_type=Path),
        metavar="FILE",
        help="Which topics cross, and as which types, in YAML.",
    ),
    click.option(
        "--topic",
        "topics",
        multiple=True,
        metavar="NAME",
        help="A further topic that crosses, as NAME or NAME=TYPE; repeatable.",
    ),
    click.option(
        "--odom-tf",
        is_flag=True,
        help="Send the pose of each Odometry from ROS as a transform, too.",
    ),
)
