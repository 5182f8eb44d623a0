"""The topics of a recording: their list, their messages, and how often these came."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from tfbus.cli.messages.message import transforms_map
from tfbus.command.recordings import BagChoice, OpenBag
from tfbus.errors import BusError
from tfbus.monitor.flow import Reading
from tfbus.recording.items import TopicItem, TransformItem
from tfbus.recording.pauses import recorded_ns
from tfbus.recording.reader import (
    TRANSFORMS_TYPE,
    RecordedTopic,
    topic_of_stream,
    topics_of,
)
from tfbus.recording.selection import Selection
from tfbus.wire.codec import encode_map
from tfbus.wire.keys import STATIC_TRANSFORMS, TRANSFORMS
from tfbus.wire.transforms import TransformMessage, encode_transforms
from tfbus.wording import did_you_mean

if TYPE_CHECKING:
    from tfbus.recording.reader import RecordingReader


@dataclass(frozen=True)
class RecordedMessage:
    """A message of a topic, and when it came."""

    topic: str
    received_ns: int
    item: TopicItem | TransformItem

    @property
    def values(self) -> dict[str, Any]:
        """Its fields by name."""
        if isinstance(self.item, TopicItem):
            return dict(self.item.values)
        return transforms_map(_message_of(self.item))

    @property
    def size(self) -> int:
        """Its bytes as it is sent on a bus."""
        if isinstance(self.item, TopicItem):
            return len(encode_map(self.item.values))
        return len(encode_transforms(_message_of(self.item)))

    @property
    def stamp_ns(self) -> int | None:
        """Its stamp, or that of its header; of transforms the newest; None if it has none."""
        if isinstance(self.item, TransformItem):
            return max(self.item.rows.stamps_as_ints(), default=0)
        return stamp_in(self.item.values)


def _message_of(item: TransformItem) -> TransformMessage:
    return TransformMessage(item.rows, item.stream.epoch_ns, item.seq)


def find_topic(reader: "RecordingReader", name: str) -> RecordedTopic:
    """The topic of this name, `tf` and `tf_static` for all streams. Raises BusError for none."""
    topics = topics_of(reader)
    if name in (TRANSFORMS, STATIC_TRANSFORMS):
        counts = [each.messages for at, each in topics.items() if at.startswith(f"{name}/")]
        return RecordedTopic(name, TRANSFORMS_TYPE, sum(counts))
    if name not in topics:
        hint = did_you_mean(name, topics, none=", nor any other")
        raise BusError(f"there is no topic {name!r} in the recording{hint}")
    return topics[name]


def messages_of(bag: OpenBag, name: str) -> Iterator[RecordedMessage]:
    """The messages of a topic in the span that was chosen. Raises BusError for no such topic."""
    topic = find_topic(bag.reader, name)
    from_ns, to_ns = bag.span
    if topic.type != TRANSFORMS_TYPE:
        for item in bag.reader.items(from_ns, to_ns, Selection(topics=(name,))):
            if isinstance(item, TopicItem):
                yield RecordedMessage(name, item.log_ns, item)
        return
    streams = tuple({each.stream.name for each in bag.reader.streams})
    for item in bag.reader.items(from_ns, to_ns, Selection(streams=streams)):
        if isinstance(item, TransformItem):
            kind = STATIC_TRANSFORMS if item.static else TRANSFORMS
            if name in (kind, topic_of_stream(kind, item.stream.name, item.stream.namespace)):
                yield RecordedMessage(name, item.log_ns, item)


def stamp_in(message: Mapping[str, Any]) -> int | None:
    """The field stamp_ns of a message, or of its header; None if it has none."""
    header = message.get("header")
    for fields in (message, header if isinstance(header, dict) else {}):
        stamp_ns = fields.get("stamp_ns")
        if type(stamp_ns) is int:
            return stamp_ns
    return None


def reading_of(
    choice: BagChoice, name: str, number_of: Callable[[RecordedMessage], float | None]
) -> Reading:
    """When the messages of a topic came, in seconds of time in which it was recorded, and a number
    of each; those of which it is None are left out.
    """
    arrivals_s: list[float] = []
    numbers: list[float] = []
    with choice.opened() as bag:
        start_ns, pauses = bag.reader.start_ns, bag.reader.pauses
        for message in messages_of(bag, name):
            number = number_of(message)
            if number is not None:
                arrivals_s.append(recorded_ns(pauses, start_ns, message.received_ns) / 1e9)
                numbers.append(number)
    return Reading(tuple(arrivals_s), tuple(numbers), len(numbers))
