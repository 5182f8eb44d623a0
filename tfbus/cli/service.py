"""`tfbus service`: services on the bus, calls of one, and launch files as services of systemd."""

import io
import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Sequence
from contextlib import redirect_stdout, suppress
from dataclasses import asdict
from pathlib import Path

import click
from click.shell_completion import CompletionItem

from tfbus.base.errors import InvalidArgumentException, ServiceError
from tfbus.base.wording import did_you_mean
from tfbus.bus.graph import Graph, ServiceInfo
from tfbus.bus.identity_folder import KEY_FILE
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
from tfbus.cli.output import (
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
from tfbus.command.types import ServiceName, matching
from tfbus.launch.find import installed_launch_files
from tfbus.launch.service_manager import MARK, Service, container_text, unit_text
from tfbus.wire.keys import relative

# There while systemd runs this machine.
_SYSTEMD = Path("/run/systemd/system")
_SYSTEM_UNITS = Path("/etc/systemd/system")

_PASSED_ON = {"ignore_unknown_options": True}
_AS_IN_LAUNCH = "[NAME:=VALUE|OPTION]..."
_SETTINGS = "TFBUS_"


def _unit_path(name: str, *, is_system: bool) -> Path:
    if is_system:
        return _SYSTEM_UNITS / f"{name}.service"
    home = os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config"
    return Path(home) / "systemd" / "user" / f"{name}.service"


def _checked(file: str, arguments: Sequence[str]) -> tuple[Path, list[str]]:
    """The launch file and the arguments of `tfbus launch` for it, which takes them.

    Raises click's errors if it does not.
    """
    from tfbus.cli import launch  # asyncio and YAML, which `tfbus service list` does not need

    given = [file, *arguments]
    context = launch.command.make_context("tfbus launch", list(given), resilient_parsing=True)
    for option in launch.command.params:
        if option.name in launch.ONLY_PRINT and context.params.get(option.name):
            raise click.UsageError(
                f"{option.opts[-1]} of tfbus launch only prints: the service would end at once, "
                "again and again"
            )
    try:
        with redirect_stdout(io.StringIO()):
            launch.command.main(
                [*given, "--dry-run"], prog_name="tfbus launch", standalone_mode=False
            )
    except click.UsageError as error:
        # With the usage of this command, not of that one.
        raise click.UsageError(error.format_message(), click.get_current_context()) from error
    path, rest = launch.chosen_file(file, context.params.get("arguments") or ())
    left = list(arguments)
    if len(rest) < len(context.params.get("arguments") or ()):
        left.remove(context.params["arguments"][0])  # of PACKAGE FILE
    return path.absolute(), left


@click.group(cls=Verbs)
def command() -> None:
    """List, show and call services; install a launch file as a service of this machine."""


@command.command(
    "install",
    context_settings=_PASSED_ON,
    epilog="Examples: tfbus service install robot.yaml --network mobile; "
    "sudo tfbus service install robot.yaml --run-as robot; tfbus service install turtle --print",
)
@click.argument("file", metavar="FILE")
@click.argument("arguments", nargs=-1, metavar=_AS_IN_LAUNCH, type=click.UNPROCESSED)
@click.option("--name", metavar="NAME", help="The name of the service (default that of FILE).")
@click.option("--system", is_flag=True, help="For the machine, at boot; the default of root.")
@click.option("--user", "is_user", is_flag=True, help="For you alone; the default of others.")
@click.option("--run-as", metavar="USER", default="", help="The user of a service of the machine.")
@click.option(
    "-n",
    "--dry-run",
    "--print",
    "only_print",
    is_flag=True,
    help="Print the unit, and install nothing.",
)
def install_command(
    file: str,
    arguments: tuple[str, ...],
    name: str | None,
    system: bool,
    is_user: bool,
    run_as: str,
    only_print: bool,
) -> None:
    """Write a unit of systemd that runs a launch file from boot on.

    FILE and what follows are as in `tfbus launch`, and settings in the environment (TFBUS_...) are
    kept. The service is started again when it ends or hangs, and writes to the journal with levels.
    """
    path, rest = _checked(file, arguments)
    is_system = _is_system(system, is_user)
    if run_as and not is_system:
        raise click.UsageError("--run-as is for services of the machine: give --system")
    if run_as:
        _check_user(run_as, is_for_here=_has_systemd() and not only_print)
        if folder := os.environ.get("TFBUS_SECURE", ""):
            _check_key(run_as, Path(folder))
    try:
        service = Service(
            name or path.stem,
            [sys.executable, "-m", "tfbus", "launch", str(path), *rest],
            Path.cwd(),
            {"PATH": _path()}
            | {key: value for key, value in os.environ.items() if key.startswith(_SETTINGS)},
            run_as or (os.environ.get("SUDO_USER", "") if is_system else ""),
        )
    except InvalidArgumentException as error:
        raise click.UsageError(str(error)) from error
    text = unit_text(service, is_system=is_system)
    if only_print:
        print_text(text.rstrip())
        return
    unit = _unit_path(service.name, is_system=is_system)
    _write(unit, text)
    print_text(f"Wrote {unit}")
    # One that runs already would go on by the unit before.
    is_started = _systemctl(
        is_system, [["daemon-reload"], ["enable", service.name], ["restart", service.name]]
    )
    if not is_system:
        print_text(f"So that it runs from boot on: sudo loginctl enable-linger {_login()}")
    of = f"-u {service.name}" if is_system else f"--user -u {service.name}"
    print_text(f"Look at it: journalctl {of} -f")
    if not is_started:
        raise click.exceptions.Exit(1)


@command.command("uninstall", epilog="Example: tfbus service uninstall robot")
@click.argument("name")
@click.option("--system", is_flag=True, help="One of the machine; the default of root.")
@click.option("--user", "is_user", is_flag=True, help="One of yours; the default of others.")
def uninstall_command(name: str, system: bool, is_user: bool) -> None:
    """Stop a service that `install` has written, and remove its unit."""
    is_system = _is_system(system, is_user)
    name = name.removesuffix(".service")
    unit = _unit_path(name, is_system=is_system)
    if not _is_ours(unit):
        raise click.ClickException(f"{unit} is not there, or not of tfbus service install")
    is_stopped = _systemctl(is_system, [["disable", "--now", name]])
    unit.unlink()
    print_text(f"Removed {unit}")
    if not (_systemctl(is_system, [["daemon-reload"]]) and is_stopped):
        raise click.exceptions.Exit(1)


@command.command(
    "container",
    context_settings=_PASSED_ON,
    epilog="Example: tfbus service container robot.yaml > Containerfile",
)
@click.argument("file", metavar="FILE")
@click.argument("arguments", nargs=-1, metavar=_AS_IN_LAUNCH, type=click.UNPROCESSED)
@click.option(
    "--extras",
    metavar="NAMES",
    default="bag",
    show_default=True,
    help="The extras of tfbus in the image.",
)
def container_command(file: str, arguments: tuple[str, ...], extras: str) -> None:
    """Print a container file for an image that runs a launch file, with all in its folder.

    FILE and what follows are as in `tfbus launch`. The first lines say how to build and run it.
    """
    path, rest = _checked(file, arguments)
    # One of tfbus's own is in the image by its name.
    supplied = {each.absolute(): name for name, each in installed_launch_files().items()}
    try:
        text = container_text(supplied.get(path, f"/robot/{path.name}"), rest, extras)
    except InvalidArgumentException as error:
        raise click.UsageError(str(error)) from error
    print_lines(text.splitlines())


def _path() -> str:
    """The PATH of a service: first the programs beside this Python, such as `tfbus`, which are not
    in systemd's own PATH.
    """
    return f"{Path(sys.executable).parent}:/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin"


def _is_system(system: bool, is_user: bool) -> bool:
    if system and is_user:
        raise click.UsageError("--system and --user exclude each other")
    return system or (os.geteuid() == 0 and not is_user)


def _check_user(user: str, *, is_for_here: bool) -> None:
    """Refuse a user that this machine has not got: systemd would start nothing. Only warn of it if
    the unit may be for another machine, or an image.
    """
    import pwd  # Windows has none

    try:
        # systemd takes a number, too, and of that no name is needed.
        if not user.isdecimal():
            pwd.getpwnam(user)
    except (KeyError, ValueError):
        missing = f"--run-as: this machine has no user {user!r}"
        if is_for_here:
            raise click.UsageError(
                f"{missing}: make it (sudo useradd --create-home NAME), or name another"
            ) from None
        warn(f"{missing}; where the unit runs there must be one, or systemd starts nothing")


def _check_key(user: str, folder: Path) -> None:
    """Warn of a private key that is another user's: none but its owner can read it."""
    import pwd  # Windows has none

    with suppress(OSError, KeyError, ValueError):
        uid = int(user) if user.isdecimal() else pwd.getpwnam(user).pw_uid
        if uid and (folder / KEY_FILE).stat().st_uid != uid:
            warn(
                f"the private key in {folder} is not that user's, who cannot read it: "
                f"sudo chown -R {shlex.quote(user)} {shlex.quote(str(folder))}"
            )


def _has_systemd() -> bool:
    """Whether systemd runs on this machine."""
    return _SYSTEMD.is_dir() and shutil.which("systemctl") is not None


def _login() -> str:
    return os.environ.get("USER") or "$USER"


def _is_ours(unit: Path) -> bool:
    try:
        return unit.read_text(encoding="utf-8").startswith(MARK)
    except (OSError, UnicodeDecodeError):
        return False


def _write(unit: Path, text: str) -> None:
    if unit.exists() and not _is_ours(unit):
        raise click.ClickException(
            f"{unit} is there and was not written by tfbus: give another name with --name"
        )
    try:
        unit.parent.mkdir(parents=True, exist_ok=True)
        unit.write_text(text, encoding="utf-8")
    except OSError as error:
        raise click.ClickException(
            f"could not write {unit}: {error.strerror or error}; a service of the machine needs "
            "root, one of yours --user"
        ) from error


def _systemctl(is_system: bool, commands: Sequence[Sequence[str]]) -> bool:
    """Run commands of systemctl, or print them if systemd does not run; whether none failed."""
    called = ["systemctl", *([] if is_system else ["--user"])]
    runs, is_done = _has_systemd(), True
    for words in commands:
        line = " ".join([*called, *words])
        if not runs:
            print_text(f"systemd does not run here; where it does: {line}")
            continue
        done = subprocess.run([*called, *words], check=False)
        if done.returncode:
            warn(f"'{line}' failed with exit code {done.returncode}")
            is_done = False
    return is_done


def _complete_show(
    ctx: click.Context, param: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    names = ServiceName().shell_complete(ctx, param, incomplete)
    return [*names, *matching([each.__qualname__ for each in supplied_calls()], incomplete)]


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
            with_type(service.name, types_of(service)) if show_types else service.name
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
