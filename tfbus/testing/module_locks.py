"""Locks that modules have made before a simulation: tasks must not wait for them in real time."""

import _thread
from collections.abc import Callable
from functools import partial
from typing import Any

from tfbus.testing.primitives import Lock
from tfbus.testing.tasks import Tasks


class ModuleLock:
    """A lock of a module: one of tasks in tasks, and Python's own on other threads."""

    def __init__(self, tasks: Tasks, real: Any, *, reentrant: bool = False) -> None:
        self._thread_ids = tasks.thread_ids
        self._real = real
        self._simulated = Lock(tasks, reentrant=reentrant)
        if _is_held(real):
            self._simulated.holder, self._simulated._depth = tasks.main, 1

    @property
    def _lock(self) -> Any:
        return self._simulated if _thread.get_ident() in self._thread_ids else self._real

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        taken: bool = self._lock.acquire(blocking, timeout)
        return taken

    __enter__ = acquire

    def release(self) -> None:
        self._lock.release()

    def __exit__(self, *_: object) -> None:
        self._lock.release()

    def locked(self) -> bool:
        return _is_held(self._lock)

    def _is_owned(self) -> bool:
        # As conditions ask for it.
        lock = self._lock
        owned: bool = getattr(lock, "_is_owned", lock.locked)()
        return owned


def _is_held(lock: Any) -> bool:
    # Python's own reentrant locks tell it from 3.14 on.
    held: bool = lock.locked() if hasattr(lock, "locked") else lock._is_owned()
    return held


def locks_of_modules(tasks: Tasks) -> dict[type, Callable[[Any], ModuleLock]]:
    """By the type of a lock, the one that takes its place."""
    return {
        _thread.LockType: partial(ModuleLock, tasks),
        _thread.RLock: partial(ModuleLock, tasks, reentrant=True),
    }
