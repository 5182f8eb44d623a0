"""The files of a recording that is written, on one disk: split, or of the last seconds only."""

import itertools
import logging
import os
import re
import shutil
from bisect import bisect_left, bisect_right, insort
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Protocol

from tfbus.bag.raw_queue import MessageSource, Raw
from tfbus.base.bounded import Bounded
from tfbus.base.errors import DecodeError, InvalidArgumentException, TfbusError
from tfbus.base.log import LogOnce
from tfbus.base.wording import printable
from tfbus.recording.items import EventItem, Item, Selection, TopicItem, TransformItem
from tfbus.recording.state import BusState
from tfbus.recording.writer import RecordingWriter

ENDING = ".mcap"

# Of recordings in other formats; any other text after a point is a part of the name.
_OF_OTHERS = (".db3", ".bag", ".sqlite3")

# The room left free on a disk: the end of a file, its summary, needs some too.
_LEFT_FREE_BYTES = 16_000_000
_LEFT_FREE_PART = 1 / 10

# Writes the file of this path.
OpenWriter = Callable[[Path], RecordingWriter]

# Takes an item that a file cannot hold, and why.
Refuse = Callable[[Item, InvalidArgumentException], None]


@dataclass(frozen=True)
class WrittenPart:
    """A file that is whole: its length is from its first item to its last, by log times."""

    path: Path
    seconds: float
    size: int


class DiskFullError(OSError):
    """The disk is nearly full: nothing further is written, so that the files so far are whole."""


def default_name() -> str:
    """`tfbus_2026_11_22-10_25_48.mcap`, as rosbag2 names recordings, in local time."""
    return f"{datetime.now().astimezone():tfbus_%Y_%m_%d-%H_%M_%S}{ENDING}"


def path_of_recording(given: str | None) -> Path:
    """The first file of a recording: `run`, `run.mcap`, or a folder, in which it has the default
    name. Raises InvalidArgumentException for the ending of another format.
    """
    if not given:
        return Path(default_name())
    path = Path(given)
    if is_folder(given):
        return _free_in(path, default_name().removesuffix(ENDING))
    if path.suffix in _OF_OTHERS:
        raise InvalidArgumentException(
            f"'{printable(given)}': recordings are written as {ENDING} files: give a name "
            f"that ends with {ENDING}, or without an ending"
        )
    return path if path.suffix == ENDING else path.with_name(f"{path.name}{ENDING}")


def _free_in(folder: Path, stem: str) -> Path:
    """A recording of this name that is not there: of two in one second, as after a start without a
    clock, the later one has a number.
    """
    path = folder / f"{stem}{ENDING}"
    number = 2
    while existing_parts(path):
        path = folder / f"{stem}-{number}{ENDING}"
        number += 1
    return path


def is_folder(given: str) -> bool:
    """Whether a path that is given for a recording names a folder, there or not."""
    return given.endswith(os.sep) or Path(given).is_dir()


def part_paths(first: Path) -> Iterator[Path]:
    """`run.mcap`, `run_1.mcap`, `run_2.mcap` and so on."""
    yield first
    number = 1
    while True:
        yield first.with_name(f"{first.stem}_{number}{ENDING}")
        number += 1


def existing_parts(first: Path) -> list[Path]:
    """The files that are there and have a name that this recording may want."""
    part = re.compile(rf"{re.escape(first.stem)}(_\d+)?{re.escape(ENDING)}")
    folder = first.parent
    return sorted(each for each in folder.glob(f"*{ENDING}") if part.fullmatch(each.name))


# The number of kept files, besides the one that grows.
_KEPT_PARTS = 8
_KEPT_WHOLE = _KEPT_PARTS / (_KEPT_PARTS + 1)


@dataclass(frozen=True)
class Keep:
    """The last seconds, or bytes, that stay on the disk, over restarts too; a time without the
    recorder counts as an eighth of them at most.
    """

    last_s: float | None = None
    most_bytes: int | None = None

    def splits(self) -> "Splits":
        """When to go on in a new file."""
        return Splits(
            None if self.most_bytes is None else self.most_bytes // (_KEPT_PARTS + 1),
            None if self.last_s is None else self.last_s / _KEPT_PARTS,
        )


