"""The lock of a buffer: fast if it is free, and open to the thread that holds it.

Compiled if there is a C compiler (`lock.pxd` has the C types).

While the GIL is held nothing else runs, so a free lock is taken by setting a number: no lock of the
operating system, which takes longer than a lookup. A thread that finds it taken sleeps at a gate of
its own. Without a GIL it is a mutex.

Python may run other code of a program while a thread holds the lock: a signal handler, or a
finalizer that the garbage collector calls. If that uses the buffer, it must not wait for its own
thread. It may read. Its writes are done when the lock is left: the holder does not expect a
change.

A fork waits until all locks are free: no thread of a forked child could leave one that was held.
"""

import logging
import os
import threading
from collections.abc import Callable
from typing import Any
from weakref import WeakSet

try:
    import cython
except ImportError:
    from tfbus.base import cython_stub as cython

_log = logging.getLogger(__name__)

# In the place of a thread's number: the lock belongs to the one whose gate was opened.
_PASSED = 2**32 - 1


class Gate:
    """A place for a thread to sleep until another opens it. `passed` is whether it has the lock
    then.
    """

    def __init__(self) -> None:
        self.passed = False
        if cython.compiled:
            self.mutex.acquire()  # type: ignore[attr-defined]  # C's own


class Lock:
    """Held by one thread, which may enter again; `with` does both.

    `settle` is called, with the lock held, when a thread has entered again and leaves.
    """

    def __init__(self, settle: Callable[[], object]) -> None:
        self._settle = settle
        with _forking:
            _locks.add(self)
        # How often the holder has entered again and not left, and whether it has entered again.
        self._depth = 0
        self._disturbed = False
        self._later: list[Callable[[], object]] = []
        if cython.compiled:
            self._owner = 0
            self._wanted = 0
            self._queue: list[Gate] = []
        else:
            self._mutex = threading.RLock()
            # Ctrl-C may raise as soon as a function of Python begins, but only after one of C.
            self.leave = self._mutex.release  # type: ignore[method-assign]

    def enter(self) -> bool:
        """Wait until no other thread holds it. False if this one held it before."""
        if cython.compiled:
            me = PyThread_get_thread_ident()  # type: ignore[name-defined]  # noqa: F821  # C's own
            if tfbus_holder(self._owner) == me:  # type: ignore[name-defined]  # noqa: F821
                self._depth += 1
                self._disturbed = True
                return False
            if not TFBUS_HAS_GIL:  # type: ignore[name-defined]  # noqa: F821
                self._mutex.acquire()
            elif self._owner:
                self._wait()
            self._owner = me
            return True
        else:
            if self.is_mine():
                self._depth += 1
                self._disturbed = True
                self.leave = self._leave  # type: ignore[method-assign]
                return False
            try:
                self._mutex.acquire()
            except BaseException:
                # Ctrl-C may raise in here before the mutex is acquired, or just after.
                if self.is_mine():
                    self._mutex.release()
                raise
            # Python handles signals at calls: from here to the caller's `try` there is none.
            return True

    def leave(self) -> None:
        """Undo one `enter`."""
        if self._depth:
            self._depth -= 1
        elif self._disturbed:
            self._leave_disturbed()
        else:
            self._release()

    def _leave(self) -> None:
        """As the `leave` of the class."""
        Lock.leave(self)

    def is_mine(self) -> bool:
        """Whether this thread holds it."""
        if cython.compiled:
            return tfbus_holder(self._owner) == PyThread_get_thread_ident()  # type: ignore[name-defined,no-any-return]  # noqa: F821
        else:
            return self._mutex._is_owned()  # type: ignore[attr-defined,no-any-return]  # not in stubs

    def later(self, call: Callable[..., object], *args: Any, **named: Any) -> bool:
        """If this thread holds it, call this when it has left, and log its exception. Whether it
        will be called.
        """
        if not self.is_mine():
            return False
        self._disturbed = True
        if not cython.compiled:
            self.leave = self._leave  # type: ignore[method-assign]
        self._later.append(lambda: call(*args, **named))
        return True

    def let_others(self) -> None:
        """With the lock held: let a thread have it that waits for it. Needs no GIL."""
        if self._depth:
            # The one that entered first still counts on it.
            pass
        elif cython.compiled and TFBUS_HAS_GIL:  # type: ignore[name-defined]  # noqa: F821
            if tfbus_is_set(self._wanted):  # type: ignore[name-defined]  # noqa: F821
                with cython.gil:
                    self._pass_on()
        elif cython.compiled:
            self._owner = 0
            self._mutex.release()
            self._mutex.acquire()
            self._owner = PyThread_get_thread_ident()  # type: ignore[name-defined]  # noqa: F821
        else:
            try:
                self.leave()
            finally:
                self.enter()

    def begin_anew(self) -> None:
        """In a forked child, with the lock held: forget the threads that wait, which are gone."""
        if cython.compiled:
            self._queue = []
            self._wanted = 0

    def __enter__(self) -> bool:
        return self.enter()

    def __exit__(self, *raised: object) -> None:
        if cython.compiled or self._depth or self._disturbed:
            self.leave()
        else:
            # With fewer calls there are fewer places where Ctrl-C leaves it locked.
            self._mutex.release()

    # Nothing of Python runs between looking at these fields and setting them, but where it waits.

    def _wait(self) -> None:
        """Sleep until the lock is free, or passed to this thread."""
        gate = Gate()
        place = len(self._queue)
        while self._owner and not gate.passed:
            self._queue.insert(place, gate)
            self._wanted = 1
            gate.mutex.acquire()  # type: ignore[attr-defined]  # lets go of the GIL
            # Where another thread was faster, this one stays the first.
            place = 0

    def _wake(self) -> None:
        gate = self._queue.pop(0)
        self._wanted = len(self._queue) > 0
        gate.mutex.release()  # type: ignore[attr-defined]  # C's own

    def _pass_on(self) -> None:
        """Give the lock to the thread that has waited longest, and wait for it again."""
        if self._disturbed:
            try:
                self._leave_disturbed()
            finally:
                self.enter()
        elif self._queue:
            gate = self._queue[0]
            gate.passed = True
            self._owner = _PASSED
            self._wake()
            self._wait()
            self._owner = PyThread_get_thread_ident()  # type: ignore[name-defined]  # noqa: F821

    def _release(self) -> None:
        if cython.compiled:
            self._owner = 0
            if not TFBUS_HAS_GIL:  # type: ignore[name-defined]  # noqa: F821
                self._mutex.release()
            elif self._wanted:
                self._wake()
        else:
            self._mutex.release()

    def _leave_disturbed(self) -> None:
        later: list[Callable[[], object]] = []
        try:
            self._disturbed = False
            if not cython.compiled:
                self.leave = self._mutex.release  # type: ignore[method-assign]
            self._settle()
            later, self._later = self._later, []
        finally:
            self._release()
        for call in later:
            try:
                call()
            except Exception:
                _log.exception("A call from within another one of the same buffer failed")


# All of this process, and the ones that a thread holds while it forks; one thread does at a time.
_locks: WeakSet[Lock] = WeakSet()
_held: list[Lock] = []
_forking = threading.RLock()


def _before_fork() -> None:
    _forking.acquire()
    for lock in list(_locks):
        lock.__enter__()
        _held.append(lock)


def _after_fork() -> None:
    while _held:
        _held.pop().__exit__()
    _forking.release()


def _after_fork_in_child() -> None:
    for lock in _held:
        lock.begin_anew()
    _after_fork()


if hasattr(os, "register_at_fork"):  # Windows has no forks
    os.register_at_fork(
        before=_before_fork,
        after_in_parent=_after_fork,
        after_in_child=_after_fork_in_child,
    )
