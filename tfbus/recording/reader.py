"""Reads recordings: the items of one or several files, in order of time, from any moment on."""

import heapq
import os
from bisect import bisect_right
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import accumulate, chain
from operator import attrgetter
from pathlib import Path
from typing import TypeVar

from tfbus.base import lazy_numpy as np
from tfbus.base.errors import DecodeError, FileError, MissingFileError
from tfbus.base.log import LogOnce, library_log
from tfbus.base.wording import printable
from tfbus.recording.items import (
    ALL,
    RECORDING,
    EventItem,
    Item,
    Pause,
    RecordedStream,
    Selection,
    TopicItem,
    TransformItem,
    pauses_between,
    pauses_of,
)
from tfbus.recording.mcap_file import McapFile, how_to_import
from tfbus.recording.part import Part, StoredChunk, UnreadItem, read_items
from tfbus.recording.records import Damage, united
from tfbus.recording.state import BusState
from tfbus.ros.definitions import Definition
from tfbus.ros.tf_message import TFMessageReader
from tfbus.wire.keys import STATIC_TRANSFORMS, TRANSFORMS

T = TypeVar("T")

# The memory of an item besides the bytes of its message.
_ITEM_BYTES = 750

# Groups whose times overlap are in memory together; more of them are refused.
_MOST_WAITING = 2**30


def in_order(
    groups: Iterable[tuple[int, Collection[T], int]], time_of: Callable[[T], int]
) -> Iterator[T]:
    """The items of all groups by their times; equal ones in the order of the groups.

    Each group comes with the least time of its items, and the bytes that they have, and groups come
    in order of that time. Raises DecodeError if items that wait for their turn are beyond 1 GB.
    """
    # The time of each, its number, its bytes, and the item.
    waiting: list[tuple[int, int, int, T]] = []
    taken = held = 0
    for from_time, items, size in groups:
        while waiting and waiting[0][0] < from_time:
            _, _, left, item = heapq.heappop(waiting)
            held -= left
            yield item
        each = _ITEM_BYTES + size // max(1, len(items))
        held += each * len(items)
        if held > _MOST_WAITING:
            raise DecodeError("the chunks of the recording overlap in time too much to be read")
        for item in items:
            heapq.heappush(waiting, (time_of(item), taken, each, item))
            taken += 1
    while waiting:
        yield heapq.heappop(waiting)[3]


SUFFIX = ".mcap"


def files_of(paths: Iterable[str | os.PathLike[str]]) -> list[Path]:
    """The files that these paths name: of a folder all files in it that end in `.mcap`, by name.

    Raises FileNotFoundError for a path that is not there, and DecodeError for a folder without
    recordings.
    """
    found = [file for path in paths for file in _files_at(Path(path))]
    return list(dict.fromkeys(found))