class PartsWritten:
    """Writes a recording, one file after the other; for one thread.

    `open_writer(path)` opens a file. `paths` are all files, `written` the ended ones. With
    `most_files` the oldest are deleted, and with `keep` the files beyond it, first files of `older`
    recordings, the oldest first. Raises OSError, and DiskFullError before a disk is full.
    """

    def __init__(
        self,
        first: Path,
        open_writer: OpenWriter,
        *,
        most_files: int | None = None,
        keep: Keep | None = None,
        older: Iterable[Path] = (),
    ) -> None:
        self._keep = keep
        self.older = list(older)
        self.paths: list[Path] = []
        self.written: list[WrittenPart] = []
        self.deleted = 0
        self._most_files = most_files
        # The log times of the first and the last item of the file that is open.
        self._span_ns: tuple[int, int] | None = None
        self._first = first
        self._open_writer = open_writer
        self._names = part_paths(first)
        self._writer: RecordingWriter | None = None
        self._bytes_before = self._flushed_bytes = 0
        self._synced = True

    @property
    def files(self) -> list[Path]:
        """All files, those of older recordings first; the last one grows."""
        return [*self.older, *self.paths]

    @property
    def is_open(self) -> bool:
        """Whether a file is open."""
        return self._writer is not None

    @property
    def part_bytes(self) -> int:
        """The size of the file that is open."""
        return 0 if self._writer is None else self._writer.size

    @property
    def written_bytes(self) -> int:
        """The size of all files when they were last flushed."""
        return self._bytes_before + self._flushed_bytes

    @property
    def free_bytes(self) -> int:
        """How much can still be written."""
        usage = shutil.disk_usage(self._first.parent)
        return max(0, usage.free - int(min(_LEFT_FREE_BYTES, usage.total * _LEFT_FREE_PART)))

    def open(self, items: Iterable[Item] = (), refuse: Refuse = lambda item, error: None) -> Path:
        """Open the next file, that begins with these items; its path. Items that it cannot hold go
        to `refuse`.
        """
        self.close()
        while True:
            path = next(self._names)
            # One of that name came meanwhile: it is not ours.
            with suppress(FileExistsError):
                self._writer = self._open_writer(path)
                break
        self.paths.append(path)
        _sync(path.parent)
        for item in items:
            try:
                self.write(item)
            except InvalidArgumentException as error:
                refuse(item, error)
        self._delete_oldest()
        # From now on it is a recording, if a short one.
        self._writer.flush()
        return path

    def write(self, item: Item) -> None:
        """Write an item. Raises InvalidArgumentException if it cannot be expressed."""
        assert self._writer is not None
        self._writer.write(item)
        self._synced = False
        log_ns = item.log_ns
        if self._span_ns is None:
            self._span_ns = log_ns, log_ns
        elif log_ns > self._span_ns[1]:
            self._span_ns = self._span_ns[0], log_ns

    def flush(self) -> None:
        """Have all that was written on the disk: it outlives a power cut."""
        if self._writer is not None and not self._synced:
            self._synced = True
            self._writer.flush()
            self._flushed_bytes = self._writer.size
            _sync(self.paths[-1])
            if not self.free_bytes:
                raise DiskFullError("the disk is full")

    def close(self) -> None:
        """End the file that is open; twice is fine."""
        writer, self._writer = self._writer, None
        if writer is not None:
            try:
                writer.close()
            finally:
                self._bytes_before += writer.size
                self._flushed_bytes = 0
                first_ns, last_ns = self._span_ns or (0, 0)
                self._span_ns = None
                self.written.append(
                    WrittenPart(self.paths[-1], (last_ns - first_ns) / 1e9, writer.size)
                )
            _sync(self.paths[-1])

    @property
    def last_data(self) -> bytes:
        """The bytes of the last message that was written."""
        return b"" if self._writer is None else self._writer.last_data

    def data_of(self, item: TransformItem | TopicItem) -> bytes:
        """The bytes of an item as it is written. Raises InvalidArgumentException if it cannot be
        expressed.
        """
        assert self._writer is not None
        return self._writer.data_of(item)

    def write_late(self, items: Iterable[Item]) -> list[InvalidArgumentException]:
        """Write items of a time before the last one; the errors of items that do not fit a file."""
        assert self._writer is not None
        self._synced = False
        return list(self._writer.write_late(items))

    def _delete_oldest(self) -> None:
        if self._keep is not None:
            while self._is_beyond(self._keep):
                self._delete_one()
        while self._most_files is not None and len(self.paths) > self._most_files:
            self._delete_one()

    def _is_beyond(self, keep: Keep) -> bool:
        """Whether the oldest file is not to be kept; the one that is open is."""
        sizes, ended_s = [], []
        for path in self.files:
            with suppress(FileNotFoundError):
                found = path.stat()
                sizes.append(found.st_size)
                ended_s.append(found.st_mtime)
        if len(self.older) + len(self.paths) < 2 or not sizes:
            return False
        if keep.last_s is not None:
            # No file is longer than this: the rest is time without a recorder.
            longest_s = keep.last_s / _KEPT_PARTS
            between = itertools.pairwise(ended_s)
            recorded_s = sum(min(max(end - begin, 0.0), longest_s) for begin, end in between)
            if recorded_s >= keep.last_s:
                return True
        return keep.most_bytes is not None and sum(sizes) > keep.most_bytes * _KEPT_WHOLE

    def _delete_one(self) -> None:
        if self.older:
            self.older.pop(0).unlink(missing_ok=True)
            return
        self.paths.pop(0).unlink(missing_ok=True)
        self._bytes_before -= self.written.pop(0).size
        self.deleted += 1


