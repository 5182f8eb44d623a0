"""Recordings out of recordings: a part of one, several in one, and with less in it."""

import filecmp
from collections import deque
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from heapq import merge
from itertools import chain
from operator import attrgetter

from tfbus.base.errors import InvalidArgumentException
from tfbus.base.wording import stamp_text
from tfbus.recording.items import (
    ALL,
    CUT_OUT,
    EventItem,
    Item,
    RecordedStream,
    Selection,
    TopicItem,
    TransformItem,
)
from tfbus.recording.reader import RecordingReader
from tfbus.recording.state import BusState

# How far apart, by their clocks, two recorders may have received the same message: one with a
# number, and one that is known by its content only.
_SAME_NUMBERED_NS = 60_000_000_000
_SAME_CONTENT_NS = 1_000_000_000


@dataclass(frozen=True)
class Span:
    """From one log time to another, both included."""

    from_ns: int
    to_ns: int

    def __post_init__(self) -> None:
        if self.to_ns < self.from_ns:
            raise InvalidArgumentException(
                f"a span ends before it begins: from {stamp_text(self.from_ns)} s to "
                f"{stamp_text(self.to_ns)} s"
            )


def cut(
    reader: RecordingReader, spans: Sequence[Span], selection: Selection = ALL
) -> Iterator[Item]:
    """The items of these spans, with the state in force at the beginning of each.

    The part between two spans was cut out, as the recording then says. Spans that overlap are
    joined.
    """
    state = BusState()
    former: Span | None = None
    for span in _in_order(spans):
        if former is not None:
            yield EventItem(former.to_ns, "paused", facts={"why": CUT_OUT})
            yield EventItem(span.from_ns, "resumed")
        before = reader.state_at(span.from_ns - 1, selection)
        for item in chain(
            _ended(state, before, span.from_ns),
            before.items(span.from_ns),
            reader.items(span.from_ns, span.to_ns, selection),
        ):
            if not state.says(item):
                state.apply(item)
                yield item
        former = span


def joined(readers: Sequence[RecordingReader], selection: Selection = ALL) -> Iterator[Item]:
    """The items of several recordings in order of log time.

    A stream or topic that several have is one in the result. A message that several recorders of
    one bus received comes once, if their clocks agree: to a minute for numbered transforms, to a
    second for other messages.
    """
    state = BusState()
    repeated = _Repeated([Span(reader.start_ns, reader.end_ns) for reader in readers])
    for item, number in merge(
        *(_numbered(reader, number, selection) for number, reader in enumerate(readers)),
        key=lambda pair: pair[0].log_ns,
    ):
        if state.says(item) or repeated.is_of_another(item, number, state):
            continue
        state.apply(item)
        yield item


def without(items: Iterator[Item], names: Collection[str]) -> Iterator[Item]:
    """The items without topics, streams and child frames of these names."""
    for item in items:
        if isinstance(item, TopicItem) and item.topic in names:
            continue
        if isinstance(item, EventItem) and item.kind.startswith("stream") and item.name in names:
            continue
        if not isinstance(item, TransformItem):
            yield item
        elif item.stream.name not in names:
            rows = item.rows.without(names)
            if rows.count or item.static:
                yield replace(item, rows=rows)


def in_namespace(items: Iterator[Item], namespace: str) -> Iterator[Item]:
    """The items with their streams, topics and nodes below a namespace, as of a fleet's robot."""
    for item in items:
        if isinstance(item, TopicItem):
            yield replace(item, topic=f"{namespace}/{item.topic}")
        elif isinstance(item, TransformItem):
            yield replace(item, stream=_stream_in(item.stream, namespace))
        else:
            yield _event_in(item, namespace)


def _stream_in(stream: RecordedStream, namespace: str) -> RecordedStream:
    below = f"{namespace}/{stream.namespace}" if stream.namespace else namespace
    node = f"/{namespace}{stream.node}" if stream.node else ""
    return replace(stream, name=f"{namespace}/{stream.name}", node=node, namespace=below)


def _event_in(event: EventItem, namespace: str) -> EventItem:
    if event.kind in ("stream", "stream gone"):
        facts = dict(event.facts)
        if facts.get("node"):
            facts["node"] = f"/{namespace}{facts['node']}"
        return replace(event, name=f"{namespace}/{event.name}", facts=facts)
    if event.kind in ("node", "node gone"):
        name = f"/{namespace}/{event.name.removeprefix('/')}"
        # Its topics and streams are named within its namespace, as they were.
        return replace(event, name=name, facts={**event.facts, "name": name} if event.facts else {})
    return event


def conflicting_epochs(readers: Sequence[RecordingReader]) -> tuple[str, ...]:
    """Streams that two recordings of the same time have in different epochs, by name.

    They have two publishers, as of two robots: of one stream only the newest epoch counts.
    """
    found: set[str] = set()
    for at, first in enumerate(readers):
        for second in readers[at + 1 :]:
            if first.end_ns < second.start_ns or second.end_ns < first.start_ns:
                continue
            ours, others = _epochs(first), _epochs(second)
            found |= {name for name in ours.keys() & others.keys() if ours[name] != others[name]}
    return tuple(sorted(found))


