"""The threads that run callbacks: a wait on one of them ends when its executor closes."""

import threading
from collections.abc import Callable


class Closing:
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

    closing: Closing | None = None
    held_up: Callable[[str], str] = staticmethod(_nothing)


here = _Here()