def _files_at(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    files = sorted(each for each in path.iterdir() if each.suffix == SUFFIX and each.is_file())
    if not files:
        import_it = how_to_import(path)
        advice = f": {import_it}" if import_it else ""
        raise DecodeError(f"{printable(str(path))} is a folder without {SUFFIX} files{advice}")
    return files


def _file_error(error: OSError, path: str | os.PathLike[str]) -> FileError:
    """The error of a file that the system does not open."""
    name = error.filename or path
    kind = MissingFileError if isinstance(error, FileNotFoundError) else FileError
    told = kind(f"{printable(str(name))} cannot be read: {error.strerror or error}")
    told.errno, told.strerror, told.filename = error.errno, error.strerror, name
    return told


_LOG = library_log("tfbus.recording")


@dataclass(frozen=True)
class StreamSummary:
    """A stream in one epoch: how many messages of dynamic and of static transforms there are. The
    static ones include repetitions of the set in force.
    """

    stream: RecordedStream
    messages: int
    static_messages: int


@dataclass(frozen=True)
class TopicSummary:
    """A topic: the name of its type, and how many messages there are. If `is_readable` is false
    they are in a format that tfbus does not read, and are left out of the items. If it
    `is_retained` a message stays in force until the next, and repetitions at the beginning of a
    file are counted too. `definition` is the text of a type of ROS's, `ros_type` the name of the
    type in the file.
    """

    name: str
    type_name: str
    messages: int
    is_readable: bool = True
    is_retained: bool = False
    definition: Definition | None = field(default=None, repr=False)
    ros_type: str = ""


class RecordingReader(AbstractContextManager["RecordingReader"]):
    """Reads the items of one or several files, or of all files in a folder, as one recording.

    An unreadable part of a file is left out. `on_damage` is called with the file and the damage
    when it is met first; by default the first of each file is logged.

    Use it in a `with`. Raises MissingFileError, FileError, and DecodeError for a file that is no
    recording. Not thread-safe, but for `items`.
    """

    def __init__(
        self,
        *paths: str | os.PathLike[str],
        on_damage: Callable[[Part, Damage], object] | None = None,
    ) -> None:
        import zstandard  # noqa: F401 - the extra `bag`

        self._parts: list[Part] = []
        self._once = LogOnce(_LOG)
        self._on_damage = on_damage or self._log_damage
        try:
            for place in files_of(paths):
                self._parts.append(Part(McapFile(place), len(self._parts)))
        except OSError as error:
            self.close()
            raise _file_error(error, paths[0]) from error
        except BaseException:
            self.close()
            raise
        self.events = self._all_events()
        self._chunks = sorted(
            (chunk for part in self._parts for chunk in part.chunks),
            key=lambda chunk: (chunk.from_ns, chunk.part.number, chunk.offset),
        )
        # Up to each chunk, the last log time of it and of all chunks before it.
        self._until = list(accumulate((chunk.to_ns for chunk in self._chunks), max))
        for part in self._parts:
            for damage in part.file.damage:
                self._on_damage(part, damage)
            part.file.on_damage = partial(self._on_damage, part)

    @property
    def chunks(self) -> Sequence[StoredChunk]:
        """The chunks of all files, by the log times of their first messages."""
        return self._chunks

    def last_chunks(
        self, stream: str, outside: Callable[[str], str], frames: set[str], before_ns: int
    ) -> dict[str, tuple[int, int]]:
        """The log times, from and to, of the last chunk that begins before a time and has
        transforms of a frame of a stream, by the index, for each of these frames that has one;
        `outside` gives the name of a frame among `frames` for its name in the files.
        """
        last: dict[str, tuple[int, int]] = {}
        spans = {
            (each.part.number, each.offset): (each.from_ns, each.to_ns) for each in self.chunks
        }
        for part in self.parts:
            channels = [
                channel.id
                for channel in part.stream_channels.values()
                if channel.stream.name == stream
            ]
            index = part.index
            edges = {
                number: name
                for number, (_, child) in enumerate(index.edges)
                if (name := outside(child)) in frames
            }
            if not channels or not edges:
                continue
            rows = np.isin(index.channel, channels) & np.isin(index.edge, list(edges))
            found = zip(index.edge[rows].tolist(), index.chunk[rows].tolist(), strict=True)
            for edge, chunk in found:
                span = spans[part.number, index.offsets[chunk]]
                name = edges[edge]
                if span[0] < before_ns and (name not in last or span[1] > last[name][1]):
                    last[name] = span
        return last

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the files."""
        for part in self._parts:
            part.close()

    @property
    def parts(self) -> tuple[Part, ...]:
        """The files, in the order in which they were given."""
        return tuple(self._parts)

    @property
    def start_ns(self) -> int:
        """The log time of the first item; 0 if there is none."""
        times = [chunk.from_ns for chunk in self._chunks[:1]]
        return min([*times, *[event.log_ns for event in self.events[:1]]], default=0)

    @property
    def end_ns(self) -> int:
        """The log time of the last item; 0 if there is none."""
        return max([*self._until[-1:], *[event.log_ns for event in self.events[-1:]]], default=0)

    @property
    def pauses(self) -> tuple[Pause, ...]:
        """When nothing was recorded though the bus may have gone on, in order of time."""
        return pauses_of(self.events, self.end_ns)

    @property
    def is_complete(self) -> bool:
        """Whether no file was cut short, as by a power failure; of a cut file the rest is read."""
        return all(part.is_complete for part in self._parts)

    @property
    def is_growing(self) -> bool:
        """Whether a file was being written when it was opened, and none was cut short."""
        of_incomplete = [part.is_growing for part in self._parts if not part.is_complete]
        return bool(of_incomplete) and all(of_incomplete)

    @property
    def is_of_one_recorder(self) -> bool:
        """Whether there is one file, or the files say that one recorder wrote them."""
        recorders = {part.about.get(RECORDING, part) for part in self._parts}
        return len(recorders) == 1

    @property
    def is_damaged(self) -> bool:
        """Whether some part read so far was unreadable."""
        return any(part.file.damage for part in self._parts)

    @property
    def damage(self) -> tuple[Damage, ...]:
        """The unreadable parts met so far."""
        return tuple(damage for part in self._parts for damage in united(part.file.damage))

    def check(self) -> None:
        """Read all chunks, to meet all damage."""
        for chunk in self._chunks:
            chunk.part.file.messages(chunk.chunk)

    @property
    def about(self) -> Mapping[str, str]:
        """The note of the recorder on itself in the first file, as `version` and `host`."""
        return self._parts[0].about if self._parts else {}

    @property
    def streams(self) -> tuple[StreamSummary, ...]:
        """The streams, each epoch for itself, by name and epoch."""
        found: dict[tuple[str, int], StreamSummary] = {}
        for part in self._parts:
            for channel in part.stream_channels.values():
                count = part.counts.get(channel.id, 0)
                key = (channel.stream.name, channel.stream.epoch_ns)
                former = found.get(key, StreamSummary(channel.stream, 0, 0))
                found[key] = StreamSummary(
                    channel.stream if channel.stream.node else former.stream,
                    former.messages + (0 if channel.is_static else count),
                    former.static_messages + (count if channel.is_static else 0),
                )
        return tuple(found[key] for key in sorted(found))

    @property
    def topics(self) -> tuple[TopicSummary, ...]:
        """The topics by name."""
        found: dict[str, TopicSummary] = {}
        for part in self._parts:
            for channel in part.topic_channels.values():
                former = found.get(channel.topic, TopicSummary(channel.topic, "", 0))
                found[channel.topic] = TopicSummary(
                    channel.topic,
                    channel.type_name or former.type_name,
                    former.messages + part.counts.get(channel.id, 0),
                    former.is_readable and channel.is_readable,
                    former.is_retained or channel.is_retained,
                    channel.definition or former.definition,
                    channel.ros_type or former.ros_type,
                )
        return tuple(found[name] for name in sorted(found))

    def child_frames(self) -> set[str]:
        """The child frames of all transforms; reads the index."""
        return {child for part in self._parts for _, child in part.index.edges}

    def items(
        self, from_ns: int | None = None, to_ns: int | None = None, selection: Selection = ALL
    ) -> Iterator[Item]:
        """The items from one log time to another, both included, in order of their log times.

        Repetitions of the state come once. Each iterator may be in a thread of its own.
        """
        state = BusState()
        for item in self._in_order(from_ns, to_ns, selection):
            if state.says(item):
                continue
            state.apply(item)
            taken = selection.taken_of(item)
            if taken is not None:
                yield taken

    def messages_before(self, until_ns: int, selection: Selection = ALL) -> Iterator[TopicItem]:
        """The messages of topics up to a log time, the last one first. Each iterator may be in a
        thread of its own, and reads the chunks of the messages that are taken from it.

        A message that repeats the one before it, as at the beginning of a file, is left out.
        """
        repeated: dict[str, TopicItem] = {}
        for item in read_items(in_order(self._groups_before(until_ns, selection), _before)):
            if not isinstance(item, TopicItem):
                continue
            later = repeated.pop(item.topic, None)
            if later is not None and later.content != item.content:
                yield later
            if item.repeated:
                repeated[item.topic] = item
            else:
                yield item
        yield from repeated.values()

    def _groups_before(
        self, until_ns: int, selection: Selection
    ) -> Iterator[tuple[int, list[Item | UnreadItem], int]]:
        tf = TFMessageReader()
        for chunk in sorted(self._chunks, key=attrgetter("to_ns"), reverse=True):
            if chunk.from_ns <= until_ns and chunk.is_taken(selection):
                items, size = chunk.items(selection, tf)
                items = [item for item in reversed(items) if item.log_ns <= until_ns]
                yield -min(chunk.to_ns, until_ns), items, size

    def state_at(self, log_ns: int, selection: Selection = ALL) -> BusState:
        """The state at a log time, after the items of that time."""
        restarted = self._sets_of_restarted
        names = {
            channel.stream.name
            for part in self._parts
            for channel in part.stream_channels.values()
            if channel.is_static
            and channel.stream.name not in restarted
            and selection.takes_transforms(channel.stream.name, static=True)
        }
        items: list[Item] = [*self.events, *chain.from_iterable(restarted.values())]
        items = [item for item in items if item.log_ns <= log_ns]
        state = BusState()
        for item in sorted([*items, *self._last_statics(names, log_ns)], key=_log_ns):
            taken = selection.taken_of(item)
            if taken is not None:
                state.apply(taken)
        for message in self._last_retained(log_ns, selection):
            state.apply(message)
        return state

    def first_statics(self) -> list[TransformItem]:
        """The sets of static transforms of the chunks in which a frame is static for the first
        time; no other chunk is read.
        """
        numbers = {(chunk.part.number, chunk.offset): at for at, chunk in enumerate(self._chunks)}
        first: dict[tuple[str, str], int] = {}
        for part in self._parts:
            index = part.index
            statics = {each.id for each in part.stream_channels.values() if each.is_static}
            for chunk, channel, edge in zip(
                index.chunk.tolist(), index.channel.tolist(), index.edge.tolist(), strict=True
            ):
                if channel in statics:
                    key = part.stream_channels[channel].stream.name, index.edges[edge][1]
                    at = numbers[part.number, index.offsets[chunk]]
                    first[key] = min(at, first.get(key, at))
        wanted: dict[int, set[str]] = defaultdict(set)
        for (stream, _), at in first.items():
            wanted[at].add(stream)
        return [
            item
            for at in sorted(wanted)
            for item, _ in self._chunks[at].statics()
            if item.stream.name in wanted[at]
        ]

    def _all_events(self) -> tuple[EventItem, ...]:
        found: list[EventItem] = []
        spans: list[tuple[int, int, str]] = []
        for part in self._parts:
            of_part = part.events
            times = [time for chunk in part.chunks for time in (chunk.from_ns, chunk.to_ns)]
            times += [event.log_ns for event in of_part]
            if times:
                spans.append((min(times), max(times), part.about.get(RECORDING, "")))
            found += of_part
        found += pauses_between(spans)
        found.sort(key=attrgetter("log_ns"))
        state = BusState()
        events = []
        filled = [event for event in found if event.kind == "filled"]
        for event in found:
            if any(_covers(each, event) for each in filled):
                continue
            if not state.says(event):
                events.append(event)
            state.apply(event)
        return tuple(events)

    def _in_order(
        self, from_ns: int | None, to_ns: int | None, selection: Selection
    ) -> Iterator[Item]:
        return read_items(in_order(self._groups(from_ns, to_ns, selection), _log_ns))

    def _groups(
        self, from_ns: int | None, to_ns: int | None, selection: Selection
    ) -> Iterator[tuple[int, list[Item | UnreadItem], int]]:
        """The items between two log times, chunk by chunk, with the bytes of their messages.

        All events come first: before messages of the same time.
        """
        first = -1 if from_ns is None else from_ns
        last = 2**64 if to_ns is None else to_ns
        yield -1, [each for each in self.events if first <= each.log_ns <= last], 0
        tf = TFMessageReader()
        for chunk in self._chunks:
            if chunk.from_ns > last or chunk.to_ns < first or not chunk.is_taken(selection):
                continue
            items, size = chunk.items(selection, tf)
            if from_ns is not None or to_ns is not None:
                items = [item for item in items if first <= item.log_ns <= last]
            yield chunk.from_ns, items, size

    def _log_damage(self, part: Part, damage: Damage) -> None:
        self._once.warning(
            part.number,
            "%s is damaged: %s cannot be read (%s), the rest is",
            part.name,
            damage.text(self.start_ns),
            damage.reason,
        )

    def _last_statics(self, names: set[str], log_ns: int) -> list[TransformItem]:
        """Of each of these streams its last static set up to a log time, in the order in which they
        came, each at the log time at which it did.
        """
        found: dict[str, TransformItem] = {}
        for at in reversed(range(len(self._chunks))):
            chunk = self._chunks[at]
            missing = names - found.keys()
            oldest = min((item.log_ns for item in found.values()), default=log_ns)
            if not missing and self._until[at] < oldest:
                break
            if chunk.from_ns > log_ns or not (chunk.static_streams & names):
                continue
            if not (chunk.static_streams & missing) and chunk.to_ns < oldest:
                continue
            sets = [item for item, _ in chunk.statics() if item.log_ns <= log_ns]
            sets.sort(key=attrgetter("log_ns"))
            last = {item.stream.name: item for item in sets}
            for name in last.keys() & names:
                if name not in found or found[name].log_ns < last[name].log_ns:
                    found[name] = last[name]
        came = [replace(item, log_ns=self._began_ns(item)) for item in found.values()]
        return sorted(came, key=_log_ns)

    @cached_property
    def _sets_of_restarted(self) -> dict[str, list[TransformItem]]:
        """All static sets of the streams that have some of several epochs, in order of their log
        times: what is left of a former epoch is known by all that came.
        """
        epochs: dict[str, set[int]] = defaultdict(set)
        for part in self._parts:
            for channel in part.stream_channels.values():
                if channel.is_static:
                    epochs[channel.stream.name].add(channel.stream.epoch_ns)
        found: dict[str, list[TransformItem]] = {
            name: [] for name, of_stream in epochs.items() if len(of_stream) > 1
        }
        for part in self._parts if found else ():
            for item in part.changed_sets(found.keys()):
                found[item.stream.name].append(item)
        return {name: sorted(sets, key=_log_ns) for name, sets in found.items()}

    def _began_ns(self, item: TransformItem) -> int:
        """Since when a stream has had a static set, which may be repeated again and again."""
        times = self._static_changes.get(item.stream.name, [])
        at = bisect_right(times, item.log_ns)
        return times[at - 1] if at else item.log_ns

    @cached_property
    def _static_changes(self) -> dict[str, list[int]]:
        """When each stream got another static set, by its name. The sets at the beginning of a
        further file are none, as it repeats the sets in force.
        """
        found: dict[str, list[int]] = {}
        known: set[RecordedStream] = set()
        for part in self._parts:
            changes = list(part.static_changes)
            first_ns = min((log_ns for log_ns, _ in changes), default=0)
            for log_ns, stream in changes:
                if log_ns > first_ns or stream not in known:
                    found.setdefault(stream.name, []).append(log_ns)
            known.update(stream for _, stream in changes)
        return {name: sorted(times) for name, times in found.items()}

    def _last_retained(self, log_ns: int, selection: Selection) -> list[TopicItem]:
        """Of each retained topic that the selection takes its last message up to a log time."""
        names = {
            topic.name
            for topic in self.topics
            if topic.is_retained and topic.is_readable and selection.takes_topic(topic.name)
        }
        found: dict[str, TopicItem] = {}
        only = Selection(topics=tuple(sorted(names)))
        for at in reversed(range(len(self._chunks))):
            chunk = self._chunks[at]
            oldest = min((item.log_ns for item in found.values()), default=log_ns)
            if found.keys() == names and self._until[at] < oldest:
                break
            if chunk.from_ns > log_ns or not (chunk.retained_topics & names):
                continue
            for item in read_items(chunk.items(only, TFMessageReader())[0]):
                # A topic may have messages that are not retained as well.
                if isinstance(item, TopicItem) and item.retained and item.log_ns <= log_ns:
                    last = found.get(item.topic)
                    if last is None or last.log_ns <= item.log_ns:
                        found[item.topic] = item
        return list(found.values())


def _covers(filled: EventItem, event: EventItem) -> bool:
    """Whether a publisher was out of reach, not gone, since the gap was filled."""
    if event.kind not in ("stream gone", "node gone") or event.facts:
        return False
    until_ns, lost = filled.facts.get("until"), filled.facts.get("lost")
    return (
        isinstance(lost, list)
        and event.name in lost
        and isinstance(until_ns, int)
        and filled.log_ns <= event.log_ns <= until_ns
    )


def _log_ns(item: Item | UnreadItem) -> int:
    return item.log_ns


def _before(item: Item | UnreadItem) -> int:
    return -item.log_ns


TRANSFORMS_TYPE = "TransformMessage"


@dataclass(frozen=True)
class RecordedTopic:
    """A topic: its name, the name of its type, "" if unknown, and how many messages came."""

    name: str
    type: str
    messages: int


def topics_of(reader: RecordingReader) -> dict[str, RecordedTopic]:
    """All topics by name; `tf/STREAM` and `tf_static/STREAM` have the transforms of a stream."""
    found: dict[str, RecordedTopic] = {}
    for topic in reader.topics:
        found[topic.name] = RecordedTopic(topic.name, topic.type_name, topic.messages)
    for each in reader.streams:
        for kind, count in (
            (TRANSFORMS, each.messages),
            (STATIC_TRANSFORMS, each.static_messages),
        ):
            name = topic_of_stream(kind, each.stream.name, each.stream.namespace)
            if count:
                before = found[name].messages if name in found else 0
                found[name] = RecordedTopic(name, TRANSFORMS_TYPE, before + count)
    return dict(sorted(found.items()))


def topic_of_stream(kind: str, stream: str, namespace: str) -> str:
    """The topic with the transforms of a stream, of the kind `tf` or `tf_static`."""
    if not namespace:
        return f"{kind}/{stream}"
    return f"{namespace}/{kind}/{stream.removeprefix(f'{namespace}/')}"
