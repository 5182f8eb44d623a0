"""A started process with its process group, and how all groups end: SIGINT, SIGTERM, SIGKILL."""

import asyncio
import os
import signal
import subprocess
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from typing import TypeVar

from tfbus.launch.run.console import Console
from tfbus.launch.run.program import Program

T = TypeVar("T")


class Child:
    """A started program, in its own session and process group.

    `exit_code` is None while it runs, and -N if signal N ended it.
    """

    def __init__(self, program: Program) -> None:
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
        _in_thread(loop, lambda: console.relay(name, output, console.output), pipe_ended)
        _in_thread(loop, lambda: console.relay(name, errors, console.errors), pipe_ended)
        _in_thread(loop, self._process.wait, process_ended)

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
    loop: asyncio.AbstractEventLoop, work: Callable[[], T], then: Callable[[T], None]
) -> None:
    """Work in a thread, then call `then(result)` in the loop."""

    def run() -> None:
        result = work()
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
