"""Channels of topics and transforms: CDR as recordings have it, JSON if that cannot express them.

Foxglove knows tf2_msgs/msg/TFMessage as well as a schema of its own. With this one a layout made
for the live bus shows a recording too, and both come from one encoder. Of dataclasses there are
JSON schemas.
"""

import json
import threading
import time
from base64 import b64decode, b64encode
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import MISSING, fields, is_dataclass
from typing import Any, get_args, get_origin, get_type_hints

from tfbus import messages
from tfbus.base.errors import DecodeError, InvalidArgumentException, TfbusError, TransformException
from tfbus.base.json_text import json_text
from tfbus.base.log import LogOnce
from tfbus.buffer.buffer import Buffer
from tfbus.bus.graph import Graph, TopicInfo
from tfbus.bus.ros_types import RosTypes
from tfbus.foxglove.nodes import absolute
from tfbus.foxglove.server import ServedChannel, Server
from tfbus.geometry.columns import Columns
from tfbus.geometry.transform import TransformStamped
from tfbus.node.node import Node
from tfbus.node.topic import RawSubscription
from tfbus.ros.definitions import MSGPACK, TF_MESSAGE, Definition
from tfbus.ros.schema import MessageCodec, MessageCodecs
from tfbus.ros.tf_message import TFMessageWriter
from tfbus.wire.codec import as_map, decode_map, type_name

# A topic whose messages changed their schema this many times goes on as JSON.
_MOST_CHANGES = 5

# Names come from the bus, and each channel takes memory here and in each client.
_MOST_TOPICS = 2000

# Descriptions of robots that wait to be read.
_MOST_WAITING = 100

# A busy node may not answer for a while; its topics stay that long.
_GONE_AFTER_S = 10.0


# Makes the values for clients, of the name of a topic and the values of a message.
Shown = Callable[[str, Mapping[str, Any]], Mapping[str, Any]]


def is_description(topic: str, type_name: str) -> bool:
    """Whether the messages of a topic describe robots: by their type, or as ROS's strings by the
    topic's name.
    """
    is_named_so = topic.rpartition("/")[2] == "robot_description"
    is_described = type_name == messages.RobotDescription.__name__
    return is_described or (is_named_so and type_name.endswith("String"))


class ServedTopic:
    """A topic as a channel with the schema of its messages. Not thread-safe.

    If the type is one of tfbus.messages, or one of ROS's with this `codec`, the channel is there
    at once, otherwise from the first message on.
    """

    def __init__(
        self,
        server: Server,
        codecs: MessageCodecs,
        name: str,
        type_name: str,
        codec: MessageCodec | None = None,
    ) -> None:
        self._server = server
        self._codec = codec
        self._codecs = codecs
        self._name = name
        self._type_name = type_name
        self._definition: Definition | None = None
        self._changes = 0
        self.channel: ServedChannel | None = None
        known = _supplied_type(type_name)
        if known is not None:
            self._open(MessageCodec.of_type(known).definition)
        elif codec is not None:
            self._open(codec.definition)

    def send(
        self,
        values: Mapping[str, Any],
        log_ns: int,
        encoded: tuple[Definition, bytes] | None = None,
    ) -> None:
        """Send a message, as it is `encoded` already if it is. Raises ValueError if neither CDR nor
        JSON can express it.
        """
        message = self._in_cdr(values) if encoded is None else self._as_it_is(*encoded)
        if message is None and (self.channel is None or self._definition is not None):
            self._open(None)
        assert self.channel is not None
        self.channel.send(json_of(values) if message is None else message, log_ns)

    def close(self) -> None:
        """Take the channel back. Twice is fine."""
        if self.channel is not None:
            self.channel.close()

    def _as_it_is(self, definition: Definition, data: bytes) -> bytes | None:
        """The message, in the schema of the channel from now on; None as `_in_cdr`."""
        is_json = self.channel is not None and not self._definition
        if self._changes > _MOST_CHANGES or is_json or not _shows_all(definition):
            return None
        if definition != self._definition:
            self._open(definition)
        return data

    def _in_cdr(self, values: Mapping[str, Any]) -> bytes | None:
        """The message in the schema of the channel, which becomes the message's; None if
        only JSON shows its fields.
        """
        if self._changes > _MOST_CHANGES or (self.channel is not None and not self._definition):
            return None
        if self._codec is not None and (message := self._codec.encode_fitted(values)) is not None:
            if self._codec.definition != self._definition:
                self._open(self._codec.definition)
            return message
        try:
            codec, message = self._codecs.encode(self._type_name or self._name, values)
        except (ValueError, OverflowError):
            return None
        if not _shows_all(codec.definition):
            return None
        if codec.definition != self._definition:
            self._open(codec.definition)
        return message

    def _open(self, definition: Definition | None) -> None:
        self.close()
        self._changes += 1
        self._definition = definition
        if definition is None:
            self.channel = self._server.open_channel(self._name, "json")
        else:
            schema = definition.name, "ros2msg", definition.text.encode()
            self.channel = self._server.open_channel(self._name, "cdr", schema)


