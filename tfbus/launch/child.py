"""A program and its process group, and how all groups end: SIGINT, SIGTERM, SIGKILL."""

import asyncio
import os
import shlex
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from shutil import which
from typing import TypeVar

from tfbus.base.callbacks import Given
from tfbus.base.wording import did_you_mean
from tfbus.bus.settings import NodeSettings
from tfbus.launch.console import Console
from tfbus.launch.description import DescribedProcess, Respawn
from tfbus.wire.descriptions import FLOAT64


@dataclass(frozen=True, slots=True)
class LaunchProgram:
    """A command line, its name, and whether it is restarted, or ends the launch, when it ends.

    `changes` are the environment variables that differ from launch's own; None unsets.
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


def program_of(process: DescribedProcess, settings: NodeSettings) -> LaunchProgram:
    """The program of a process in a launch with these settings.

    A tfbus node gets the settings of the bus as options, any other program as environment
    variables, which tfbus nodes inside it read; variables of launch's own environment that say
    otherwise do not count. `listen` is not passed on: only one process can listen at an address.
    """
    argv = _node_argv(process, settings) if process.node else (*process.command, *process.arguments)
    return LaunchProgram(
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


def dry_run_line(program: LaunchProgram) -> str:
    """A line for `--dry-run`: the name, and a shell command that does the same."""
    unset = (name for name, value in program.changes.items() if value is None)
    changes = [word for name in unset if name in os.environ for word in ("-u", name)]
    changes += [f"{name}={value}" for name, value in program.changes.items() if value is not None]
    environment = shlex.join(["env", *changes]) + " " if changes else ""
    folder = (
        "" if program.directory == Path.cwd() else f"cd {shlex.quote(str(program.directory))} && "
    )
    return f"[{program.name}] {folder}{environment}{program.command_line}"


def check_startable(process: DescribedProcess, nodes: Collection[str]) -> None:
    """Raises YamlFileError if there is no such program; `nodes` are tfbus's."""
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


def _node_argv(process: DescribedProcess, settings: NodeSettings) -> tuple[str, ...]:
    # -P: the installed tfbus, not a clone in the current folder.
    start = (process.node,) if process.node.endswith(".py") else ("-P", "-m", "tfbus", process.node)
    return (sys.executable, *start, *_node_options(process, settings), *process.arguments)


def _node_options(process: DescribedProcess, settings: NodeSettings) -> Iterator[str]:
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
    if (network := process.network or settings.network) != "lan":
        yield from ("--network", network)
    if (poses := process.poses or settings.poses) != FLOAT64:
        yield from ("--poses", poses)
    if settings.log_level != "info":
        yield from ("--log-level", settings.log_level)
    if settings.sim_time or process.sim_time:
        yield "--sim-time"
    for name, value in process.parameters:
        yield from ("--param", f"{name}={value}")
    for source, target in process.remappings:
        yield from ("--remap", f"{source}:={target}")


def _changes(process: DescribedProcess, settings: NodeSettings) -> dict[str, str | None]:
    network = process.network or settings.network
    poses = process.poses or settings.poses
    told = {
        "TFBUS_NAMESPACE": process.namespace or None,
        "TFBUS_MODE": settings.mode or None,
        "TFBUS_CONNECT": " ".join(settings.connect) or None,
        "TFBUS_CONFIG": str(Path(settings.config).resolve()) if settings.config else None,
        "TFBUS_SECURE": process.secure or settings.secure or None,
        "TFBUS_NETWORK": None if network == "lan" else network,
        "TFBUS_POSES": None if poses == FLOAT64 else poses,
        "TFBUS_LOG_LEVEL": settings.log_level,
        "TFBUS_SIM_TIME": "1" if settings.sim_time or process.sim_time else None,
    }
    if process.node:
        # Its options omit defaults: a variable of launch's own environment would count in place of
        # one that an option of launch has set back to the default.
        told = {name: value for name, value in told.items() if name in os.environ}
    # Python buffers a pipe: without this, lines come late or never.
    changes: dict[str, str | None] = {"PYTHONUNBUFFERED": "1", "TFBUS_LISTEN": None}
    return changes | told | dict(process.environment)


T = TypeVar("T")


