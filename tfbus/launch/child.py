"""One started process and everything that it starts in turn: a process group of its own."""

import asyncio
import os
import signal
import subprocess
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

from tfbus.launch.console import Console
from tfbus.launch.program import Program


class Child:
    """A program that was started, in a session and process group of its own.

    Made in the thread of a running asyncio loop. Raises OSError if it cannot be started.
    `exit_code` is None while it runs, and -N if signal N ended it.
    """

    def __init__(self, program: Program, console: Console, on_end: Callable[[], None]) -> None:
        self.program = program
        self.exit_code: int | None = None
        self._loop = asyncio.get_running_loop()
        self._on_end = on_end
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
        assert self._process.stdout and self._process.stderr  # both asked for above
        for pipe, stream in (
            (self._process.stdout, console.output),
            (self._process.stderr, console.errors),
        ):
            # The relay closes its own copy; Popen keeps and closes the original.
            source = os.dup(pipe.fileno())
            pipe.close()
            relay = partial(console.relay, program.name, source, stream)
            self._in_thread(relay, self._pipe_ended)
        self._in_thread(self._process.wait, self._ended)

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

    def _pipe_ended(self, _: object) -> None:
        self._open_pipes -= 1
        self._on_end()

    def _ended(self, exit_code: int) -> None:
        self.exit_code = exit_code
        self._on_end()

    def _in_thread(self, work: Callable[[], Any], then: Callable[[Any], None]) -> None:
        def run() -> None:
            result = work()
            # The loop is closed where launch gave up on this process.
            with suppress(RuntimeError):
                self._loop.call_soon_threadsafe(then, result)

        threading.Thread(target=run, daemon=True).start()
