"""A terminal that passes on every key at once, the keys from its bytes, and its modes afterwards.

A key is a name: the character itself (`g`, `Q`), an arrow (`up`, `down`, `left`, `right`),
`escape`, or `other` for every other key. An escape sequence is always read as a whole, so that no
letter in it is taken for a typed one.
"""

import atexit
import os
import re
import select
import signal
import termios
import threading
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from types import FrameType
from typing import Any

from tfbus.base.errors import SettingsError

# Signals that end or stop a process by default. SIGINT and SIGTERM, which tfbus handles, end the
# `with` and need nothing here.
_LEAVING = (signal.SIGHUP, signal.SIGQUIT, signal.SIGTSTP)

_STANDARD_INPUT = 0

# The key that is read from a terminal that was closed.
QUIT = "q"


class NoTerminalError(SettingsError):
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
            # One that others have set meanwhile stays.
            if signal.getsignal(number) in (self._leave, self._resume):
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


# Where sequences end: ECMA-48, section 5.4 (CSI), and xterm's ctlseqs (SS3, strings).
_KEY = re.compile(
    rb"""
      \x1b\[\[ .                                 # function keys of the Linux console
    | \x1b\[ [0-?]* [ -/]* (?P<csi> [@-Z\\-~] )  # CSI; its last byte says which key
    | \x1bO [0-?]* (?P<ss3> [@-~] )              # SS3: the arrows in application mode
    | \x1b[PX\]^_] [^\x1b\x07]* (?: \x07 | \x1b\\ | (?= \x1b[^\\] ) )  # the terminal's own answers
    | \x1b[\[O] [ -?]* (?= [^\x20-\x7e] )        # a sequence broken off by another key
    | (?P<escape> \x1b (?= \x1b ) )
    | \x1b [^\[OPX\]^_\x1b]                      # Alt and a character
    | (?P<character> [\x00-\x1a\x1c-\x7f] )
    | [\xc0-\xff] [\x80-\xbf]*                   # a character beyond ASCII, in UTF-8
    | [\x80-\xbf]
    """,
    re.VERBOSE | re.DOTALL,
)
_ARROWS = {b"A": "up", b"B": "down", b"C": "right", b"D": "left"}


class KeyReader:
    """Turns bytes into keys; keeps the pieces of a sequence until it is complete."""

    def __init__(self) -> None:
        self._pending = b""

    def feed(self, data: bytes) -> list[str]:
        """The keys that these bytes complete, in the order they were typed."""
        keys = []
        self._pending += data
        while match := _KEY.match(self._pending):
            self._pending = self._pending[match.end() :]
            keys.append(_key(match))
        return keys

    def flush(self) -> list[str]:
        """The key that the pending bytes stand for if nothing follows them."""
        pending, self._pending = self._pending, b""
        return ["escape" if pending == b"\x1b" else "other"] if pending else []


def _key(match: re.Match[bytes]) -> str:
    if match["character"] is not None:
        return match["character"].decode("ascii")
    if match["escape"] is not None:
        return "escape"
    return _ARROWS.get(match["csi"] or match["ss3"] or b"", "other")


@contextmanager
def typed_keys(within_s: float, *, wanted: bool = True) -> Iterator[Callable[[], list[str]] | None]:
    """Inside the `with`, a function that returns the keys typed within this time; None if keys
    are not `wanted`, or there is no terminal to read them from.

    A terminal that goes away (ssh, a closed window) ends the `with` as Ctrl-C does, so that the
    files are whole, except if nohup has it ignored.
    """
    if not wanted or not _is_own_terminal():
        with _hanging_up() if signal.getsignal(signal.SIGHUP) == signal.SIG_DFL else nullcontext():
            yield None
        return
    reader = KeyReader()
    with RawTerminal(_STANDARD_INPUT) as terminal, _hanging_up() as hang_up:

        def read() -> list[str]:
            try:
                data = terminal.read(within_s)
            except NoTerminalError:
                hang_up()  # before its signal, or without one: that goes to the session's leader
                return [QUIT]
            return reader.feed(data) if data else reader.flush()

        yield read


def _is_own_terminal() -> bool:
    """Whether standard input is a terminal whose foreground job this is: reading from the
    background would stop the process.
    """
    with suppress(OSError):
        return os.isatty(_STANDARD_INPUT) and os.tcgetpgrp(_STANDARD_INPUT) == os.getpgrp()
    return False


@contextmanager
def _hanging_up() -> Iterator[Callable[[], None]]:
    """Inside the `with` SIGHUP ends it as Ctrl-C does; the function given does its first half.

    From then on nothing is printed, and a SIGHUP does nothing: it may come late, while the files
    are made whole.
    """

    def hang_up() -> None:
        nothing = os.open(os.devnull, os.O_WRONLY)
        for stream in (1, 2):
            os.dup2(nothing, stream)
        os.close(nothing)
        signal.signal(signal.SIGHUP, signal.SIG_IGN)

    def end(number: int, frame: object) -> None:
        hang_up()
        raise KeyboardInterrupt

    previous = signal.signal(signal.SIGHUP, end)
    try:
        yield hang_up
    finally:
        if signal.getsignal(signal.SIGHUP) is end:
            signal.signal(signal.SIGHUP, previous)
