"""Recordings out of recordings: a part of one, several in one, and with less in it."""

from collections import Counter, deque
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from heapq import merge

from tfbus.errors import InvalidArgumentException
from tfbus.recording.items import EventItem, Item, RecordedStream, TopicItem, TransformItem
from tfbus.recording.reader import RecordingReader
from tfbus.recording.selection import ALL, Selection
from tfbus.recording.state import BusState
from tfbus.wording import stamp_text

# Two recorders may have received the same message at times as far apart, by their clocks.
_SAME_MESSAGE_NS = 60_000_000_000


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
    """The items of these spans, with what is in force at the beginning of each.

    Between two spans the recorder was paused, as the recording then says. Spans that overlap are
    joined.
    """
    state = BusState()
    former: Span | None = None
    for span in _in_order(spans):
        if former is not None:
            yield EventItem(former.to_ns, "paused")
            yield EventItem(span.from_ns, "resumed")
        before = reader.state_at(span.from_ns - 1, selection)
        beginning = [*_ended(state, before, span.from_ns), *before.items(span.from_ns)]
        for item in (*beginning, *reader.items(span.from_ns, span.to_ns, selection)):
            if not state.says(item):
                state.take(item)
                yield item
        former = span


def joined(readers: Sequence[RecordingReader], selection: Selection = ALL) -> Iterator[Item]:
    """The items of several recordings in order of log time.

    A stream or topic that several have is one in the result. A message that several recorders of
    one bus received, up to a minute apart by their clocks, comes once.
    """
    state = BusState()
    repeated = _Repeated([Span(reader.start_ns, reader.end_ns) for reader in readers])
    for item, number in merge(
        *(_numbered(reader, number, selection) for number, reader in enumerate(readers)),
        key=lambda pair: pair[0].log_ns,
    ):
        if state.says(item) or repeated.is_of_another(item, number):
            continue
        state.take(item)
        yield item


def without(items: Iterator[Item], names: Collection[str]) -> Iterator[Item]:
    """The items without those of topics, streams and child frames of these names."""
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
    """The items with their streams, topics and nodes below a namespace, as those of one robot of a
    fleet.
    """
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
        return replace(event, name=f"/{namespace}/{event.name.removeprefix('/')}")
    return event


def conflicting_epochs(readers: Sequence[RecordingReader]) -> tuple[str, ...]:
    """Streams that two recordings of the same time have in different epochs, by name.

    That are two publishers, as of two robots: of one stream only the newest epoch counts.
    """
    found: set[str] = set()
    for at, first in enumerate(readers):
        for second in readers[at + 1 :]:
            if first.end_ns < second.start_ns or second.end_ns < first.start_ns:
                continue
            ours, others = _epochs(first), _epochs(second)
            found |= {name for name in ours.keys() & others.keys() if ours[name] != others[name]}
    return tuple(sorted(found))


def _epochs(reader: RecordingReader) -> dict[str, set[int]]:
    epochs: dict[str, set[int]] = {}
    for each in reader.streams:
        epochs.setdefault(each.stream.name, set()).add(each.stream.epoch_ns)
    return epochs


def _in_order(spans: Sequence[Span]) -> list[Span]:
    """The spans by their beginning, those that overlap or touch as one."""
    found: list[Span] = []
    for span in sorted(spans, key=lambda each: each.from_ns):
        if found and span.from_ns <= found[-1].to_ns + 1:
            found[-1] = Span(found[-1].from_ns, max(found[-1].to_ns, span.to_ns))
        else:
            found.append(span)
    return found


def _ended(state: BusState, later: BusState, log_ns: int) -> Iterator[EventItem]:
    """Events for what has gone between two spans."""
    for name in state.nodes.keys() - later.nodes.keys():
        yield EventItem(log_ns, "node gone", name)
    for name in state.streams.keys() - state.gone.keys():
        if name not in later.streams:
            yield EventItem(log_ns, "stream gone", name)


def _numbered(
    reader: RecordingReader, number: int, selection: Selection
) -> Iterator[tuple[Item, int]]:
    for item in reader.items(selection=selection):
        yield item, number


class _Repeated:
    """Finds messages that another recording gave already, where two overlap in time."""

    def __init__(self, spans: Sequence[Span]) -> None:
        self._spans = spans
        # By message, how often each recording has had it; and when, to forget it.
        self._counts: dict[int, Counter[int]] = {}
        self._when: deque[tuple[int, int]] = deque()

    def is_of_another(self, item: Item, number: int) -> bool:
        """Whether another recording had the message as often before. Items come in order."""
        if isinstance(item, EventItem) or not self._overlaps(item.log_ns, number):
            return False
        while self._when and self._when[0][0] < item.log_ns - _SAME_MESSAGE_NS:
            self._counts.pop(self._when.popleft()[1], None)
        digest = _digest(item)
        counts = self._counts.get(digest)
        if counts is None:
            counts = self._counts[digest] = Counter()
            self._when.append((item.log_ns, digest))
        counts[number] += 1
        return any(counts[other] >= counts[number] for other in counts if other != number)

    def _overlaps(self, log_ns: int, number: int) -> bool:
        return any(
            span.from_ns - _SAME_MESSAGE_NS <= log_ns <= span.to_ns + _SAME_MESSAGE_NS
            for at, span in enumerate(self._spans)
            if at != number
        )


def _digest(item: TransformItem | TopicItem) -> int:
    if isinstance(item, TopicItem):
        return hash((item.topic, item.type_name, repr(item.values)))
    rows, stream = item.rows, item.stream
    names = tuple([(rows.frames[parent], rows.frames[child]) for parent, child in rows.pairs()])
    told = (stream.name, stream.epoch_ns, item.static, item.seq)
    return hash((told, names, rows.stamps_bytes(), rows.poses_bytes()))
