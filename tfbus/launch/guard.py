"""A process that ends the programs that a killed launch leaves behind.

Launch cannot catch SIGKILL. The guard reads the process groups from a pipe, which the kernel
closes when launch ends, however it ends. Unlike PR_SET_PDEATHSIG it needs no code between fork
and exec (unsafe in a process with threads), reaches whole groups, and works beyond Linux.

Run as a script, this file is the guard; it imports only the standard library.
"""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterable
from contextlib import suppress

_POLL_S = 0.02


class GuardProcess:
    """The guard of one launch; a context manager."""

    def __init__(self, grace_s: float = 2.0) -> None:
        """Start the guard; it waits `grace_s` between SIGTERM and SIGKILL."""
        self._process = subprocess.Popen(
            (sys.executable, "-I", "-S", __file__, str(grace_s)),
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            bufsize=0,
            cwd="/",
            start_new_session=True,
        )
        self.pid = self._process.pid

    def watch(self, group: int) -> None:
        """A process group was started."""
        self._write(f"+{group}\n")

    def release(self, group: int) -> None:
        """A process group has ended; its number may be used again."""
        self._write(f"-{group}\n")

    def close(self) -> None:
        """End the guard, after the groups that were not released."""
        if self._process.stdin:
            self._process.stdin.close()
        self._process.wait()

    def __enter__(self) -> "GuardProcess":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _write(self, line: str) -> None:
        # The guard was killed: launch still ends its processes itself.
        with suppress(BrokenPipeError):
            if self._process.stdin:
                self._process.stdin.write(line.encode())


def _groups_left(lines: Iterable[str]) -> set[int]:
    """The groups that were not released when the lines end."""
    groups: set[int] = set()
    for line in lines:
        (groups.add if line[0] == "+" else groups.discard)(int(line[1:]))
    return groups


def _end_groups(groups: set[int], grace_s: float) -> None:
    deadline_s = time.monotonic() + grace_s
    groups = {group for group in groups if _send(group, signal.SIGTERM)}
    while groups and time.monotonic() < deadline_s:
        time.sleep(_POLL_S)
        groups = {group for group in groups if _send(group, 0)}
    for group in groups:
        _send(group, signal.SIGKILL)


def _send(group: int, number: int) -> bool:
    """Whether the group still exists."""
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(group, number)
        return True
    return False


if __name__ == "__main__":
    for ignored in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
        signal.signal(ignored, signal.SIG_IGN)
    _end_groups(_groups_left(sys.stdin), float(sys.argv[1]))
