"""What is in a recording, in numbers: streams, rates, gaps, topics, nodes, events."""

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from tfbus.recording.damage import Damage, united
from tfbus.recording.edges import EdgeFacts, EdgeTable
from tfbus.recording.items import EventItem
from tfbus.recording.pauses import Pause, recorded_ns, waits_between
from tfbus.recording.viewpoint import Viewpoint

if TYPE_CHECKING:
    import numpy as np

    from tfbus.recording.reader import RecordingReader
else:
    from tfbus.core import lazy_numpy as np


@dataclass(frozen=True)
class FileFacts:
    """A file of a recording."""

    path: str
    size: int
    is_complete: bool
    damage: tuple[Damage, ...]


@dataclass(frozen=True)
class Flow:
    """How messages came: how many, at which log times the first and the last, how many a second
    while it was recorded (None for fewer than two), and the longest time without one, from when on,
    but for pauses of the recorder.
    """

    messages: int
    first_ns: int | None = None
    last_ns: int | None = None
    rate: float | None = None
    longest_gap_s: float | None = None
    gap_from_ns: int | None = None


@dataclass(frozen=True)
class StreamFacts:
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
    """A topic: the name of its type, and how its messages came."""

    name: str
    type_name: str
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
    """What is in a recording. Times are log times, nanoseconds since the Unix epoch. With
    `is_checked` all messages were read, and so all damage is known.
    """

    files: tuple[FileFacts, ...]
    start_ns: int
    end_ns: int
    about: Mapping[str, str]
    streams: tuple[StreamFacts, ...]
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
        """The messages of all streams and topics, without those that repeat static transforms."""
        flows = [each.flow for each in self.streams] + [each.flow for each in self.topics]
        return sum(flow.messages for flow in flows)


def summary_of(reader: "RecordingReader") -> Summary:
    """The summary of a recording; reads its indices, not its messages. Raises DecodeError."""
    flows = _flows(reader)
    return Summary(
        tuple(
            FileFacts(str(part.path), part.size, part.is_complete, tuple(united(part.file.damage)))
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
        int(waits.length_ns[longest]) * 1e-9,
        int(waits.from_ns[longest]),
    )


def _streams(
    reader: "RecordingReader", facts: Iterable[EdgeFacts], flows: Mapping[_FlowKey, Flow]
) -> tuple[StreamFacts, ...]:
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
        StreamFacts(
            name,
            stream.node,
            stream.namespace,
            tuple(epochs[name]),
            stream.split,
            flows.get(("stream", name), Flow(0)),
            transforms[name],
            tuple(sorted(dynamic.get(name, ()), key=_by_number)),
            tuple(sorted(static.get(name, ()), key=_by_number)),
            gone[name].log_ns if name in gone else None,
        )
        for name, stream in sorted(streams.items())
    )


def _by_number(name: str) -> list[tuple[int, str]]:
    """So that link2 comes before link10."""
    return [
        (int(part), "") if part.isdecimal() and len(part) < 20 else (-1, part)
        for part in re.split(r"([0-9]+)", name)
    ]


def _nodes(events: Iterable[EventItem]) -> tuple[NodeFacts, ...]:
    found: dict[str, NodeFacts] = {}
    for event in events:
        if event.kind == "node":
            found[event.name] = NodeFacts(event.name, str(event.facts.get("host", "")), False)
        elif event.kind == "node gone":
            host = found[event.name].host if event.name in found else ""
            found[event.name] = NodeFacts(event.name, host, True)
    return tuple(found[name] for name in sorted(found))
