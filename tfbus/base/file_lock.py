"""The lock of a file or folder: of all processes of this host one holds it, until it lets go or
ends. On a system without such locks, as Windows, none is ever known to be held.

A forked child has the open files of its parent, and with them their locks, so that to close one is
not enough to let go.
"""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from tfbus.base import scheduler

# Somebody who asks whether a lock is held has it for an instant.
_TRIES = 20
_TRY_EVERY_S = 0.001


@contextmanager
def locked(folder: Path, *, waits: bool) -> Iterator[bool]:
    """Inside the `with` no other process holds the folder's lock: it waits for one that does, or,
    unless it `waits`, gives False.
    """
    if os.name == "nt":  # which opens no folder
        yield True
        return
    descriptor = os.open(folder, os.O_RDONLY)
    let_go = _own(descriptor)
    try:
        yield _lock(descriptor, "LOCK_EX", waits=waits)
    finally:
        let_go()
        os.close(descriptor)


def hold(file: BinaryIO) -> Callable[[], None]:
    """Hold the lock of an open file, unless somebody else goes on to have it. The function returned
    lets go, while the file is open.
    """
    for _ in range(_TRIES):
        if _lock(file.fileno(), "LOCK_EX", waits=False):
            break
        scheduler.sleep(_TRY_EVERY_S)
    return _own(file.fileno())


def is_held(path: Path) -> bool:
    """Whether a process holds the lock of a file."""
    with suppress(OSError), path.open("rb") as file:
        # Others that ask, too, are not taken for one.
        is_free = _lock(file.fileno(), "LOCK_SH", waits=False)
        _let_go(file.fileno())
        return not is_free
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


def _own(descriptor: int) -> Callable[[], None]:
    """A function that lets go of the lock in this process. In a forked child it does nothing: the
    lock is its parent's.
    """
    process = os.getpid()

    def let_go() -> None:
        if os.getpid() == process:
            _let_go(descriptor)

    return let_go


def _let_go(descriptor: int) -> None:
    """Let go of the lock, if this open file has it."""
    with suppress(ImportError, OSError):
        import fcntl

        fcntl.flock(descriptor, fcntl.LOCK_UN)
