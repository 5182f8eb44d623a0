"""A terminal that hands over every key at once, and is left as it was found."""

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

from tfbus import TfbusError

# Signals that end or stop a process without its doing. Those that tfbus handles itself (SIGINT
# and SIGTERM) end the `with` and need nothing here.
_LEAVING = (signal.SIGHUP, signal.SIGQUIT, signal.SIGTSTP)


class NoTerminalError(TfbusError):
    """There is no terminal where one is needed, or it has gone."""


class RawTerminal:
    """The terminal `fd` without echo and without waiting for Enter, while its `with` lasts.

    Ctrl-C and Ctrl-Z stay signals, and output stays as it is. However the process ends or stops,
    short of SIGKILL, the terminal gets back the modes it had; when the process goes on after
    Ctrl-Z it is raw again. To be used in the main thread. Raises NoTerminalError where `fd` is
    no terminal.
    """

    def __init__(self, fd: int):
        if not os.isatty(fd):
            raise NoTerminalError(
                "keys are read from a terminal, and standard input is none: run this in a "
                "terminal of its own (over ssh: ssh -t)"
            )
        self._fd = fd
        self._found = termios.tcgetattr(fd)
        self._previous: dict[int, Any] = {}

    def __enter__(self) -> "RawTerminal":
        # For a signal that ends the process between here and the `with`.
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
        """What was typed, as soon as there is something; b"" where nothing was in time.

        Raises NoTerminalError when the terminal has gone.
        """
        readable, _, _ = select.select([self._fd], [], [], timeout_s)
        if not readable:
            return b""
        with suppress(OSError):
            if data := os.read(self._fd, 4096):
                return data
        raise NoTerminalError("the terminal has gone")

    def _make_raw(self) -> None:
        with suppress(termios.error):
            tty.setcbreak(self._fd, termios.TCSANOW)

    def _restore(self) -> None:
        # A terminal that has hung up has no modes any more.
        with suppress(termios.error):
            termios.tcsetattr(self._fd, termios.TCSANOW, self._found)

    def _leave(self, number: int, frame: FrameType | None) -> None:
        """Leave the terminal as it was, and let the signal do what it does."""
        self._restore()
        signal.signal(number, signal.SIG_DFL)
        # To this very thread: it takes effect before the next line.
        signal.pthread_kill(threading.get_ident(), number)
        # Only from a stop is there a way back.
        signal.signal(number, self._leave)
        self._make_raw()

    def _resume(self, number: int, frame: FrameType | None) -> None:
        self._make_raw()
