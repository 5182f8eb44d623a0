"""State at a moment of a recording: what stands for the time before it."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Protocol

from tfbus.recording.former import last_item
from tfbus.recording.items import EventItem, Item, TopicItem, TransformItem
from tfbus.recording.selection import ALL, Selection


class State(Protocol):
    """The state at a moment of a recording."""

    def items(self, log_ns: int) -> list[Item]:
        """The events and static sets that stand for it."""


class Source(Protocol):
    """The items for a player: a RecordingReader."""

    @property
    def start_ns(self) -> int:
        """The log time of the first item."""

    @property
    def end_ns(self) -> int:
        """The log time of the last item."""

    def items(
        self, from_ns: int | None = None, to_ns: int | None = None, selection: Selection = ALL
    ) -> Iterator[Item]:
        """The items of a span in the order of their log times."""

    def state_at(self, log_ns: int, selection: Selection = ALL) -> State:
        """The state at a log time."""


def in_force(
    source: Source, at_ns: int, selection: Selection, lasting: Sequence[str], look_back_ns: int
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


def _last_messages(source: Source, at_ns: int, topics: Sequence[str]) -> Iterator[Item]:
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
    children: dict[str, set[str]] = {}
    for event in state:
        if isinstance(event, EventItem) and event.kind == "stream":
            epochs[event.name] = event.facts.get("epoch", epochs.get(event.name))
            children[event.name] = {row[1] for row in event.facts.get("frames", ())}
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
