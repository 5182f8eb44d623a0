"""Refusals: what a simulated process must not do, each with a sentence that says what to do."""

import os
import shlex
import socket
import subprocess
from collections.abc import Callable, Iterator
from multiprocessing.process import BaseProcess
from typing import Any, NoReturn

from tfbus.testing.tasks import SimulationError


def refusals() -> Iterator[tuple[Any, str, Callable[..., NoReturn]]]:
    """The owner and name of each function that is refused, and what refuses it."""
    yield socket.socket, "__init__", _socket
    yield subprocess.Popen, "__init__", _program
    yield BaseProcess, "start", _fork
    for name in ("fork", "forkpty", "posix_spawn", "posix_spawnp", "system"):
        if hasattr(os, name):
            yield os, name, _fork


def _socket(*_: object, **__: object) -> NoReturn:
    raise SimulationError(
        "a socket cannot be simulated: its other end is in real time. Use a topic or a service, or "
        "give the node an object in its place that the test makes"
    )


def _program(_: object, args: Any = "", *__: object, **___: object) -> NoReturn:
    words = args if isinstance(args, str | bytes) else shlex.join(map(os.fsdecode, args))
    raise SimulationError(
        f"program {os.fsdecode(words)!r} cannot be simulated: it runs in real time. Run its main "
        "function by network.program(host, main), or give the node its output"
    )


def _fork(*_: object, **__: object) -> NoReturn:
    raise SimulationError(
        "a process of the system cannot be simulated: it runs in real time. Run its main function "
        "by network.program(host, main)"
    )
