"""The samples of a recording by stamp: the chunks around a time, read into a buffer."""

import math
from bisect import bisect_left, bisect_right
from collections import defaultdict
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tfbus.buffer.buffer import Buffer
from tfbus.frames.runs import FIRST_NS, LAST_NS, Run, runs_of
from tfbus.geometry.columns import Columns
from tfbus.recording.items import Pause, TransformItem, Viewpoint
from tfbus.recording.part import Group, Part
from tfbus.recording.reader import RecordingReader
from tfbus.recording.state import LastingStatics, Statics
from tfbus.recording.summary import EdgeFacts, EdgeTable, StreamKey

Ints = NDArray[np.int64]

# In the place of the number of a run.
_NO_RUN, _SEVERAL = -1, -2

# Beyond this number of changes of static transforms, when one took place is read of the index
# alone: to the second or so.
_MOST_EXACT_CHANGES = 256


@dataclass(frozen=True)
class SampledSpan:
    """A buffer, and the stamps from `first_ns` to `last_ns` for which it has all samples of the
    `runs`, which are numbers.
    """

    buffer: Buffer
    first_ns: int
    last_ns: int
    runs: frozenset[int]


@dataclass(frozen=True)
class _Stretch:
    """The first and last stamp of a run."""

    first_ns: int
    last_ns: int
    run: int

    @property
    def is_any(self) -> bool:
        """Whether there is a stamp."""
        return self.first_ns <= self.last_ns


