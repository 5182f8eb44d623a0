"""A terminal that passes on every key at once, and gets its modes back afterwards."""

import atexit
import os
import select
import signal
import termios
import threading
import tty
from contextlib import suppress
from types import FrameType
from typing import Any

from tfbus.errors import TfbusError

# Signals that end or stop a process by default. SIGINT and SIGTERM, which tfbus handles, end the
# `with` and need nothing here.
_LEAVING = (signal.SIGHUP, signal.SIGQUIT, signal.SIGTSTP)


class NoTerminalError(TfbusError):
    """Standard input is not a terminal, or its terminal was closed."""


class RawTerminal:
    """The terminal `fd`, inside its `with`, without echo and without waiting for Enter.

    Ctrl-C and Ctrl-Z stay signals, and output stays as it is. However the process ends or stops,
    except by SIGKILL, the terminal gets its modes back; it is raw again when the process continues
    after Ctrl-Z. For the main thread only. Raises NoTerminalError if `fd` is not a terminal.
    """

    def __init__(self, fd: int):
        if not os.isatty(fd):
            raise NoTerminalError(
                "standard input is not a terminal: run this in its own terminal (over ssh: ssh -t)"
            )
        self._fd = fd
        self._found = termios.tcgetattr(fd)
        self._previous: dict[int, Any] = {}

    def __enter__(self) -> "RawTerminal":
        # For a signal that ends the process before the body of the `with`.
        atexit.register(self._restore)
        for number in (*_LEAVING, signal.SIGCONT):
            self._previous[number] = signal.getsignal(number)
            handler = self._resume if number == signal.SIGCONT else self._leave
            signal.signal(number, handler)
        self._make_raw()
        return self

    def __exit__(self, *_: object) -> None:
        for number, previous in self._previous.items():
            signal.signal(number, previous)
        self._restore()
        atexit.unregister(self._restore)

    def read(self, timeout_s: float) -> bytes:
        """The next bytes typed; b"" after the timeout.

        Raises NoTerminalError when the terminal was closed.
        """
        readable, _, _ = select.select([self._fd], [], [], timeout_s)
        if not readable:
            return b""
        with suppress(OSError):
            if data := os.read(self._fd, 4096):
                return data
        raise NoTerminalError("the terminal was closed")

    def _make_raw(self) -> None:
        with suppress(termios.error):
            tty.setcbreak(self._fd, termios.TCSANOW)

    def _restore(self) -> None:
        # A terminal that has hung up has no modes.
        with suppress(termios.error):
            termios.tcsetattr(self._fd, termios.TCSANOW, self._found)

    def _leave(self, number: int, frame: FrameType | None) -> None:
        """Restore the terminal, and let the signal take its default action."""
        self._restore()
        signal.signal(number, signal.SIG_DFL)
        # To this thread: it takes effect before the next line.
        signal.pthread_kill(threading.get_ident(), number)
        # Reached only after a stop.
        signal.signal(number, self._leave)
        self._make_raw()

    def _resume(self, number: int, frame: FrameType | None) -> None:
        self._make_raw()
