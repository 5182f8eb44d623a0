"""The samples of a recording by stamp: which chunks hold those around a time, as a buffer."""

import math
from bisect import bisect_left, bisect_right
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tfbus.buffer.buffer import Buffer
from tfbus.core.sampling import TF2, Sampling
from tfbus.geometry.columns import Columns
from tfbus.recording.index import Edge
from tfbus.recording.items import TransformItem
from tfbus.recording.lasting_statics import LastingStatics, Statics
from tfbus.recording.part import Group, Part
from tfbus.recording.reader import RecordingReader

FIRST_NS, LAST_NS = -(2**63), 2**63 - 1

# A stream in one epoch.
StreamKey = tuple[str, int]

# Beyond this number of changes of static transforms, when one took place is read of the index
# alone: to the second or so.
_MOST_EXACT_CHANGES = 256


@dataclass(frozen=True)
class Span:
    """A buffer, and the stamps from `first_ns` to `last_ns` for which it has all samples of the
    streams and epochs with the numbers `keys`.
    """

    buffer: Buffer
    first_ns: int
    last_ns: int
    keys: frozenset[int]


@dataclass(frozen=True)
class FrameFacts:
    """What the index says of an edge of one stream in one epoch; stamps in nanoseconds."""

    key: StreamKey
    edge: Edge
    is_static: bool
    samples: int
    first_ns: int
    last_ns: int