def _sync(path: Path) -> None:
    """Have the system's buffers of a file, or folder, written to the disk."""
    file = os.open(path, os.O_RDONLY)
    try:
        os.fsync(file)
    finally:
        os.close(file)


# Keys come from the bus: of at most as many the next number is known.
_MOST_KEYS = 200_000

# Of the missing numbers that may still come late at most as many are known.
_MOST_LATE = 1_000


# Messages that are missing for longer were lost in an outage; single ones are lost on some networks
# all the time.
_OUTAGE_NS = 1_000_000_000


class MissedMessages:
    """Counts the numbers that are missing between messages of dynamic transforms.

    A publisher counts the messages of each key and epoch. A message left out on purpose, in a
    pause, is not missed. `on_outage(stream, from_ns, until_ns)` is called with the log times of the
    messages before and after, a second or more apart, between which some are missing.
    """

    def __init__(self) -> None:
        self.count = 0
        self.on_outage: Callable[[str, int, int], object] = lambda stream, from_ns, until_ns: None
        # By key: the epoch, the number that comes next, and when the last message came.
        self._next: Bounded[MessageSource, tuple[int, int, int]] = Bounded(_MOST_KEYS)
        # Key, epoch and number, the oldest first.
        self._missing: Bounded[tuple[MessageSource, int, int], None] = Bounded(_MOST_LATE)

    def add(self, source: MessageSource, item: Item) -> None:
        """Take the next message of a key."""
        if isinstance(item, EventItem):
            if item.kind == "resumed":
                self._next.clear()
        elif isinstance(item, TransformItem) and item.seq is not None and not item.static:
            self._add(source, item, item.seq)

    def fill(self, source: MessageSource, item: Item) -> None:
        """A message of before has come after all, from another recorder."""
        if not isinstance(item, TransformItem) or item.seq is None or item.static:
            return
        epoch_ns, expected, _ = self._next.get(source, (None, 0, 0))
        if epoch_ns != item.stream.epoch_ns:
            return
        if item.seq < expected:
            self._missing.pop((source, epoch_ns, item.seq), None)
            self.count = max(self.count - 1, 0)
        else:
            # The stream itself is not back yet: only what is missing after this is an outage then.
            self._expect(source, item, item.seq, expected)

    def _add(self, source: MessageSource, item: TransformItem, seq: int) -> None:
        epoch_ns = item.stream.epoch_ns
        if (source, epoch_ns, seq) in self._missing:
            # It is only late.
            del self._missing[source, epoch_ns, seq]
            self.count -= 1
            return
        epoch, expected, last_ns = self._next.get(source, (None, 0, 0))
        if epoch != epoch_ns:
            expected = seq
        if seq > expected and item.log_ns - last_ns >= _OUTAGE_NS:
            self.on_outage(item.stream.name, last_ns, item.log_ns)
        self._expect(source, item, seq, expected)

    def _expect(self, source: MessageSource, item: TransformItem, seq: int, expected: int) -> None:
        """Note that the messages from the expected number on are missing, up to this one."""
        epoch_ns = item.stream.epoch_ns
        self.count += max(seq - expected, 0)
        for number in range(max(expected, seq - _MOST_LATE), seq):
            self._missing[source, epoch_ns, number] = None
        self._next[source] = (epoch_ns, max(expected, seq + 1), item.log_ns)