def repeated(
    readers: Sequence[RecordingReader],
) -> list[tuple[RecordingReader, RecordingReader]]:
    """The recordings that are the same files, byte by byte, as one before; each with that one."""
    found: list[tuple[RecordingReader, RecordingReader]] = []
    different: list[RecordingReader] = []
    for reader in readers:
        first = next((each for each in different if _are_same_files(each, reader)), None)
        if first is None:
            different.append(reader)
        else:
            found.append((reader, first))
    return found


def _are_same_files(first: RecordingReader, second: RecordingReader) -> bool:
    pairs = list(zip(first.parts, second.parts, strict=False))
    return len(first.parts) == len(second.parts) and all(
        one.size == other.size and filecmp.cmp(one.path, other.path, shallow=False)
        for one, other in pairs
    )


def _epochs(reader: RecordingReader) -> dict[str, set[int]]:
    epochs: dict[str, set[int]] = {}
    for each in reader.streams:
        epochs.setdefault(each.stream.name, set()).add(each.stream.epoch_ns)
    return epochs


def _in_order(spans: Sequence[Span]) -> list[Span]:
    """The spans by their beginning; spans that overlap or touch are joined."""
    found: list[Span] = []
    for span in sorted(spans, key=attrgetter("from_ns")):
        if found and span.from_ns <= found[-1].to_ns + 1:
            found[-1] = Span(found[-1].from_ns, max(found[-1].to_ns, span.to_ns))
        else:
            found.append(span)
    return found


def _ended(state: BusState, later: BusState, log_ns: int) -> Iterator[EventItem]:
    """Events for nodes and streams that have gone between two spans."""
    # Lists: the state changes with each event.
    for name in [each for each in state.nodes if each not in later.nodes]:
        yield EventItem(log_ns, "node gone", name)
    alive = [each for each in state.streams if each not in state.gone]
    for name in [each for each in alive if each not in later.streams]:
        yield EventItem(log_ns, "stream gone", name)


def _numbered(
    reader: RecordingReader, number: int, selection: Selection
) -> Iterator[tuple[Item, int]]:
    for item in reader.items(selection=selection):
        yield item, number


class _Repeated:
    """Finds messages that another recording gave already, if two overlap in time.

    A message is the same by its content and number. Without a number the same content may be sent
    again: then it is the same message only if it was received within a second, while both recorded.
    A message that a recorder received first of a retained topic may have been in force for long.
    """

    def __init__(self, spans: Sequence[Span]) -> None:
        self._spans = spans
        # By content: when a message was received first, and the recordings that had it so far.
        self._received: dict[int, list[tuple[int, set[int]]]] = {}
        self._in_order: deque[tuple[int, int]] = deque()
        self._has_retained: set[tuple[int, str]] = set()

    def is_of_another(self, item: Item, number: int, state: BusState) -> bool:
        """Whether another recording had the message before. Items come in order of log time;
        `state` was in force before this one.
        """
        if isinstance(item, EventItem):
            return False
        is_numbered = isinstance(item, TransformItem) and item.seq is not None
        apart_ns = _SAME_NUMBERED_NS if is_numbered else _SAME_CONTENT_NS
        others = self._recording_at(item.log_ns, apart_ns if is_numbered else 0) - {number}
        was_in_force = isinstance(item, TopicItem) and self._was_in_force(item, number, state)
        if was_in_force or not others:
            return was_in_force and bool(others)
        self._forget_before(item.log_ns - _SAME_NUMBERED_NS)
        digest = _digest(item)
        received = self._received.setdefault(digest, [])
        for log_ns, numbers in reversed(received):
            if item.log_ns - log_ns > apart_ns:
                break
            # One that has ended cannot have had this message.
            if number not in numbers and not numbers.isdisjoint(others):
                numbers.add(number)
                return True
        received.append((item.log_ns, {number}))
        self._in_order.append((item.log_ns, digest))
        return False

    def _was_in_force(self, item: TopicItem, number: int, state: BusState) -> bool:
        """Whether it is the first of a retained topic that a recorder received, and no news."""
        if not item.retained or (number, item.topic) in self._has_retained:
            return False
        self._has_retained.add((number, item.topic))
        return state.says(replace(item, repeated=True))

    def _recording_at(self, log_ns: int, slack_ns: int) -> set[int]:
        """The recordings that were made at this time, by their numbers."""
        return {
            number
            for number, span in enumerate(self._spans)
            if span.from_ns - slack_ns <= log_ns <= span.to_ns + slack_ns
        }

    def _forget_before(self, log_ns: int) -> None:
        while self._in_order and self._in_order[0][0] < log_ns:
            _, digest = self._in_order.popleft()
            received = self._received[digest]
            del received[0]
            if not received:
                del self._received[digest]


def _digest(item: TransformItem | TopicItem) -> int:
    if isinstance(item, TopicItem):
        return hash((item.topic, item.content))
    rows, stream = item.rows, item.stream
    names = tuple([(rows.frames[parent], rows.frames[child]) for parent, child in rows.pairs()])
    told = (stream.name, stream.epoch_ns, item.static, item.seq)
    return hash((told, names, rows.stamps_bytes(), rows.poses_bytes()))
