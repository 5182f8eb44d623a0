"""The threads that run callbacks: how they sleep, and how a wait on one ends with its executor."""

import threading
from collections.abc import Callable

from tfbus.runtime import scheduler


class ExecutorEnd:
    """The end of an executor, for callbacks that wait on its threads."""

    def __init__(self) -> None:
        self.has_begun = False
        # Changed by single operations only: a signal handler may close in the middle of a wait.
        self._wakes: dict[int, Callable[[], object]] = {}

    def begin(self) -> None:
        """Wake all that wait; twice is fine."""
        self.has_begun = True
        for wake in list(self._wakes.values()):
            wake()

    def wakes(self, waiter: object, wake: Callable[[], object]) -> None:
        """Call `wake()` when it begins, until `forget(waiter)`."""
        self._wakes[id(waiter)] = wake

    def forget(self, waiter: object) -> None:
        """Wake this one no longer."""
        self._wakes.pop(id(waiter), None)


def _nothing(stream: str) -> str:
    return ""


class _Here(threading.local):
    """Of the thread that reads it, if it runs the callbacks of an executor.

    `closing` is the end of that, None on all other threads. `held_up(stream)` names a callback that
    waits for the current one to return, if the same executor sends the stream; "" elsewhere.
    """

    closing: ExecutorEnd | None = None
    held_up: Callable[[str], str] = staticmethod(_nothing)


here = _Here()


class Bell:
    """A bell that one thread sleeps on until another rings it: an Event whose `ring` may interrupt
    its own `wait`, as in a signal handler.
    """

    __slots__ = ("_silent",)

    def __init__(self) -> None:
        self._silent = scheduler.Lock()
        self._silent.acquire()

    def ring(self) -> None:
        """End the `wait` of now, or else the next one."""
        try:  # noqa: SIM105  # `suppress` would be a third of this
            self._silent.release()
        except RuntimeError:
            pass

    def wait(self, timeout_s: float | None) -> None:
        """Sleep until it is rung, at most this long; None: for as long as it takes."""
        if timeout_s is None or timeout_s > scheduler.TIMEOUT_MAX:
            timeout_s = scheduler.TIMEOUT_MAX
        self._silent.acquire(timeout=timeout_s if timeout_s > 0.0 else 0.0)
