"""Lookups that call back when they may be answered, for owners without a thread that waits."""

from collections.abc import Callable

from tfbus.base.clock import limit_by
from tfbus.buffer.buffer import Buffer
from tfbus.buffer.lookup import Lookup
from tfbus.buffer.store import Waiter


class PendingLookup:
    """A lookup of one stamp, None for the latest, for at most `timeout_s` from now on.

    After a `poll` that returned False, `wake()` is called from any thread when another one is
    worth it, but for the end of a timeout in real seconds, which comes `left_s` later. End it by
    `close()`.
    """

    def __init__(
        self,
        buffer: Buffer,
        target_frame: str,
        source_frame: str,
        stamp_ns: int | None,
        timeout_s: float,
        wake: Callable[[], None],
    ) -> None:
        self._store = buffer._store
        self._lookup = Lookup(self._store, ((target_frame, source_frame, stamp_ns),))
        self._timeout_s = timeout_s
        self._wake = wake
        self._limit = limit_by(self._store.clock, timeout_s, wake)
        self._waiter: Waiter | None = None

    @property
    def left_s(self) -> float | None:
        """The real seconds that are left; None if another clock ends it."""
        return self._limit.left_s

    def poll(self) -> bool:
        """Whether there is an answer. If there will be none it raises as `lookup_transform` with a
        timeout.
        """
        if self._lookup.answers() is not None:
            return True
        if self._waiter is None:
            self._waiter = Waiter(self._wake)
            self._store.waiters.add(self._waiter)
        return (
            self._lookup._answers_or_watch(self._waiter, self._limit, self._timeout_s) is not None
        )

    def close(self) -> None:
        """End it; once."""
        if self._waiter is not None:
            self._store.waiters.discard(self._waiter)
        self._limit.__exit__()
