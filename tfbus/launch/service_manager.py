"""The service manager that has started this process, systemd: what it is told, and its journal."""

import os
import re
import socket
from contextlib import suppress

# It is told three times as often as it waits.
_TOLD_AS_OFTEN = 3

_LEVEL = re.compile(rb"\[(DEBUG|INFO|WARN|WARNING|ERROR|FATAL)\]")
_LEVELS = {
    b"DEBUG": b"<7>",
    b"INFO": b"<6>",
    b"WARN": b"<4>",
    b"WARNING": b"<4>",
    b"ERROR": b"<3>",
    b"FATAL": b"<2>",
}


class ServiceManager:
    """Tells the manager how it goes, if there is one. Removes its variables from the environment,
    so that child processes do not inherit them.
    """

    def __init__(self) -> None:
        address = os.environ.pop("NOTIFY_SOCKET", "")
        # One of Linux's that is no file begins with a zero byte.
        self._address = f"\0{address[1:]}" if address.startswith("@") else address
        wait_us = os.environ.pop("WATCHDOG_USEC", "")
        is_ours = os.environ.pop("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        # How often it has to be told that this process lives; None for never.
        self.every_s: float | None = None
        if self._address and is_ours and wait_us.isdecimal() and int(wait_us):
            self.every_s = int(wait_us) / 1e6 / _TOLD_AS_OFTEN

    def tell(self, *facts: str) -> None:
        """Tell it facts, such as `READY=1`; nothing without a manager, or if it does not listen."""
        if self._address:
            with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as told:
                told.setblocking(False)
                told.sendto("\n".join(facts).encode(), self._address)


def is_journal(descriptor: int) -> bool:
    """Whether a file descriptor leads to the journal: lines may say their level there."""
    device, _, inode = os.environ.get("JOURNAL_STREAM", "").partition(":")
    with suppress(OSError):
        found = os.fstat(descriptor)
        return (device, inode) == (str(found.st_dev), str(found.st_ino))
    return False


def journal_level(line: bytes) -> bytes:
    """The level of a line of a log, as the journal reads it in front; b"" if it says none."""
    found = _LEVEL.match(line)
    return _LEVELS[found[1]] if found else b""
