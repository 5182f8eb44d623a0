"""What a session has declared, and whether it has a counterpart."""

import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import zenoh

from tfbus.bus.callbacks import on_kept_thread


def direct(callback: Callable[[Any], None], drop: Callable[[], None] | None = None) -> Any:
    """The callback as Zenoh wants it: called on Zenoh's own thread.

    By default zenoh-python starts a thread for each callback, which now and then outlives its
    session and then keeps the process from ending. Ours only decode and store, or hand over to
    the node's thread, and so one that falls behind holds up its own link, not the memory.
    """
    return zenoh.handlers.Callback(on_kept_thread(callback), drop, indirect=False)


class Declaration:
    """Something that a session has declared; it ends with the session, or before."""

    def __init__(self, declared: Any):
        self._declared = declared

    def close(self) -> None:
        """End it; twice is fine."""
        with suppress(zenoh.ZError):
            self._declared.undeclare()


class _MatchWatch:
    """Knows at any time whether what a session declared has a counterpart; closed by `close`."""

    def __init__(self, declared: zenoh.Querier | zenoh.Publisher):
        self._matched = threading.Event()
        self._declared = Declaration(declared)
        self._listener = Declaration(
            declared.declare_matching_listener(direct(lambda status: self._set(status.matching)))
        )
        status: Any = declared.matching_status  # a bool in Zenoh's stubs, but not in Zenoh
        if status.matching:
            self._set(True)

    def wait(self, timeout_s: float | None = None) -> bool:
        """Whether there is one, waited for at most `timeout_s` (None: for ever)."""
        return self._matched.wait(timeout_s)

    def close(self) -> None:
        """Watch no more."""
        self._listener.close()
        self._declared.close()

    def _set(self, matched: bool) -> None:
        if matched:
            self._matched.set()
        else:
            self._matched.clear()


class ServedWatch(_MatchWatch):
    """Knows at any time whether somebody serves a key; closed when nobody asks any more."""

    @property
    def served(self) -> bool:
        """Whether somebody serves it now."""
        return self._matched.is_set()


class HeardWatch(_MatchWatch):
    """Knows at any time whether somebody subscribes to a key."""

    @property
    def heard(self) -> bool:
        """Whether somebody subscribes to it now."""
        return self._matched.is_set()
