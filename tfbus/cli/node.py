"""`tfbus node`: which nodes are there, and what one of them does."""

import json
import time
from typing import Any

import click

from tfbus.cli.bus import open_bus
from tfbus.options import bus_options
from tfbus.presence import describe_nodes, list_nodes
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
    if only_count:
        click.echo(len(names))
    elif as_json:
        click.echo(json.dumps(names))
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
        click.echo(f"Warning: {len(nodes)} nodes have the name {nodes[0]['name']}", err=True)
    for node in nodes:
        click.echo(json.dumps(node) if as_json else _as_text(node))


def _as_text(node: dict[str, Any]) -> str:
    uptime_s = (time.time_ns() - node["started_ns"]) / 1e9
    lines = [
        node["name"],
        f"  Host: {node['host']}",
        f"  Pid: {node['pid']}",
        f"  Version: {node['version']}",
        f"  Up: {uptime_s:.0f} s",
        f"  Streams: {', '.join(node['streams']) or 'none'}",
    ]
    for kind in _INTERFACES:
        lines.append(f"  {kind.capitalize()}:")
        lines += [f"    {name}: {type_}" for name, type_ in sorted(node[kind].items())]
    lines.append("  Parameters:")
    lines += [f"    {entry['name']}: {_as_yaml(entry['value'])}" for entry in node["parameters"]]
    return "\n".join(lines)


def _as_yaml(value: object) -> str:
    return value if isinstance(value, str) else json.dumps(value)