# Messages that have come are known for this time, and longer while a gap may be filled.
_KNOWN_NS = 60_000_000_000
# Longer times without messages, as where the recorder was stopped, make none older.
_LONGEST_WITHOUT_NS = 5_000_000_000
_MOST_KNOWN = 1_000_000

# Log times of a message that came twice differ by less: of two recorders, and by the link. Dynamic
# transforms have numbers, and no two are the same: one may come as late as it likes.
_SAME_WITHIN_NS = 5_000_000_000
# Messages without a stamp are equal to the ones before and after them.
_SAME_AGAIN_WITHIN_NS = 500_000_000


@dataclass(eq=False)
class Fill:
    """The messages of one gap, which come page by page: the state before the next one, and the
    messages among them that had come by themselves.
    """

    state: BusState
    met: set[tuple[tuple[str, int], int]] = field(default_factory=set)


class Received:
    """The messages that have come by themselves: of kept messages that come later from another
    recorder only the missing ones are written.

    While `is_held` none is forgotten for its age; of more than a million the oldest are.
    """

    def __init__(self) -> None:
        self.is_held = False
        self._log_ns: dict[tuple[str, int], list[int]] = {}
        self._order: deque[tuple[int, tuple[str, int]]] = deque()
        # The log time of the last message, and that of before which messages are forgotten.
        self._last_ns = self._known_from_ns = 0

    def add(self, item: TransformItem | TopicItem, data: bytes) -> None:
        """Note a message that has come, and its bytes in the file."""
        log_ns, key = item.log_ns, _key_of(item, data)
        insort(self._log_ns.setdefault(key, []), log_ns)
        order = self._order
        order.append((log_ns, key))
        if len(order) == 1:
            self._last_ns, self._known_from_ns = log_ns, log_ns - _KNOWN_NS
        later_ns = max(log_ns - self._last_ns, 0)
        self._last_ns += later_ns
        self._known_from_ns += min(later_ns, _LONGEST_WITHOUT_NS)
        while len(order) > _MOST_KNOWN or (not self.is_held and order[0][0] < self._known_from_ns):
            self._remove(*order.popleft())

    def has(self, item: TransformItem | TopicItem, data: bytes, fill: Fill) -> bool:
        """Whether a message has come at about its log time: each counts once in a fill."""
        key = _key_of(item, data)
        times = self._log_ns.get(key)
        if not times:
            return False
        if isinstance(item, TransformItem) and item.seq is not None:
            return True  # a stopped recorder takes it long after it has come
        within_ns = _SAME_WITHIN_NS if len(times) == 1 else _SAME_AGAIN_WITHIN_NS
        first = bisect_left(times, item.log_ns - within_ns)
        end = bisect_right(times, item.log_ns + within_ns)
        left = [log_ns for log_ns in times[first:end] if (key, log_ns) not in fill.met]
        if not left:
            return False
        fill.met.add((key, min(left, key=lambda log_ns: abs(log_ns - item.log_ns))))
        return True

    def _remove(self, log_ns: int, key: tuple[str, int]) -> None:
        times = self._log_ns[key]
        del times[bisect_left(times, log_ns)]
        if not times:
            del self._log_ns[key]


def _key_of(item: TransformItem | TopicItem, data: bytes) -> tuple[str, int]:
    name = item.topic if isinstance(item, TopicItem) else f"tf {item.stream.name}"
    return name, hash(data)


UNREADABLE, REFUSED = "unreadable", "refused"


