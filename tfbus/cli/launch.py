"""`tfbus launch`: start the processes of a launch file, and stop them together."""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from tfbus.base.errors import SettingsError, TfbusError
from tfbus.base.log import open_log
from tfbus.base.signals import StopSignals
from tfbus.bus.settings import MODES, NodeSettings
from tfbus.bus.settings import NAMES as NETWORK_NAMES
from tfbus.cli import NODES, entry_points
from tfbus.cli.output import paint, print_lines
from tfbus.command.options import click_error
from tfbus.command.types import NOT_NEGATIVE, LogLevel, matching
from tfbus.launch.arguments import show_arguments
from tfbus.launch.child import (
    LaunchProgram,
    Timeouts,
    check_startable,
    dry_run_line,
    program_of,
)
from tfbus.launch.description import LaunchArgumentError, LaunchError
from tfbus.launch.find import (
    find_in,
    find_launch_file,
    installed_launch_files,
    launch_files_of,
    packages_with_nodes,
)
from tfbus.launch.reader import read_arguments, read_description, read_launch_file
from tfbus.launch.run import run_programs
from tfbus.launch.supervisor import Presence
from tfbus.wire.descriptions import POSES

# The options with which it starts nothing.
ONLY_PRINT = ("list_files", "show_args", "dry_run")


