"""Reads the items of a recording ahead, on a thread of its own."""

from collections import deque
from collections.abc import Iterator
from types import TracebackType

from tfbus.recording.items import EventItem, Item, TransformItem
from tfbus.runtime import scheduler

# At most this many items are kept ready, and about this much memory. Then reading waits until half
# of it is played.
_MOST_ITEMS = 2000
_MOST_BYTES = 64 * 2**20

# With this many ready, reading gives way to playing for this long each time it has read so much. To
# do so after each item would cost more than to read it.
_ENOUGH_ITEMS = 100
_GIVES_WAY_S = 0.0002
_AT_ONCE = 16
_BYTES_AT_ONCE = 2**20

# What Python's objects of an item take, about, and the columns of one transform.
_ITEM_BYTES = 1000
_ROW_BYTES = 8 + 8 + 56


class ReadAhead:
    """Keeps the next items of `items` ready; use it in a `with`, which ends its thread.

    `changed` is notified when an item comes if there was none, and at the end. Hold it around
    each call.
    """

    def __init__(self, items: Iterator[Item], changed: scheduler.Condition) -> None:
        self._items = items
        self._changed = changed
        self._has_room = scheduler.Condition(scheduler.Lock())
        self._ready: deque[Item] = deque()
        self._bytes = 0
        self._is_read = self._is_closed = self._waits_for_room = False
        self._error: Exception | None = None
        self._thread = scheduler.Thread(target=self._read, name="read ahead", daemon=True)

    def __enter__(self) -> "ReadAhead":
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        with self._has_room:
            self._is_closed = True
            self._has_room.notify()
        self._thread.join()

    @property
    def is_at_end(self) -> bool:
        """Whether all items were taken. Raises what reading them raised."""
        if self._ready or not self._is_read:
            return False
        if self._error is not None:
            raise self._error
        return True

    def first(self) -> Item | None:
        """The next item, which stays; None if none is ready."""
        return self._ready[0] if self._ready else None

    def take(self) -> Item:
        """The next item; `first` must have returned one."""
        item = self._ready.popleft()
        with self._has_room:
            self._bytes -= _size(item)
            if self._waits_for_room and (self._is_half_empty or not self._ready):
                self._has_room.notify()
        return item

    def _read(self) -> None:
        batch: list[Item] = []
        size = 0
        try:
            for item in self._items:
                batch.append(item)
                size += _size(item)
                is_enough = len(self._ready) > _ENOUGH_ITEMS
                if is_enough and len(batch) < _AT_ONCE and size < _BYTES_AT_ONCE:
                    continue
                if not self._add(batch, size):
                    return
                batch, size = [], 0
                if is_enough:
                    scheduler.sleep(_GIVES_WAY_S)
        except Exception as error:  # raised again where the items are taken
            self._error = error
        self._add(batch, size)
        with self._changed:
            self._is_read = True
            self._changed.notify_all()

    def _add(self, batch: list[Item], size: int) -> bool:
        """Add items once there is room; False if no further ones are wanted."""
        with self._has_room:
            if len(self._ready) >= _MOST_ITEMS or self._bytes + size > _MOST_BYTES:
                self._waits_for_room = True
                while self._ready and not self._is_closed and not self._is_half_empty:
                    self._has_room.wait()
                self._waits_for_room = False
            self._bytes += size
            if self._is_closed:
                return False
        with self._changed:
            was_empty = not self._ready
            self._ready.extend(batch)
            if was_empty:
                self._changed.notify_all()
        return True

    @property
    def _is_half_empty(self) -> bool:
        return len(self._ready) <= _MOST_ITEMS // 2 and self._bytes <= _MOST_BYTES // 2


def _size(item: Item) -> int:
    """About how many bytes an item takes."""
    if isinstance(item, TransformItem):
        return _ITEM_BYTES + _ROW_BYTES * item.rows.count
    if isinstance(item, EventItem):
        return _ITEM_BYTES
    # Long ones are images, or arrays of numbers.
    return _ITEM_BYTES + sum(
        len(value) for value in item.values.values() if isinstance(value, bytes | str | list)
    )
