"""Descendants that left the process group they were started in (daemons, `setsid`).

On Linux a process can become the parent of its orphaned descendants. Launch does, to find and end
them too. Elsewhere they are not found.
"""

import asyncio
import ctypes
import os
import signal
import sys
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

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
    """The adopted children of this process.

    `started` returns the pids of the children that it started itself; they are left alone.
    """

    def __init__(self, started: Callable[[], Collection[int]]) -> None:
        self._started = started

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
        return children - set(self._started())


def _send(pid: int, number: signal.Signals) -> None:
    with suppress(ProcessLookupError, PermissionError):
        os.kill(pid, number)


def _set_subreaper(value: int) -> None:
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, value, 0, 0, 0)
