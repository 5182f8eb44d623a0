"""`tfbus node`: the nodes on the bus or in a recording, and the interfaces of one."""

import time
from collections import Counter
from collections.abc import Iterable

import click

from tfbus.base.errors import BusError
from tfbus.base.wording import did_you_mean, printable
from tfbus.bus.presence import ask_nodes, describe_nodes, list_nodes
from tfbus.bus.settings import NodeSettings
from tfbus.cli import Verbs
from tfbus.cli.bus import open_bus, say_if_empty, warn_of_unanswered
from tfbus.cli.message import shown_type
from tfbus.cli.output import as_text, json_option, paint, print_json, print_lines, warn
from tfbus.command.names import nodes_in
from tfbus.command.options import bus_options
from tfbus.command.recordings import BagChoice, bag_options
from tfbus.command.types import NodeName
from tfbus.wire.codec import as_map
from tfbus.wire.descriptions import NodeDescription
from tfbus.wire.keys import ALL_NODES_EVERYWHERE

_INTERFACES = ("publishes", "subscribes", "serves", "calls")


@click.group(cls=Verbs)
def command() -> None:
    """List nodes, or show one."""


@command.command("list", epilog="Example: tfbus node list")
@click.option("-a", "--all", "everyone", is_flag=True, help="Include names that start with _.")
@click.option("-c", "--count", "only_count", is_flag=True, help="Print only the count.")
@json_option("Print a JSON list.")
@bag_options("at")
@bus_options("node")
def list_command(
    settings: NodeSettings, bag: BagChoice | None, everyone: bool, only_count: bool, as_json: bool
) -> None:
    """Print the full names of all nodes, one per line."""
    if bag is not None:
        names = _shown(list(nodes_at(bag)[0]), everyone)
    else:
        with open_bus(settings) as session:
            present = list_nodes(session)
            found = ask_nodes(session, alive=session.living(ALL_NODES_EVERYWHERE))
            for error in found.unreadable:
                warn(error)
            described = {(node.session, node.name) for node in found.nodes}
            names = _shown(present, everyone)
            say_if_empty(session, names, "node", is_all=not present)
        warn_of_unanswered(_shown(found.silent_nodes, everyone))
        for name, count in Counter(name for _, name in described).items():
            if count > 1:
                warn(f"{count} nodes have the name {name}")
    if only_count:
        click.echo(len(names))
    elif as_json:
        print_json(names)
    else:
        print_lines(names)


@command.command("info", epilog="Example: tfbus node info /sim")
@click.argument("name", type=NodeName())
@json_option("Print JSON, one object per line.")
@bag_options("at")
@bus_options("node")
def info_command(settings: NodeSettings, bag: BagChoice | None, name: str, as_json: bool) -> None:
    """Print the topics, services, parameters, host and pid of the node NAME."""
    now_ns = time.time_ns()
    if bag is not None:
        found, now_ns = node_at(bag, settings, name)
        nodes = [found]
    else:
        with open_bus(settings) as session:
            nodes = describe_nodes(session, name)
    if len(nodes) > 1:
        warn(f"{len(nodes)} nodes have the name {nodes[0].name}")
    for node in nodes:
        if as_json:
            print_json(as_map(node))
        else:
            print_lines(_lines(node, now_ns))


def nodes_at(choice: BagChoice) -> tuple[dict[str, NodeDescription], int]:
    """The nodes by their full names, and the log time of the moment. Raises TfbusError."""
    with choice.opened() as bag:
        return nodes_in(bag.reader.state_at(bag.at_ns).nodes.values()), bag.at_ns


def node_at(choice: BagChoice, settings: NodeSettings, name: str) -> tuple[NodeDescription, int]:
    """The node of a name, relative to the namespace or full, and the log time of the moment.

    Raises BusError for none.
    """
    nodes, at_ns = nodes_at(choice)
    path = name.strip("/")
    full = path if name.startswith("/") else "/".join(filter(None, (settings.namespace, path)))
    if f"/{full}" not in nodes:
        hint = did_you_mean(f"/{full}", nodes, none=", nor any other")
        raise BusError(f"there is no node {name!r} in the recording at that time{hint}")
    return nodes[f"/{full}"], at_ns


def _shown(names: Iterable[str], everyone: bool) -> list[str]:
    return [name for name in names if everyone or not _is_hidden(name)]


def _is_hidden(name: str) -> bool:
    """Whether a node belongs to a tool, such as `tfbus topic echo`."""
    return name.rpartition("/")[2].startswith("_")


def _lines(node: NodeDescription, now_ns: int) -> list[str]:
    uptime_s = (now_ns - node.started_ns) / 1e9
    lines = [
        paint(node.name, "name"),
        f"  Host: {node.host}",
        f"  Pid: {node.pid}",
        f"  Version: {node.version}",
        f"  Up: {uptime_s:.0f} s",
        *([f"  Identity: {node.identity}"] if node.identity else []),
        f"  Streams: {', '.join(node.streams) or 'none'}",
    ]
    if node.delays:
        lines += ["  Held up:", *(f"    {delay}" for delay in node.delays)]
    if node.failures:
        lines += ["  Failed:", *(f"    {failure}" for failure in node.failures)]
    for kind in _INTERFACES:
        lines.append(f"  {kind.capitalize()}:")
        lines += [
            f"    {name}: {paint(shown_type(type_), 'type')}"
            for name, type_ in sorted(getattr(node, kind).items())
        ]
    lines.append("  Parameters:")
    lines += [f"    {entry.name}: {printable(as_text(entry.value))}" for entry in node.parameters]
    return lines
