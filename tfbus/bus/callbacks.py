"""Python's knowledge of a thread that is not Python's own, kept from one callback to the next.

Python makes a state for such a thread when it calls in, and throws it away when the call ends.
That takes several times as long as all the rest: of a message received from Zenoh 11.1 us of CPU,
against 2.7 us where the state is kept.
"""

import ctypes
import itertools
import threading
from collections.abc import Callable
from typing import Any

# So many threads are kept; Zenoh has a few that live as long as the process.
_MOST_KEPT = 64


def on_kept_thread(callback: Callable[[Any], None]) -> Callable[[Any], None]:
    """The callback, so wrapped that the threads that call it are kept."""

    def called(event: Any) -> None:
        kept.known = True
        callback(event)

    return called


class _Thread(threading.local):
    """Keeps the thread that makes it."""

    known = False
    _kept = itertools.count()

    def __init__(self) -> None:
        if next(self._kept) < _MOST_KEPT:
            # Python drops a thread's state at the release of what was ensured: this never is.
            ctypes.pythonapi.PyGILState_Ensure()


# To set `kept.known` in a callback keeps the thread that it is called on: the first time in a
# thread, that makes its _Thread.
kept = _Thread()