class Samples:
    """Finds samples by their stamps.

    Of each stream those of one epoch count at a time: of the last one whose samples begin before
    and end after it, else of the last one that begins before.
    """

    def __init__(self, reader: RecordingReader, statics: Statics = "always") -> None:
        self._reader = reader
        self._lasting = LastingStatics(reader) if statics == "always" else None
        self._pauses = reader.pauses
        self._chunks = list(reader.chunks)
        self._edges: dict[Edge, int] = {}
        self._keys: dict[StreamKey, int] = {}
        table = self._table()
        is_static = table[:, 1] == 1
        self._static, self._dynamic = table[is_static], table[~is_static]
        self._children: dict[str, int] = {}
        for _, child in self._edges:
            self._children.setdefault(child, len(self._children))
        self._sort()
        self._epochs = self._epoch_ranges()
        self._versions = self._static_versions()
        self._breaks = sorted(self._break_stamps())

    # What there is

    @property
    def first_ns(self) -> int | None:
        """The earliest stamp of a dynamic transform; None where there is none."""
        return int(self._first.min()) if len(self._first) else None

    @property
    def last_ns(self) -> int | None:
        """The latest stamp of a dynamic transform; None where there is none."""
        return int(self._last.max()) if len(self._last) else None

    def range_of(self, child: str, keys: Collection[int]) -> tuple[int, int] | None:
        """The first and last stamp of a child frame in streams and epochs of these numbers."""
        number = self._children.get(child)
        found = [(a, b) for of, key, a, b in self._segments if of == number and key in keys]
        if not found:
            return None
        first = min(int(self._first[a:b].min()) for a, b in found)
        return first, max(int(self._last[a:b].max()) for a, b in found)

    def facts(self) -> list[FrameFacts]:
        """What there is of each edge of each stream in each epoch."""
        keys, edges = list(self._keys), list(self._edges)
        found = []
        for table, is_static in ((self._static, True), (self._dynamic, False)):
            order = np.lexsort((table[:, 3], table[:, 2]))
            rows = table[order]
            if not len(rows):
                continue
            is_new = np.ones(len(rows), bool)
            is_new[1:] = (rows[1:, 2:4] != rows[:-1, 2:4]).any(axis=1)
            starts = np.flatnonzero(is_new)
            for row, first, last, count in zip(
                rows[starts].tolist(),
                np.minimum.reduceat(rows[:, 4], starts).tolist(),
                np.maximum.reduceat(rows[:, 5], starts).tolist(),
                np.add.reduceat(rows[:, 6], starts).tolist(),
                strict=True,
            ):
                found.append(FrameFacts(keys[row[2]], edges[row[3]], is_static, count, first, last))
        return found

    def knows(self, *frames: str) -> bool:
        """Whether all of these frames are in the recording."""
        known = {name for edge in self._edges for name in edge}
        return known.issuperset(frames)

    def chain(self, *frames: str) -> set[str]:
        """The frames, and all that were ever above them."""
        parents: dict[str, set[str]] = {}
        for parent, child in self._edges:
            parents.setdefault(child, set()).add(parent)
        found: set[str] = set()
        waiting = list(frames)
        while waiting:
            frame = waiting.pop()
            if frame not in found:
                found.add(frame)
                waiting += parents.get(frame, ())
        return found

    # Buffers

    def end(self) -> Buffer:
        """The last samples of all frames, of the last epochs."""
        return self._span(LAST_NS, LAST_NS, self._last_keys(), None, TF2).buffer

    def span(
        self,
        first_ns: int,
        last_ns: int,
        *,
        children: Collection[str] | None = None,
        of_last_epochs: bool = False,
    ) -> Span:
        """A buffer for the stamps from `first_ns` on, at most to `last_ns`: the samples between
        them, and the last before and the first behind, of these child frames or of all.

        It ends before an epoch begins or ends, and before static transforms change.
        """
        last_ns = self.end_of(first_ns, last_ns)
        if of_last_epochs:
            keys = self._last_keys()
        else:
            keys = {_epoch_at(epochs, first_ns) for epochs in self._epochs.values()}
        return self._span(first_ns, last_ns, keys, children, TF2)

    def start_of(self, stamp_ns: int, least_ns: int) -> int:
        """The earliest stamp, `least_ns` or later, from which a span reaches to this one."""
        at = bisect_right(self._breaks, stamp_ns)
        return max(least_ns, self._breaks[at - 1]) if at else least_ns

    def end_of(self, stamp_ns: int, most_ns: int) -> int:
        """The latest stamp, `most_ns` or earlier, to which a span reaches from this one."""
        at = bisect_right(self._breaks, stamp_ns)
        return min(most_ns, self._breaks[at] - 1) if at < len(self._breaks) else most_ns

    def last_statics(self) -> list[TransformItem]:
        """The static sets in force at the end."""
        return self._statics_at(LAST_NS)

    def groups(
        self, first_ns: int, last_ns: int, children: Collection[str] | None = None
    ) -> list[Group]:
        """The messages of all epochs that may have samples from one stamp to another."""
        keys = set(self._keys.values())
        return self._read(self._wanted(first_ns, last_ns, keys, children), children)

    def _span(
        self,
        first_ns: int,
        last_ns: int,
        keys: set[int],
        children: Collection[str] | None,
        sampling: Sampling,
    ) -> Span:
        buffer = Buffer(math.inf, sampling=sampling)
        buffer.expect_no_more()
        for item in self._statics_at(first_ns):
            rows = item.rows if children is None else item.rows.only(children)
            buffer.set_transforms(rows, static=True, authority=item.stream.name)
        groups = self._read(self._wanted(first_ns, last_ns, keys, children), children)
        while self._drop_damaged():
            groups = self._read(self._wanted(first_ns, last_ns, keys, children), children)
        for section, reason in self._sections(groups):
            for group in section:
                buffer.set_transforms(group.rows, authority=group.channel.stream.name)
            if reason:
                buffer.interrupt(reason)
        return Span(buffer, first_ns, last_ns, frozenset(keys))

    def _sections(self, groups: list[Group]) -> Iterator[tuple[list[Group], str]]:
        """The groups up to each pause and behind the last, and why there is none in the pause."""
        for pause in self._pauses:
            before = [part for each in groups if (part := each.until(pause.from_ns))]
            if before:
                yield before, pause.said(self._reader.start_ns)
                groups = [part for each in groups if (part := each.behind(pause.from_ns))]
        yield groups, ""

    def _wanted(
        self, first_ns: int, last_ns: int, keys: set[int], children: Collection[str] | None
    ) -> list[int]:
        """The rows with samples between two stamps, and those with the last before and the first
        behind, of each child in each stream.
        """
        numbers = None
        if children is not None:
            numbers = {self._children[name] for name in children if name in self._children}
        found: list[int] = []
        for child, key, start, end in self._segments:
            if key in keys and (numbers is None or child in numbers):
                found += self._wanted_of(start, end, first_ns, last_ns)
        return found

    def _wanted_of(self, start: int, end: int, first_ns: int, last_ns: int) -> list[int]:
        """The same of the rows of one segment."""
        begins = start + int(np.searchsorted(self._peak[start:end], first_ns))
        behind = start + int(np.searchsorted(self._first[start:end], last_ns, "right"))
        # Those before end before; between, one that ends early may follow one that ends late.
        between = self._last[begins:behind] >= first_ns
        found = (begins + np.flatnonzero(between)).tolist()
        if begins > start:
            found.append(int(self._peak_at[begins - 1]))
            if self._count[found[-1]] == 1:  # two tell more than one: how often it comes
                found.append(max(start, found[-1] - 1))
        if not between.all():
            early = begins + np.flatnonzero(~between)
            found.append(int(early[np.argmax(self._last[early])]))
        found += range(behind, min(end, behind + 1))
        if behind < end and self._count[behind] == 1:
            found += range(behind + 1, min(end, behind + 2))
        return found

    def _read(self, rows: Collection[int], children: Collection[str] | None) -> list[Group]:
        """The messages of these rows' chunks and channels, in the order of the chunks."""
        keys_of: dict[int, set[int]] = {}
        for chunk, key in zip(
            self._chunk[list(rows)].tolist(), self._key[list(rows)].tolist(), strict=True
        ):
            keys_of.setdefault(chunk, set()).add(key)
        found = []
        for number, keys in sorted(keys_of.items()):
            chunk = self._chunks[number]
            found += chunk.groups(self._channels(chunk.part, keys), children)
        return found

    def _drop_damaged(self) -> bool:
        """Forget the rows of chunks that could not be read; whether there were some."""
        if not self._reader.is_damaged:
            return False
        numbers = [
            number
            for number, chunk in enumerate(self._chunks)
            if chunk.part.file.is_damaged(chunk.offset)
        ]
        is_damaged = np.isin(self._dynamic[:, 0], numbers)
        if not is_damaged.any():
            return False
        self._dynamic = self._dynamic[~is_damaged]
        self._sort()
        return True

    def _channels(self, part: Part, keys: set[int]) -> set[int]:
        """The channels of a file with dynamic transforms of these streams."""
        return {
            channel.id
            for channel in part.stream_channels.values()
            if not channel.is_static
            and self._keys[channel.stream.name, channel.stream.epoch_ns] in keys
        }

    def _last_keys(self) -> set[int]:
        return {epochs[-1][2] for epochs in self._epochs.values()}

    # Static transforms

    def _statics_at(self, stamp_ns: int) -> list[TransformItem]:
        """The static sets in force at a stamp; where they always hold, with those to come."""
        at = bisect_left([stamp for stamp, _ in self._versions], stamp_ns)
        log_ns = self._versions[at - 1][1] if at else -1
        found = self._reader.state_at(log_ns).statics.values() if at else ()
        return list(found) if self._lasting is None else self._lasting.with_later(found, log_ns)

    def _static_changes(self) -> list[tuple[int, str]]:
        """The log times at which a stream got another static set, and its name."""
        return sorted(
            (log_ns, part.stream_channels[channel].stream.name)
            for part in self._reader.parts
            for channel, log_ns in part.index.changes
            if channel in part.stream_channels
        )

    def _static_versions(self) -> list[tuple[int, int]]:
        """For each change of a static set: up to which stamp the former one holds, and the log time
        of the change; by stamp.
        """
        changes = {log_ns for log_ns, _ in self._static_changes()}
        exact = len(changes) <= _MOST_EXACT_CHANGES
        return sorted((self._stamp_at(log_ns, exact=exact), log_ns) for log_ns in changes)

    def _stamp_at(self, log_ns: int, *, exact: bool) -> int:
        """The newest stamp that had been received at a log time."""
        last = np.array([chunk.to_ns for chunk in self._chunks], np.int64)
        first = np.array([chunk.from_ns for chunk in self._chunks], np.int64)
        before = self._last[(last <= log_ns)[self._chunk]]
        newest = int(before.max()) if len(before) else FIRST_NS
        if exact:
            for number in np.flatnonzero((first <= log_ns) & (last > log_ns)).tolist():
                chunk = self._chunks[number]
                dynamic = self._channels(chunk.part, set(self._keys.values()))
                for group in chunk.groups(dynamic):
                    stamps = group.rows.stamps_ns().reshape(len(group.log_ns), -1)
                    taken = stamps[np.array(group.log_ns) <= log_ns]
                    newest = max(newest, int(taken.max())) if taken.size else newest
        return newest

    # Building

    def _sort(self) -> None:
        """Sort the rows of dynamic transforms by child, stream and first stamp: each child of each
        stream is a segment.
        """
        child_of = np.array([self._children[child] for _, child in self._edges], np.int64)
        rows = self._dynamic
        child = child_of[rows[:, 3]] if len(rows) else rows[:, 3]
        order = np.lexsort((rows[:, 4], rows[:, 2], child))
        child = child[order]
        self._chunk, self._key, self._first, self._last, self._count = (
            np.ascontiguousarray(rows[order, at]) for at in (0, 2, 4, 5, 6)
        )
        # Up to each row of a segment: the latest stamp, and the row that has it.
        self._peak = self._last.copy()
        self._peak_at = np.arange(len(order))
        is_new = np.r_[True, (child[1:] != child[:-1]) | (self._key[1:] != self._key[:-1])]
        starts = np.flatnonzero(is_new[: len(order)]).tolist()
        self._segments: list[tuple[int, int, int, int]] = []
        for start, end in pairwise([*starts, len(order)]):
            peak = np.maximum.accumulate(self._last[start:end])
            is_peak = self._last[start:end] == peak
            at = np.where(is_peak, np.arange(start, end), start)
            self._peak[start:end] = peak
            self._peak_at[start:end] = np.maximum.accumulate(at)
            self._segments.append((int(child[start]), int(self._key[start]), start, end))

    def _table(self) -> NDArray[np.int64]:
        """The rows of all files: chunk, whether static, stream, edge, first and last stamp, and
        the number of samples.
        """
        numbers = {(chunk.part.number, chunk.offset): at for at, chunk in enumerate(self._chunks)}
        tables = [np.empty((0, 7), np.int64)]
        for part in self._reader.parts:
            index = part.index
            table = np.empty((len(index.chunk), 7), np.int64)
            places = np.array([numbers[part.number, offset] for offset in index.offsets], np.int64)
            edges = np.array([self._number(edge) for edge in index.edges], np.int64)
            channels = np.zeros((2**16, 2), np.int64)
            for channel in part.stream_channels.values():
                key = (channel.stream.name, channel.stream.epoch_ns)
                number = self._keys.setdefault(key, len(self._keys))
                channels[channel.id] = channel.is_static, number
            if len(table):
                table[:, 0] = places[index.chunk]
                table[:, 1:3] = channels[index.channel]
                table[:, 3] = edges[index.edge]
                table[:, 4], table[:, 5] = index.first_ns, index.last_ns
                table[:, 6] = index.count
                tables.append(table)
        return np.concatenate(tables)

    def _number(self, edge: Edge) -> int:
        return self._edges.setdefault(edge, len(self._edges))

    def _epoch_ranges(self) -> dict[str, list[tuple[int, int, int, int]]]:
        """Of each stream with dynamic transforms its epochs as they came: the chunk in which one
        begins, its first stamp, its number, its last stamp.
        """
        count = len(self._keys)
        begins = np.full(count, LAST_NS)
        np.minimum.at(begins, self._key, self._chunk)
        first = np.full(count, LAST_NS)
        last = np.full(count, FIRST_NS)
        np.minimum.at(first, self._key, self._first)
        np.maximum.at(last, self._key, self._last)
        found: dict[str, list[tuple[int, int, int, int]]] = {}
        for (name, _), number in self._keys.items():
            if first[number] <= last[number]:
                epoch = (int(begins[number]), int(first[number]), number, int(last[number]))
                found.setdefault(name, []).append(epoch)
        return {name: sorted(epochs) for name, epochs in found.items()}

    def _break_stamps(self) -> set[int]:
        """Where a span must begin: where an epoch begins, behind one, behind a static set."""
        breaks = {stamp + 1 for stamp, _ in self._versions}
        for epochs in self._epochs.values():
            if len(epochs) > 1:
                breaks.update(first for _, first, _, _ in epochs)
                breaks.update(last + 1 for _, _, _, last in epochs)
        return breaks


