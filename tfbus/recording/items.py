"""The contents of a recording, item by item, each with the time at which it was received.

Selections take a part of them, by topic, stream and frame, seen from a namespace. Pauses are the
times at which the recorder recorded nothing, though the bus went on.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, TypeAlias

from tfbus.base import lazy_numpy as np
from tfbus.base.errors import InvalidArgumentException
from tfbus.base.lazy_numpy import NDArray
from tfbus.base.wording import printable
from tfbus.geometry.columns import Columns
from tfbus.geometry.transform import check_stamp
from tfbus.ros.definitions import Definition
from tfbus.ros.message_type import message_of
from tfbus.wire.fleet import Fleet, FrameNames, has_name

EventKind = Literal[
    "stream", "stream gone", "node", "node gone", "paused", "resumed", "dropped", "filled"
]


@dataclass(frozen=True)
class RecordedStream:
    """A stream in one epoch.

    `name` is as a session without a namespace has it, `robot7/sim`, and `namespace` its part
    `robot7`. `node` is the full name of its publisher, "" if no description had come. `split`
    is whether each frame has a key of its own.
    """

    name: str
    node: str = ""
    namespace: str = ""
    epoch_ns: int = 0
    split: bool = False


@dataclass(frozen=True)
class TransformItem:
    """A message of transforms. With `static` the rows are all static transforms of the stream, and
    replace the former ones. `seq` counts the messages of its key in its epoch.
    """

    log_ns: int
    stream: RecordedStream
    rows: Columns
    static: bool = False
    seq: int | None = None


@dataclass(frozen=True)
class TopicItem:
    """A message of a topic: its fields by name, as they go over the bus. `type_name` is the name of
    its type, as its publisher's node says, "" if it does not. A `retained` one stays in force until
    the next.

    `encoded` is the same message as ROS 2 has it, with the definition of its type, if it comes
    from a file: so it is written again as it was. A `repeated` one was in force already at its log
    time, as at the beginning of a file: it was not sent then.
    """

    log_ns: int
    topic: str
    type_name: str
    values: Mapping[str, Any]
    encoded: tuple[Definition, bytes] | None = field(default=None, compare=False, repr=False)
    retained: bool = False
    repeated: bool = field(default=False, compare=False)

    @property
    def with_arrays(self) -> Mapping[str, Any]:
        """Its fields with arrays of numpy in the place of binaries."""
        if self.encoded is None:
            return self.values
        from tfbus.ros.counterparts import with_arrays  # with all messages, which few items need

        found: dict[str, Any] = with_arrays(self.values, message_of(self.encoded[0]))
        return found

    @property
    def content(self) -> object:
        """Its type and fields in a form that has a hash, equal for messages with the same bits."""
        return self.type_name, _with_hash(self.values)


def _with_hash(value: Any) -> object:
    if isinstance(value, Mapping):
        return tuple([(name, _with_hash(each)) for name, each in value.items()])
    if isinstance(value, memoryview | bytes):
        return bytes(value)
    if isinstance(value, list) and value and isinstance(value[0], dict | list | bytes | memoryview):
        return tuple(map(_with_hash, value))
    # As a text: 1, 1.0 and True are equal, and nan is not.
    return repr(value)


@dataclass(frozen=True)
class EventItem:
    """An event on the bus, or of the recorder.

    "stream": the stream `name` is there, or has another description, whose fields are `facts` (as
    in docs/reference/wire.md). "node": the same of a node. "stream gone", "node gone": its token
    was lost. "paused", "resumed": the recorder was. "dropped": `facts["messages"]` messages were
    not recorded, as the disk or the machine was too slow. "filled": the recorder `name`
    was out of reach until `facts["until"]`, and `facts["messages"]` that it had kept were written
    later; `facts["lost"]` are the streams and nodes that seemed to be gone then.
    """

    log_ns: int
    kind: EventKind
    name: str = ""
    facts: Mapping[str, Any] = field(default_factory=dict)

    @property
    def dropped(self) -> int:
        """How many messages were not recorded; 0 of other events, and if that is no number."""
        messages = self.facts.get("messages") if self.kind == "dropped" else 0
        return messages if isinstance(messages, int) else 0

    @property
    def children(self) -> frozenset[str]:
        """The child frames that the description of a stream lists, in rows that can be read."""
        rows = self.facts.get("frames")
        if not isinstance(rows, list | tuple):
            return frozenset()
        return frozenset(
            row[1]
            for row in rows
            if isinstance(row, list | tuple) and len(row) > 1 and isinstance(row[1], str)
        )


Item = TransformItem | TopicItem | EventItem


# The topics of transforms, as ROS has them.
_DYNAMIC, _STATIC = "tf", "tf_static"


@dataclass(frozen=True)
class Selection:
    """The items to take; everything by default.

    `topics` are names of topics: given, only these. Among them `tf` stands for the dynamic
    transforms of all streams, `tf_static` for their static ones, `robot7/tf` for the streams of a
    namespace; if none of them is given, there are no transforms unless `streams` or `frames` are
    given too. `streams` are names of streams: given, only these. `frames` are child frames, by
    their own names or as in a fleet, `robot7/base_link`: given, only their transforms. `regex`
    and `exclude` are regular expressions, found anywhere in the name of a topic or stream;
    `exclude_topics` are names as `topics`. Names are full, as a session without a namespace has
    them. The topics `always` are taken in any case.
    """

    topics: tuple[str, ...] = ()
    streams: tuple[str, ...] = ()
    frames: tuple[str, ...] = ()
    regex: str = ""
    exclude: str = ""
    exclude_topics: tuple[str, ...] = ()
    always: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for option in ("regex", "exclude"):
            try:
                re.compile(getattr(self, option))
            except re.error as error:
                raise InvalidArgumentException(
                    f"{option} {getattr(self, option)!r} is no regular expression: {error}"
                ) from error

    # There may be as many as there are streams, and each item is looked for.

    @cached_property
    def _topics(self) -> frozenset[str]:
        return frozenset(self.topics)

    @cached_property
    def _streams(self) -> frozenset[str]:
        return frozenset(self.streams)

    @property
    def is_all(self) -> bool:
        """Whether it takes everything."""
        return self == ALL

    def takes_topic(self, topic: str) -> bool:
        """Whether it takes the messages of a topic."""
        if topic in self.always:
            return True
        if topic in self.exclude_topics:
            return False
        if self.topics:
            return topic in self._topics and self._matches(topic)
        if (self.streams or self.frames) and not self.regex:
            return False
        return self._matches(topic)

    def takes_stream(self, stream: str) -> bool:
        """Whether it takes transforms of a stream, dynamic or static ones."""
        return self.takes_transforms(stream, static=False) or self.takes_transforms(
            stream, static=True
        )

    def takes_transforms(self, stream: str, *, static: bool) -> bool:
        """Whether it takes the dynamic, or the static, transforms of a stream."""
        if _stand_for(self.exclude_topics, stream, static):
            return False
        if any(map(is_of_transforms, self.topics)):
            if not _stand_for(self.topics, stream, static):
                return False
        elif self.topics and not (self.streams or self.frames or self.regex):
            return False
        return (not self.streams or stream in self._streams) and self._matches(stream)

    def takes_frame(self, child: str, namespace: str) -> bool:
        """Whether it takes the transforms of a child frame in a namespace."""
        return not self.frames or any(has_name(child, namespace, name) for name in self.frames)

    def taken_of(self, item: Item) -> Item | None:
        """The item, or the part of it that is taken; None if nothing is."""
        if isinstance(item, EventItem):
            about_stream = item.kind in ("stream", "stream gone")
            return item if not about_stream or self.takes_stream(item.name) else None
        if isinstance(item, TopicItem):
            return item if self.takes_topic(item.topic) else None
        return self._taken_of_transforms(item)

    def _taken_of_transforms(self, item: TransformItem) -> TransformItem | None:
        if not self.takes_transforms(item.stream.name, static=item.static):
            return None
        if not self.frames:
            return item
        namespace, frames = item.stream.namespace, self.frames
        if namespace:
            children = item.rows.children()
            frames = tuple(each for each in children if self.takes_frame(each, namespace))
        rows = item.rows.only(frames)
        return replace(item, rows=rows) if rows.count or item.static else None

    def _matches(self, name: str) -> bool:
        if self.exclude and _is_found(self.exclude, name):
            return False
        return not self.regex or _is_found(self.regex, name)


def lacks_statics(selection: Selection) -> bool:
    """Whether its topics are such that it takes dynamic transforms and no static ones: lookups
    through static frames fail then.
    """
    kinds = {topic.rpartition("/")[2] for topic in selection.topics}
    return _DYNAMIC in kinds and _STATIC not in kinds


def _is_found(regex: str, name: str) -> bool:
    """Whether it is found in a name, which ROS writes with a slash before it."""
    return any(re.search(regex, each) for each in (name, f"/{name}"))


def is_of_transforms(topic: str) -> bool:
    """Whether a topic stands for transforms."""
    return topic.rpartition("/")[2] in (_DYNAMIC, _STATIC)


def _stand_for(topics: tuple[str, ...], stream: str, static: bool) -> bool:
    """Whether one of the topics stands for the dynamic, or static, transforms of a stream."""
    kind = _STATIC if static else _DYNAMIC
    places = [topic.removesuffix(kind) for topic in topics if topic.rpartition("/")[2] == kind]
    return any(map(stream.startswith, places))  # "robot7/", or ""


ALL = Selection()


class Viewpoint:
    """A namespace, "" for none; with a fleet also the namespaces below it. Without a namespace,
    None, all streams are seen, and frames are called as they were sent.
    """

    def __init__(self, namespace: str | None = "", fleet: Fleet | None = None) -> None:
        self._sees_all = namespace is None
        self.namespace = (namespace or "").strip("/")
        self._fleet = fleet
        self._names: dict[str, FrameNames] = {}

    def called(self, stream: str, namespace: str) -> str | None:
        """The name of a stream, by its full name and its namespace; None if it is not seen."""
        if self._sees_all:
            return stream
        if namespace != self.namespace and (self._fleet is None or not self._is_below(namespace)):
            return None
        return stream.removeprefix(f"{self.namespace}/") if self.namespace else stream

    def names(self, namespace: str) -> FrameNames:
        """How the frames of a namespace are called."""
        names = self._names.get(namespace)
        if names is None:
            below = namespace.removeprefix(self.namespace).strip("/")
            fleet = self._fleet or Fleet()
            names = self._names[namespace] = fleet.names(below if self._fleet else "")
        return names

    def _is_below(self, namespace: str) -> bool:
        return not self.namespace or namespace.startswith(f"{self.namespace}/")


Ints: TypeAlias = "NDArray[np.int64]"

# Why nothing was recorded, if the recorder was not paused: the fact "why" of the event.
STOPPED, CUT_OUT = "stopped", "cut out"

# A key of the recorder's metadata: equal in the files of one recording.
RECORDING = "recording"


@dataclass(frozen=True)
class Pause:
    """Nothing was recorded between two log times. `why` is "paused", "stopped" or "cut out"."""

    from_ns: int
    to_ns: int
    why: str = "paused"

    def said(self, start_ns: int) -> str:
        """A clause with the times since the beginning of the recording, as `--at` takes them."""
        from_s, to_s = ((each - start_ns) / 1e9 for each in (self.from_ns, self.to_ns))
        span = f"from {from_s:+.3f}s to {to_s:+.3f}s"
        if self.why == CUT_OUT:
            return f"what came {span} was cut out of the recording"
        return f"the recorder was {self.why} {span}"


def pauses_of(events: Iterable[EventItem], end_ns: int) -> tuple[Pause, ...]:
    """The pauses that these events tell of; one without an end lasts until `end_ns`."""
    found = []
    begun: EventItem | None = None
    for event in events:
        if event.kind == "paused" and begun is None:
            begun = event
        elif event.kind == "resumed" and begun is not None:
            found.append(Pause(begun.log_ns, event.log_ns, _why(begun)))
            begun = None
    if begun is not None:
        found.append(Pause(begun.log_ns, end_ns, _why(begun)))
    return tuple(found)


def recorded_ns(pauses: Iterable[Pause], from_ns: int, to_ns: int) -> int:
    """How long it was recorded between two log times."""
    inside = ((max(each.from_ns, from_ns), min(each.to_ns, to_ns)) for each in pauses)
    return to_ns - from_ns - sum(max(end - begin, 0) for begin, end in inside)


def _why(event: EventItem) -> str:
    why = event.facts.get("why")
    return printable(why, 40) if isinstance(why, str) and why else "paused"


def pauses_between(spans: Iterable[tuple[int, int, str]]) -> Iterator[EventItem]:
    """The events of a pause wherever no recorder ran. `spans` are the first and last log times of
    files, and which recording each is of, "" if it does not say.
    """
    until_ns, former = 0, ""
    for from_ns, to_ns, recording in sorted(spans):
        if former and recording and recording != former and from_ns > until_ns:
            yield EventItem(until_ns, "paused", facts={"why": STOPPED})
            yield EventItem(from_ns, "resumed")
        if to_ns > until_ns:
            until_ns, former = to_ns, recording


@dataclass(frozen=True, eq=False)
class Waits:
    """The times from each of N messages to the next: when they begin, and how long they are, each
    (N - 1,) in ns. With a pause in it, it is the longer of the waits before and after the pause,
    and not `is_whole` (N - 1,).
    """

    from_ns: Ints
    length_ns: Ints
    is_whole: NDArray[np.bool_]

    def period_s(self) -> float:
        """The median time from a message to the next; 0 for too few."""
        return float(np.median(self.length_ns)) * 1e-9 if len(self.length_ns) else 0.0

    def rate_hz(self) -> float | None:
        """Messages a second while it was recorded; None for too few."""
        span_s = float(self.length_ns[self.is_whole].sum()) * 1e-9
        return int(self.is_whole.sum()) / span_s if span_s > 0 else None


def waits_between(log_ns: Ints, pauses: Sequence[Pause]) -> Waits:
    """The waits between messages with these log times, which rise."""
    from_ns, length_ns = log_ns[:-1].copy(), np.diff(log_ns)
    is_whole = np.ones(len(length_ns), bool)
    for pause in pauses:
        at = int(np.searchsorted(log_ns, pause.from_ns, "right")) - 1
        if not 0 <= at < len(length_ns) or log_ns[at + 1] < pause.to_ns:
            continue  # none was sent before or after it; or another recorder was there
        before_ns = pause.from_ns - int(from_ns[at])
        after_ns = int(log_ns[at + 1]) - pause.to_ns
        if after_ns > before_ns:
            from_ns[at] = pause.to_ns
        length_ns[at] = max(before_ns, after_ns)
        is_whole[at] = False
    return Waits(from_ns, length_ns, is_whole)


def check_span(from_ns: int | None, to_ns: int | None) -> None:
    """Raise InvalidArgumentException for no stamps, and a span that ends before it begins."""
    for stamp_ns in (from_ns, to_ns):
        if stamp_ns is not None:
            check_stamp(stamp_ns)
    if from_ns is not None and to_ns is not None and to_ns < from_ns:
        raise InvalidArgumentException(
            f"the span ends before it begins: from_ns is {from_ns}, to_ns is {to_ns}"
        )
