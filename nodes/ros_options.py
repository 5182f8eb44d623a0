"""What the commands of the bridges to ROS share: their options, and the run."""

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar, cast

import click

from tfbus import Node, NodeSettings, Number
from tfbus.bridge import BridgeOptions, LegSettings, TopicTable

F = TypeVar("F", bound=Callable[..., Any])

_CLOCKS = ("auto", "to-ros", "from-ros", "off")


@dataclass(frozen=True)
class Crossing:
    """What crosses, as the command line has it."""

    options: BridgeOptions
    table: TopicTable
    odom_tf: bool


def crossing_options(command: F) -> F:
    """The options that say what crosses; the command gets a `crossing`."""

    def with_crossing(
        *,
        ros_namespace: str,
        frame_prefix: str,
        only_to_ros: bool,
        only_from_ros: bool,
        frames: tuple[str, ...],
        rate_limit: float | None,
        clock: str,
        topics: Path | None,
        topic: tuple[str, ...],
        odom_tf: bool,
        **given: Any,
    ) -> Any:
        if only_to_ros and only_from_ros:
            raise click.UsageError("--only-to-ros and --only-from-ros are mutually exclusive")
        options = BridgeOptions(
            to_ros=not only_from_ros,
            from_ros=not only_to_ros,
            frames=frames,
            frame_prefix=frame_prefix,
            rate_limit_hz=rate_limit,
            ros_namespace=ros_namespace.strip("/"),
            clock=cast(Literal["auto", "to-ros", "from-ros", "off"], clock),
        )
        table = TopicTable.of_file(topics, topic)
        return command(crossing=Crossing(options, table, odom_tf), **given)

    with_crossing.__name__ = command.__name__
    with_crossing.__doc__ = command.__doc__
    with_crossing.__click_params__ = getattr(command, "__click_params__", [])  # type: ignore[attr-defined]
    for option in reversed(_OPTIONS):
        option(with_crossing)
    return cast(F, with_crossing)


_OPTIONS = (
    click.option(
        "--ros-namespace",
        default="",
        metavar="NAME",
        help="The namespace in ROS: robot1 for /robot1/tf (default: none).",
    ),
    click.option(
        "--frame-prefix",
        default="",
        metavar="TEXT",
        help="What the bus has before the names of frames of ROS, such as robot1/.",
    ),
    click.option("--only-to-ros", is_flag=True, help="Nothing comes from ROS."),
    click.option("--only-from-ros", is_flag=True, help="Nothing goes to ROS."),
    click.option(
        "--frames",
        multiple=True,
        metavar="PATTERN",
        help="Child frames that cross, such as 'robot1/*'; repeatable (default: all).",
    ),
    click.option(
        "--rate-limit",
        type=Number(least=0.001, most=100_000.0),
        metavar="HZ",
        help="How often a frame crosses at most; the newest goes (default: always).",
    ),
    click.option(
        "--clock",
        type=click.Choice(_CLOCKS),
        default="auto",
        show_default=True,
        help="Which side gets the other's simulated time.",
    ),
    click.option(
        "--topics",
        type=click.Path(dir_okay=False, path_type=Path),
        metavar="FILE",
        help="A YAML file of further topics, and of types of your own.",
    ),
    click.option(
        "--topic",
        multiple=True,
        metavar="NAME[=TYPE]",
        help="A topic to look for in ROS, such as arm/goal=PoseStamped; repeatable.",
    ),
    click.option(
        "--odom-tf",
        is_flag=True,
        help="Take the poses of Odometry from ROS as transforms, too.",
    ),
)


def run_bridge(settings: NodeSettings, crossing: Crossing, via: str, leg: LegSettings) -> None:
    """Join the bus and ROS until a signal."""
    from tfbus.bridge import Bridge, open_leg, with_odometry_frames

    with Node.from_settings(settings) as node:
        joined = open_leg(via, leg, node.log)
        if crossing.odom_tf:
            joined = with_odometry_frames(joined, crossing.table, leg.namespace)
        bridge = Bridge(
            node, joined, crossing.options, ros_node=leg.full_name, table=crossing.table
        )
        with closing(bridge):
            node.ready(bridge.announcement)
            node.wait(None)
