"""`tfbus service`: services on the bus, calls of one, and launch files as services of systemd."""

from dataclasses import asdict

import click
from click.shell_completion import CompletionItem

from tfbus.bus.session import Session
from tfbus.bus.settings import NodeSettings
from tfbus.cli import Verbs
from tfbus.cli.bus import look, look_once, open_bus, say_if_empty
from tfbus.cli.call import CALLED_IN_ROS, TIMEOUT, follow, typed_request, types_of
from tfbus.cli.message import (
    bare,
    call_of_ros,
    complete_request,
    find_call,
    names_of_type,
    print_type,
    print_types,
    supplied_call,
    supplied_calls,
)
from tfbus.cli.output import json_option, paint, print_json, print_lines, print_text, yaml_text
from tfbus.cli.service_unit import container_command, install_command, uninstall_command
from tfbus.command.options import bus_options
from tfbus.command.types import ServiceName, matching
from tfbus.discover.graph import Graph, ServiceInfo
from tfbus.errors import ServiceError
from tfbus.wire.keys import relative
from tfbus.wording import did_you_mean


def _complete_show(
    ctx: click.Context, param: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    names = ServiceName().shell_complete(ctx, param, incomplete)
    return [*names, *matching([each.__qualname__ for each in supplied_calls()], incomplete)]


@click.group(cls=Verbs)
def command() -> None:
    """List, show and call services; install a launch file as a service of this machine."""


for _of_systemd in (install_command, uninstall_command, container_command):
    command.add_command(_of_systemd)


@command.command("list", epilog="Example: tfbus service list -t")
@click.option("-t", "--show-types", is_flag=True, help="Print their types too.")
@click.option("-c", "--count", "only_count", is_flag=True, help="Print only the count.")
@json_option("Print a JSON list of objects, with all servers and clients.")
@bus_options("service")
def list_command(settings: NodeSettings, show_types: bool, only_count: bool, as_json: bool) -> None:
    """Print the names of all services and actions, one per line."""
    with open_bus(settings) as session:
        graph = look(session)
        services = _served(graph)
        say_if_empty(session, services, "service", is_all=not graph.topics)
    if only_count:
        click.echo(len(services))
    elif as_json:
        print_json([_as_map(service) for service in services])
    else:
        print_lines(
            f"{service.name} {paint(f'[{types_of(service)}]', 'type')}"
            if show_types
            else service.name
            for service in services
        )


@command.command("info", epilog="Example: tfbus service info spawn")
@click.argument("service", type=ServiceName())
@json_option("Print a JSON object.")
@bus_options("service")
def info_command(settings: NodeSettings, service: str, as_json: bool) -> None:
    """Print the type of SERVICE, and the number of its servers and clients."""
    with open_bus(settings) as session:
        info = _find(session, relative(service, settings.namespace))
    if as_json:
        print_json(_as_map(info))
        return
    print_text(f"Type: {paint(types_of(info), 'type')}")
    print_text(f"Clients count: {len(info.clients)}")
    print_text(f"Services count: {len(info.servers)}")


@command.command("type", epilog="Example: tfbus service type spawn")
@click.argument("service", type=ServiceName())
@bus_options("service")
def type_command(settings: NodeSettings, service: str) -> None:
    """Print the type of SERVICE."""
    with open_bus(settings) as session:
        print_text(types_of(_find(session, relative(service, settings.namespace))))


@command.command("find", epilog="Example: tfbus service find Spawn")
@click.argument("type_name", metavar="TYPE")
@click.option("-c", "--count", "only_count", is_flag=True, help="Print only the count.")
@bus_options("service")
def find_command(settings: NodeSettings, type_name: str, only_count: bool) -> None:
    """Print the names of the services and actions of TYPE, one per line."""
    with open_bus(settings) as session:
        served = {service.name: service for service in _served(look_once(session))}
    found = names_of_type(served, type_name, "service")
    click.echo(len(found)) if only_count else print_lines(found)


@command.command(
    "call",
    hints=CALLED_IN_ROS,
    epilog="Example: tfbus service call spawn '{x: 2, y: 3, name: turtle2}'",
)
@click.argument("service", type=ServiceName())
@click.argument("request", nargs=-1, metavar="[TYPE] [REQUEST]", shell_complete=complete_request)
@TIMEOUT
@json_option("Print each answer as one line of JSON.")
@bus_options("service")
def call_command(
    settings: NodeSettings, service: str, request: tuple[str, ...], timeout_s: float, as_json: bool
) -> None:
    """Call SERVICE and print its response as YAML.

    REQUEST is a YAML map of fields; missing ones get their defaults, or zeros. TYPE, such as Spawn
    or package.module:Name, is optional; it is an error if the service has another type. An action
    gives several answers, as in `tfbus call`.
    """
    typed = typed_request(request)
    service = relative(service, settings.namespace)
    with open_bus(settings) as session:
        payload = typed.payload(session, service)
        for at, answer in enumerate(follow(session, service, payload, timeout_s)):
            if as_json:
                print_json(answer)
            else:
                print_text(("---\n" if at else "") + yaml_text(answer))


@command.command(
    "show",
    epilog="Examples: tfbus service show; tfbus service show spawn; tfbus service show Spawn",
)
@click.argument("service", metavar="[SERVICE|TYPE]", required=False, shell_complete=_complete_show)
@json_option("Print a JSON object.")
@bus_options("service")
def show_command(settings: NodeSettings, service: str | None, as_json: bool) -> None:
    """Print the fields of the request and the response of SERVICE, or of the type TYPE.

    TYPE is a service or action of tfbus.messages or package.module:Name. Without an argument, list
    those of tfbus.messages.
    """
    if service is None:
        print_types(supplied_calls())
        return
    type_ = (
        supplied_call(bare(service))
        or call_of_ros(service)
        or (find_call(service) if ":" in service else None)
    )
    if type_ is None:
        service = relative(service, settings.namespace)
        with open_bus(settings) as session:
            services = look_once(session).services
        if service not in services:
            known = {*services, *(each.__qualname__ for each in supplied_calls())}
            raise ServiceError(
                f"there is no service or type {service!r}{did_you_mean(service, known)}"
            )
        type_ = _type_of(services[service])
    print_type(type_, as_json=as_json)


def _type_of(info: ServiceInfo) -> type:
    known = [type_ for name in info.types if (type_ := supplied_call(name) or call_of_ros(name))]
    if not known:
        raise ServiceError(
            f"{info.name!r} is of type {types_of(info)}, whose fields only its nodes know: name it "
            "by its place in Python, as in: tfbus service show my_robot.services:Dock"
        )
    return known[0]


def _served(graph: Graph) -> list[ServiceInfo]:
    return [service for service in graph.services.values() if service.servers]


def _find(session: Session, service: str) -> ServiceInfo:
    services = look_once(session).services
    if service not in services:
        hint = did_you_mean(service, services, none=", nor any other: is a node running?")
        raise ServiceError(f"there is no service {service!r}{hint}")
    return services[service]


def _as_map(service: ServiceInfo) -> dict[str, object]:
    return {**asdict(service), "types": list(service.types)}
