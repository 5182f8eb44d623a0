"""Messages that never came: gaps in the numbers of a key's messages."""

from tfbus.bag.raw_queue import Source
from tfbus.recording.items import EventItem, Item, TransformItem

# Keys come from the bus: of at most as many the next number is known.
_MOST_KEYS = 200_000


class MissedMessages:
    """Counts the numbers that are missing between messages of dynamic transforms.

    A publisher counts the messages of each key and epoch. What was left out on purpose, in a pause,
    is not missed.
    """

    def __init__(self) -> None:
        self.count = 0
        # By key: the epoch, and the number that comes next.
        self._next: dict[Source, tuple[int, int]] = {}

    def add(self, source: Source, item: Item) -> None:
        """Take the next message of a key."""
        if isinstance(item, EventItem):
            if item.kind == "resumed":
                self._next.clear()
        elif isinstance(item, TransformItem) and item.seq is not None and not item.static:
            epoch_ns, seq = item.stream.epoch_ns, item.seq
            expected = self._next.get(source)
            if expected is not None and expected[0] == epoch_ns and seq > expected[1]:
                self.count += seq - expected[1]
            elif expected is None and len(self._next) >= _MOST_KEYS:
                self._next.clear()
            self._next[source] = (epoch_ns, seq + 1)
