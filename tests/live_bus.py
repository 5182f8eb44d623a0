"""A bus of real processes: on loopback only, on a port from the system, apart from any other."""

import logging
import os
import re
import socket
import subprocess
import sys
import termios
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from signal import (
    SIG_DFL,
    SIG_IGN,
    SIGABRT,
    SIGHUP,
    SIGINT,
    SIGKILL,
    default_int_handler,
    getsignal,
)
from signal import signal as set_handler
from typing import Any

from tests.buses import DEADLINE_S, eventually
from tfbus import Node, NodeSettings
from tfbus.bus.session import Session

# Where the tests run in the background their children would inherit that these are ignored.
if getsignal(SIGINT) == SIG_IGN:
    set_handler(SIGINT, default_int_handler)
if getsignal(SIGHUP) == SIG_IGN:
    set_handler(SIGHUP, SIG_DFL)


# A process that is told to abort has printed its stacks by then.
_ABORTS_WITHIN_S = 10.0

# The last ones, more than a test has. The system gives the port of a bound socket to nobody who
# takes any port, to listen or to connect; a program that names it may listen there.
_reserved: deque[socket.socket] = deque(maxlen=64)


def free_port() -> int:
    """A free TCP port of the loopback interface, which stays so until a program listens there."""
    reservation = socket.socket()
    reservation.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    reservation.bind(("127.0.0.1", 0))
    _reserved.append(reservation)
    port: int = reservation.getsockname()[1]
    return port


class Process:
    """A process under test; what it prints is read as it comes."""

    def __init__(self, command: Sequence[str], env: dict[str, str], cwd: Path | None = None):
        self.command = command
        self.popen = subprocess.Popen(
            command,
            env={"PYTHONFAULTHANDLER": "1", **env},
            cwd=cwd,
            text=True,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,
        )
        self.pid = self.popen.pid
        self.out: list[str] = []
        self.err: list[str] = []
        self._readers = [
            threading.Thread(target=self._read, args=(stream, lines), daemon=True)
            for stream, lines in ((self.popen.stdout, self.out), (self.popen.stderr, self.err))
        ]
        for reader in self._readers:
            reader.start()

    @staticmethod
    def _read(stream: Iterator[str], lines: list[str]) -> None:
        for line in stream:
            lines.append(line.rstrip("\n"))

    def wait_for_line(self, pattern: str, *, timeout_s: float = DEADLINE_S) -> str:
        """The first line on stdout or stderr that has the pattern in it."""

        def found() -> str | None:
            lines = [*self.out, *self.err]
            return next((line for line in lines if re.search(pattern, line)), None)

        code = self.wait_until(lambda: found() is not None, timeout_s=timeout_s)
        line = found()
        assert line is not None, (
            f"{pattern!r} was not printed by {' '.join(self.command)}, which "
            f"{self._abort() if code is None else f'ended with {code}'}\n"
            f"stdout: {self.out}\nstderr: {self.err}"
        )
        return line

    def wait_until(
        self, condition: Callable[[], bool], *, timeout_s: float = DEADLINE_S
    ) -> int | None:
        """Wait until the condition holds, or the process has ended and all that it printed is
        read: its exit code, None if it goes on.
        """
        with suppress(AssertionError):
            eventually(lambda: condition() or self.popen.poll() is not None, within_s=timeout_s)
        return None if self.popen.poll() is None else self.wait()

    def signal(self, number: int) -> None:
        """Send a signal to the process."""
        self.popen.send_signal(number)

    def stop(self, number: int = SIGINT) -> int:
        """Send a signal and wait for the end: the exit code."""
        if self.popen.poll() is None:
            self.signal(number)
        return self.wait()

    def wait(self, *, timeout_s: float = DEADLINE_S) -> int:
        """The exit code, once it has ended and all that it printed is read. If it does not end, the
        error says what it was doing, and it is aborted.
        """
        try:
            code = self.popen.wait(timeout_s)
        except subprocess.TimeoutExpired as late:
            late.add_note(f"{' '.join(self.command)} {self._abort()}")
            raise
        for reader in self._readers:
            reader.join(timeout_s)
        return code

    def _abort(self) -> str:
        """End it; where its threads of Python were, as the end of a sentence."""
        printed = len(self.err)
        self.signal(SIGABRT)
        with suppress(subprocess.TimeoutExpired):
            self.popen.wait(_ABORTS_WITHIN_S)
            for reader in self._readers:
                reader.join(_ABORTS_WITHIN_S)
        return "\n".join(["went on:", *self.err[printed:]])

    def kill(self) -> None:
        """End it and all its children, whatever they do."""
        # Once it was waited for, another process may have its number: then no child of it is left.
        if self.popen.poll() is None or not Path(f"/proc/{self.pid}").exists():
            with suppress(ProcessLookupError):
                os.killpg(self.pid, SIGKILL)
        self.popen.wait(DEADLINE_S)