@dataclass
class RecordingCounts:
    """Counts of recorded and lost messages.

    `transforms` are the dynamic ones, `statics` the static ones by stream and child frame. `topics`
    and `streams` count messages by name, without static transforms, which repeat; `filled` messages
    came later, from a recorder that had kept them. `lost` counts messages by the cause of the loss:
    the kinds that the queue dropped, "unreadable", "refused" by the format of the file, "missing"
    ones of dynamic transforms, which never came, and "history", kept by publishers from before, for
    which there was no room.
    """

    messages: int = 0
    transforms: int = 0
    statics: set[tuple[str, str]] = field(default_factory=set)
    events: int = 0
    topics: Counter[str] = field(default_factory=Counter)
    streams: Counter[str] = field(default_factory=Counter)
    filled: int = 0
    lost: Counter[str] = field(default_factory=Counter)

    def add(self, item: Item) -> None:
        """Count an item that was written."""
        if isinstance(item, TransformItem):
            self.messages += 1
            name = item.stream.name
            if item.static:
                self.statics.update((name, child) for child in item.rows.children())
            else:
                self.transforms += item.rows.count
            self.streams[name] += 0 if item.static else 1
        elif isinstance(item, TopicItem):
            self.messages += 1
            self.topics[item.topic] += 1
        else:
            self.events += 1


class ItemWriter:
    """Reads messages, and writes the selected part of each into files; counts them, and the ones
    that cannot be read or written, of which it logs the first of each name.
    """

    def __init__(self, parts: PartsWritten, selection: Selection, log: logging.Logger) -> None:
        self.counts = RecordingCounts()
        self._parts = parts
        self._selection = None if selection.is_all else selection
        self._once = LogOnce(log)

    def read(self, raw: Raw) -> Item | None:
        """A message, read; None if it cannot be."""
        try:
            return raw.item()
        except DecodeError as error:
            self._lose(UNREADABLE, raw.source, error)
            return None

    def select(self, item: Item) -> Item | None:
        """The part of an item that is recorded; None if that is nothing."""
        return item if self._selection is None else self._selection.taken_of(item)

    def write(self, item: Item) -> bool:
        """Write and count an item; False if the file refuses it."""
        try:
            self._parts.write(item)
        except InvalidArgumentException as error:
            self.refuse(item, error)
            return False
        self.counts.add(item)
        return True

    def refuse(self, item: Item, error: InvalidArgumentException) -> None:
        """Count an item that a file cannot hold."""
        self._lose(REFUSED, item, error)

    def _lose(self, how: str, what: object, error: TfbusError) -> None:
        self.counts.lost[how] += 1
        named = what.stream if isinstance(what, TransformItem) else what
        name = getattr(named, "name", "") or getattr(named, "topic", "")
        self._once.warning((how, name), "Did not record a message of %r: %s", name, error)


@dataclass(frozen=True)
class Splits:
    """A file ends once it has this many bytes, or seconds; None: it does not."""

    most_bytes: int | None = None
    most_s: float | None = None


UNSPLIT = Splits()


class Keeping(Protocol):
    """Takes messages in the order in which they came."""

    def keep(self, raw: Raw) -> EventItem | None:
        """Keep a message; the event that it is."""

    def split(self, log_ns: int) -> Path:
        """Go on in a new file, or write a snapshot; its path. Raises TfbusError."""