class RecordedSamples:
    """Finds samples by their stamps.

    Of each stream the messages of one run count at a time, of a frame that was removed only one
    part of the run: of the last whose samples begin before and end after the time, else of the last
    that begins before.
    """

    def __init__(
        self, reader: RecordingReader, statics: Statics = "always", view: Viewpoint | None = None
    ) -> None:
        self._reader = reader
        self._view = view or Viewpoint(None)
        self._lasting = LastingStatics(reader.first_statics()) if statics == "always" else None
        self._pauses = reader.pauses
        # Chunks by number: that cannot be read, and that have been read for the ends of a range.
        self._damaged: list[int] = []
        self._tried: set[int] = set()
        self._chunks = list(reader.chunks)
        # From when to when the messages of each chunk were received (N, 2).
        logs = [(chunk.from_ns, chunk.to_ns) for chunk in self._chunks]
        self._logs = np.array(logs, np.int64).reshape(-1, 2)
        self._table = EdgeTable(reader, self._view)
        self._children: dict[str, int] = {}
        for _, child in self._table.edges:
            self._children.setdefault(child, len(self._children))
        self._begin_runs()
        self._dynamic = self._rows_of_runs(self._table.dynamic)
        self._sort()
        self._find_stretches()
        self._versions = self._static_versions()
        self._breaks = sorted(self._break_stamps())

    # Stamps and frames

    @property
    def first_ns(self) -> int | None:
        """The earliest stamp of a dynamic transform; None if there is none."""
        return int(self._first.min()) if len(self._first) else None

    @property
    def last_ns(self) -> int | None:
        """The latest stamp of a dynamic transform; None if there is none."""
        return int(self._last.max()) if len(self._last) else None

    def range_of(self, child: str, runs: Collection[int]) -> tuple[int, int] | None:
        """The first and last stamp of a child frame in runs of these numbers."""
        number = self._children.get(child)
        while True:
            rows = [
                row
                for of, run, start, end in self._segments
                if of == number and run in runs
                for row in range(start, end)
            ]
            if not rows:
                return None
            first = rows[int(np.argmin(self._first[rows]))]
            last = rows[int(np.argmax(self._last[rows]))]
            # That a chunk is damaged is known once it has been read.
            self._read([row for row in (first, last) if self._chunk[row] not in self._tried], None)
            self._tried.update(self._chunk[[first, last]].tolist())
            if not self._drop_damaged():
                return int(self._first[first]), int(self._last[last])

    def facts(self) -> list[EdgeFacts]:
        """The samples of each edge of each stream in each epoch, counted."""
        return self._table.facts()

    def knows(self, *frames: str) -> bool:
        """Whether all of these frames are in the recording."""
        known = {name for edge in self._table.edges for name in edge}
        return known.issuperset(frames)

    def chain(self, *frames: str) -> frozenset[str]:
        """The frames, and all that were ever above them."""
        parents: dict[str, set[str]] = {}
        for parent, child in self._table.edges:
            parents.setdefault(child, set()).add(parent)
        found: set[str] = set()
        waiting = list(frames)
        while waiting:
            frame = waiting.pop()
            if frame not in found:
                found.add(frame)
                waiting += parents.get(frame, ())
        return frozenset(found)

    # Buffers

    def end(self) -> Buffer:
        """The last samples of all frames, of the last runs."""
        return self._span(LAST_NS, LAST_NS, self._runs_at(None), None).buffer

    def span(
        self,
        first_ns: int,
        last_ns: int,
        *,
        children: frozenset[str] | None = None,
        of_last_runs: bool = False,
    ) -> SampledSpan:
        """A buffer for the stamps from `first_ns` on, at most to `last_ns`: the samples between
        them, and the last before and the first behind, of these child frames or of all.

        It ends before a run begins or ends, and before static transforms change.
        """
        last_ns = self.end_of(first_ns, last_ns)
        runs = self._runs_at(None if of_last_runs else first_ns)
        return self._span(first_ns, last_ns, runs, children)

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
        self, first_ns: int, last_ns: int, children: frozenset[str] | None = None
    ) -> list[Group]:
        """The messages of all runs that may have samples from one stamp to another, in the order in
        which they came.
        """
        runs = set(range(len(self._runs)))
        return _in_order(self._read(self._wanted(first_ns, last_ns, runs, children), children))

    def _span(
        self, first_ns: int, last_ns: int, runs: set[int], children: frozenset[str] | None
    ) -> SampledSpan:
        buffer = Buffer(math.inf)
        buffer.expect_no_more()
        for item in self._statics_at(first_ns):
            rows = item.rows if children is None else item.rows.only(children)
            buffer.set_transforms(rows, static=True, authority=item.stream.name)
        groups = self._read(self._wanted(first_ns, last_ns, runs, children), children)
        while self._drop_damaged():
            groups = self._read(self._wanted(first_ns, last_ns, runs, children), children)
        for section, reason in self._sections(_in_order(groups)):
            for group in section:
                buffer.set_transforms(group.rows, authority=group.channel.stream.name)
            if reason:
                buffer.interrupt(reason)
        return SampledSpan(buffer, first_ns, last_ns, frozenset(runs))

    def _sections(self, groups: list[Group]) -> Iterator[tuple[list[Group], str]]:
        """The groups up to each pause and behind the last, and why there is none in the pause."""
        for pause in self._pauses:
            before = [part for each in groups if (part := each.until(pause.from_ns))]
            if before:
                yield before, pause.said(self._reader.start_ns)
                groups = [part for each in groups if (part := each.behind(pause.from_ns))]
        yield groups, ""

    def _wanted(
        self, first_ns: int, last_ns: int, runs: set[int], children: frozenset[str] | None
    ) -> list[int]:
        """The rows with samples between two stamps, with the last before and with the first behind,
        of each child in each stream.
        """
        numbers = None
        if children is not None:
            numbers = {self._children[name] for name in children if name in self._children}
        found: list[int] = []
        for child, run, start, end in self._segments:
            if run in runs and (numbers is None or child in numbers):
                wanted = self._wanted_of(start, end, first_ns, last_ns)
                found += wanted
                for pause in self._pauses:
                    found += self._newest_before(pause, start, end, wanted)
        return found

    def _newest_before(self, pause: Pause, start: int, end: int, wanted: list[int]) -> list[int]:
        """The rows of one segment with its newest samples from before a pause, if some of the
        wanted rows came before it and some after: samples that come late are older than these, and
        so not the first behind the pause.
        """
        chunks = self._chunk[start:end]
        began, ended = self._logs[chunks, 0], self._logs[chunks, 1]
        is_wanted = np.zeros(end - start, bool)
        is_wanted[np.array(wanted, np.int64) - start] = True
        has_begun, is_over = began <= pause.from_ns, ended <= pause.from_ns
        if not (is_wanted & has_begun).any() or not (is_wanted & ~is_over).any():
            return []
        last = self._last[start:end]
        rows = np.flatnonzero(has_begun & ~is_over).tolist()
        if is_over.any():
            rows.append(int(np.argmax(np.where(is_over, last, FIRST_NS))))
        return [start + row for row in rows]

    def _wanted_of(self, start: int, end: int, first_ns: int, last_ns: int) -> list[int]:
        """The same of the rows of one segment."""
        begins = start + int(np.searchsorted(self._peak[start:end], first_ns))
        behind = start + int(np.searchsorted(self._first[start:end], last_ns, "right"))
        # Earlier rows end before; between, one that ends early may follow one that ends late.
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

    def _read(self, rows: Collection[int], children: frozenset[str] | None) -> list[Group]:
        """The messages of these rows' chunks and runs."""
        runs_of: dict[int, set[int]] = {}
        for chunk, run in zip(
            self._chunk[list(rows)].tolist(), self._run[list(rows)].tolist(), strict=True
        ):
            runs_of.setdefault(chunk, set()).add(run)
        sent = None if children is None else self._table.sent_names(children)
        found: list[Group] = []
        for number, runs in sorted(runs_of.items()):
            chunk = self._chunks[number]
            keys = {self._table.keys[self._runs[run].key] for run in runs}
            for group in chunk.groups(self._channels(chunk.part, keys), sent):
                for run, part in self._counting(group):
                    if run in runs:
                        found.append(part)
        return found

    def _counting(self, group: Group) -> Iterator[tuple[int, Group]]:
        """The messages of a group by the runs in which they count, which have numbers."""
        stream = group.channel.stream
        names = self._view.names(stream.namespace).all_outside(group.rows.frames)
        group = replace(group, rows=group.rows.with_frames(names))
        for number in self._runs_of[stream.name, stream.epoch_ns]:
            parts = self._parts_of.get(number, {})
            rest = only(group.rows, _children(group) - parts.keys()) if parts else group.rows
            if part := self._part(group, number, rest):
                yield number, part
            for child, numbers in parts.items():
                rows = only(group.rows, {child})
                for each in numbers:
                    if part := self._part(group, each, rows):
                        yield each, part

    def _part(self, group: Group, number: int, rows: Columns) -> Group | None:
        """The messages of a run, with these of their rows; None if there are none."""
        if not rows.count:
            return None
        run = self._runs[number]
        group = replace(group, rows=rows)
        return group if run.is_whole else _between(group, run)

    def _drop_damaged(self) -> bool:
        """Forget the rows of chunks that could not be read; whether there are new ones."""
        if not self._reader.is_damaged:
            return False
        damaged = [
            number
            for number, chunk in enumerate(self._chunks)
            if chunk.part.file.is_damaged(chunk.offset)
        ]
        if damaged == self._damaged:
            return False
        self._damaged = damaged
        self._dynamic = self._dynamic[~np.isin(self._dynamic[:, 0], damaged)]
        self._sort()
        return True

    def _channels(self, part: Part, keys: Collection[int]) -> set[int]:
        """The channels of a file with dynamic transforms of these streams."""
        return {
            channel.id
            for channel in part.stream_channels.values()
            if not channel.is_static and self._table.key(channel) in keys
        }

    # Static transforms

    def _statics_at(self, stamp_ns: int) -> list[TransformItem]:
        """The static sets in force at a stamp; if they always hold, with later ones."""
        at = bisect_left([stamp for stamp, _ in self._versions], stamp_ns)
        log_ns = self._versions[at - 1][1] if at else -1
        found = self._reader.state_at(log_ns).statics if at else []
        if self._lasting is not None:
            found = self._lasting.with_later(found, log_ns)
        return [item for each in found if (item := self._seen(each)) is not None]

    def _seen(self, item: TransformItem) -> TransformItem | None:
        """A static set as it is called here; None if it is not seen."""
        stream = item.stream
        if self._view.called(stream.name, stream.namespace) is None:
            return None
        names = self._view.names(stream.namespace).all_outside(item.rows.frames)
        return replace(item, rows=item.rows.with_frames(names))

    def _static_versions(self) -> list[tuple[int, int]]:
        """For each change of a static set: up to which stamp the former one holds, and the log time
        of the change; by stamp.
        """
        changes = {
            log_ns
            for part in self._reader.parts
            for channel, log_ns in part.static_times
            if self._table.key(part.stream_channels[channel]) is not None
        }
        exact = len(changes) <= _MOST_EXACT_CHANGES
        return sorted((self._stamp_at(log_ns, exact=exact), log_ns) for log_ns in changes)

    def _stamp_at(self, log_ns: int, *, exact: bool) -> int:
        """The stamp of a log time: the newest that had been received. If nothing had come for a
        while, so much later, but before the next one.
        """
        first, last = self._logs.T
        before = np.flatnonzero((last <= log_ns)[self._chunk])
        latest = int(before[np.argmax(self._last[before])]) if len(before) else None
        newest = FIRST_NS if latest is None else int(self._last[latest])
        if not exact:
            return newest
        came_ns = None
        behind = self._first[(first > log_ns)[self._chunk]]
        next_ns = int(behind.min()) if len(behind) else LAST_NS
        for number in np.flatnonzero((first <= log_ns) & (last > log_ns)).tolist():
            for logs, stamps in self._received(number):
                taken = logs <= log_ns
                if taken.any() and stamps[taken].max() >= newest:
                    newest = int(stamps[taken].max())
                    came_ns = int(logs[taken & (stamps == newest)].max())
                if not taken.all():
                    next_ns = min(next_ns, int(stamps[~taken].min()))
        if came_ns is None and latest is not None:
            found = [
                int(logs[stamps == newest].max())
                for logs, stamps in self._received(int(self._chunk[latest]))
                if (stamps == newest).any()
            ]
            came_ns = max(found, default=None)
        if came_ns is None:
            return newest
        return max(newest, min(newest + log_ns - came_ns, next_ns - 1))

    def _received(self, number: int) -> Iterator[tuple[Ints, Ints]]:
        """The log times of the messages of a chunk, stream by stream, and the newest stamp of
        each.
        """
        chunk = self._chunks[number]
        for group in chunk.groups(self._channels(chunk.part, self._table.keys.values())):
            stamps = group.rows.stamps_ns().reshape(len(group.log_ns), -1)
            if stamps.size:
                yield np.array(group.log_ns, np.int64), stamps.max(axis=1)

    # Building

    def _begin_runs(self) -> None:
        """Number the runs in the order in which they began."""
        runs = runs_of(self._reader, self._view)
        self._runs = [run for run in runs if run.key in self._table.keys]
        # By stream and epoch its runs; by run the parts of frames that were removed in it.
        self._runs_of: dict[StreamKey, list[int]] = defaultdict(list)
        self._parts_of: dict[int, dict[str, list[int]]] = defaultdict(dict)
        for number, run in enumerate(self._runs):
            if run.child:
                whole = next(each for each in self._runs_of[run.key] if run.is_in(self._runs[each]))
                self._parts_of[whole].setdefault(run.child, []).append(number)
            else:
                self._runs_of[run.key].append(number)

    def _rows_of_runs(self, dynamic: Ints) -> Ints:
        """The rows with the number of their run in the place of their key's. If one run ends in a
        chunk the chunk is read.
        """
        found = [np.empty((0, 6), np.int64)]
        children = [child for _, child in self._table.edges]
        for key, number in self._table.keys.items():
            rows, runs = dynamic[dynamic[:, 1] == number], self._runs_of[key]
            if len(runs) == 1 and self._runs[runs[0]].is_whole and runs[0] not in self._parts_of:
                rows[:, 1] = runs[0]
                found.append(rows)
                continue
            for chunk in np.unique(rows[:, 0]).tolist():
                of_chunk = rows[rows[:, 0] == chunk]
                for row in of_chunk:
                    row[1] = self._run_of(chunk, key, children[row[2]])
                if (of_chunk[:, 1] == _SEVERAL).any():
                    of_chunk = self._read_rows(chunk, key)
                found.append(of_chunk[of_chunk[:, 1] >= 0])
        return np.concatenate(found)

    def _run_of(self, chunk: int, key: StreamKey, child: str) -> int:
        """The run of all messages of a frame in a chunk; _SEVERAL if they may be of several, or
        not all are of one, _NO_RUN if none counts.
        """
        of_child: list[int] = []
        for each in self._runs_of[key]:
            of_child += self._parts_of.get(each, {}).get(child, [each])
        from_ns, to_ns = self._chunks[chunk].from_ns, self._chunks[chunk].to_ns
        for number in of_child:
            run = self._runs[number]
            if run.from_ns <= from_ns and to_ns < run.to_ns:
                return number
            if run.from_ns <= to_ns and from_ns < run.to_ns:
                return _SEVERAL
        return _NO_RUN

    def _read_rows(self, number: int, key: StreamKey) -> Ints:
        """The rows of a chunk and a stream in one epoch, as its messages say them."""
        found = [np.empty((0, 6), np.int64)]
        chunk = self._chunks[number]
        for group in chunk.groups(self._channels(chunk.part, {self._table.keys[key]})):
            for run, part in self._counting(group):
                pairs = part.rows.pairs()[: part.rows.count // len(part.log_ns)]
                frames = part.rows.frames
                stamps = part.rows.stamps_ns().reshape(len(part.log_ns), -1)
                rows = np.empty((len(pairs), 6), np.int64)
                rows[:, 0], rows[:, 1], rows[:, 5] = number, run, len(part.log_ns)
                rows[:, 2] = [self._table.edges[frames[a], frames[b]] for a, b in pairs]
                rows[:, 3], rows[:, 4] = stamps.min(axis=0), stamps.max(axis=0)
                found.append(rows)
        return np.concatenate(found)

    def _sort(self) -> None:
        """Sort the rows of dynamic transforms by child, run and first stamp: each child of each run
        is a segment.
        """
        child_of = np.array([self._children[child] for _, child in self._table.edges], np.int64)
        rows = self._dynamic
        child = child_of[rows[:, 2]] if len(rows) else rows[:, 2]
        order = np.lexsort((rows[:, 3], rows[:, 1], child))
        child = child[order]
        self._chunk, self._run, self._first, self._last, self._count = (
            np.ascontiguousarray(rows[order, at]) for at in (0, 1, 3, 4, 5)
        )
        # Up to each row of a segment: the latest stamp, and the row that has it.
        self._peak = self._last.copy()
        self._peak_at = np.arange(len(order))
        is_new = np.r_[True, (child[1:] != child[:-1]) | (self._run[1:] != self._run[:-1])]
        starts = np.flatnonzero(is_new[: len(order)]).tolist()
        self._segments: list[tuple[int, int, int, int]] = []
        for start, end in pairwise([*starts, len(order)]):
            peak = np.maximum.accumulate(self._last[start:end])
            is_peak = self._last[start:end] == peak
            at = np.where(is_peak, np.arange(start, end), start)
            self._peak[start:end] = peak
            self._peak_at[start:end] = np.maximum.accumulate(at)
            self._segments.append((int(child[start]), int(self._run[start]), start, end))

    def _find_stretches(self) -> None:
        """Find the stamps of the runs of each stream, and of the parts of each frame of a run that
        was removed in it; in the order in which they began.
        """
        first = np.full(len(self._runs), LAST_NS)
        last = np.full(len(self._runs), FIRST_NS)
        np.minimum.at(first, self._run, self._first)
        np.maximum.at(last, self._run, self._last)
        self._part_stretches: dict[tuple[int, str], list[_Stretch]] = {}
        for run, parts in self._parts_of.items():
            for child, numbers in parts.items():
                found = [_Stretch(int(first[at]), int(last[at]), at) for at in numbers]
                self._part_stretches[run, child] = [each for each in found if each.is_any]
                first[run] = min(first[run], *first[numbers])
                last[run] = max(last[run], *last[numbers])
        self._stretches: dict[str, list[_Stretch]] = {}
        for number, each in enumerate(self._runs):
            stretch = _Stretch(int(first[number]), int(last[number]), number)
            if not each.child and stretch.is_any:
                self._stretches.setdefault(each.key[0], []).append(stretch)

    def _runs_at(self, stamp_ns: int | None) -> set[int]:
        """The run of each stream, and the part of each removed frame of it, that count at a stamp;
        None for the last ones.
        """
        runs = {_at(each, stamp_ns).run for each in self._stretches.values()}
        parts = [
            _at(of_part, stamp_ns).run
            for (run, _), of_part in self._part_stretches.items()
            if run in runs and of_part
        ]
        return runs.union(parts)

    def _break_stamps(self) -> set[int]:
        """The stamps at which a span must begin: of the begin of a run, behind its end, and behind
        a static set.
        """
        breaks = {stamp + 1 for stamp, _ in self._versions}
        for stretches in (*self._stretches.values(), *self._part_stretches.values()):
            if len(stretches) > 1:
                breaks.update(each.first_ns for each in stretches)
                breaks.update(each.last_ns + 1 for each in stretches)
        return breaks


def only(rows: Columns, children: Collection[str], parent: str | None = None) -> Columns:
    """The rows with these child frames and, if it is given, this parent; fast for many."""
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


def _at(stretches: list[_Stretch], stamp_ns: int | None) -> _Stretch:
    """The stretch that counts at a stamp; None for the last one."""
    if stamp_ns is None:
        return stretches[-1]
    begun = [each for each in stretches if each.first_ns <= stamp_ns]
    lasting = [each for each in begun if each.last_ns >= stamp_ns]
    return (lasting or begun or stretches[:1])[-1]


def _children(group: Group) -> frozenset[str]:
    """The child frames of a group: all of its messages have the first one's."""
    rows = group.rows
    edges = np.frombuffer(rows.edges, np.uint32, 2 * rows.count // len(group.log_ns), rows.edges_at)
    return frozenset([rows.frames[child] for child in edges[1::2].tolist()])


def _between(group: Group, run: Run) -> Group | None:
    """The messages of a group that were received in the time of a run; None if there are none."""
    behind = group.behind(run.from_ns - 1)
    return None if behind is None else behind.until(run.to_ns - 1)


def _in_order(groups: list[Group]) -> list[Group]:
    """The groups in the order in which they came: of equal stamps of a frame the last counts. If a
    frame has equal stamps in groups that came at the same time, their messages are by themselves.
    """
    groups = sorted(groups, key=lambda group: group.log_ns[0])
    of_child: dict[str, list[int]] = defaultdict(list)
    for at, group in enumerate(groups):
        for child in _children(group):
            of_child[child].append(at)
    mixed: set[int] = set()
    for numbers in of_child.values():
        until = numbers[0]
        for at in numbers[1:]:
            if groups[at].log_ns[0] <= groups[until].log_ns[-1] and _has_equal_stamps(
                groups[until], groups[at]
            ):
                mixed |= {until, at}
            if groups[at].log_ns[-1] > groups[until].log_ns[-1]:
                until = at
    if not mixed:
        return groups
    parts = [
        part
        for at, group in enumerate(groups)
        for part in (group.messages() if at in mixed else [group])
    ]
    return sorted(parts, key=lambda group: group.log_ns[0])


def _has_equal_stamps(group: Group, other: Group) -> bool:
    return len(np.intersect1d(group.rows.stamps_ns(), other.rows.stamps_ns())) > 0