class Child:
    """A started program, in its own session and process group.

    `exit_code` is None while it runs, and -N if signal N ended it.
    """

    def __init__(self, program: LaunchProgram) -> None:
        """Start the program. Raises OSError or ValueError if that fails."""
        self.program = program
        self.exit_code: int | None = None
        with _blocked(signal.SIGINT) if program.unblocks_sigint else nullcontext():
            self._process = subprocess.Popen(
                program.argv,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                bufsize=0,
                cwd=program.directory,
                env=program.environment,
                start_new_session=True,
            )
        self.pid = self._process.pid
        self._open_pipes = 2

    def follow(self, console: Console, on_change: Callable[[], None]) -> None:
        """Relay its output, and call `on_change` in the running asyncio loop when the process ends
        and when each of its two outputs ends.
        """
        loop = asyncio.get_running_loop()
        assert self._process.stdout and self._process.stderr  # both asked for above

        def pipe_ended(_: None) -> None:
            self._open_pipes -= 1
            on_change()

        def process_ended(exit_code: int) -> None:
            self.exit_code = exit_code
            on_change()

        name, output, errors = self.program.name, self._process.stdout, self._process.stderr
        _in_thread(loop, pipe_ended, console.relay, name, output, console.output)
        _in_thread(loop, pipe_ended, console.relay, name, errors, console.errors)
        _in_thread(loop, process_ended, self._process.wait)

    @property
    def group_lives(self) -> bool:
        """Whether any process of the group is left.

        Orphans become children of launch if it is a subreaper; this reaps them, as a zombie
        counts as a member.
        """
        if self.exit_code is None:
            return True
        with suppress(ChildProcessError):
            while os.waitpid(-self.pid, os.WNOHANG)[0]:
                pass
        try:
            os.killpg(self.pid, 0)
        except ProcessLookupError:
            return False
        except PermissionError:
            pass  # a group of zombies on macOS, another user's process on Linux
        return True

    @property
    def output_ended(self) -> bool:
        """Whether all of its output was relayed."""
        return self._open_pipes == 0

    def send(self, number: signal.Signals) -> None:
        """Send a signal to the whole group, if it still exists."""
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self.pid, number)


@contextmanager
def _blocked(number: signal.Signals) -> Iterator[None]:
    """Block the signal, here and in processes that start meanwhile."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {number})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _in_thread(
    loop: asyncio.AbstractEventLoop,
    then: Callable[[T], None],
    work: Callable[[*Given], T],
    *given: *Given,
) -> None:
    """Call `work(*given)` in a thread, then `then(result)` in the loop."""

    def run() -> None:
        result = work(*given)
        # The loop is closed if launch gave up on this process.
        with suppress(RuntimeError):
            loop.call_soon_threadsafe(then, result)

    threading.Thread(target=run, daemon=True).start()


SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)


@dataclass(frozen=True, slots=True)
class Timeouts:
    """How long a supervisor waits, in seconds: after each signal, and between two notices."""

    after_sigint_s: float = 5.0
    after_sigterm_s: float = 5.0
    after_sigkill_s: float = 5.0
    notice_s: float = 3.0

    def after(self, number: signal.Signals) -> float:
        """How long to wait after this signal."""
        waits = (self.after_sigint_s, self.after_sigterm_s, self.after_sigkill_s)
        return waits[SIGNALS.index(number)]


class Escalation:
    """Sends one signal after another until `children` is empty: by itself, or sooner if asked.

    Calls `give_up` if some survive SIGKILL, stuck in the kernel.
    """

    def __init__(
        self,
        children: Sequence[Child],
        console: Console,
        timeouts: Timeouts,
        give_up: Callable[[], None],
    ) -> None:
        self._children = children
        self._console = console
        self._timeouts = timeouts
        self._give_up = give_up
        self._sent: signal.Signals | None = None
        self._timer: asyncio.TimerHandle | None = None

    @property
    def has_begun(self) -> bool:
        """Whether the first signal was sent."""
        return self._sent is not None

    def explains(self, exit_code: int) -> bool:
        """Whether a process ends so by a signal that was sent: killed by it, or as a shell says."""
        sent = SIGNALS[: 0 if self._sent is None else SIGNALS.index(self._sent) + 1]
        return any(exit_code in (-number, 128 + number) for number in sent)

    def escalate(self, at_least: signal.Signals = signal.SIGINT) -> None:
        """Send the next signal, at least `at_least`, and start the timer for the one after it."""
        lowest = 0 if self._sent is None else SIGNALS.index(self._sent) + 1
        number = SIGNALS[min(max(lowest, SIGNALS.index(at_least)), len(SIGNALS) - 1)]
        self._sent = number
        for child in self._children:
            name = child.program.name
            self._console.say("INFO", name, f"sending signal '{number.name}' to process[{name}]")
            child.send(number)
        self.cancel()
        self._timer = asyncio.get_running_loop().call_later(
            self._timeouts.after(number), self._time_out, number
        )

    def cancel(self) -> None:
        """Stop the timer for the next signal."""
        if self._timer:
            self._timer.cancel()

    def _time_out(self, number: signal.Signals) -> None:
        """Send the signal after `number`, which some processes did not obey in time."""
        text = f"'{self._timeouts.after(number):g}' seconds after receiving '{number.name}'"
        following = SIGNALS[SIGNALS.index(number) + 1 :]
        then = f"escalating to '{following[0].name}'" if following else "giving up"
        for child in self._children:
            name = child.program.name
            self._console.say("ERROR", name, f"process[{name}] failed to terminate {text}, {then}")
        if following:
            self.escalate()
        else:
            self._give_up()