class _LiveTopic:
    """A topic of the bus; it is subscribed to while a client watches its channel, or until its
    first message, if that has to show the schema.
    """

    def __init__(
        self,
        node: Node,
        name: str,
        type_name: str,
        server: Server,
        once: LogOnce,
        *,
        retained: bool,
        shown: Shown | None,
        codec: MessageCodec | None = None,
    ) -> None:
        self.type_name = type_name
        self.seen_s = time.monotonic()
        self.retained = retained
        self.codec = codec
        self._node = node
        self._name = name
        self._once = once
        self._shown = shown
        self._lock = threading.Lock()
        # Codecs of its own: messages of topics come on several threads.
        self._sent = ServedTopic(server, MessageCodecs(exact=False), name, type_name, codec)
        self._subscription: RawSubscription | None = None

    @property
    def channel(self) -> ServedChannel | None:
        """Its channel, once there is one."""
        return self._sent.channel

    def adapt(self) -> None:
        """Subscribe, or no longer, as clients do."""
        channel = self.channel
        is_needed = channel is None or channel.is_watched
        if is_needed and self._subscription is None:
            self._subscription = self._node.create_raw_subscription(
                self._name,
                self._on_message,
                type_name=self.type_name,
                retained=self.retained,
            )
        elif not is_needed and self._subscription is not None:
            self._subscription.close()
            self._subscription = None

    def repeat(self) -> None:
        """Send the retained message to a client that comes late, too."""
        if self.retained and self._subscription is not None:
            self._subscription.close()
            self._subscription = None
            self.adapt()

    def close(self) -> None:
        """The topic is gone."""
        if self._subscription is not None:
            self._subscription.close()
        with self._lock:
            self._sent.close()

    def _on_message(self, payload: bytes) -> None:
        if self._shown is None:
            self._send(payload)
        else:
            # To read a large URDF takes longer than Zenoh's thread should.
            self._node.executor.submit(
                f"topic {self._name}", self._send, payload, limit=_MOST_WAITING
            )

    def _send(self, payload: bytes) -> None:
        try:
            values: Mapping[str, Any] = decode_map(payload, in_place=self.codec is not None)
            if self._shown is not None:
                values = self._shown(self._name, values)
            with self._lock:
                self._sent.send(values, self._node.now_ns())
        except (DecodeError, ValueError) as error:
            self._once.warning(
                ("topic", self._name), "Dropped a message on topic %r: %s", self._name, error
            )


