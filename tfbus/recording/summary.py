"""The contents of a recording, in numbers: streams, rates, gaps, topics, nodes, events."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from tfbus.base import lazy_numpy as np
from tfbus.base.lazy_numpy import NDArray
from tfbus.base.wording import natural_order
from tfbus.recording.items import EventItem, Pause, Viewpoint, recorded_ns, waits_between
from tfbus.recording.layout import Edge
from tfbus.recording.part import StreamChannel
from tfbus.recording.reader import RecordingReader
from tfbus.recording.records import Damage, united

# A stream in one epoch.
StreamKey = tuple[str, int]


@dataclass(frozen=True)
class EdgeFacts:
    """An edge of a stream in one epoch, by the index: its samples; stamps in nanoseconds."""

    key: StreamKey
    edge: Edge
    is_static: bool
    samples: int
    first_ns: int
    last_ns: int


class EdgeTable:
    """The edges of the streams that are seen from a viewpoint, by the indices of all files.

    `keys` and `edges` are numbered, as are the chunks by their place in `RecordingReader.chunks`.
    `static` and `dynamic` (N, 6) have a row for each edge of a stream in a chunk: chunk, key, edge,
    first and last stamp, and the number of samples.
    """

    def __init__(self, reader: RecordingReader, view: Viewpoint) -> None:
        self.edges: dict[Edge, int] = {}
        self.keys: dict[StreamKey, int] = {}
        # By the name of a child frame here: its names in the file.
        self._sent_names: dict[str, set[str]] = {}
        self._view = view
        table = self._read(reader)
        is_static = table[:, 0] == 1
        self.static, self.dynamic = table[is_static, 1:], table[~is_static, 1:]

    def key(self, channel: StreamChannel) -> int | None:
        """The number of the stream of a channel in its epoch; None if it is not seen."""
        return self.keys.get((channel.stream.name, channel.stream.epoch_ns))

    def sent_names(self, children: frozenset[str]) -> frozenset[str]:
        """The names in the files of child frames that are called so here."""
        return frozenset(name for child in children for name in self._sent_names.get(child, ()))

    def facts(self) -> list[EdgeFacts]:
        """The samples of each edge of each stream in each epoch, counted."""
        keys, edges = list(self.keys), list(self.edges)
        found = []
        for table, is_static in ((self.static, True), (self.dynamic, False)):
            rows = table[np.lexsort((table[:, 2], table[:, 1]))]
            if not len(rows):
                continue
            is_new = np.ones(len(rows), bool)
            is_new[1:] = (rows[1:, 1:3] != rows[:-1, 1:3]).any(axis=1)
            starts = np.flatnonzero(is_new)
            for row, first, last, count in zip(
                rows[starts].tolist(),
                np.minimum.reduceat(rows[:, 3], starts).tolist(),
                np.maximum.reduceat(rows[:, 4], starts).tolist(),
                np.add.reduceat(rows[:, 5], starts).tolist(),
                strict=True,
            ):
                found.append(EdgeFacts(keys[row[1]], edges[row[2]], is_static, count, first, last))
        return found

    def _read(self, reader: RecordingReader) -> NDArray[np.int64]:
        """The rows of all files, with whether they are static before the rest."""
        numbers = {(chunk.part.number, chunk.offset): at for at, chunk in enumerate(reader.chunks)}
        tables = [np.empty((0, 7), np.int64)]
        for part in reader.parts:
            index = part.index
            places = np.array([numbers[part.number, offset] for offset in index.offsets], np.int64)
            order = np.argsort(index.channel, kind="stable")
            ordered = index.channel[order]
            for channel in part.stream_channels.values():
                stream = channel.stream
                if self._view.called(stream.name, stream.namespace) is None:
                    continue
                start, end = np.searchsorted(ordered, [channel.id, channel.id + 1]).tolist()
                rows = order[start:end]
                key = self.keys.setdefault((stream.name, stream.epoch_ns), len(self.keys))
                table = np.empty((len(rows), 7), np.int64)
                table[:, 0], table[:, 2] = channel.is_static, key
                table[:, 1] = places[index.chunk[rows]]
                table[:, 3] = self._numbers(index.edges, index.edge[rows], stream.namespace)
                table[:, 4], table[:, 5] = index.first_ns[rows], index.last_ns[rows]
                table[:, 6] = index.count[rows]
                tables.append(table)
        return np.concatenate(tables)

    def _numbers(
        self, edges: tuple[Edge, ...], used: NDArray[np.uint32], namespace: str
    ) -> NDArray[np.int64]:
        """The numbers here of edges of a file."""
        outside = self._view.names(namespace).outside
        here = np.zeros(len(edges), np.int64)
        for at in np.unique(used).tolist():
            parent, child = edges[at]
            edge = outside(parent), outside(child)
            self._sent_names.setdefault(edge[1], set()).add(child)
            here[at] = self.edges.setdefault(edge, len(self.edges))
        return here[used]


@dataclass(frozen=True)
class FileFacts:
    """A file of a recording; one that `is_growing` is being written."""

    path: str
    size: int
    is_complete: bool
    is_growing: bool
    damage: tuple[Damage, ...]


@dataclass(frozen=True)
class Flow:
    """How messages came: how many, at which log times the first and the last, how many a second
    while it was recorded (None for fewer than two), the median time from one to the next, and the
    longest time without one, from when on, but for pauses of the recorder.
    """

    messages: int
    first_ns: int | None = None
    last_ns: int | None = None
    rate: float | None = None
    period_s: float | None = None
    longest_gap_s: float | None = None
    gap_from_ns: int | None = None


@dataclass(frozen=True)
class RecordedStreamFacts:
    """A stream: its epochs, each with the time at which it begins by its own word; how its dynamic
    messages came; how many transforms these hold; and its frames.
    """

    name: str
    node: str
    namespace: str
    epochs_ns: tuple[int, ...]
    split: bool
    flow: Flow
    transforms: int
    frames: tuple[str, ...]
    static_frames: tuple[str, ...]
    gone_ns: int | None

    @property
    def restarts(self) -> int:
        """How often a new epoch began."""
        return max(0, len(self.epochs_ns) - 1)


@dataclass(frozen=True)
class TopicFacts:
    """A topic: the name of its type on the bus, and in the file, and how its messages came."""

    name: str
    type_name: str
    ros_type: str
    is_readable: bool
    flow: Flow


@dataclass(frozen=True)
class NodeFacts:
    """A node that described itself: where it ran, and whether it was gone at the end."""

    name: str
    host: str
    is_gone: bool


@dataclass(frozen=True)
class Summary:
    """The contents of a recording. Times are log times, nanoseconds since the Unix epoch. With
    `is_checked` all messages were read, and so all damage is known.
    """

    files: tuple[FileFacts, ...]
    start_ns: int
    end_ns: int
    about: Mapping[str, str]
    streams: tuple[RecordedStreamFacts, ...]
    topics: tuple[TopicFacts, ...]
    nodes: tuple[NodeFacts, ...]
    events: tuple[EventItem, ...]
    pauses: tuple[Pause, ...]
    dropped: int
    is_checked: bool = False

    @property
    def is_complete(self) -> bool:
        """Whether no file was cut short or is damaged."""
        return all(file.is_complete and not file.damage for file in self.files)

    @property
    def size(self) -> int:
        """The bytes of all files."""
        return sum(file.size for file in self.files)

    @property
    def duration_s(self) -> float:
        """Seconds from the first item to the last."""
        return (self.end_ns - self.start_ns) / 1e9

    @property
    def recorded_s(self) -> float:
        """The same without the pauses of the recorder."""
        return recorded_ns(self.pauses, self.start_ns, self.end_ns) / 1e9

    @property
    def messages(self) -> int:
        """The messages of all streams and topics, without repeated static transforms."""
        flows = [each.flow for each in self.streams] + [each.flow for each in self.topics]
        return sum(flow.messages for flow in flows)


def summary_of(reader: "RecordingReader") -> Summary:
    """The summary of a recording; reads its indices, not its messages. Raises DecodeError."""
    flows = _flows(reader)
    return Summary(
        tuple(
            FileFacts(
                str(part.path),
                part.size,
                part.is_complete,
                part.is_growing,
                tuple(united(part.file.damage)),
            )
            for part in reader.parts
        ),
        reader.start_ns,
        reader.end_ns,
        reader.about,
        _streams(reader, EdgeTable(reader, Viewpoint(None)).facts(), flows),
        tuple(
            TopicFacts(
                topic.name,
                topic.type_name,
                topic.ros_type,
                topic.is_readable,
                flows.get(("topic", topic.name), Flow(topic.messages)),
            )
            for topic in reader.topics
        ),
        _nodes(reader.events),
        reader.events,
        reader.pauses,
        sum(event.dropped for event in reader.events),
    )


# "stream" or "topic", and the name.
_FlowKey = tuple[str, str]


def _flows(reader: "RecordingReader") -> dict[_FlowKey, Flow]:
    times: dict[_FlowKey, list[int]] = {}
    for part in reader.parts:
        keys: dict[int, _FlowKey] = {
            channel.id: ("stream", channel.stream.name)
            for channel in part.stream_channels.values()
            if not channel.is_static
        }
        keys |= {channel.id: ("topic", channel.topic) for channel in part.topic_channels.values()}
        for chunk in part.chunks:
            for channel, found in part.file.log_times(chunk.chunk).items():
                if channel in keys:
                    times.setdefault(keys[channel], []).extend(found)
    return {key: _flow(found, reader.pauses) for key, found in times.items()}


def _flow(times: list[int], pauses: Sequence[Pause]) -> Flow:
    times.sort()
    if len(times) < 2:
        return Flow(len(times), *times, *times)
    waits = waits_between(np.array(times, np.int64), pauses)
    longest = int(waits.length_ns.argmax())
    return Flow(
        len(times),
        times[0],
        times[-1],
        waits.rate_hz(),
        waits.period_s(),
        int(waits.length_ns[longest]) * 1e-9,
        int(waits.from_ns[longest]),
    )


def _streams(
    reader: "RecordingReader", facts: Iterable[EdgeFacts], flows: Mapping[_FlowKey, Flow]
) -> tuple[RecordedStreamFacts, ...]:
    dynamic: dict[str, set[str]] = {}
    static: dict[str, set[str]] = {}
    transforms: Counter[str] = Counter()
    for fact in facts:
        name = fact.key[0]
        (static if fact.is_static else dynamic).setdefault(name, set()).add(fact.edge[1])
        if not fact.is_static:
            transforms[name] += fact.samples
    epochs: dict[str, dict[int, None]] = {}
    streams = {}
    for each in reader.streams:
        name = each.stream.name
        epochs.setdefault(name, {})[each.stream.epoch_ns] = None
        if name not in streams or each.stream.node:
            streams[name] = each.stream
    gone = reader.state_at(reader.end_ns).gone
    return tuple(
        RecordedStreamFacts(
            name,
            stream.node,
            stream.namespace,
            tuple(epochs[name]),
            stream.split,
            flows.get(("stream", name), Flow(0)),
            transforms[name],
            tuple(sorted(dynamic.get(name, ()), key=natural_order)),
            tuple(sorted(static.get(name, ()), key=natural_order)),
            gone[name].log_ns if name in gone else None,
        )
        for name, stream in sorted(streams.items(), key=lambda item: natural_order(item[0]))
    )


def _nodes(events: Iterable[EventItem]) -> tuple[NodeFacts, ...]:
    found: dict[str, NodeFacts] = {}
    for event in events:
        if event.kind == "node":
            found[event.name] = NodeFacts(event.name, str(event.facts.get("host", "")), False)
        elif event.kind == "node gone":
            host = found[event.name].host if event.name in found else ""
            found[event.name] = NodeFacts(event.name, host, True)
    return tuple(found[name] for name in sorted(found, key=natural_order))
