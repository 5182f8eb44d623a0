"""Runs a supervisor with its signals, guard, output and orphans."""

import asyncio
import ctypes
import math
import os
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path

from tfbus.launch.child import LaunchProgram, Timeouts
from tfbus.launch.console import Console, OutputStream
from tfbus.launch.guard import GuardProcess
from tfbus.launch.service_manager import ServiceManager
from tfbus.launch.supervisor import Presence, Supervisor

_REASONS = {
    signal.SIGINT: "user interrupted with ctrl-c (SIGINT)",
    signal.SIGTERM: "asked to end (SIGTERM)",
    signal.SIGHUP: "the terminal was closed (SIGHUP)",
    signal.SIGQUIT: "user pressed ctrl-\\ (SIGQUIT): killing all",
}
_SAME_SIGNAL_S = 0.1


def run_programs(
    programs: Sequence[LaunchProgram],
    *,
    presence: Presence | None,
    timeouts: Timeouts,
    longest_s: float | None = None,
) -> int:
    """Run the programs until they or the user end them, or for `longest_s` seconds.

    Returns the exit code. For the main thread of a process that does nothing else: it handles the
    signals, and leaves Ctrl-C and SIGTERM ignored, as nothing is left to stop.
    """
    manager = ServiceManager()
    with adopting_orphans(), GuardProcess(timeouts.after_sigterm_s) as guard:
        return asyncio.run(_run(programs, presence, timeouts, guard, longest_s, manager))


async def _run(
    programs: Sequence[LaunchProgram],
    presence: Presence | None,
    timeouts: Timeouts,
    guard: GuardProcess,
    longest_s: float | None,
    manager: ServiceManager,
) -> int:
    loop = asyncio.get_running_loop()
    console = Console(OutputStream(1), OutputStream(2))
    supervisor = Supervisor(programs, console, presence=presence, guard=guard, timeouts=timeouts)
    orphans = Orphans(supervisor, guard)

    def stop_unread() -> None:
        loop.call_soon_threadsafe(supervisor.stop, "the reader of the output is gone")

    console.output.on_gone = console.errors.on_gone = stop_unread
    _take_signals(supervisor)
    loop.add_signal_handler(signal.SIGCHLD, orphans.reap)
    if longest_s is not None:
        reason = f"has run for {longest_s:g} s, as asked"
        loop.call_later(longest_s, partial(supervisor.stop, reason, level="INFO"))
    telling = asyncio.create_task(_notify(manager, supervisor))
    try:
        return await supervisor.run()
    finally:
        telling.cancel()
        manager.notify("STOPPING=1")
        await orphans.end_all(timeouts.after_sigterm_s)
        console.close()
        for number in (signal.SIGCHLD, *_REASONS):
            loop.remove_signal_handler(number)
        for number in _REASONS:
            signal.signal(number, signal.SIG_IGN)


async def _notify(manager: ServiceManager, supervisor: Supervisor) -> None:
    """Tell the service manager once all programs have been started, and that this loop goes on."""
    await supervisor.started()
    manager.notify("READY=1", f"STATUS={supervisor.status}")
    while manager.every_s is not None:
        # A READY that got lost would leave the service at its start.
        manager.notify("WATCHDOG=1", "READY=1", f"STATUS={supervisor.status}")
        await asyncio.sleep(manager.every_s)


def _take_signals(supervisor: Supervisor) -> None:
    """Let Ctrl-C, SIGTERM and the like stop the supervisor, and hurry it when they come again."""
    loop = asyncio.get_running_loop()
    debounce = Debounce()

    def on_signal(number: signal.Signals) -> None:
        is_new = debounce.is_new(loop.time())
        if number == signal.SIGQUIT:
            supervisor.hurry(_REASONS[number], at_least=signal.SIGKILL)
        elif is_new:
            supervisor.hurry(_REASONS[number])

    for number in _REASONS:
        # nohup ignores SIGHUP: its program continues without the terminal.
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
            loop.add_signal_handler(number, on_signal, number)


class Debounce:
    """Tells a user's second Ctrl-C from one that arrives twice.

    `timeout`, `make` and shells send a signal to a process and to its group: it arrives twice
    within 0.1 s.
    """

    def __init__(self) -> None:
        self._last_s = -math.inf

    def is_new(self, now_s: float) -> bool:
        """Whether a signal at this time, by any clock, is a new one."""
        since_s, self._last_s = now_s - self._last_s, now_s
        return since_s >= _SAME_SIGNAL_S


_PR_SET_CHILD_SUBREAPER = 36  # from linux/prctl.h
_POLL_S = 0.02


@contextmanager
def adopting_orphans() -> Iterator[None]:
    """Adopt descendants whose own parent ends; Linux only, elsewhere nothing changes."""
    _set_subreaper(1)
    try:
        yield
    finally:
        _set_subreaper(0)


class Orphans:
    """The adopted children of this process; its own, of the supervisor and the guard, are left
    alone.
    """

    def __init__(self, supervisor: Supervisor, guard: GuardProcess) -> None:
        self._supervisor = supervisor
        self._guard = guard

    def reap(self) -> None:
        """Reap the adopted children that ended, which would stay zombies otherwise."""
        for pid in self._adopted():
            with suppress(ChildProcessError):
                os.waitpid(pid, os.WNOHANG)

    async def end_all(self, grace_s: float) -> None:
        """End the adopted children and their orphans: SIGTERM, and after `grace_s` SIGKILL."""
        loop = asyncio.get_running_loop()
        deadline_s = loop.time() + grace_s
        asked: set[int] = set()
        while pids := self._remaining():
            for pid in pids:
                if loop.time() >= deadline_s:
                    _send(pid, signal.SIGKILL)
                elif pid not in asked:
                    _send(pid, signal.SIGTERM)
            asked |= pids
            await asyncio.sleep(_POLL_S)

    def _remaining(self) -> set[int]:
        self.reap()
        return self._adopted()

    def _adopted(self) -> set[int]:
        children: set[int] = set()
        for task in Path("/proc/self/task").glob("*/children"):
            with suppress(OSError):  # the thread has just ended
                children.update(int(pid) for pid in task.read_text().split())
        return children - self._supervisor.pids - {self._guard.pid}


def _send(pid: int, number: signal.Signals) -> None:
    with suppress(ProcessLookupError, PermissionError):
        os.kill(pid, number)


def _set_subreaper(value: int) -> None:
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, value, 0, 0, 0)
