"""Static transforms that the buffer refused, and that may fit later: they are not sent again."""

import threading
from collections.abc import Callable
from contextlib import suppress

from tfbus.buffer.buffer import Buffer
from tfbus.buffer.info import Change
from tfbus.errors import TransformException
from tfbus.geometry.columns import Columns


class RefusedStatics:
    """Calls `retry` when an edge that was in the way of refused static transforms is gone.

    Safe from any thread.
    """

    def __init__(self, buffer: Buffer, retry: Callable[[], None]) -> None:
        self._buffer = buffer
        self._retry = retry
        self._lock = threading.Lock()
        self._blocking: frozenset[str] = frozenset()
        self._end_watch: Callable[[], None] | None = None

    def watch(self, batch: Columns) -> None:
        """Some of these transforms were refused: watch the frames that would make a loop with them,
        in the place of those of before.
        """
        blocking = frozenset(
            frame
            for parent, child in batch.pairs()
            for frame in self._between(batch.frames[parent], batch.frames[child])
        )
        self._set(blocking)

    def clear(self) -> None:
        """None is refused any longer."""
        if self._end_watch is not None:
            self._set(frozenset())

    def _between(self, parent: str, child: str) -> list[str]:
        """The frames from a refused parent up to the child; those of an edge that is in, too."""
        with suppress(TransformException):
            return self._buffer.path(child, parent)[:-1]
        return []

    def _set(self, blocking: frozenset[str]) -> None:
        with self._lock:
            self._blocking = blocking
            end, self._end_watch = self._end_watch, None
            if blocking:
                self._end_watch = self._buffer.on_change(self._on_change)
        if end is not None:
            end()

    def _on_change(self, change: Change) -> None:
        if change.kind in ("publisher gone", "removed", "reparented"):
            with self._lock:
                if change.frame not in self._blocking:
                    return
                # Until it is known again what is in the way: the retry makes changes itself.
                self._blocking = frozenset()
            self._retry()
