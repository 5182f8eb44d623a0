"""A bus of the benchmark's own: on loopback, without multicast; and processes that join it.

A process is one function of a module of this package, called with keyword arguments in an
interpreter of its own. It says what it has to say in lines of JSON, and goes on until its
standard input ends.
"""

import json
import os
import random
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory, mkstemp
from typing import Any

ROOT = Path(__file__).parent.parent.parent

# What a library prints is not said: run.py lets it go elsewhere.
_SPEECH = sys.stdout

# There is no router: peers find each other at one endpoint.
_CONFIG = "{scouting: {multicast: {enabled: false}}, timestamping: {enabled: true}}"


# Below the ports that Linux and Windows give outgoing connections.
_PORTS = (10_000, 32_000)


class Place:
    """Where the processes of one measurement meet."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        config = folder / "zenoh.json5"
        config.write_text(_CONFIG)
        inherited = {name: text for name, text in os.environ.items() if name[:6] != "TFBUS_"}
        self.env = {
            **inherited,
            "TFBUS_CONFIG": str(config),
            "TFBUS_LOG_LEVEL": "warning",
        }
        # Processes run in the folder, with the benchmark's files in it: tfbus is the installed one.
        (folder / "benchmarks").symlink_to(ROOT / "benchmarks")

    def listening(self) -> dict[str, str]:
        """The environment of the process that the others connect to."""
        return {**self.env, "TFBUS_LISTEN": self.endpoint}

    def connecting(self) -> dict[str, str]:
        """The environment of the others."""
        return {**self.env, "TFBUS_CONNECT": self.endpoint}


@contextmanager
def place() -> Iterator[Place]:
    """A place in a folder that goes away."""
    with TemporaryDirectory(prefix="tfbus-bench-") as folder:
        yield Place(Path(folder))


class Process:
    """A process as the top of this file says; a context manager that ends it.

    `on` makes its command one that runs on another host.
    """

    def __init__(
        self,
        at: Place,
        function: str,
        env: dict[str, str],
        *,
        python: str = sys.executable,
        on: Callable[..., Sequence[str]] = lambda *command: command,
        **arguments: Any,
    ) -> None:
        command = on(python, "-m", "benchmarks.bus.run", function, json.dumps(arguments))
        # Logs would stand among the benchmark's own lines; they are shown where a process fails.
        log, self._log = mkstemp(dir=at.folder, suffix=".log")
        self._popen = subprocess.Popen(
            command,
            env=env,
            cwd=at.folder,
            text=True,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=log,
        )
        os.close(log)

    @property
    def pid(self) -> int:
        """Its number in the system."""
        return self._popen.pid

    def __enter__(self) -> "Process":
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self._popen.communicate(timeout=20.0)
        except subprocess.TimeoutExpired:
            self._popen.kill()
            self._popen.communicate()

    def signal(self, number: int) -> None:
        """Send it a signal."""
        self._popen.send_signal(number)

    def kill(self) -> None:
        """Kill it, and wait until it has ended."""
        self._popen.kill()
        self._popen.wait()

    def hear(self) -> Any:
        """The next thing that it says."""
        assert self._popen.stdout is not None
        line = self._popen.stdout.readline()
        if not line:
            self._popen.wait()
            log = Path(self._log).read_text().strip()[-2000:]
            raise RuntimeError(f"a process has ended: {self._popen.args!r:.200}\n{log}")
        return json.loads(line)

    def tell(self, line: str = "") -> None:
        """Send it one line, which it may wait for."""
        assert self._popen.stdin is not None
        self._popen.stdin.write(f"{line}\n")
        self._popen.stdin.flush()


def free_port() -> int:
    """A free port of loopback that the system gives no outgoing connection: a process that is
    killed can be started there again.
    """
    while True:
        with suppress(OSError), socket.create_server(("127.0.0.1", random.randrange(*_PORTS))) as s:
            port: int = s.getsockname()[1]
            return port


def say(thing: Any) -> None:
    """Said by a process to the benchmark."""
    print(json.dumps(thing), file=_SPEECH, flush=True)


def wait_for_line() -> bool:
    """In a process: wait for a line from the benchmark; False if the benchmark has ended."""
    return bool(sys.stdin.readline())
