"""The command line and environment of a process of a launch file."""

import os
import shlex
import sys
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from shutil import which

from tfbus.bus.settings import NodeSettings
from tfbus.launch.description import Process, Respawn
from tfbus.wording import did_you_mean


@dataclass(frozen=True, slots=True)
class Program:
    """A command line, its name, and what to do when it ends.

    `changes` are the environment variables that differ from those of launch itself; None unsets.
    `unblocks_sigint`: the program starts with SIGINT blocked and unblocks it itself, as the command
    `tfbus` does.
    """

    name: str
    argv: tuple[str, ...]
    changes: Mapping[str, str | None]
    directory: Path
    respawn: Respawn | None = None
    required: bool = False
    full_name: str = ""
    after: tuple[str, ...] = ()
    unblocks_sigint: bool = False

    @property
    def environment(self) -> dict[str, str]:
        """All environment variables."""
        merged = {**os.environ, **self.changes}
        return {name: value for name, value in merged.items() if value is not None}

    @property
    def command_line(self) -> str:
        """The command line, quoted for a shell."""
        return shlex.join(self.argv)


def program_of(process: Process, settings: NodeSettings) -> Program:
    """The program of a process in a launch with these settings.

    A tfbus node gets the settings of the bus as options, any other program as environment
    variables, which tfbus nodes inside it read. `listen` is not passed on: only one process can
    listen at an address.
    """
    argv = _node_argv(process, settings) if process.node else (*process.command, *process.arguments)
    return Program(
        name=process.label,
        argv=argv,
        changes=_changes(process, settings),
        directory=process.directory,
        respawn=process.respawn,
        required=process.required,
        full_name=process.full_name,
        after=process.after,
        unblocks_sigint=bool(process.node) and not process.node.endswith(".py"),
    )


def dry_run_line(program: Program) -> str:
    """A line for `--dry-run`: the name, and a shell command that does the same."""
    changes = [f"{name}={value}" for name, value in program.changes.items() if value is not None]
    environment = shlex.join(["env", *changes]) + " " if changes else ""
    folder = (
        "" if program.directory == Path.cwd() else f"cd {shlex.quote(str(program.directory))} && "
    )
    return f"[{program.name}] {folder}{environment}{program.command_line}"


def check_startable(process: Process, nodes: Collection[str]) -> None:
    """Raises YamlFileError if there is no such program; `nodes` are those of tfbus."""
    if process.node:
        if not process.node.endswith(".py") and process.node not in nodes:
            raise process.place.mistake(
                f"tfbus has no node {process.node!r} (a file of your own ends with .py)"
                f"{did_you_mean(process.node, nodes)}"
            )
        return
    program = process.command[0]
    path = dict(process.environment).get("PATH", os.environ.get("PATH", os.defpath))
    # A path with a folder is relative to the folder where the process runs.
    found = which(str(process.directory / program) if "/" in program else program, path=path)
    if found is None:
        raise process.place.mistake(
            f"no executable program {program!r}; install it, or give its path"
        )


def _node_argv(process: Process, settings: NodeSettings) -> tuple[str, ...]:
    # -P: the installed tfbus, not a clone in the current folder.
    start = (process.node,) if process.node.endswith(".py") else ("-P", "-m", "tfbus", process.node)
    return (sys.executable, *start, *_node_options(process, settings), *process.arguments)


def _node_options(process: Process, settings: NodeSettings) -> Iterator[str]:
    yield from ("--name", process.name)
    if process.namespace:
        yield from ("--namespace", process.namespace)
    if settings.mode:
        yield from ("--mode", settings.mode)
    for endpoint in settings.connect:
        yield from ("--connect", endpoint)
    if settings.config:
        yield from ("--config", str(Path(settings.config).resolve()))
    if secure := process.secure or settings.secure:
        yield from ("--secure", secure)
    if settings.log_level != "info":
        yield from ("--log-level", settings.log_level)
    if settings.sim_time or process.sim_time:
        yield "--sim-time"
    for name, value in process.parameters:
        yield from ("--param", f"{name}={value}")
    for source, target in process.remappings:
        yield from ("--remap", f"{source}:={target}")


def _changes(process: Process, settings: NodeSettings) -> dict[str, str | None]:
    # Python buffers a pipe: without this, lines come late or never.
    changes: dict[str, str | None] = {"PYTHONUNBUFFERED": "1", "TFBUS_LISTEN": None}
    if not process.node:
        changes |= {
            "TFBUS_NAMESPACE": process.namespace or None,
            "TFBUS_MODE": settings.mode or None,
            "TFBUS_CONNECT": " ".join(settings.connect) or None,
            "TFBUS_CONFIG": str(Path(settings.config).resolve()) if settings.config else None,
            "TFBUS_SECURE": process.secure or settings.secure or None,
            "TFBUS_LOG_LEVEL": settings.log_level,
            "TFBUS_SIM_TIME": "1" if settings.sim_time or process.sim_time else None,
        }
    return changes | dict(process.environment)