def complete_file(
    ctx: click.Context, param: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """The launch files of tfbus, packages with launch files, and paths."""
    names = [*installed_launch_files(), *filter(_has_files, packages_with_nodes())]
    return [*matching(names, incomplete), CompletionItem(incomplete, "file")]


def chosen_file(file: str, arguments: Sequence[str]) -> tuple[Path, tuple[str, ...]]:
    """The launch file of `FILE ...` or `PACKAGE FILE ...`, and the rest of the arguments.

    Raises SettingsError if there is none.
    """
    try:
        if arguments and "=" not in arguments[0] and "/" not in file:
            return find_in(file, arguments[0]), tuple(arguments[1:])
        return find_launch_file(file), tuple(arguments)
    except LaunchError as error:
        hint = ""
        if arguments and file in installed_launch_files():
            hint = f"; if {arguments[0]!r} is an argument of {file}, write NAME:=VALUE"
        raise SettingsError(f"{error}{hint}") from error


def _has_files(package: str) -> bool:
    try:
        return bool(launch_files_of(package))
    except TfbusError:
        return False


def complete_argument(
    ctx: click.Context, param: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """After a package its launch files; then `NAME:=` for each argument of the file, and after it
    its choices or its default.
    """
    first, typed = ctx.params.get("file") or "", ctx.params.get("arguments") or ()
    if not typed and "=" not in incomplete and _has_files(first):
        return matching(launch_files_of(first), incomplete)
    try:
        declared = read_arguments(chosen_file(first, typed)[0])
    except TfbusError:
        return []
    name, given, value = incomplete.partition(":=")
    if given:
        values = [
            choice
            for each in declared
            if each.name == name
            for choice in each.choices or (each.default or "",)
        ]
        return [
            CompletionItem(f"{name}:={each}") for each in values if each and each.startswith(value)
        ]
    taken = {text.partition(":=")[0] for text in ctx.params.get("arguments") or ()}
    return [
        CompletionItem(f"{each.name}:=", help=each.description or None)
        for each in declared
        if each.name.startswith(name) and each.name not in taken
    ]


@click.command(
    "launch",
    epilog="Example: tfbus launch turtle turtlename:=turtle1",
)
@click.argument("file", metavar="[PACKAGE] FILE", required=False, shell_complete=complete_file)
@click.argument("arguments", nargs=-1, metavar="[NAME:=VALUE]...", shell_complete=complete_argument)
@click.option("-l", "--list", "list_files", is_flag=True, help="Print all launch files and exit.")
@click.option("-s", "--show-args", is_flag=True, help="Print the arguments of FILE and exit.")
@click.option("-n", "--dry-run", is_flag=True, help="Print the command lines and exit.")
@click.option("--namespace", metavar="PATH", help="The namespace of all nodes, such as robot7.")
@click.option("--mode", type=click.Choice(MODES), help="How all nodes join the bus (default peer).")
@click.option(
    "--connect",
    multiple=True,
    metavar="ENDPOINT",
    help="Connect all nodes to this endpoint; repeatable.",
)
@click.option(
    "--listen",
    multiple=True,
    metavar="ENDPOINT",
    help="Where launch itself listens, to see nodes; repeatable. Nodes do not listen there.",
)
@click.option(
    "--config",
    type=click.Path(),
    metavar="FILE",
    help="Zenoh's configuration of all nodes, in JSON5.",
)
@click.option(
    "--secure",
    type=click.Path(),
    metavar="DIR",
    help="The identity of all nodes on a closed bus, unless the file names it (tfbus keys).",
)
@click.option(
    "--network",
    type=click.Choice(NETWORK_NAMES),
    help="The network of all nodes, unless the file names it (default lan).",
)
@click.option(
    "--poses",
    type=click.Choice(POSES),
    help="How precise the transforms of all nodes are, unless the file says it (default float64).",
)
@click.option("--log-level", type=LogLevel(), help="The log level of all nodes (default info).")
@click.option("--sim-time", is_flag=True, help="Make all nodes take the time from the topic clock.")
@click.option(
    "--for",
    "longest_s",
    type=NOT_NEGATIVE,
    metavar="SECONDS",
    help="Stop after this time.",
)
@click.option(
    "--sigterm-timeout",
    type=NOT_NEGATIVE,
    metavar="SECONDS",
    default=5.0,
    show_default=True,
    help="Time between SIGINT and SIGTERM.",
)
@click.option(
    "--sigkill-timeout",
    type=NOT_NEGATIVE,
    metavar="SECONDS",
    default=5.0,
    show_default=True,
    help="Time between SIGTERM and SIGKILL.",
)
def command(
    file: str | None,
    arguments: tuple[str, ...],
    list_files: bool,
    show_args: bool,
    dry_run: bool,
    longest_s: float | None,
    sigterm_timeout: float,
    sigkill_timeout: float,
    **bus: Any,
) -> None:
    """Start the processes of a launch file, and stop them together.

    FILE is a launch file of tfbus, such as turtle, or a path; or, after the name of a Python
    package, one of that package. Ctrl-C stops all processes; a second
    Ctrl-C escalates to the next signal at once.
    """
    with _as_click_errors():
        if list_files:
            print_lines(_list(file))
            return
        if file is None:
            raise click.UsageError("name a launch file; tfbus launch --list prints those there are")
        path, arguments = chosen_file(file, arguments)
        if show_args:
            click.echo(show_arguments(read_arguments(path)))
            return
        settings = _settings(bus)
        processes = read_launch_file(path, _given(arguments), namespace=settings.namespace)
        for process in processes:
            check_startable(process, _node_names())
        programs = [program_of(process, settings) for process in processes]
        if dry_run:
            click.echo("\n".join(map(dry_run_line, programs)))
            return
        timeouts = Timeouts(after_sigint_s=sigterm_timeout, after_sigterm_s=sigkill_timeout)
        if not settings.secure:
            # It waits for nodes on their bus.
            secure = next((each.secure for each in processes if each.secure), "")
            settings = replace(settings, secure=secure)
        raise SystemExit(_run(programs, settings, timeouts, longest_s))


def _list(package: str | None) -> Iterator[str]:
    """The launch files of a package, or of tfbus and all packages that add nodes to it."""
    packages = [package] if package else ["tfbus", *packages_with_nodes()]
    for name in packages:
        files = installed_launch_files() if name == "tfbus" else launch_files_of(name)
        if files:
            yield paint(f"{name}:", "heading")
        for file, path in files.items():
            yield f"  {paint(file, 'name')}  {_description(path)}".rstrip()


def _description(path: Path) -> str:
    try:
        return read_description(path)
    except TfbusError as error:
        return f"({error})"


@contextmanager
def _as_click_errors() -> Iterator[None]:
    """Turn errors into one sentence, with exit code 2 for a wrong argument, else 1."""
    try:
        yield
    except LaunchArgumentError as error:
        raise click.UsageError(f"{error} (write arguments as NAME:=VALUE)") from error
    except TfbusError as error:
        raise click_error(error) from error


def _settings(bus: Mapping[str, Any]) -> NodeSettings:
    """The settings from the options, completed from the environment."""
    try:
        given = {name: value for name, value in bus.items() if value not in (None, (), False)}
        return NodeSettings(name="launch", **given)
    except TfbusError as error:
        raise click.UsageError(str(error)) from error


def _given(arguments: Sequence[str]) -> dict[str, str]:
    given = {}
    for text in arguments:
        name, found, value = text.partition("=")
        name = name.removesuffix(":")  # `:=` is ROS's sign, and `=` the one of tfbus
        if not found or not name:
            raise click.UsageError(f"{text!r} is not of the form NAME:=VALUE")
        given[name] = value
    return given


def _node_names() -> set[str]:
    return {*NODES, *entry_points()}


def _run(
    programs: Sequence[LaunchProgram],
    settings: NodeSettings,
    timeouts: Timeouts,
    longest_s: float | None,
) -> int:
    run = partial(run_programs, programs, timeouts=timeouts, longest_s=longest_s)
    if not any(program.after for program in programs):
        return run(presence=None)
    with _presence(settings) as presence:
        return run(presence=presence)


@contextmanager
def _presence(settings: NodeSettings) -> Iterator[Presence]:
    """The nodes of the whole bus, to wait for by their full names.

    A client waits for its router, until Ctrl-C or SIGTERM.
    """
    from tfbus.bus.presence import NodeWatch
    from tfbus.bus.session import Session  # Zenoh, which a launch without `after:` does not need

    log = open_log("/launch", "launch", settings.log_level)
    signals = StopSignals()
    try:
        session = Session(replace(settings, namespace=""), log, patience_s=math.inf)
    except KeyboardInterrupt:
        raise SystemExit(0) from None
    finally:
        signals.uninstall()
    with session:
        watch = NodeWatch(session)
        yield watch
        watch.close()
