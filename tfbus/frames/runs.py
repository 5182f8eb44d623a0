"""The messages of a recording that counted together, by the rules of a listener.

The listener is one: `RecordedFrames` goes through the index and the events, and each time
that it drops the samples of a stream, or of a frame, other messages begin to count.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise, repeat
from operator import attrgetter, itemgetter

from tfbus.buffer.buffer import Buffer
from tfbus.frames.recorded import RecordedFrames
from tfbus.geometry.columns import Columns
from tfbus.recording.items import EventItem, TransformItem, Viewpoint
from tfbus.recording.part import StreamChannel
from tfbus.recording.reader import RecordingReader
from tfbus.recording.summary import StreamKey

FIRST_NS, LAST_NS = -(2**63), 2**63 - 1

_NONE = Columns.of_bytes((), b"", b"", b"")


@dataclass(frozen=True)
class Run:
    """The messages of a stream in one epoch that were received from one log time on, and before
    another: they count together, and void earlier ones. With a `child` they are messages of that
    frame alone, which was removed before or behind them.
    """

    key: StreamKey
    from_ns: int = FIRST_NS
    to_ns: int = LAST_NS
    child: str = ""

    @property
    def is_whole(self) -> bool:
        """Whether no log time is outside."""
        return self.from_ns == FIRST_NS and self.to_ns == LAST_NS

    def is_in(self, other: Run) -> bool:
        """Whether the other one has all log times of it."""
        return other.from_ns <= self.from_ns and self.to_ns <= other.to_ns


class _Dropping(Buffer):
    """A buffer without samples, which notes whose samples are dropped: a stream, and the frames,
    None for all.
    """

    def __init__(self) -> None:
        super().__init__()
        self.dropped: list[tuple[str, frozenset[str] | None]] = []

    def forget(self, authority: str, frames: Iterable[str] | None = None) -> None:
        """Note it of all frames, or these."""
        self.dropped.append((authority, None if frames is None else frozenset(frames)))

    def remove_sent(self, frames: Iterable[str], authority: str) -> None:
        """Note it of these frames."""
        self.dropped.append((authority, frozenset(frames)))


def runs_of(reader: RecordingReader, view: Viewpoint) -> list[Run]:
    """The runs of streams with several epochs, in the order in which they began, and the parts of
    frames that were removed. Of any other stream all messages count together.
    """
    dropping = _Dropping()
    frames = RecordedFrames(reader, view=view, buffer=dropping, sim_time=False)
    epochs: dict[str, set[int]] = defaultdict(set)
    for each in reader.streams:
        epochs[each.stream.name].add(each.stream.epoch_ns)
    present = {name: Run((name, min(each))) for name, each in epochs.items() if len(each) == 1}
    several = epochs.keys() - present.keys()
    runs: list[Run] = []
    removed: dict[str, list[tuple[int, str]]] = defaultdict(list)
    for item in _told(reader, frames, several):
        name = item.name if isinstance(item, EventItem) else item.stream.name
        for _, children in dropping.dropped:
            removed[name] += [(item.log_ns, child) for child in children or ()]
        dropping.dropped.clear()
        epoch_ns, run = frames.epoch_ns(name), present.get(name)
        if name in several and epoch_ns is not None and (run is None or run.key[1] != epoch_ns):
            if run is not None:
                runs.append(replace(run, to_ns=item.log_ns))
            present[name] = Run((name, epoch_ns), FIRST_NS if run is None else item.log_ns)
    runs += present.values()
    parts = [part for run in runs for part in _parts(run, removed.get(run.key[0], []))]
    return sorted([*runs, *parts], key=attrgetter("from_ns"))


def _parts(run: Run, removed: list[tuple[int, str]]) -> Iterator[Run]:
    """The parts of frames that were removed within a run."""
    inside = [each for each in removed if run.from_ns < each[0] < run.to_ns]
    for child in {child for _, child in inside}:
        ends = sorted({run.from_ns, run.to_ns, *(log for log, each in inside if each == child)})
        for from_ns, to_ns in pairwise(ends):
            yield Run(run.key, from_ns, to_ns, child)


def _told(
    reader: RecordingReader, frames: RecordedFrames, several: Collection[str]
) -> Iterator[EventItem | TransformItem]:
    """The events of streams, and of streams with several epochs the messages that may begin one,
    each when `frames` has taken it.
    """
    events = [each for each in reader.events if each.kind in ("stream", "stream gone")]
    # By stream the channel of its last message that counted: the next of it changes nothing.
    counted: dict[str, StreamChannel] = {}
    at = 0
    for log_ns, channel in [*_messages(reader, several), (LAST_NS, None)]:
        while at < len(events) and events[at].log_ns <= log_ns:
            counted.pop(events[at].name, None)
            frames.apply(events[at])
            yield events[at]
            at += 1
        if channel is None or counted.get(channel.stream.name) is channel:
            continue
        stream = channel.stream
        item = TransformItem(log_ns, stream, _NONE, channel.is_static)
        frames.apply(item)
        if frames.epoch_ns(stream.name) == stream.epoch_ns and not channel.is_static:
            counted[stream.name] = channel
        else:
            counted.pop(stream.name, None)
        yield item


def _messages(reader: RecordingReader, streams: Collection[str]) -> list[tuple[int, StreamChannel]]:
    """The log times and channels of the messages of streams, and of the changes of their static
    sets, in the order of the log times.
    """
    found: list[tuple[int, StreamChannel]] = []
    for part in reader.parts:
        channels = part.stream_channels
        wanted = {each.id for each in channels.values() if each.stream.name in streams}
        for chunk in part.chunks if wanted else ():
            for channel, times in part.file.log_times(chunk.chunk).items():
                if channel in wanted and not channels[channel].is_static:
                    found += zip(times, repeat(channels[channel]), strict=False)
        found += [(at, channels[each]) for each, at in part.index.changes if each in wanted]
    found.sort(key=itemgetter(0))
    return found
