"""The topics of a recording, those with transforms among them."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from tfbus.wire.keys import STATIC_TRANSFORMS, TRANSFORMS

if TYPE_CHECKING:
    from tfbus.recording.reader import RecordingReader

TRANSFORMS_TYPE = "TransformMessage"


@dataclass(frozen=True)
class RecordedTopic:
    """A topic: its name, the name of its type, "" if unknown, and how many messages came."""

    name: str
    type: str
    messages: int


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
            name = topic_of_stream(kind, each.stream.name, each.stream.namespace)
            if count:
                before = found[name].messages if name in found else 0
                found[name] = RecordedTopic(name, TRANSFORMS_TYPE, before + count)
    return dict(sorted(found.items()))


def topic_of_stream(kind: str, stream: str, namespace: str) -> str:
    """The topic with the transforms of a stream, of the kind `tf` or `tf_static`."""
    if not namespace:
        return f"{kind}/{stream}"
    return f"{namespace}/{kind}/{stream.removeprefix(f'{namespace}/')}"
