"""`tfbus param`: the parameters of nodes, read and set while they run."""

import click

from tfbus.cli.bus import open_bus
from tfbus.cli.output import as_text, warn
from tfbus.codec import decode_message, encode_map
from tfbus.description import ParameterDescription
from tfbus.errors import BusError, DecodeError, ParameterError, TfbusError
from tfbus.keys import node_parameters_key, parameter_key
from tfbus.options import bus_options
from tfbus.presence import describe_nodes, list_nodes, relative_name
from tfbus.session import Answer, Session
from tfbus.settings import NodeSettings


@click.group()
def command() -> None:
    """List, read and set the parameters of nodes."""


@command.command("list", epilog="Example: tfbus param list sim")
@click.argument("node", required=False)
@bus_options("param")
def list_command(settings: NodeSettings, node: str | None) -> None:
    """Print the names of the parameters of NODE, or of every node."""
    with open_bus(settings) as session:
        for name in [node] if node else list_nodes(session):
            try:
                _print_names(session, name)
            except TfbusError as error:
                if node:
                    raise
                warn(error)


def _print_names(session: Session, node: str) -> None:
    namespace = session.settings.namespace
    described = _ask(session, node, None)
    click.echo("/" + "/".join(filter(None, (namespace, relative_name(node, namespace)))) + ":")
    for name in sorted(parameter.name for parameter in described):
        click.echo(f"  {name}")


@command.command("get", epilog="Example: tfbus param get sim background_r")
@click.argument("node")
@click.argument("parameter")
@bus_options("param")
def get_command(settings: NodeSettings, node: str, parameter: str) -> None:
    """Print the type and the value of a parameter."""
    with open_bus(settings) as session:
        answers = _ask(session, node, parameter)
    if len(answers) > 1:
        warn(f"{len(answers)} nodes have the name {node}")
    for described in answers:
        click.echo(f"{described.type.capitalize()} value is: {as_text(described.value)}")


@command.command("set", epilog="Example: tfbus param set sim background_r 100")
@click.argument("node")
@click.argument("parameter")
@click.argument("value")
@bus_options("param")
def set_command(settings: NodeSettings, node: str, parameter: str, value: str) -> None:
    """Set a parameter; VALUE is read as the parameter's type."""
    with open_bus(settings) as session:
        _ask(session, node, parameter, encode_map({"value": value}))
    click.echo("Set parameter successful")


def _ask(
    session: Session, node: str, parameter: str | None, payload: bytes | None = None
) -> list[ParameterDescription]:
    """What the node answers of its parameter, or of all of them where that is None."""
    path, _, name = relative_name(node, session.settings.namespace).rpartition("/")
    key = parameter_key(name, parameter) if parameter else node_parameters_key(name)
    described = []
    for answer in session.ask("/".join(filter(None, (path, key))), payload, timeout_s=2.0):
        if answer.refusal is not None:
            raise ParameterError(answer.refusal or f"node {node!r} did not answer in time")
        described.append(_read(node, answer))
    if not described:
        describe_nodes(session, node)  # says so where there is no such node
        if parameter is not None:
            raise BusError(f"node {node!r} did not answer")
    return described


def _read(node: str, answer: Answer) -> ParameterDescription:
    try:
        return decode_message(ParameterDescription, answer.payload)
    except DecodeError as error:
        raise DecodeError(
            f"what node {node!r} tells about its parameters cannot be read: {error}"
        ) from error