class LiveTopics:
    """The topics of the bus, as of the last `update`; all calls come on one thread.

    `shown(topic, values)` makes the clients' values of the description of a robot; without it
    these topics are left out.
    """

    def __init__(self, node: Node, server: Server, once: LogOnce, shown: Shown | None) -> None:
        self._node = node
        self._shown = shown
        self._server = server
        self._once = once
        self._ros_types = RosTypes(node.session)
        self._topics: dict[str, _LiveTopic] = {}

    def update(self, graph: Graph) -> None:
        """Take the topics of the graph."""
        now_s = time.monotonic()
        for name, info in graph.topics.items():
            self._see(absolute(name), info, now_s)
        for name, topic in list(self._topics.items()):
            if now_s > topic.seen_s + _GONE_AFTER_S:
                self._topics.pop(name).close()
        self.adapt()

    def adapt(self) -> None:
        """Subscribe to the topics that clients watch."""
        for name, topic in list(self._topics.items()):
            try:
                topic.adapt()
            except TfbusError as error:
                self._once.warning(("subscribe", name), "Topic %r is not shown: %s", name, error)

    def subscribed(self, channel_id: int) -> None:
        """A client has come to a channel; late ones get the retained message."""
        for topic in self._topics.values():
            if topic.channel is not None and topic.channel.id == channel_id:
                topic.repeat()
        self.adapt()

    def close(self) -> None:
        """Take all channels back."""
        while self._topics:
            self._topics.popitem()[1].close()

    def _see(self, name: str, info: TopicInfo, now_s: float) -> None:
        type_name = _type_of(info)
        is_robot = is_description(name, type_name)
        if is_robot and self._shown is None:
            return
        known = self._topics.get(name)
        seen = type_name, info.retained, self._codec(info)
        if known is not None and (known.type_name, known.retained, known.codec) == seen:
            known.seen_s = now_s
            return
        if known is None and len(self._topics) >= _MOST_TOPICS:
            self._once.warning("topics", "More than %d topics: the rest is not shown", _MOST_TOPICS)
            return
        if known is not None:
            known.close()
        self._topics[name] = _LiveTopic(
            self._node,
            name,
            type_name,
            self._server,
            self._once,
            retained=info.retained,
            shown=self._shown if is_robot else None,
            codec=seen[2],
        )

    def _codec(self, info: TopicInfo) -> MessageCodec | None:
        """That of the type of ROS's that its publishers say; of its subscribers without any."""
        ends = info.publishers or info.subscribers or ()
        found = [self._ros_types.codec(end.node, end.type) for end in ends]
        return next((codec for codec in found if codec is not None), None)


def _type_of(info: TopicInfo) -> str:
    """The type that its publishers say; of its subscribers if there is none."""
    types = sorted({end.type for end in info.publishers or info.subscribers or ()} - {""})
    return types[0] if types else ""


def _shows_all(definition: Definition) -> bool:
    """Whether no part of a message is in MessagePack, of which Foxglove would show bytes."""
    packed = MSGPACK.name.rpartition("/")[2]
    return definition.name != MSGPACK.name and f"/{packed}" not in definition.text


def _supplied_type(name: str) -> type | None:
    """A message of tfbus.messages by its name."""
    found = getattr(messages, name, None)
    is_message = isinstance(found, type) and is_dataclass(found)
    return found if is_message and found.__module__ == messages.__name__ else None


class TransformChannels:
    """Sends transforms to the clients that subscribe; safe from any thread."""

    def __init__(self, server: Server, now_ns: Callable[[], int], once: LogOnce) -> None:
        schema = TF_MESSAGE.name, "ros2msg", TF_MESSAGE.text.encode()
        self._dynamic = server.open_channel("/tf", "cdr", schema)
        self._static = server.open_channel("/tf_static", "cdr", schema)
        self._now_ns = now_ns
        self._once = once
        self._writer = TFMessageWriter()
        self._lock = threading.Lock()

    def have(self, channel_id: int) -> bool:
        """Whether a channel is one of these."""
        return channel_id in (self._dynamic.id, self._static.id)

    def send_present(self, buffer: Buffer, log_ns: int | None = None) -> None:
        """Send where all frames of a buffer are, for clients that come late."""
        for static in (True, False):
            self.send(present(buffer, static=static), static=static, log_ns=log_ns)

    def send(self, rows: Columns, *, static: bool, log_ns: int | None = None) -> None:
        """Send transforms, if a client subscribes."""
        channel = self._static if static else self._dynamic
        if not rows.count or not channel.is_watched:
            return
        try:
            with self._lock:
                message = self._writer.write(rows)
        except InvalidArgumentException as error:
            self._once.warning("transforms", "Foxglove cannot show some transforms: %s", error)
            return
        channel.send(message, self._now_ns() if log_ns is None else log_ns)


