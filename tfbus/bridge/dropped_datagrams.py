"""Datagrams that the system has dropped for sockets of this process, if it is Linux."""

import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

_TABLES = ("/proc/self/net/udp", "/proc/self/net/udp6")
_OPEN_FILES = "/proc/self/fd"

# Columns of the tables.
_INODE, _DROPS = 9, 12


def udp_sockets() -> frozenset[str]:
    """The sockets for datagrams that this process has open, by their inodes."""
    own = set()
    with suppress(OSError):
        for name in os.listdir(_OPEN_FILES):
            with suppress(OSError):  # closed meanwhile
                own.add(os.readlink(f"{_OPEN_FILES}/{name}").removeprefix("socket:[")[:-1])
    return frozenset(own.intersection(row[_INODE] for row in _rows()))


def dropped_datagrams(sockets: frozenset[str]) -> int:
    """How many datagrams came to these sockets while so many waited that there was no room."""
    return sum(int(row[_DROPS]) for row in _rows() if row[_INODE] in sockets)


def _rows() -> Iterable[list[str]]:
    for table in _TABLES:
        with suppress(OSError):
            for line in Path(table).read_text(encoding="ascii").splitlines()[1:]:
                yield line.split()
