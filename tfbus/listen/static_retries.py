"""Retries static transforms that the buffer refused, and that may fit later."""

from collections.abc import Callable, Collection
from contextlib import suppress

from tfbus.buffer.buffer import Buffer
from tfbus.buffer.info import Change
from tfbus.errors import TransformException
from tfbus.geometry.columns import Columns
from tfbus.runtime import scheduler

_InTheWay = dict[str, frozenset[str]]


class StaticRetries:
    """Calls `retry` when an edge that was in the way of refused static transforms is gone.

    Safe from any thread.
    """

    def __init__(self, buffer: Buffer, retry: Callable[[], None]) -> None:
        self._buffer = buffer
        self._retry = retry
        self._lock = scheduler.Lock()
        # The frames in the way of each refused child, and all of them together.
        self._in_the_way: dict[str, frozenset[str]] = {}
        self._blocking: frozenset[str] = frozenset()
        self._end_watch: Callable[[], None] | None = None
        self._is_closed = False

    def watch(self, batch: Columns) -> None:
        """Some of these transforms were refused: watch the frames that would make a loop with them.
        Other children are watched as before.
        """
        found = {
            batch.frames[child]: frozenset(self._between(batch.frames[parent], batch.frames[child]))
            for parent, child in batch.pairs()
        }
        self._change(lambda known: {**known, **found})

    def forget(self, children: Collection[str]) -> None:
        """The static transforms of these children are in."""
        self._change(lambda known: {child: known[child] for child in known.keys() - set(children)})

    def keep_only(self, children: Collection[str]) -> None:
        """There are no static transforms of other children any longer."""
        self._change(lambda known: {child: known[child] for child in known.keys() & set(children)})

    def clear(self) -> None:
        """There are no static transforms any longer."""
        self._change(lambda known: {})

    def close(self) -> None:
        """Watch nothing from now on."""
        with self._lock:
            self._is_closed = True
        self.clear()

    def _between(self, parent: str, child: str) -> list[str]:
        """The frames from a refused parent up to the child; those of an edge that is in, too."""
        with suppress(TransformException):
            return self._buffer.path(child, parent)[:-1]
        return []

    def _change(self, change: Callable[[_InTheWay], _InTheWay]) -> None:
        if self._end_watch is None and not change({}):
            return
        end = None
        with self._lock:
            known = {} if self._is_closed else change(self._in_the_way)
            self._in_the_way = {child: frames for child, frames in known.items() if frames}
            self._blocking = frozenset().union(*self._in_the_way.values())
            if not self._blocking:
                end, self._end_watch = self._end_watch, None
            elif self._end_watch is None:
                self._end_watch = self._buffer.on_change(self._on_change)
        if end is not None:
            end()

    def _on_change(self, change: Change) -> None:
        if change.kind in ("publisher gone", "removed", "reparented"):
            with self._lock:
                if change.frame not in self._blocking:
                    return
                # Until it is known again what is in the way: the retry makes changes itself.
                self._in_the_way, self._blocking = {}, frozenset()
            self._retry()
