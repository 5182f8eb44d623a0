"""`tfbus node`: which nodes are there, and what one of them does."""

import time
from collections import Counter

import click

from tfbus.cli.bus import as_json as json_line
from tfbus.cli.bus import as_text, open_bus, warn
from tfbus.codec import as_map
from tfbus.description import NodeDescription
from tfbus.options import bus_options
from tfbus.presence import describe_all, describe_nodes, list_nodes
from tfbus.settings import NodeSettings

_INTERFACES = ("publishes", "subscribes", "serves", "calls")


@click.group()
def command() -> None:
    """List nodes, or show what one of them does."""


@command.command("list", epilog="Example: tfbus node list")
@click.option("--count", "only_count", is_flag=True, help="Print only how many there are.")
@click.option("--json", "as_json", is_flag=True, help="Print a JSON list.")
@bus_options("node")
def list_command(settings: NodeSettings, only_count: bool, as_json: bool) -> None:
    """Print the full names of all nodes, one a line."""
    with open_bus(settings) as session:
        names = list_nodes(session)
        told = {(node.session, node.name) for node in describe_all(session, warn)}
    for name, count in Counter(name for _, name in told).items():
        if count > 1:
            warn(f"{count} nodes have the name {name}")
    if only_count:
        click.echo(len(names))
    elif as_json:
        click.echo(json_line(names))
    else:
        for name in names:
            click.echo(name)


@command.command("info", epilog="Example: tfbus node info /sim")
@click.argument("name")
@click.option("--json", "as_json", is_flag=True, help="Print JSON, one object a line.")
@bus_options("node")
def info_command(settings: NodeSettings, name: str, as_json: bool) -> None:
    """Print what the node NAME publishes, subscribes, serves; its parameters, host and pid."""
    with open_bus(settings) as session:
        nodes = describe_nodes(session, name)
    if len(nodes) > 1:
        warn(f"{len(nodes)} nodes have the name {nodes[0].name}")
    for node in nodes:
        click.echo(json_line(as_map(node)) if as_json else _as_text(node))


def _as_text(node: NodeDescription) -> str:
    uptime_s = (time.time_ns() - node.started_ns) / 1e9
    lines = [
        node.name,
        f"  Host: {node.host}",
        f"  Pid: {node.pid}",
        f"  Version: {node.version}",
        f"  Up: {uptime_s:.0f} s",
        f"  Streams: {', '.join(node.streams) or 'none'}",
    ]
    for kind in _INTERFACES:
        lines.append(f"  {kind.capitalize()}:")
        lines += [f"    {name}: {type_}" for name, type_ in sorted(getattr(node, kind).items())]
    lines.append("  Parameters:")
    lines += [f"    {entry.name}: {as_text(entry.value)}" for entry in node.parameters]
    return "\n".join(lines)
