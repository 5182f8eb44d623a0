"""Messages that never came: gaps in the numbers of a key's messages."""

from tfbus.bag.raw_queue import Source
from tfbus.recording.items import EventItem, Item, TransformItem

# Keys come from the bus: of at most as many the next number is known.
_MOST_KEYS = 200_000

# Of the missing numbers at most as many are known, those that may still come late.
_MOST_LATE = 1_000


class MissedMessages:
    """Counts the numbers that are missing between messages of dynamic transforms.

    A publisher counts the messages of each key and epoch. A message left out on purpose, in a
    pause, is not missed.
    """

    def __init__(self) -> None:
        self.count = 0
        # By key: the epoch, and the number that comes next.
        self._next: dict[Source, tuple[int, int]] = {}
        # Key, epoch and number, the oldest first.
        self._missing: dict[tuple[Source, int, int], None] = {}

    def add(self, source: Source, item: Item) -> None:
        """Take the next message of a key."""
        if isinstance(item, EventItem):
            if item.kind == "resumed":
                self._next.clear()
        elif isinstance(item, TransformItem) and item.seq is not None and not item.static:
            self._add(source, item.stream.epoch_ns, item.seq)

    def _add(self, source: Source, epoch_ns: int, seq: int) -> None:
        if (source, epoch_ns, seq) in self._missing:
            # It is only late.
            del self._missing[source, epoch_ns, seq]
            self.count -= 1
            return
        epoch, expected = self._next.get(source, (None, 0))
        if epoch is None and len(self._next) >= _MOST_KEYS:
            self._next.clear()
        if epoch != epoch_ns:
            expected = seq
        if seq > expected:
            self.count += seq - expected
            for number in range(max(expected, seq - _MOST_LATE), seq):
                self._missing[source, epoch_ns, number] = None
            while len(self._missing) > _MOST_LATE:
                del self._missing[next(iter(self._missing))]
        self._next[source] = (epoch_ns, max(expected, seq + 1))
