"""`tfbus foxglove`: the bus, or a recording, in Foxglove.

Try it: tfbus launch turtle, and beside it: tfbus foxglove --teleop turtle1/cmd_vel
"""

from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import TypedDict

import click

from tfbus import (
    Fleet,
    Node,
    NodeSettings,
    Number,
    Robot,
    TfbusError,
    TopicName,
    fleet_options,
    node_options,
)
from tfbus.base.installation import install_command
from tfbus.command.recordings import BagChoice, bag_options
from tfbus.command.server import ServerOptions, server_options
from tfbus.foxglove.front import Serving


class _Robots(TypedDict):
    """The robots that are shown, and the places of their meshes."""

    robot: Robot | None
    package_path: Sequence[Path]


@click.command(
    epilog="Examples: tfbus foxglove --teleop turtle1/cmd_vel; tfbus foxglove --bag run.mcap"
)
@server_options("foxglove", 8765)
@click.option(
    "--teleop",
    type=TopicName(),
    multiple=True,
    metavar="TOPIC",
    help="Let clients drive: publish what Foxglove's Teleop panel sends on TOPIC; repeatable.",
)
@click.option(
    "--read-only/--operate",
    "read_only",
    default=None,
    help="Whether clients only look, or may set parameters and call services (default: operate, "
    "with --public read-only).",
)
@click.option(
    "--allow-origin",
    "origins",
    multiple=True,
    metavar="URL",
    help="Let pages of another host connect, such as http://viewer.lan:8080; repeatable.",
)
@click.option(
    "-r",
    "--rate",
    type=Number(least=0.001, most=10_000.0),
    metavar="NUMBER",
    help="With --bag: recorded seconds per second at the beginning (default 1).",
)
@click.option("-l", "--loop", is_flag=True, help="With --bag: at the end begin again.")
@click.option(
    "--urdf",
    type=click.Path(path_type=Path, dir_okay=False, exists=True),
    metavar="FILE",
    help="Show this robot, of a URDF or .xacro file (default: those described on the bus).",
)
@click.option(
    "--package-path",
    "package_path",
    type=click.Path(path_type=Path, file_okay=False, exists=True),
    multiple=True,
    metavar="DIR",
    help="A folder with the packages that the URDF's meshes are in; repeatable.",
)
@bag_options("begin", "end")
@fleet_options
@node_options("foxglove")
def main(
    settings: NodeSettings,
    fleet: Fleet | None,
    bag: BagChoice | None,
    listening: ServerOptions,
    teleop: tuple[str, ...],
    read_only: bool | None,
    origins: tuple[str, ...],
    rate: float | None,
    loop: bool,
    urdf: Path | None,
    package_path: tuple[Path, ...],
) -> None:
    """Show the bus, or a recording, in Foxglove.

    Of the bus it shows frames, robots, topics, parameters, services and the graph of nodes. With
    --bag it shows a recording, and Foxglove's bar plays it.
    """
    robot = Robot.from_urdf(urdf, package_path=package_path) if urdf else None
    _require_foxglove()
    robots: _Robots = {"robot": robot, "package_path": package_path}
    if read_only is None:
        read_only = listening.is_public
        if read_only and teleop:
            raise click.UsageError("with --public clients only look: add --operate for --teleop")
    public = listening.public(settings)
    serving = Serving(
        listening.host,
        listening.port,
        origins,
        public.tls if public else None,
        public.token if public else None,
    )
    notes = public.notes if public else ()
    if bag is None:
        if rate is not None or loop:
            raise click.UsageError("--rate and --loop play a recording: give --bag")
        if read_only and teleop:
            raise click.UsageError("--read-only and --teleop are mutually exclusive: give one")
        _show_bus(settings, serving, fleet, teleop, read_only, notes, robots)
    else:
        if teleop:
            raise click.UsageError("--teleop and --bag are mutually exclusive: give one")
        _show_recording(settings, serving, fleet, bag, rate or 1.0, loop, notes, robots)


def _show_bus(
    settings: NodeSettings,
    serving: Serving,
    fleet: Fleet | None,
    teleop: tuple[str, ...],
    read_only: bool,
    notes: Sequence[str],
    robots: _Robots,
) -> None:
    from tfbus.foxglove.live import LiveBridge

    with Node.from_settings(settings) as node:
        bridge = LiveBridge(
            node, serving, fleet=fleet, teleop=teleop, read_only=read_only, **robots
        )
        with closing(bridge):
            node.ready(bridge.front.announcement())
            for note in notes:
                node.log.info("%s", note)
            for warning in bridge.front.warnings():
                node.log.warning("%s", warning)
            node.wait(None)


def _show_recording(
    settings: NodeSettings,
    serving: Serving,
    fleet: Fleet | None,
    bag: BagChoice,
    rate: float,
    loop: bool,
    notes: Sequence[str],
    robots: _Robots,
) -> None:
    """Serve a recording; no bus is joined."""
    with bag.opened() as opened:
        span = opened.span
    from tfbus.foxglove.playback import PlaybackBridge

    bridge = PlaybackBridge(
        bag.paths,
        span,
        serving,
        log_level=settings.log_level,
        fleet=fleet,
        rate=rate,
        at_end="loop" if loop else "wait",
        **robots,
    )
    with closing(bridge):
        for text in (bridge.front.announcement(), *notes):
            bridge.log.info("%s", text)
        for warning in bridge.front.warnings():
            bridge.log.warning("%s", warning)
        bridge.run()


def _require_foxglove() -> None:
    try:
        import websockets  # noqa: F401  # only whether it is installed
    except ImportError as error:
        raise TfbusError(
            f"websockets is not installed ({error}): {install_command('foxglove')}"
        ) from error


if __name__ == "__main__":
    main()
