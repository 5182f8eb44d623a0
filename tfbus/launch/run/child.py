"""One started process and everything that it starts in turn: a process group of its own."""

import asyncio
import os
import signal
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from typing import TypeVar

from tfbus.launch.run.console import Console
from tfbus.launch.run.program import Program

T = TypeVar("T")


class Child:
    """A program that was started, in a session and process group of its own.

    `exit_code` is None while it runs, and -N if signal N ended it.
    """

    def __init__(self, program: Program) -> None:
        """Start the program; OSError or ValueError if that cannot be done."""
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
        """Pass its output on from now, and call `on_change` in the running asyncio loop when it
        has ended and when each of its two outputs has.
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
        _in_thread(loop, lambda: console.relay(name, output, console.output), pipe_ended)
        _in_thread(loop, lambda: console.relay(name, errors, console.errors), pipe_ended)
        _in_thread(loop, self._process.wait, process_ended)

    @property
    def group_lives(self) -> bool:
        """Whether any process of the group is left.

        Those that were orphaned become children of launch where it is a subreaper; they are
        buried here, for a dead one that nobody waits for counts as a member.
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
            pass  # macOS says so of a group of zombies, Linux of another user's process
        return True

    @property
    def has_told_all(self) -> bool:
        """Whether all of its output has been passed on."""
        return self._open_pipes == 0

    def send(self, number: signal.Signals) -> None:
        """Send a signal to the whole group; nothing happens if it is gone."""
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self.pid, number)


@contextmanager
def _blocked(number: signal.Signals) -> Iterator[None]:
    """While it lasts the signal is held back, here and in processes that are started."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {number})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _in_thread(
    loop: asyncio.AbstractEventLoop, work: Callable[[], T], then: Callable[[T], None]
) -> None:
    """Work in a thread, and hand the result to `then` in the loop."""

    def run() -> None:
        result = work()
        # The loop is closed where launch gave up on this process.
        with suppress(RuntimeError):
            loop.call_soon_threadsafe(then, result)

    threading.Thread(target=run, daemon=True).start()
