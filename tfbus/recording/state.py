"""State at a moment of a recording: all that stands for the time before it, or for all times."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from operator import attrgetter
from typing import Literal, Protocol

from tfbus.base.bounded import Bounded
from tfbus.geometry.columns import Columns
from tfbus.geometry.packed import edge_bytes
from tfbus.recording.items import ALL, EventItem, Item, Selection, TopicItem, TransformItem

# Streams come and go: as a listener remembers, at most this many that are gone are in force.
MOST_GONE = 1000

# A publisher may have other frames after each restart: of at most as many former epochs of a
# stream the frames are in force.
MOST_FORMER = 16


class BusState:
    """The state after the items that were taken.

    `retained` are the last messages of topics that are retained, `streams` and `nodes` the events
    that describe them; `gone` are the streams that have gone, whose frames are still shown: the
    last thousand. Of nodes that have gone the last thousand are known too.
    """

    def __init__(self) -> None:
        # By stream and epoch. Of a former epoch there is what no later one has had: a listener
        # keeps these frames, as gone.
        self._sets: dict[tuple[str, int], TransformItem] = {}
        self._epochs: dict[str, list[int]] = {}
        self.retained: dict[str, TopicItem] = {}
        self.streams: dict[str, EventItem] = {}
        self.nodes: dict[str, EventItem] = {}
        self.gone: Bounded[str, EventItem] = Bounded(MOST_GONE, self._forget)
        self._gone_nodes: Bounded[str, None] = Bounded(MOST_GONE)

    def apply(self, item: Item) -> None:
        """Apply an item; items come in order of their log times."""
        if isinstance(item, TransformItem):
            if item.static and not self.says(item):
                self._apply_set(item)
        elif isinstance(item, EventItem):
            self._apply_event(item)
        elif item.retained:
            self.retained[item.topic] = item

    def says(self, item: Item) -> bool:
        """Whether the item changes nothing, as it repeats the state in force."""
        if isinstance(item, TransformItem):
            known = self._sets.get((item.stream.name, item.stream.epoch_ns))
            return item.static and _is_same_set(known, item)
        if isinstance(item, TopicItem):
            return item.repeated and _is_same_message(self.retained.get(item.topic), item)
        match item.kind:
            case "stream":
                return item.name not in self.gone and _is_same(self.streams.get(item.name), item)
            case "node":
                return _is_same(self.nodes.get(item.name), item)
            case "stream gone":
                return item.name in self.gone
            case "node gone":
                return item.name in self._gone_nodes
        return False

    @property
    def statics(self) -> list[TransformItem]:
        """The static transforms in force: of each stream its set, and what its former epochs have
        left. The set that changed last is the last: of two with one frame it counts.
        """
        return list(self._sets.values())

    def items(self, log_ns: int) -> list[Item]:
        """The items that put a bus into this state, all at this log time: nodes, streams, their
        static transforms, retained messages, and at last the streams that are gone.
        """
        retained = {name: replace(item, repeated=True) for name, item in self.retained.items()}
        groups = (self.nodes, self.streams, retained, self.gone)
        nodes, streams, messages, gone = (group.values() for group in groups)
        found = [*nodes, *streams, *self.statics, *messages, *gone]
        return [replace(item, log_ns=log_ns) for item in found]

    def _apply_set(self, item: TransformItem) -> None:
        name, epoch_ns = item.stream.name, item.stream.epoch_ns
        epochs = self._epochs.setdefault(name, [])
        described_ns = 0 if name in self.gone else _epoch_ns(self.streams.get(name))
        if epochs and epoch_ns < min(epochs[-1], described_ns):
            # Late, as the publisher has been started again; or a file says what is left of it.
            if epoch_ns in epochs:
                left = self._sets[name, epoch_ns].rows.children() - item.rows.children()
                self._take_from_former(name, left, [epoch_ns])
            return
        if epoch_ns in epochs:
            self._drop_set(name, epoch_ns)
        self._take_from_former(name, item.rows.children(), epochs)
        for each in epochs[: max(0, len(epochs) - MOST_FORMER)]:
            self._drop_set(name, each)
        self._put_before(name, epoch_ns)
        epochs.append(epoch_ns)
        self._sets[name, epoch_ns] = item

    def _put_before(self, name: str, epoch_ns: int) -> None:
        """Give former sets epochs before this one: it is smaller if the clock of the publisher was
        behind when it was started again, and who hears of all sets at once takes the latest.
        """
        formers = self._epochs[name]
        if not formers or formers[-1] < epoch_ns:
            return
        latest = range(epoch_ns - len(formers), epoch_ns)
        epochs = dict(zip(formers, map(min, formers, latest), strict=True))
        self._epochs[name][:] = epochs.values()
        self._sets = {
            (stream, epochs[each]) if stream == name else (stream, each): (
                replace(item, stream=replace(item.stream, epoch_ns=epochs[each]))
                if stream == name
                else item
            )
            for (stream, each), item in self._sets.items()
        }

    def _drop_set(self, name: str, epoch_ns: int) -> None:
        self._epochs[name].remove(epoch_ns)
        del self._sets[name, epoch_ns]

    def _take_from_former(self, name: str, children: frozenset[str], former: Iterable[int]) -> None:
        """Take these frames out of what former epochs of a stream have left."""
        for epoch_ns in list(former):
            item = self._sets[name, epoch_ns]
            rows = item.rows.without(children)
            if not rows.count:
                self._drop_set(name, epoch_ns)
            elif rows.count != item.rows.count:
                self._sets[name, epoch_ns] = replace(item, rows=rows)

    def _describe(self, item: EventItem) -> None:
        """Take a description. Frames that the one before has had, and this one does not, have been
        removed or sent in its epoch: so they are not what a former epoch has left.
        """
        name, before = item.name, self.streams.get(item.name)
        if before is not None and (dropped := before.children - item.children):
            former = [each for each in self._epochs.get(name, ()) if each < _epoch_ns(before)]
            self._take_from_former(name, dropped, former)
        self.streams[name] = item
        self.gone.pop(name, None)

    def _apply_event(self, item: EventItem) -> None:
        match item.kind:
            case "stream":
                self._describe(item)
            case "stream gone":
                self.gone[item.name] = item
            case "node":
                self.nodes[item.name] = item
                self._gone_nodes.pop(item.name, None)
            case "node gone":
                self.nodes.pop(item.name, None)
                self._gone_nodes[item.name] = None

    def _forget(self, stream: str, _: EventItem) -> None:
        self.streams.pop(stream, None)
        for epoch_ns in self._epochs.pop(stream, ()):
            del self._sets[stream, epoch_ns]


def _epoch_ns(description: EventItem | None) -> int:
    """The epoch of a description; 0 if there is none, or it says none."""
    epoch_ns = None if description is None else description.facts.get("epoch")
    return epoch_ns if isinstance(epoch_ns, int) else 0


def _is_same(former: EventItem | None, item: EventItem) -> bool:
    return former is not None and former.facts == item.facts


def _is_same_message(former: TopicItem | None, item: TopicItem) -> bool:
    return former is not None and former.content == item.content


def _is_same_set(former: TransformItem | None, item: TransformItem) -> bool:
    if former is None or (former.stream, former.seq) != (item.stream, item.seq):
        return False
    ours, others = former.rows, item.rows
    return (
        ours.stamps_bytes() == others.stamps_bytes()
        and ours.poses_bytes() == others.poses_bytes()
        and [(ours.frames[a], ours.frames[b]) for a, b in ours.pairs()]
        == [(others.frames[a], others.frames[b]) for a, b in others.pairs()]
    )


# This much is read at first, and then four times as much each time.
_FIRST_SPAN_NS = 200_000_000


class ItemsInOrder(Protocol):
    """Items by their log times: a RecordingReader."""

    def items(
        self, from_ns: int | None = None, to_ns: int | None = None, selection: Selection = ALL
    ) -> Iterator[Item]:
        """The items of a span in the order of their log times."""


def last_item(
    source: ItemsInOrder,
    start_ns: int,
    until_ns: int,
    selection: Selection = ALL,
    is_wanted: Callable[[Item], bool] = lambda item: True,
) -> Item | None:
    """The last item that is wanted from one log time to another, both included; None if there
    is none.
    """
    span_ns = _FIRST_SPAN_NS
    while until_ns >= start_ns:
        from_ns = max(until_ns - span_ns, start_ns)
        found = None
        for item in source.items(from_ns, until_ns, selection):
            if is_wanted(item):
                found = item
        if found is not None:
            return found
        until_ns, span_ns = from_ns - 1, 4 * span_ns
    return None


class StateItems(Protocol):
    """The state at a moment of a recording, as items."""

    def items(self, log_ns: int) -> list[Item]:
        """The events and static sets that stand for it."""


class Playable(ItemsInOrder, Protocol):
    """A recording that can be played: a RecordingReader."""

    @property
    def start_ns(self) -> int:
        """The log time of the first item."""

    @property
    def end_ns(self) -> int:
        """The log time of the last item."""

    def state_at(self, log_ns: int, selection: Selection = ALL) -> StateItems:
        """The state at a log time."""


def items_of_state(
    source: Playable, at_ns: int, selection: Selection, lasting: Sequence[str], look_back_ns: int
) -> list[Item]:
    """The last messages of the topics `lasting`, then the events and static sets, and where each
    frame was last, if that was within `look_back_ns`. Streams that are gone come at the end.
    """
    state = source.state_at(at_ns, selection).items(at_ns)
    gone = [item for item in state if _is_gone(item)]
    there = [item for item in state if not _is_gone(item)]
    before: list[TransformItem] = []
    if look_back_ns and at_ns > source.start_ns:
        former = source.items(max(at_ns - look_back_ns, source.start_ns), at_ns - 1, selection)
        before = _last_of_each(former, there)
    return [*_last_messages(source, at_ns, lasting), *there, *before, *gone]


def _last_messages(source: Playable, at_ns: int, topics: Sequence[str]) -> Iterator[Item]:
    for topic in topics:
        of_topic = Selection(topics=(topic,))
        item = last_item(source, source.start_ns, at_ns, of_topic, _is_message)
        if item is not None:
            yield item


def _last_of_each(former: Iterable[Item], state: Iterable[Item]) -> list[TransformItem]:
    """Of these items the last dynamic transforms of each stream and frames; none of former epochs,
    nor of frames that were removed.
    """
    last: dict[tuple[str, tuple[str, ...]], TransformItem] = {}
    epochs: dict[str, int] = {}
    for item in former:
        if isinstance(item, TransformItem) and not item.static:
            name = item.stream.name
            epochs[name] = item.stream.epoch_ns
            key = (name, item.rows.frames)
            # So the order is that of the messages.
            last.pop(key, None)
            last[key] = item
    children: dict[str, frozenset[str]] = {}
    for event in state:
        if isinstance(event, EventItem) and event.kind == "stream":
            epochs[event.name] = event.facts.get("epoch", epochs.get(event.name))
            children[event.name] = event.children
    found = []
    for (name, _), item in last.items():
        if item.stream.epoch_ns != epochs[name]:
            continue
        rows = item.rows.only(children[name]) if children.get(name) else item.rows
        if rows.count:
            found.append(replace(item, rows=rows))
    return found


def _is_message(item: Item) -> bool:
    return isinstance(item, TopicItem)


def _is_gone(item: Item) -> bool:
    return isinstance(item, EventItem) and item.kind == "stream gone"


# The static transforms that a lookup knows: of the whole recording, or only as received by then.
Statics = Literal["always", "then"]
STATICS: tuple[Statics, ...] = ("always", "then")


class LastingStatics:
    """The static transforms that each frame was given first: they hold before they came, too, as
    static transforms do in a buffer that has all of the recording.

    They are made of sets in which each frame is static for the first time, such as a reader's
    `first_statics`. Of a frame that several streams set the first one counts.
    """

    def __init__(self, sets: Iterable[TransformItem]) -> None:
        first: dict[str, TransformItem] = {}
        for item in sets:
            for child in item.rows.children():
                if child not in first or item.log_ns < first[child].log_ns:
                    first[child] = item
        # By stream: its sets with frames that come first there, and these frames.
        self._of_stream: dict[str, list[tuple[TransformItem, frozenset[str]]]] = {}
        own: dict[int, set[str]] = {}
        for child, item in first.items():
            own.setdefault(id(item), set()).add(child)
        for item in {id(each): each for each in first.values()}.values():
            children = frozenset(own[id(item)])
            self._of_stream.setdefault(item.stream.name, []).append((item, children))

    def with_later(self, sets: Iterable[TransformItem], log_ns: int) -> list[TransformItem]:
        """The static sets in force at a log time, with the frames that come later only."""
        sets = list(sets)
        last = {item.stream.name: item for item in sets}
        found = [self.widened(item) if item is last[item.stream.name] else item for item in sets]
        for name, firsts in self._of_stream.items():
            if name not in last and all(item.log_ns > log_ns for item, _ in firsts):
                earliest = min((item for item, _ in firsts), key=attrgetter("log_ns"))
                found.append(self.widened(replace(earliest, log_ns=log_ns, rows=_NONE, seq=None)))
        return found

    def widened(self, item: TransformItem) -> TransformItem:
        """A static set with the frames that its stream sets later for the first time."""
        own = item.rows.children()
        later = [
            first.rows.only(children - own)
            for first, children in self._of_stream.get(item.stream.name, ())
            if first.log_ns > item.log_ns and not children <= own
        ]
        return replace(item, rows=_joined([item.rows, *later])) if later else item


_NONE = Columns.of_bytes((), b"", b"", b"")


def _joined(parts: list[Columns]) -> Columns:
    """All rows, as they are: rows of a file may be no valid transforms."""
    numbers: dict[str, int] = {}
    edges = [
        edge_bytes(
            numbers.setdefault(rows.frames[parent], len(numbers)),
            numbers.setdefault(rows.frames[child], len(numbers)),
        )
        for rows in parts
        for parent, child in rows.pairs()
    ]
    stamps = b"".join(rows.stamps_bytes() for rows in parts)
    poses = b"".join(rows.poses_bytes() for rows in parts)
    return Columns.of_bytes(tuple(numbers), b"".join(edges), stamps, poses)
