"""`tfbus param`: reads and sets the parameters of running nodes."""

import math
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from operator import attrgetter
from typing import IO, Any

import click
from click.shell_completion import CompletionItem

from tfbus.base.errors import ParameterError, TfbusError
from tfbus.base.wording import counted, did_you_mean, listed
from tfbus.bus.presence import full_name_of, list_nodes
from tfbus.bus.remote_parameters import parameter_of, parameters_of, set_parameter
from tfbus.bus.session import Session
from tfbus.bus.settings import NodeSettings
from tfbus.cli import Verbs
from tfbus.cli.bus import open_bus, say_if_empty
from tfbus.cli.node import node_at, nodes_at
from tfbus.cli.output import (
    as_text,
    json_option,
    paint,
    print_json,
    print_lines,
    print_text,
    warn,
    with_type,
    yaml_text,
)
from tfbus.command.options import bus_options
from tfbus.command.recordings import BagChoice, bag_options
from tfbus.command.types import NodeName, ParameterName
from tfbus.wire.codec import as_map
from tfbus.wire.descriptions import NodeDescription, ParameterDescription


def _complete_pair(
    ctx: click.Context, param: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """The name of a parameter; its value is not completed."""
    is_value = len(ctx.params.get("pairs") or ()) % 2
    return [] if is_value else ParameterName().shell_complete(ctx, param, incomplete)


@click.group(
    cls=Verbs,
    hints={"delete": "a node keeps its parameters while it runs; set it instead"},
)
def command() -> None:
    """List, read, set, save and load the parameters of nodes."""


@contextmanager
def _one_of_ros(name: str) -> Iterator[None]:
    """For a node that refuses ROS's parameter of simulated time, a usage error that says how to set
    it.
    """
    try:
        yield
    except ParameterError as error:
        if name != "use_sim_time":
            raise
        raise click.UsageError(
            "a node has no parameter 'use_sim_time': simulated time is set where it starts, as in: "
            "tfbus simulator --sim-time; tfbus clock publishes the time"
        ) from error


@command.command("list", epilog="Example: tfbus param list sim")
@click.argument("node", type=NodeName(), required=False)
@click.option("--filter", "pattern", metavar="REGEX", help="Print only names that contain a match.")
@click.option("-t", "--param-type", "show_types", is_flag=True, help="Print their types too.")
@json_option("Print a JSON object: a list of names for each node.")
@bag_options("at")
@bus_options("param")
def list_command(
    settings: NodeSettings,
    bag: BagChoice | None,
    node: str | None,
    pattern: str | None,
    show_types: bool,
    as_json: bool,
) -> None:
    """Print the names of the parameters of NODE, or of every node."""
    wanted = _compiled(pattern or "")
    if bag is not None:
        described = _recorded(bag, settings, node)
    else:
        with open_bus(settings) as session:
            described = _of_one(session, node) if node else _of_all(session)
            say_if_empty(session, described, "node")
    found = {
        name: [each for each in parameters if wanted.search(each.name)]
        for name, parameters in described.items()
    }
    if as_json:
        print_json({name: [each.name for each in parameters] for name, parameters in found.items()})
        return
    for name, parameters in found.items():
        print_text(f"{paint(name, 'name')}:")
        print_lines(
            f"  {with_type(each.name, each.type) if show_types else each.name}"
            for each in parameters
        )


@command.command("get", epilog="Example: tfbus param get sim background_r")
@click.argument("node", type=NodeName())
@click.argument("parameters", type=ParameterName(), nargs=-1, required=True, metavar="PARAMETER...")
@click.option("--hide-type", is_flag=True, help="Print only the value.")
@json_option("Print a JSON object of the values.")
@bag_options("at")
@bus_options("param")
def get_command(
    settings: NodeSettings,
    bag: BagChoice | None,
    node: str,
    parameters: tuple[str, ...],
    hide_type: bool,
    as_json: bool,
) -> None:
    """Print the type and value of one or more parameters of NODE."""
    if bag is not None:
        recorded, _ = node_at(bag, settings, node)
        described = [_parameter_in(recorded, name) for name in parameters]
    else:
        with open_bus(settings) as session:
            described = [_described(session, node, name) for name in parameters]
    if as_json:
        print_json({each.name: each.value for each in described})
        return
    for each in described:
        value = as_text(each.value)
        typed = value if hide_type else f"{each.type.capitalize()} value is: {value}"
        print_text(typed if len(described) == 1 else f"{paint(each.name, 'name')}: {typed}")


def _recorded(
    bag: BagChoice, settings: NodeSettings, node: str | None
) -> dict[str, list[ParameterDescription]]:
    """The parameters of a node of a recording, or of all, by its full name."""
    nodes = nodes_at(bag)[0].values() if node is None else [node_at(bag, settings, node)[0]]
    return {each.name: sorted(each.parameters, key=attrgetter("name")) for each in nodes}


class _SetCommand(click.Command):
    """Accepts negative numbers as values, which click would take for options."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        ctx.ignore_unknown_options = "--" not in args and any(map(_is_negative, args))
        rest = super().parse_args(ctx, args)
        if ctx.ignore_unknown_options:
            for text in ctx.params.get("pairs") or ():
                if text.startswith("-") and not _is_negative(text):
                    raise click.NoSuchOption(text, ctx=ctx)
        return rest


def _is_negative(text: str) -> bool:
    """Whether the text is a negative number."""
    try:
        return text.startswith("-") and not math.isnan(float(text))
    except ValueError:
        return False


@command.command("set", cls=_SetCommand, epilog="Example: tfbus param set sim background_r 100")
@click.argument("node", type=NodeName())
@click.argument(
    "pairs",
    nargs=-1,
    required=True,
    metavar="PARAMETER VALUE...",
    shell_complete=_complete_pair,
)
@bus_options("param")
def set_command(settings: NodeSettings, node: str, pairs: tuple[str, ...]) -> None:
    """Set one or more parameters of NODE; VALUE is read as the parameter's type."""
    if len(pairs) % 2:
        raise click.UsageError(f"parameters and values come in pairs: {pairs[-1]!r} has no value")
    with open_bus(settings) as session:
        for name, value in zip(pairs[::2], pairs[1::2], strict=True):
            with _one_of_ros(name):
                set_parameter(session, node, name, value, warn)
            many = f": {name}" if len(pairs) > 2 else ""
            print_text(f"Set parameter successful{many}")


@command.command("dump", epilog="Example: tfbus param dump sim > sim.yaml")
@click.argument("node", type=NodeName())
@json_option("Print JSON instead of YAML.")
@bag_options("at")
@bus_options("param")
def dump_command(settings: NodeSettings, bag: BagChoice | None, node: str, as_json: bool) -> None:
    """Print all parameters of NODE as YAML, for `tfbus param load`."""
    if bag is not None:
        described = _recorded(bag, settings, node)
    else:
        with open_bus(settings) as session:
            described = {full_name_of(session, node): parameters_of(session, node)}
    values = {
        name: {each.name: each.value for each in parameters}
        for name, parameters in described.items()
    }
    if as_json:
        print_json(values)
    else:
        print_text(yaml_text(values))


@command.command("load", epilog="Example: tfbus param load sim sim.yaml")
@click.argument("node", type=NodeName())
@click.argument("file", type=click.File())
@bus_options("param")
def load_command(settings: NodeSettings, node: str, file: IO[str]) -> None:
    """Set the parameters of NODE from a YAML file; `-` is stdin.

    The file is a map of parameters, or of nodes with their parameters, as `tfbus param dump` prints
    it; `/**` matches any node. Prints the parameters that the node refuses, and sets all others.
    """
    with open_bus(settings) as session:
        values = read_parameter_file(file, full_name_of(session, node))
        refused = 0
        for name, value in values.items():
            try:
                set_parameter(session, node, name, value, warn)
            except ParameterError as error:
                refused += 1
                warn(error)
            else:
                print_text(f"Set parameter {name} successful")
    if refused:
        raise ParameterError(f"{refused} of {counted(len(values), 'parameter')} not set")


@command.command("describe", epilog="Example: tfbus param describe sim background_r")
@click.argument("node", type=NodeName())
@click.argument("parameters", type=ParameterName(), nargs=-1, metavar="[PARAMETER]...")
@json_option("Print a JSON list of objects.")
@bus_options("param")
def describe_command(
    settings: NodeSettings, node: str, parameters: tuple[str, ...], as_json: bool
) -> None:
    """Print the type, description and bounds of parameters of NODE, or of all."""
    with open_bus(settings) as session:
        if parameters:
            described = [_described(session, node, name) for name in parameters]
        else:
            described = parameters_of(session, node)
    if as_json:
        print_json([as_map(each) for each in described])
        return
    for each in described:
        print_lines(_description(each))


def _described(session: Session, node: str, name: str) -> ParameterDescription:
    with _one_of_ros(name):
        return parameter_of(session, node, name, warn)


def _compiled(pattern: str) -> re.Pattern[str]:
    try:
        return re.compile(pattern)
    except re.error as error:
        raise click.UsageError(
            f"--filter {pattern!r} is not a regular expression: {error}"
        ) from error


def _of_one(session: Session, node: str) -> dict[str, list[ParameterDescription]]:
    return {full_name_of(session, node): parameters_of(session, node)}


def _of_all(session: Session) -> dict[str, list[ParameterDescription]]:
    """The parameters of every node; warns of nodes that do not answer."""
    described: dict[str, list[ParameterDescription]] = {}
    for name in list_nodes(session):
        try:
            described |= _of_one(session, name)
        except TfbusError as error:
            warn(error)
    return described


def _description(parameter: ParameterDescription) -> list[str]:
    lines = [f"Parameter name: {paint(parameter.name, 'name')}", f"  Type: {parameter.type}"]
    if parameter.description:
        lines.append(f"  Description: {parameter.description}")
    bounds = {"Min": parameter.minimum, "Max": parameter.maximum}
    limits = [f"    {end} value: {value}" for end, value in bounds.items() if value is not None]
    return [*lines, *(["  Constraints:"] if limits else []), *limits]


# The key for every node, and ROS 2's key above the parameters of one.
_EVERY_NODE = "/**"
_ROS_PARAMETERS = "ros__parameters"


def read_parameter_file(file: IO[str], node: str) -> dict[str, Any]:
    """The parameters in the file for the node of this full name.

    A file without names of nodes is for any node. Raises click.BadParameter if it is not a map, or
    has nothing for this node.
    """
    from tfbus.base.yaml_file import read_value  # YAML, which `--help` does not need

    try:
        content = read_value(file.read())
    except UnicodeDecodeError as error:
        raise _mistake(file, "is not a text file in UTF-8") from error
    if not isinstance(content, dict) or not content:
        raise _mistake(file, "is not a YAML map of parameters")
    if not any(isinstance(value, dict) for value in content.values()):
        return content
    nodes = [name for name in (_EVERY_NODE, node, node.strip("/")) if name in content]
    if not nodes:
        raise _mistake(file, f"has no parameters for {node}; available: {listed(content)}")
    values: dict[str, Any] = {}
    for name in nodes:
        values |= _parameters(file, name, content[name])
    return values


def _parameters(file: IO[str], node: str, content: Any) -> Mapping[str, Any]:
    if isinstance(content, dict) and list(content) == [_ROS_PARAMETERS]:
        content = content[_ROS_PARAMETERS]
    if not isinstance(content, dict):
        raise _mistake(file, f"has no map of parameters under {node}")
    return content


def _mistake(file: IO[str], what: str) -> click.BadParameter:
    return click.BadParameter(f"{file.name} {what}", param_hint="FILE")


def _parameter_in(node: NodeDescription, name: str) -> ParameterDescription:
    """A parameter of a recorded node. Raises ParameterError for none."""
    for each in node.parameters:
        if each.name == name:
            return each
    names = [each.name for each in node.parameters]
    raise ParameterError(
        f"node {node.name!r} has no parameter {name!r} in the recording{did_you_mean(name, names)}"
    )
