"""The keys that are typed while a tool of `tfbus bag` works, and its terminal that goes away."""

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress

from tfbus.command.terminal import KeyReader, NoTerminalError, RawTerminal

_STANDARD_INPUT = 0

# What a terminal that was closed is read as.
QUIT = "q"


@contextmanager
def typed_keys(within_s: float, *, wanted: bool = True) -> Iterator[Callable[[], list[str]] | None]:
    """Inside the `with`, a function that returns the keys typed within this time; None if keys
    are not `wanted`, or there is no terminal to read them from.

    A terminal that goes away (ssh, a closed window) ends the `with` as Ctrl-C does, so that what
    is written is whole, except if nohup has it ignored.
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

    From then on nothing is printed, and a SIGHUP does nothing: it may come late, while what was
    written is made whole.
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
