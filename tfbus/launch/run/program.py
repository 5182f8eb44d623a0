"""What the supervisor starts: a process of a launch file with its command line worked out."""

import os
import shlex
import sys
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from shutil import which

from tfbus.bus.settings import NodeSettings
from tfbus.launch.description import Process, Respawn
from tfbus.launch.place import nearest


@dataclass(frozen=True, slots=True)
class Program:
    """A command line, what it is called, and what is to happen when it ends.

    `changes` are the environment variables that differ from those of launch itself; None: unset.
    `unblocks_sigint` is whether the program lets a SIGINT through by itself that comes before it
    can be taken, as the command `tfbus` does.
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
        """All its environment variables."""
        merged = {**os.environ, **self.changes}
        return {name: value for name, value in merged.items() if value is not None}

    @property
    def command_line(self) -> str:
        """The command line as it could be typed into a shell."""
        return shlex.join(self.argv)


def program_of(process: Process, settings: NodeSettings) -> Program:
    """How a process is started by a launch with these settings.

    What the settings say of the bus reaches a tfbus node as options and any other program as
    environment variables, which tfbus nodes inside it obey. Where launch itself listens is not
    handed down: only one process can listen there.
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
    """One line for `--dry-run`: the name, and a command for a shell that does the same."""
    changes = [f"{name}={value}" for name, value in program.changes.items() if value is not None]
    environment = shlex.join(["env", *changes]) + " " if changes else ""
    folder = (
        "" if program.directory == Path.cwd() else f"cd {shlex.quote(str(program.directory))} && "
    )
    return f"[{program.name}] {folder}{environment}{program.command_line}"


def check_startable(process: Process, nodes: Collection[str]) -> None:
    """LaunchFileError if the program of a process does not exist; `nodes` are those of tfbus."""
    if process.node:
        if not process.node.endswith(".py") and process.node not in nodes:
            raise process.place.mistake(
                f"tfbus has no node {process.node!r}{nearest(process.node, nodes)} "
                f"There are: {', '.join(sorted(nodes))}; a file of your own ends in .py"
            )
        return
    program = process.command[0]
    path = dict(process.environment).get("PATH", os.environ.get("PATH", os.defpath))
    # A path with a folder in it is relative to where the process runs, as for a shell there.
    found = which(str(process.directory / program) if "/" in program else program, path=path)
    if found is None:
        raise process.place.mistake(
            f"there is no program {program!r} that can be run; give its path, or install it"
        )


def _node_argv(process: Process, settings: NodeSettings) -> tuple[str, ...]:
    # The tfbus that is installed, not a clone of it that one happens to stand in: -P.
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
    if settings.log_level != "info":
        yield from ("--log-level", settings.log_level)
    if settings.sim_time or process.sim_time:
        yield "--sim-time"
    for name, value in process.parameters:
        yield from ("--param", f"{name}={value}")
    for source, target in process.remappings:
        yield from ("--remap", f"{source}:={target}")


def _changes(process: Process, settings: NodeSettings) -> dict[str, str | None]:
    # Python writes to a pipe by the block: without this, lines would come late or never.
    changes: dict[str, str | None] = {"PYTHONUNBUFFERED": "1", "TFBUS_LISTEN": None}
    if not process.node:
        changes |= {
            "TFBUS_NAMESPACE": process.namespace or None,
            "TFBUS_MODE": settings.mode or None,
            "TFBUS_CONNECT": " ".join(settings.connect) or None,
            "TFBUS_CONFIG": str(Path(settings.config).resolve()) if settings.config else None,
            "TFBUS_LOG_LEVEL": settings.log_level,
            "TFBUS_SIM_TIME": "1" if settings.sim_time or process.sim_time else None,
        }
    return changes | dict(process.environment)