# A session is open once it is linked, and the others have told what they declare. By default Zenoh
# connects in the background, and overlooks what comes before it has noted who is there: it then
# waits for the whole delay, as one session in five did on a busy machine.
_MEETING = (
    "{connect: {exit_on_failure: {peer: true}, timeout_ms: {peer: 60000}},"
    " scouting: {multicast: {enabled: false}, delay: 5000},"
)
AT_ONCE = "{scouting: {multicast: {enabled: false}, delay: 10},"

# On a busy machine a link may be silent for longer than tfbus allows by default, and take longer to
# open. Without multicast, peers that lose each other meet again late, and peers that do not meet
# when a third one introduces them never do.
PATIENT = (
    " transport: {link: {tx: {lease: 60000}},"
    " unicast: {open_timeout: 60000, accept_timeout: 60000}},"
    " timestamping: {enabled: true}"
)


def _config(beginning: str) -> str:
    return f"{beginning}{PATIENT}, listen: {{endpoints: ['tcp/127.0.0.1:0']}}}}"


class Bus:
    """Peers that meet on loopback without a router and without multicast."""

    def __init__(self, folder: Path):
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        self.config = folder / "zenoh.json5"
        self.config.write_text(_config(_MEETING))
        # A process has found the others when its session is open; a node of the test itself is
        # open at once, and the test waits for what it needs.
        self.quick_config = folder / "quick.json5"
        self.quick_config.write_text(_config(AT_ONCE))
        self.options = ["--config", str(self.config), "--connect", self.endpoint]
        self.env = {
            **{key: value for key, value in os.environ.items() if not key.startswith("TFBUS_")},
            "TFBUS_CONFIG": str(self.config),
            "TFBUS_CONNECT": self.endpoint,
            "PYTHONUNBUFFERED": "1",
            "COLUMNS": "80",
        }
        self._nodes: list[Node] = []
        self.processes: list[Process] = []
        meeting_point = NodeSettings("test", config=str(self.quick_config), listen=(self.endpoint,))
        self._meeting_point = Session(meeting_point, logging.getLogger("test"))

    def node(self, name: str, *, namespace: str = "", **given: Any) -> Node:
        """A node in the process of the test; what is given are fields of NodeSettings."""
        fields: dict[str, Any] = {
            "config": str(self.quick_config),
            "connect": (self.endpoint,),
            **given,
        }
        node = Node(settings=NodeSettings(name, namespace=namespace, **fields))
        self._nodes.append(node)
        return node

    def start(self, *arguments: str, env: dict[str, str] | None = None) -> Process:
        """`tfbus ARGUMENTS` as a process that goes on."""
        # A router scouts until the delay is over, whomever it meets.
        quick = {"TFBUS_CONFIG": str(self.quick_config)} if arguments[0] == "router" else {}
        return self.start_python("tfbus", *arguments, env={**quick, **(env or {})})

    def start_python(
        self, module: str, *arguments: str, env: dict[str, str] | None = None
    ) -> Process:
        """`python -m MODULE ARGUMENTS` as a process that goes on."""
        return self.start_command([sys.executable, "-m", module, *arguments], env=env)

    def start_command(
        self, command: Sequence[str], *, env: dict[str, str] | None = None, cwd: Path | None = None
    ) -> Process:
        """Any command as a process on this bus that goes on."""
        process = Process(command, {**self.env, **(env or {})}, cwd)
        self.processes.append(process)
        return process

    def run(
        self, *arguments: str, env: dict[str, str] | None = None, stdin: str = ""
    ) -> subprocess.CompletedProcess[str]:
        """`tfbus ARGUMENTS`, run to its end."""
        return subprocess.run(
            [sys.executable, "-m", "tfbus", *arguments],
            env={**self.env, **(env or {})},
            input=stdin,
            capture_output=True,
            text=True,
            timeout=DEADLINE_S,
        )

    def run_in_terminal(self, *arguments: str, until: str = "", lines: int = 24) -> str:
        """All that `tfbus ARGUMENTS` writes to a terminal of 80 columns; Ctrl-C ends it once that
        has `until` in it.
        """
        master, slave = os.openpty()
        termios.tcsetwinsize(slave, (lines, 80))
        env = {name: text for name, text in self.env.items() if name not in ("COLUMNS", "LINES")}
        process = subprocess.Popen(
            [sys.executable, "-m", "tfbus", *arguments],
            env={**env, "TERM": "xterm-256color"},
            stdin=slave,
            stdout=slave,
            stderr=slave,
        )
        os.close(slave)
        shown = ""
        deadline = threading.Timer(DEADLINE_S, process.kill)
        deadline.start()
        try:
            with suppress(OSError):  # the terminal's end
                while data := os.read(master, 65536):
                    shown += data.decode(errors="replace")
                    if until and until in shown:
                        process.send_signal(SIGINT)
                        until = ""
            process.wait(DEADLINE_S)
        finally:
            deadline.cancel()
            os.close(master)
        assert not until and process.returncode != -SIGKILL, f"{until!r} is not in {shown!r}"
        return shown.replace("\r\n", "\n")

    def close(self) -> None:
        """End all that was started on it."""
        for process in self.processes:
            process.kill()
        for node in reversed(self._nodes):
            node.close()
        self._meeting_point.close()
