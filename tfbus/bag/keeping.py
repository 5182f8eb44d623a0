"""Ways to keep messages: all into files that are split, or the last seconds into snapshots."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from tfbus.bag.parts_written import PartsWritten, Refuse
from tfbus.bag.raw_queue import MessageSource, Raw
from tfbus.errors import TfbusError
from tfbus.recording.items import EventItem, Item, TransformItem
from tfbus.recording.state import BusState
from tfbus.runtime.bounded import Bounded

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
        self._next: Bounded[MessageSource, tuple[int, int]] = Bounded(_MOST_KEYS)
        # Key, epoch and number, the oldest first.
        self._missing: Bounded[tuple[MessageSource, int, int], None] = Bounded(_MOST_LATE)

    def add(self, source: MessageSource, item: Item) -> None:
        """Take the next message of a key."""
        if isinstance(item, EventItem):
            if item.kind == "resumed":
                self._next.clear()
        elif isinstance(item, TransformItem) and item.seq is not None and not item.static:
            self._add(source, item.stream.epoch_ns, item.seq)

    def _add(self, source: MessageSource, epoch_ns: int, seq: int) -> None:
        if (source, epoch_ns, seq) in self._missing:
            # It is only late.
            del self._missing[source, epoch_ns, seq]
            self.count -= 1
            return
        epoch, expected = self._next.get(source, (None, 0))
        if epoch != epoch_ns:
            expected = seq
        if seq > expected:
            self.count += seq - expected
            for number in range(max(expected, seq - _MOST_LATE), seq):
                self._missing[source, epoch_ns, number] = None
        self._next[source] = (epoch_ns, max(expected, seq + 1))


# Reads a message; None where it cannot be read.
Read = Callable[[Raw], Item | None]
# The part of an item that is recorded; None where that is nothing.
Select = Callable[[Item], Item | None]
# Writes an item, and counts it; False where the file refuses it.
Write = Callable[[Item], bool]


@dataclass(frozen=True)
class Splits:
    """A file ends once it has this many bytes, or seconds; None: it does not."""

    most_bytes: int | None = None
    most_s: float | None = None


UNSPLIT = Splits()


class Keeping(Protocol):
    """Takes messages in the order in which they came."""

    def take(self, raw: Raw) -> EventItem | None:
        """Take a message; the event that it is."""

    def split(self, log_ns: int) -> Path:
        """Go on in a new file, or write a snapshot; its path. Raises TfbusError."""


class InFiles:
    """Writes all messages, into one file after the other."""

    def __init__(
        self,
        parts: PartsWritten,
        splits: Splits,
        read: Read,
        select: Select,
        write: Write,
        refuse: Refuse,
    ) -> None:
        self._parts = parts
        self._splits = splits
        self._read = read
        self._select = select
        self._write = write
        self._refuse = refuse
        self._state = BusState()
        self._began_ns: int | None = None
        self._began_bytes = 0
        self.missed = MissedMessages()

    def take(self, raw: Raw) -> EventItem | None:
        """Take a message; the event that it is."""
        whole = self._read(raw)
        if whole is None:
            return None
        # By their numbers, which those that are not selected have too.
        self.missed.add(raw.source, whole)
        item = self._select(whole)
        if item is None:
            return None
        if self._is_full(raw.log_ns):
            self.split(raw.log_ns)
        # What a file has refused the next one would refuse too.
        if self._write(item) and raw.source.is_essential:
            self._state.take(item)
        return item if isinstance(item, EventItem) else None

    def split(self, log_ns: int) -> Path:
        """Go on in a new file, which begins with what is in force."""
        self._began_ns = log_ns
        path = self._parts.open(self._state.items(log_ns), self._refuse)
        self._began_bytes = self._parts.part_bytes
        return path

    def _is_full(self, log_ns: int) -> bool:
        if self._began_ns is None:
            self._began_ns = log_ns
        most_bytes, most_s = self._splits.most_bytes, self._splits.most_s
        # What is in force alone may be larger than a file should be.
        if most_bytes and self._parts.part_bytes >= max(most_bytes, 2 * self._began_bytes):
            return True
        return most_s is not None and log_ns - self._began_ns >= most_s * 1e9


class LastSeconds:
    """Keeps the last seconds of messages as they came, and writes them into a file when asked.

    The state before it is in force in it: statics, streams, nodes. Of more than `most_bytes` the
    oldest messages go.
    """

    def __init__(
        self,
        parts: PartsWritten,
        last_s: float,
        most_bytes: int,
        read: Read,
        select: Select,
        write: Write,
        refuse: Refuse,
    ) -> None:
        self._parts = parts
        self._last_ns = int(last_s * 1e9)
        self._most_bytes = most_bytes
        self._read = read
        self._select = select
        self._write = write
        self._refuse = refuse
        self._state = BusState()
        self._kept: deque[Raw] = deque()
        self.bytes = 0
        # For how many seconds there was room, where that was less than asked for.
        self.short_s: float | None = None

    @property
    def kept_s(self) -> float:
        """How many seconds are kept now."""
        return (self._kept[-1].log_ns - self._kept[0].log_ns) / 1e9 if self._kept else 0.0

    def take(self, raw: Raw) -> EventItem | None:
        """Take a message; the event that it is."""
        self._kept.append(raw)
        self.bytes += raw.size
        while self._kept[0].log_ns < raw.log_ns - self._last_ns:
            self._forget_oldest()
        while self.bytes > self._most_bytes and len(self._kept) > 1:
            self._forget_oldest()
            self.short_s = self.kept_s
        return raw.payload if isinstance(raw.payload, EventItem) else None

    def split(self, log_ns: int) -> Path:
        """Write what is kept into a file, and begin again. Raises TfbusError if that is
        nothing.
        """
        if not self._kept:
            raise TfbusError("nothing has come since the last snapshot")
        path = self._parts.open(self._state.items(self._kept[0].log_ns), self._refuse)
        for raw in self._kept:
            item = self._item(raw)
            if item is not None and self._write(item):
                self._note(raw, item)
        self._kept.clear()
        self.bytes = 0
        self._parts.close()
        return path

    def _forget_oldest(self) -> None:
        raw = self._kept.popleft()
        self.bytes -= raw.size
        if raw.source.is_essential:
            item = self._item(raw)
            if item is not None:
                self._note(raw, item)

    def _item(self, raw: Raw) -> Item | None:
        whole = self._read(raw)
        return None if whole is None else self._select(whole)

    def _note(self, raw: Raw, item: Item) -> None:
        if raw.source.is_essential:
            self._state.take(item)
