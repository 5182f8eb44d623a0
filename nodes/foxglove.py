"""`tfbus foxglove`: the bus, or a recording, in Foxglove.

Try it: tfbus launch turtle, and beside it: tfbus foxglove --teleop turtle1/cmd_vel
"""

import click

from tfbus import Fleet, Node, NodeSettings, TfbusError, TopicName, fleet_options, node_options
from tfbus.command import install_command
from tfbus.foxglove import Front, Serving, is_local, page_url


def _port(ctx: click.Context, param: click.Parameter, text: str) -> int:
    if not (text.isdecimal() and 1 <= int(text) <= 65535):
        raise click.BadParameter(f"{text!r} is not a port number from 1 to 65535")
    return int(text)


@click.command(epilog="Example: tfbus foxglove --teleop turtle1/cmd_vel")
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
@fleet_options
@node_options("foxglove")
def main(
    settings: NodeSettings,
    fleet: Fleet | None,
    host: str,
    port: int,
    teleop: tuple[str, ...],
    read_only: bool,
    origins: tuple[str, ...],
) -> None:
    """Show the bus in Foxglove: frames, topics, parameters, services and the graph of nodes."""
    if read_only and teleop:
        raise click.UsageError("--read-only and --teleop are mutually exclusive: give one")
    _require_foxglove()
    from tfbus.foxglove import LiveBridge

    serving = Serving(host, port, origins)
    with Node.from_settings(settings) as node:
        bridge = LiveBridge(node, serving, fleet=fleet, teleop=teleop, read_only=read_only)
        try:
            _announce(node, bridge.front, serving)
            node.wait(None)
        finally:
            bridge.close()


def _announce(node: Node, front: Front, serving: Serving) -> None:
    """Log where to open it, and who can."""
    if front.port != serving.port:
        node.log.warning("Port %d of %s is taken: using %d", serving.port, serving.host, front.port)
    address = front.addresses[0]
    node.ready(f"Foxglove: open {page_url(address)} or connect to {' or '.join(front.addresses)}")
    if not is_local(serving.host):
        node.log.warning(
            "Anyone who reaches %s can see the bus, set parameters and call services: there is no "
            "password. A tunnel is safer: ssh -L %d:127.0.0.1:%d this-machine",
            " or ".join(front.addresses),
            front.port,
            front.port,
        )


def _require_foxglove() -> None:
    try:
        import foxglove  # noqa: F401  # only whether it is installed
    except ImportError as error:
        raise TfbusError(
            f"foxglove-sdk is not installed ({error}): {install_command('foxglove')}"
        ) from error


if __name__ == "__main__":
    main()
