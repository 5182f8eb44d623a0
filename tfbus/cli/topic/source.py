"""The topics of a bus, heard by a hidden node, and of a recording: one of any type, by its name.

`tf/sim` and `tf_static/sim` are the transforms of the stream `sim`; `tf` and `tf_static` of all
streams.
"""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from struct import iter_unpack
from typing import TYPE_CHECKING, Any

from tfbus.base.errors import BusError, DecodeError
from tfbus.base.log import LogOnce
from tfbus.base.wording import did_you_mean
from tfbus.bus.graph import TRANSFORMS_TYPE, Graph, TopicInfo
from tfbus.bus.settings import NodeSettings
from tfbus.cli.bus import look
from tfbus.cli.message import supplied_type
from tfbus.command.recordings import BagChoice, OpenBag
from tfbus.command.types import own_name
from tfbus.frames.windows import WindowReading
from tfbus.geometry.columns import Columns
from tfbus.recording.items import Selection, TopicItem, TransformItem, recorded_ns
from tfbus.recording.reader import (
    RecordedTopic,
    RecordingReader,
    topic_of_stream,
    topics_of,
)
from tfbus.ros.counterparts import with_arrays
from tfbus.ros.definitions import message_named
from tfbus.wire.codec import as_map, decode_map, decode_message, encode_map, stamp_in
from tfbus.wire.keys import STATIC_TRANSFORMS, TRANSFORMS, is_foreign
from tfbus.wire.transforms import (
    TransformMessage,
    decode_transforms,
    encode_transforms,
    is_numbered,
)

if TYPE_CHECKING:
    from tfbus.node.node import Node


# The bytes of one message as a map; raises DecodeError.
Reader = Callable[[bytes], dict[str, Any]]

# After this long without a message, the tools print that they wait.
SAY_AFTER_S = 2.0

# A hint for a bus without transforms.
_SHOWN_BY = {
    TRANSFORMS: "tfbus frames shows all frames, and tfbus echo TARGET SOURCE one from another",
    STATIC_TRANSFORMS: "tfbus static world camera publishes one, and tfbus frames shows all frames",
}


@contextmanager
def visiting(settings: NodeSettings, purpose: str, *, goes_on: bool = True) -> Iterator["Node"]:
    """A node for a tool that listens or publishes; Ctrl-C and SIGTERM end it without a word.

    They are the usual end of a tool that goes on until then, which exits with 0. Another one
    exits with 130; if a wait returned before its answer came, it raises KeyboardInterrupt.

    Its name starts with `_`, so lists of nodes omit it.
    """
    from tfbus.node.node import Node  # numpy, which completion and `--help` do not need

    try:
        with Node.from_settings(settings.named_by_default(own_name(f"_{purpose}"))) as node:
            node.session.settle()
            yield node
            return
    except KeyboardInterrupt:
        pass
    # Also if the node's `with` swallowed the interrupt.
    raise SystemExit(0 if goes_on else 128 + signal.SIGINT)


def subscribe(
    node: "Node",
    topic: str,
    type_name: str,
    callback: Callable[[bytes], None],
    *,
    retained: bool = False,
    named: bool = False,
) -> Any:
    """Call `callback(payload)` for each message, on a thread of Zenoh.

    Static transforms come at once, as for a listener, and so do messages that are `retained`.
    If they are to be `named`, transforms have the names of their frames, whatever they are sent as.
    """
    from tfbus.bus.retained import declare_retained_subscriber  # Zenoh

    def on_transforms(key: str, payload: bytes) -> None:
        if not is_foreign(key):
            callback(payload)

    kind, stream = _transforms(topic)
    if kind == TRANSFORMS and named:
        return _Named(node, f"{topic}/**", callback)
    if kind == STATIC_TRANSFORMS:
        key = topic if stream else f"{topic}/**"
        return declare_retained_subscriber(node.session, key, on_transforms)
    if kind == TRANSFORMS:  # each frame of a split stream has its own key
        return node.session.subscriber(f"{topic}/**", on_transforms)
    return node.create_raw_subscription(topic, callback, type_name=type_name, retained=retained)


class _Named:
    """A subscription of transforms with the names of their frames; close it with `close()`."""

    def __init__(self, node: "Node", key: str, callback: Callable[[bytes], None]) -> None:
        from tfbus.frames.named import NamedMessages  # Zenoh

        self._callback = callback
        self._once = LogOnce(node.log)
        self._named = NamedMessages(node, self._receive, everywhere=True)
        self._subscription = node.session.subscriber(key, self._read)

    def close(self) -> None:
        """End it. Twice is fine."""
        self._subscription.close()
        self._named.close()

    def _read(self, key: str, payload: bytes) -> None:
        if is_foreign(key):
            return
        if not is_numbered(payload):
            self._callback(payload)
            return
        try:
            self._named.decode(key, payload)
        except DecodeError as error:
            self._once.warning(key, "Skipped a message on %r: %s", key, error)

    def _receive(self, key: str, message: TransformMessage, size: int) -> None:
        self._callback(encode_transforms(message))


def may_be_retained(graph: Graph, topic: str) -> bool:
    """Whether the messages of a topic are retained, or its publisher is still to come."""
    info = graph.topics.get(topic)
    return info is None or not info.publishers or info.retained


