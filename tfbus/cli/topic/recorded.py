"""The topics of a recording: their list, their messages, and how often these came."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from tfbus.cli.messages.message import transforms_map
from tfbus.cli.messages.view import MessageFilter
from tfbus.command.recordings import BagChoice, OpenBag
from tfbus.errors import BusError
from tfbus.monitor.window import Reading
from tfbus.recording.items import TopicItem, TransformItem
from tfbus.recording.selection import Selection
from tfbus.wire.keys import STATIC_TRANSFORMS, TRANSFORMS
from tfbus.wire.transforms import TransformMessage
from tfbus.wording import did_you_mean

if TYPE_CHECKING:
    from tfbus.recording.reader import RecordingReader


@dataclass(frozen=True)
class RecordedTopic:
    """A topic: its name, the name of its type, "" where unknown, and how many messages came."""

    name: str
    type: str
    messages: int


@dataclass(frozen=True)
class RecordedMessage:
    """A message of a topic as a map, and when it came."""

    received_ns: int
    values: dict[str, Any]


TRANSFORMS_TYPE = "TransformMessage"


def topics_of(reader: "RecordingReader") -> dict[str, RecordedTopic]:
    """All topics by name; `tf/STREAM` and `tf_static/STREAM` have the transforms of a stream."""
    found: dict[str, RecordedTopic] = {}
    for topic in reader.topics:
        found[topic.name] = RecordedTopic(topic.name, topic.type_name, topic.messages)
    for each in reader.streams:
        for kind, count in (
            (TRANSFORMS, each.messages),
            (STATIC_TRANSFORMS, each.static_messages),
        ):
            name = _topic_of(kind, each.stream.name, each.stream.namespace)
            if count:
                before = found[name].messages if name in found else 0
                found[name] = RecordedTopic(name, TRANSFORMS_TYPE, before + count)
    return dict(sorted(found.items()))


def _topic_of(kind: str, stream: str, namespace: str) -> str:
    if not namespace:
        return f"{kind}/{stream}"
    return f"{namespace}/{kind}/{stream.removeprefix(f'{namespace}/')}"


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
                yield RecordedMessage(item.log_ns, dict(item.values))
        return
    streams = tuple({each.stream.name for each in bag.reader.streams})
    for item in bag.reader.items(from_ns, to_ns, Selection(streams=streams)):
        if isinstance(item, TransformItem):
            kind = STATIC_TRANSFORMS if item.static else TRANSFORMS
            if name in (kind, _topic_of(kind, item.stream.name, item.stream.namespace)):
                message = TransformMessage(item.rows, item.stream.epoch_ns, item.seq)
                yield RecordedMessage(item.log_ns, transforms_map(message))


def arrivals_of(choice: BagChoice, name: str, wanted: MessageFilter | None) -> Reading:
    """When the messages of a topic came, or those that the filter takes."""
    with choice.opened() as bag:
        arrivals_s = tuple(
            each.received_ns / 1e9
            for each in messages_of(bag, name)
            if wanted is None or wanted.takes(each.values)
        )
    return Reading(arrivals_s, (0.0,) * len(arrivals_s), len(arrivals_s))