class InFiles:
    """Writes all messages, into one file after the other."""

    def __init__(self, parts: PartsWritten, splits: Splits, items: ItemWriter) -> None:
        self._parts = parts
        self._splits = splits
        self._items = items
        self._state = BusState()
        self._began_ns: int | None = None
        self._began_bytes = 0
        self.missed = MissedMessages()
        # None as long as no recorder elsewhere fills gaps.
        self.received: Received | None = None

    def keep(self, raw: Raw) -> EventItem | None:
        """Keep a message; the event that it is."""
        whole = self._items.read(raw)
        if whole is None:
            return None
        # By their numbers, which messages that are not selected have too.
        self.missed.add(raw.source, whole)
        item = self._items.select(whole)
        if item is None:
            return None
        if self._is_full(raw.log_ns):
            self.split(raw.log_ns)
        # An item that a file has refused the next one would refuse too.
        if self._items.write(item):
            if raw.source.is_essential:
                self._state.apply(item)
            if self.received is not None and not isinstance(item, EventItem):
                self.received.add(item, self._parts.last_data)
        return item if isinstance(item, EventItem) else None

    def begin_fill(self) -> Fill:
        """A fill that begins with the state in force."""
        state = BusState()
        for item in self._state.items(0):
            state.apply(item)
        return Fill(state)

    def fill(self, raws: Iterable[Raw], fill: Fill, again_ns: int) -> list[Item]:
        """Write messages of before that did not come then; returns the written items. From the log
        time `again_ns` on they may come again, of the next gap.
        """
        items: list[Item] = []
        for raw in raws:
            whole = self._items.read(raw)
            item = None if whole is None else self._items.select(whole)
            if whole is None or item is None or fill.state.says(item):
                continue
            if self._has_come(item, fill, again_ns):
                continue
            fill.state.apply(item)
            self.missed.fill(raw.source, whole)
            items.append(item)
        for error in self._parts.write_late(items):
            self._items.refuse(items[0], error)
        return items

    def _has_come(self, item: Item, fill: Fill, again_ns: int) -> bool:
        if self.received is None or isinstance(item, EventItem):
            return False
        try:
            data = self._parts.data_of(item)
        except InvalidArgumentException:
            return False  # which is refused where it is written
        if self.received.has(item, data, fill):
            return True
        if item.log_ns >= again_ns:
            self.received.add(item, data)
            fill.met.add((_key_of(item, data), item.log_ns))
        return False

    def split(self, log_ns: int) -> Path:
        """Go on in a new file, which begins with the state in force."""
        self._began_ns = log_ns
        path = self._parts.open(self._state.items(log_ns), self._items.refuse)
        self._began_bytes = self._parts.part_bytes
        return path

    def _is_full(self, log_ns: int) -> bool:
        if self._began_ns is None:
            self._began_ns = log_ns
        most_bytes, most_s = self._splits.most_bytes, self._splits.most_s
        # The state in force alone may be larger than a file should be.
        if most_bytes and self._parts.part_bytes >= max(most_bytes, 2 * self._began_bytes):
            return True
        return most_s is not None and log_ns - self._began_ns >= most_s * 1e9


class LastSeconds:
    """Keeps the last seconds of messages as they came, and writes them into a file when asked.

    The state before it is in force in it: statics, streams, nodes. Of more than `most_bytes` the
    oldest messages go.
    """

    def __init__(
        self, parts: PartsWritten, last_s: float, most_bytes: int, items: ItemWriter
    ) -> None:
        self._parts = parts
        self._last_ns = int(last_s * 1e9)
        self._most_bytes = most_bytes
        self._items = items
        self._state = BusState()
        self._kept: deque[Raw] = deque()
        self.bytes = 0
        # For how many seconds there was room, where that was less than asked for.
        self.short_s: float | None = None

    @property
    def kept_s(self) -> float:
        """How many seconds are kept now."""
        return (self._kept[-1].log_ns - self._kept[0].log_ns) / 1e9 if self._kept else 0.0

    def keep(self, raw: Raw) -> EventItem | None:
        """Keep a message; the event that it is."""
        self._kept.append(raw)
        self.bytes += raw.size
        while self._kept[0].log_ns < raw.log_ns - self._last_ns:
            self._forget_oldest()
        while self.bytes > self._most_bytes and len(self._kept) > 1:
            self._forget_oldest()
            self.short_s = self.kept_s
        return raw.payload if isinstance(raw.payload, EventItem) else None

    def split(self, log_ns: int) -> Path:
        """Write the kept messages into a file, and begin again. Raises TfbusError without any."""
        if not self._kept:
            raise TfbusError("nothing has come since the last snapshot")
        path = self._parts.open(self._state.items(self._kept[0].log_ns), self._items.refuse)
        for raw in self._kept:
            item = self._item(raw)
            if item is not None and self._items.write(item):
                self._apply_essential(raw, item)
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
                self._apply_essential(raw, item)

    def _item(self, raw: Raw) -> Item | None:
        whole = self._items.read(raw)
        return None if whole is None else self._items.select(whole)

    def _apply_essential(self, raw: Raw, item: Item) -> None:
        if raw.source.is_essential:
            self._state.apply(item)