def full_topic(topic: str, settings: NodeSettings) -> str:
    """The name of a topic as a session without a namespace has it, and a recording."""
    if topic.startswith("/") or not settings.namespace:
        return topic.removeprefix("/")
    return f"{settings.namespace}/{topic}"


def find_topic(graph: Graph, name: str) -> TopicInfo:
    """The topic of this name. Raises BusError, with a near name, if there is none."""
    kind, stream = _transforms(name)
    if kind and not stream:
        ends = [t for key, t in graph.topics.items() if key.startswith(f"{name}/")]
        publishers = {end for topic in ends for end in topic.publishers}
        return TopicInfo(name, tuple(sorted(publishers)), None)
    if name not in graph.topics:
        hint = did_you_mean(name, graph.topics, none=", nor any other: is a node running?")
        raise BusError(f"there is no topic {name!r}{hint}")
    return graph.topics[name]


def type_of(graph: Graph, topic: str) -> str:
    """The name of the topic's type; "" if its nodes announce none, or different ones."""
    if _transforms(topic)[0]:
        return TRANSFORMS_TYPE
    info = graph.topics.get(topic)
    return info.types[0] if info and len(info.types) == 1 else ""


def why_silent(node: "Node", topic: str) -> str:
    """A sentence on the topic that a tool waits for if no message comes."""
    graph = look(node.session)
    published = {name: each for name, each in graph.topics.items() if each.publishers}
    try:
        senders = [end.node for end in find_topic(graph, topic).publishers]
    except BusError:
        senders = []
    if senders:
        return f"Waiting for a message on {topic!r}: its publisher {', '.join(senders)} sends none"
    waiting = f"Waiting for a message on {topic!r}: it has no publisher"
    if topic in _SHOWN_BY:
        return f"{waiting}; {_SHOWN_BY[topic]}"
    return waiting + did_you_mean(topic, published, none=", nor any other topic")


def _transforms(topic: str) -> tuple[str, str]:
    """The kind of a topic of transforms, `tf` or `tf_static`, and its stream.

    The kind is "" for other topics, the stream "" for all streams.
    """
    chunks = topic.split("/")
    for kind in (TRANSFORMS, STATIC_TRANSFORMS):
        if kind in chunks:
            return kind, "/".join(chunks[chunks.index(kind) + 1 :])
    return "", ""


def reader_of(type_name: str) -> Reader:
    """Reads messages of the type of this name, and checks types of `tfbus.messages`."""
    if type_name == TRANSFORMS_TYPE:
        return _read_transforms
    message_type = supplied_type(type_name)
    if message_type is None:
        return _reader_of_ros(type_name) if "/" in type_name else decode_map
    return lambda payload: as_map(decode_message(message_type, payload))


def _reader_of_ros(type_name: str) -> Reader:
    """Reads messages of a type of ROS, with arrays if its definition has them."""
    try:
        message = message_named(type_name)
    except DecodeError:
        return decode_map
    return lambda payload: with_arrays(decode_map(payload), message)


def _read_transforms(payload: bytes) -> dict[str, Any]:
    return _transforms_map(decode_transforms(payload))


def _transforms_map(message: TransformMessage) -> dict[str, Any]:
    """A message of transforms as a map."""
    counted = {} if message.seq is None else {"seq": message.seq}
    return {"epoch": message.epoch_ns, **counted, "transforms": _rows(message.rows)}


def _rows(rows: Columns) -> list[dict[str, Any]]:
    """The rows as they came, with rows that a buffer rejects."""
    poses = iter_unpack("=7d", rows.poses_bytes())
    columns = zip(rows.pairs(), rows.stamps_as_ints(), poses, strict=True)
    return [
        {
            "stamp_ns": stamp_ns,
            "frame_id": rows.frames[parent],
            "child_frame_id": rows.frames[child],
            "transform": {
                "translation": dict(zip("xyz", pose[:3], strict=True)),
                "rotation": dict(zip("xyzw", pose[3:], strict=True)),
            },
        }
        for (parent, child), stamp_ns, pose in columns
    ]


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
            return dict(self.item.with_arrays)
        return _transforms_map(_message_of(self.item))

    @property
    def size(self) -> int:
        """Its bytes as it is sent on a bus."""
        if isinstance(self.item, TopicItem):
            return len(encode_map(self.item.values))
        return len(encode_transforms(_message_of(self.item)))

    @property
    def stamp_ns(self) -> int | None:
        """Its stamp, or its header's; of transforms the newest; None if it has none."""
        if isinstance(self.item, TransformItem):
            return max(self.item.rows.stamps_as_ints(), default=None)
        return stamp_in(self.item.values)


def _message_of(item: TransformItem) -> TransformMessage:
    return TransformMessage(item.rows, item.stream.epoch_ns, item.seq)


def recorded_topic(reader: RecordingReader, name: str) -> RecordedTopic:
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
    topic = recorded_topic(bag.reader, name)
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


def reading_of(
    choice: BagChoice, name: str, number_of: Callable[[RecordedMessage], float | None]
) -> WindowReading:
    """When the messages of a topic came, in seconds of time in which it was recorded, and a number
    of each; messages without a number are left out.
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
    return WindowReading(tuple(arrivals_s), tuple(numbers), len(numbers))