def only(rows: Columns, children: Collection[str], parent: str | None = None) -> Columns:
    """The rows with these child frames and, where it is given, this parent; fast for many."""
    if not rows.count:
        return rows
    edges = np.frombuffer(rows.edges, np.uint32, 2 * rows.count, rows.edges_at).reshape(-1, 2)
    kept = np.array([frame in children for frame in rows.frames], bool)[edges[:, 1]]
    if parent is not None:
        kept &= np.array([frame == parent for frame in rows.frames], bool)[edges[:, 0]]
    if kept.all():
        return rows
    return Columns.of_bytes(
        rows.frames,
        edges[kept].tobytes(),
        rows.stamps_ns()[kept].tobytes(),
        poses_of(rows)[kept].tobytes(),
    )


def poses_of(rows: Columns) -> NDArray[np.float64]:
    """The poses of all rows (N, 7)."""
    return np.frombuffer(rows.poses, np.float64, 7 * rows.count, rows.poses_at).reshape(-1, 7)


def _epoch_at(epochs: list[tuple[int, int, int, int]], stamp_ns: int) -> int:
    """The number of the epoch that counts at a stamp."""
    begun = [each for each in epochs if each[1] <= stamp_ns]
    lasting = [each for each in begun if each[3] >= stamp_ns]
    return (lasting or begun or epochs[:1])[-1][2]