def present(buffer: Buffer, *, static: bool) -> Columns:
    """The static transforms of a buffer, or the last of each dynamic frame."""
    found = []
    for frame in buffer.all_frames():
        if frame.parent is None or frame.newest_ns is None or frame.static is not static:
            continue
        with suppress(TransformException):  # removed in between
            pose = buffer.lookup_transform(frame.parent, frame.name).transform
            found.append(TransformStamped(frame.newest_ns, frame.parent, frame.name, pose))
    return Columns.of_transforms(found)


def json_of(values: Mapping[Any, Any]) -> bytes:
    """A message as JSON. Bytes become base64, numbers that are not finite null.

    Raises ValueError if it is nested too deeply.
    """
    try:
        return json_text(values, of_bytes=_base64).encode()
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error


def _base64(value: bytes) -> str:
    return b64encode(value).decode()


def values_of(payload: bytes, message_type: type | None) -> dict[str, Any]:
    """A message that came as JSON; base64 becomes bytes if the type has bytes.

    Raises ValueError if it is no JSON object.
    """
    try:
        values = json.loads(payload) if payload else {}
    except (UnicodeDecodeError, RecursionError) as error:
        raise ValueError(f"not JSON: {error}") from error
    if not isinstance(values, dict):
        raise ValueError("a message must be a JSON object")
    return values if message_type is None else _with_bytes(values, message_type)


def _with_bytes(values: dict[str, Any], message_type: type) -> dict[str, Any]:
    hints = get_type_hints(message_type)
    return {name: _read(value, hints.get(name)) for name, value in values.items()}


def _read(value: Any, expected: Any) -> Any:
    if expected is bytes and isinstance(value, str):
        return b64decode(value)
    if is_dataclass(expected) and isinstance(expected, type) and isinstance(value, dict):
        return _with_bytes(value, expected)
    if get_origin(expected) in (list, tuple) and isinstance(value, list):
        return [_read(each, get_args(expected)[0]) for each in value]
    return value


def json_schema(message_type: type) -> dict[str, Any]:
    """The JSON schema of a dataclass, with its defaults."""
    hints = get_type_hints(message_type)
    properties = {}
    for entry in fields(message_type):
        schema = _schema_of(hints[entry.name])
        default: Any = entry.default
        if entry.default_factory is not MISSING:
            default = entry.default_factory()
        if default is not MISSING and not isinstance(default, bytes):
            schema["default"] = as_map(default) if is_dataclass(default) else default
        properties[entry.name] = schema
    return {"title": type_name(message_type), "type": "object", "properties": properties}


_PLAIN: dict[Any, dict[str, Any]] = {
    bool: {"type": "boolean"},
    bytes: {"type": "string", "contentEncoding": "base64"},
    float: {"type": "number"},
    int: {"type": "integer"},
    str: {"type": "string"},
}


def _schema_of(expected: Any) -> dict[str, Any]:
    if is_dataclass(expected) and isinstance(expected, type):
        return json_schema(expected)
    origin, args = get_origin(expected), get_args(expected)
    if origin is dict:
        return {"type": "object", "additionalProperties": _schema_of(args[1])}
    if origin in (list, tuple):
        same = origin is list or Ellipsis in args
        return {"type": "array", "items": _schema_of(args[0]) if same else {}}
    return dict(_PLAIN.get(expected, {}))
