"""The lock of a file or folder: of all processes of this host one holds it, until it lets go or
ends. On a system without such locks, as Windows, nobody is known to hold one.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO


@contextmanager
def locked(folder: Path, *, waits: bool) -> Iterator[bool]:
    """Inside the `with` no other process holds the folder's lock: it waits for one that does, or,
    unless it `waits`, gives False.
    """
    if os.name == "nt":  # which opens no folder
        yield True
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        yield _lock(descriptor, "LOCK_EX", waits=waits)
    finally:
        os.close(descriptor)


def hold(file: BinaryIO) -> None:
    """Hold the lock of an open file until it is closed, unless somebody else has it."""
    _lock(file.fileno(), "LOCK_EX", waits=False)


def is_held(path: Path) -> bool:
    """Whether a process holds the lock of a file."""
    with suppress(OSError), path.open("rb") as file:
        # Others that ask, too, are not taken for one.
        return not _lock(file.fileno(), "LOCK_SH", waits=False)
    return False


def _lock(descriptor: int, kind: str, *, waits: bool) -> bool:
    """Take the lock; False if another has it."""
    try:
        import fcntl  # Windows has none

        fcntl.flock(descriptor, getattr(fcntl, kind) | (0 if waits else fcntl.LOCK_NB))
    except BlockingIOError:
        return False
    except (ImportError, OSError):  # as of a folder on another machine
        return True
    return True
