"""The state of a bus at one moment: static sets, retained messages, streams and nodes."""

from dataclasses import replace

from tfbus.recording.items import EventItem, Item, TopicItem, TransformItem

# Streams come and go: as a listener remembers, at most this many that are gone are in force.
MOST_GONE = 1000


class BusState:
    """The state after the items that were taken.

    `statics` are the static transforms by the name of their stream, `retained` the last messages of
    topics that are retained, `streams` and `nodes` the events that describe them; `gone` are the
    streams that have gone, whose frames are still shown: the last thousand. Of nodes that have gone
    the last thousand are known too.
    """

    def __init__(self) -> None:
        self.statics: dict[str, TransformItem] = {}
        self.retained: dict[str, TopicItem] = {}
        self.streams: dict[str, EventItem] = {}
        self.nodes: dict[str, EventItem] = {}
        self.gone: dict[str, EventItem] = {}
        self._gone_nodes: dict[str, None] = {}

    def take(self, item: Item) -> None:
        """Take an item; items come in order of their log times."""
        if isinstance(item, TransformItem):
            if item.static:
                self.statics[item.stream.name] = item
        elif isinstance(item, EventItem):
            self._take_event(item)
        elif item.retained:
            self.retained[item.topic] = item

    def says(self, item: Item) -> bool:
        """Whether the item changes nothing, as it repeats what is in force."""
        if isinstance(item, TransformItem):
            return item.static and _is_same_set(self.statics.get(item.stream.name), item)
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

    def items(self, log_ns: int) -> list[Item]:
        """The items that put a bus into this state, all at this log time: nodes, streams, their
        static transforms, retained messages, and at last the streams that are gone.
        """
        retained = {name: replace(item, repeated=True) for name, item in self.retained.items()}
        groups = (self.nodes, self.streams, self.statics, retained, self.gone)
        return [replace(item, log_ns=log_ns) for group in groups for item in group.values()]

    def _take_event(self, item: EventItem) -> None:
        match item.kind:
            case "stream":
                self.streams[item.name] = item
                self.gone.pop(item.name, None)
            case "stream gone":
                self.gone.pop(item.name, None)
                self.gone[item.name] = item
                if len(self.gone) > MOST_GONE:
                    self._forget(next(iter(self.gone)))
            case "node":
                self.nodes[item.name] = item
                self._gone_nodes.pop(item.name, None)
            case "node gone":
                self.nodes.pop(item.name, None)
                self._gone_nodes[item.name] = None
                if len(self._gone_nodes) > MOST_GONE:
                    del self._gone_nodes[next(iter(self._gone_nodes))]

    def _forget(self, stream: str) -> None:
        for known in (self.gone, self.streams, self.statics):
            known.pop(stream, None)


def _is_same(former: EventItem | None, item: EventItem) -> bool:
    return former is not None and former.facts == item.facts


def _is_same_message(former: TopicItem | None, item: TopicItem) -> bool:
    if former is None:
        return False
    # As texts: 1, 1.0 and True are equal, and nan is not.
    return former.type_name == item.type_name and repr(former.values) == repr(item.values)


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
