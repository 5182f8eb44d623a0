"""`tfbus foxglove`: the bus, or a recording, in Foxglove.

Try it: tfbus launch turtle, and beside it: tfbus foxglove --teleop turtle1/cmd_vel
"""

from contextlib import closing

import click

from tfbus import (
    Fleet,
    Node,
    NodeSettings,
    Number,
    TfbusError,
    TopicName,
    fleet_options,
    node_options,
)
from tfbus.command import BagChoice, bag_options, install_command
from tfbus.foxglove import Serving


def _port(ctx: click.Context, param: click.Parameter, text: str) -> int:
    if not (text.isdecimal() and 1 <= int(text) <= 65535):
        raise click.BadParameter(f"{text!r} is not a port number from 1 to 65535")
    return int(text)


@click.command(
    epilog="Examples: tfbus foxglove --teleop turtle1/cmd_vel; tfbus foxglove --bag run.mcap"
)
@click.option("--host", default="127.0.0.1", help="The address to listen on (default 127.0.0.1).")
@click.option(
    "--port",
    default="8765",
    callback=_port,
    metavar="NUMBER",
    help="The port, or the first free one after it (default 8765).",
)
@click.option(
    "--teleop",
    type=TopicName(),
    multiple=True,
    metavar="TOPIC",
    help="Let clients drive: publish what Foxglove's Teleop panel sends on TOPIC; repeatable.",
)
@click.option(
    "--read-only", is_flag=True, help="Let clients neither set parameters nor call services."
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
@bag_options("begin", "end")
@fleet_options
@node_options("foxglove")
def main(
    settings: NodeSettings,
    fleet: Fleet | None,
    bag: BagChoice | None,
    host: str,
    port: int,
    teleop: tuple[str, ...],
    read_only: bool,
    origins: tuple[str, ...],
    rate: float | None,
    loop: bool,
) -> None:
    """Show the bus, or a recording, in Foxglove.

    Of the bus it shows frames, topics, parameters, services and the graph of nodes. With --bag it
    shows a recording, and Foxglove's bar plays it.
    """
    _require_foxglove()
    serving = Serving(host, port, origins)
    if bag is None:
        if rate is not None or loop:
            raise click.UsageError("--rate and --loop play a recording: give --bag")
        if read_only and teleop:
            raise click.UsageError("--read-only and --teleop are mutually exclusive: give one")
        _show_bus(settings, serving, fleet, teleop, read_only)
    else:
        if teleop:
            raise click.UsageError("--teleop and --bag are mutually exclusive: give one")
        _show_recording(settings, serving, fleet, bag, rate or 1.0, loop)


def _show_bus(
    settings: NodeSettings,
    serving: Serving,
    fleet: Fleet | None,
    teleop: tuple[str, ...],
    read_only: bool,
) -> None:
    from tfbus.foxglove import LiveBridge

    with Node.from_settings(settings) as node:
        bridge = LiveBridge(node, serving, fleet=fleet, teleop=teleop, read_only=read_only)
        with closing(bridge):
            node.ready(bridge.front.announcement())
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
) -> None:
    """Serve a recording; no bus is joined."""
    with bag.opened() as opened:
        span = opened.span
    from tfbus.foxglove import PlaybackBridge

    bridge = PlaybackBridge(
        bag.paths,
        span,
        serving,
        log_level=settings.log_level,
        fleet=fleet,
        rate=rate,
        at_end="loop" if loop else "wait",
    )
    with closing(bridge):
        bridge.log.info("%s", bridge.front.announcement())
        for warning in bridge.front.warnings():
            bridge.log.warning("%s", warning)
        bridge.run()


def _require_foxglove() -> None:
    try:
        import foxglove  # noqa: F401  # only whether it is installed
    except ImportError as error:
        raise TfbusError(
            f"foxglove-sdk is not installed ({error}): {install_command('foxglove')}"
        ) from error


if __name__ == "__main__":
    main()
