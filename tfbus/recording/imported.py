"""Messages of foreign files, decoded, as the items of a recording."""

import sys
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple, Protocol

from tfbus.base.errors import DecodeError, InvalidNameError
from tfbus.base.wording import stamp_text
from tfbus.geometry.columns import Columns
from tfbus.geometry.packed import EDGE_SIZE, POSE_SIZE, STAMP_SIZE
from tfbus.recording import foxglove_frames
from tfbus.recording.foxglove_frames import ns_of
from tfbus.recording.items import (
    ALL,
    EventItem,
    Item,
    RecordedStream,
    Selection,
    TopicItem,
    TransformItem,
)
from tfbus.ros.counterparts import counterpart_of_ros
from tfbus.ros.definitions import Definition
from tfbus.ros.message_type import with_ros2_names
from tfbus.ros.ros1 import decode_ros1_tf_message
from tfbus.ros.schema import MessageCodec
from tfbus.ros.tf_message import TFMessageReader
from tfbus.wire.keys import (
    CLOCK_TOPIC,
    STATIC_TRANSFORMS,
    TRANSFORMS,
    check_namespace,
    check_no_transforms,
    check_topic,
)


@dataclass(frozen=True)
class ForeignChannel:
    """Messages of one topic, type and, if the file says so, publisher.

    `type_name` is as ROS 2 has it, `tf2_msgs/msg/TFMessage`, or as Foxglove, and `encoding` is of
    the messages: "cdr", "ros1", "json", "protobuf" or another. `definition` is the type's in
    `definition_format`, "ros2msg" or "ros1msg" among others; "" if the file has none. A topic
    that is `retained` is transient local in ROS 2, and latched in ROS 1.
    """

    topic: str
    type_name: str
    encoding: str
    definition_format: str = ""
    definition: str = ""
    publisher: str = ""
    retained: bool = False


class ForeignMessage(NamedTuple):
    """A message, and when the recorder received it."""

    log_ns: int
    channel: ForeignChannel
    data: bytes


class ForeignFile(Protocol):
    """A file, or the files of one rosbag2 recording.

    `start_ns` and `end_ns` are the log times of the first and last message, both 0 without any.
    `note` is a sentence for the user, or "".
    """

    name: str
    note: str
    start_ns: int
    end_ns: int

    @property
    def damage(self) -> list[str]:
        """The unreadable parts so far, and was left out."""

    def messages(self) -> Iterator[ForeignMessage]:
        """All messages in order of log time. Raises DecodeError if the file is damaged."""

    def close(self) -> None:
        """Close the file."""


def ros_type_name(name: str) -> str:
    """The name of a type of ROS 1, `tf2_msgs/TFMessage`, as ROS 2 has it; others as they are."""
    package, slash, type_name = name.partition("/")
    if not slash or "/" in type_name:
        return name
    return f"{package}/msg/{type_name}"


TransformsDecoder = Callable[[bytes], Columns]
# The values by field, and the message as ROS 2 has it; None where that is not known.
DecodedValues = tuple[Mapping[str, Any], tuple[Definition, bytes] | None]
ValuesDecoder = Callable[[bytes], DecodedValues]

_TF_MESSAGES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_FOXGLOVE_ROS = ("foxglove_msgs/msg/FrameTransform", "foxglove_msgs/msg/FrameTransforms")
_HEADER = "std_msgs/msg/Header"
_FOXGLOVE = ("foxglove.FrameTransform", "foxglove.FrameTransforms")


def transforms_decoder(channel: ForeignChannel) -> TransformsDecoder | None:
    """The reader of the transforms of a channel; None if its messages are no transforms.

    Raises DecodeError if they are, and cannot be read.
    """
    name = channel.type_name
    if name in _TF_MESSAGES and channel.encoding == "cdr":
        return TFMessageReader().read
    if name in _TF_MESSAGES and channel.encoding == "ros1":
        return decode_ros1_tf_message
    if name in _FOXGLOVE_ROS:
        values = values_decoder(channel)
        return lambda data: foxglove_frames.of_values(values(data)[0])
    if name in _FOXGLOVE and channel.encoding == "json":
        return foxglove_frames.of_json
    if name in _FOXGLOVE and channel.encoding == "protobuf":
        return partial(foxglove_frames.of_protobuf, many=name == _FOXGLOVE[1])
    if name in (*_TF_MESSAGES, *_FOXGLOVE):
        raise DecodeError(f"transforms in {channel.encoding or 'an unknown encoding'} are not read")
    return None


def values_decoder(channel: ForeignChannel) -> ValuesDecoder:
    """The reader of the messages of a channel into maps. Raises DecodeError if nothing can."""
    if channel.encoding == "json":
        return lambda data: (foxglove_frames.json_map(data), None)
    if channel.encoding == "ros1" and channel.definition_format == "ros1msg":
        return _ros1_values(channel)
    if channel.encoding == "cdr" and channel.definition_format == "ros2msg":
        return _cdr_values(Definition(channel.type_name, channel.definition))
    if channel.encoding in ("cdr", "ros1"):
        what = channel.definition_format or "not in the file"
        raise DecodeError(f"the definition of its type is {what}; .msg is read")
    raise DecodeError(f"messages in {channel.encoding or 'an unknown encoding'} are not read")


def _cdr_values(definition: Definition) -> ValuesDecoder:
    codec = MessageCodec.of_definition(definition)
    return lambda data: (codec.decode(data), (definition, data))


def _ros1_values(channel: ForeignChannel) -> ValuesDecoder:
    """By way of ROS 2, whose bytes rosbags makes of ROS 1's."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    name = channel.type_name
    try:
        store = get_typestore(Stores.EMPTY)
        types = get_types_from_msg(channel.definition, name)
        if _HEADER in types:  # ROS 2 has no sequence number in it
            constants, fields = types[_HEADER]
            types[_HEADER] = (constants, [each for each in fields if each[0] != "seq"])
        store.register(types)
        text, _ = store.generate_msgdef(name, ros_version=2)
    except Exception as error:  # rosbags raises any error of its parts
        raise DecodeError(f"the definition of its type cannot be read: {error}") from error
    decode = _cdr_values(with_ros2_names(Definition(name, text)))

    def read(data: bytes) -> DecodedValues:
        try:
            as_ros2 = bytes(store.ros1_to_cdr(data, name))
        except Exception as error:
            raise DecodeError(f"a message does not fit its type: {error}") from error
        return decode(as_ros2)

    return read


_NS_PER_S = 1_000_000_000
_CLOCK = "rosgraph_msgs/msg/Clock"

_Read = Callable[[ForeignMessage], Item | None]


@dataclass
class Imported:
    """Counts of imported messages. `left_out` says by topic why none of its messages was imported,
    `failed` how many of a topic could not be read or written, and `why_failed` the first reason;
    `refused` is how many were read and not written. `topics` are all that the files have.
    """

    transforms: int = 0
    static_transforms: int = 0
    topic_messages: int = 0
    topics: set[str] = field(default_factory=set)
    left_out: dict[str, str] = field(default_factory=dict)
    failed: Counter[str] = field(default_factory=Counter)
    why_failed: dict[str, str] = field(default_factory=dict)
    refused: int = 0

    def add(self, item: Item) -> None:
        """Count an item."""
        self._add(item, 1)

    def refuse(self, item: Item, reason: str) -> None:
        """Note that an item, which was counted, could not be written."""
        self._add(item, -1)
        self.refused += 1
        if not isinstance(item, EventItem):
            self.fail(item.topic if isinstance(item, TopicItem) else item.stream.name, reason)

    def fail(self, topic: str, reason: str) -> None:
        """Note that a message of a topic is left out."""
        self.failed[topic] += 1
        self.why_failed.setdefault(topic, reason)

    def _add(self, item: Item, number: int) -> None:
        if isinstance(item, TopicItem):
            self.topic_messages += number
        elif isinstance(item, TransformItem) and item.static:
            self.static_transforms += number * item.rows.count
        elif isinstance(item, TransformItem):
            self.transforms += number * item.rows.count


def imported(
    messages: Iterable[ForeignMessage],
    counts: Imported,
    *,
    selection: Selection = ALL,
    topics: Collection[str] = (),
    only_transforms: bool = False,
    default_stream: str = "",
) -> Iterator[Item]:
    """The messages as items, in the same order.

    Transforms come as one stream for each publisher if the file names it, as rosbag1 does, and
    else as one stream `ros` or `foxglove`, or `default_stream`. Transforms of `/robot7/tf` are in
    the namespace `robot7`. Leading slashes of frames are removed, as tf2 does. A static transform
    stays until another one of its child comes on the same stream.

    Of other topics, `topics` alone if it names any, and none with `only_transforms`.
    """
    importer = _Importer(counts, selection, frozenset(topics), default_stream)
    importer.only_transforms = only_transforms
    return importer.items(messages)


class _Importer:
    def __init__(
        self, counts: Imported, selection: Selection, topics: frozenset[str], default_stream: str
    ) -> None:
        self._counts = counts
        self._selection = selection
        self._topics = topics
        self.only_transforms = False
        self._default_stream = default_stream
        self._reads: dict[ForeignChannel, _Read | None] = {}
        self._epochs: dict[str, int] = {}
        self._statics: dict[str, _StaticSet] = {}

    def items(self, messages: Iterable[ForeignMessage]) -> Iterator[Item]:
        for message in messages:
            channel = message.channel
            if channel not in self._reads:
                self._counts.topics.add(channel.topic.lstrip("/"))
                self._reads[channel] = self._read_of(channel)
            read = self._reads[channel]
            if read is None:
                continue
            try:
                item = read(message)
            except DecodeError as error:
                self._counts.fail(channel.topic, str(error))
                continue
            taken = None if item is None else self._selection.taken_of(item)
            if taken is not None:
                self._counts.add(taken)
                yield taken

    def _read_of(self, channel: ForeignChannel) -> _Read | None:
        """The maker of items of a channel's messages; None if it is left out, which is noted."""
        try:
            columns_of = transforms_decoder(channel)
            if columns_of is not None:
                return self._transforms_of(channel, columns_of)
            if self.only_transforms:
                return None
            topic = check_no_transforms(check_topic(channel.topic.lstrip("/")))
            if self._topics and topic not in self._topics:
                return None
            if not self._selection.takes_topic(topic):
                return None
            return _topic_of(channel, topic, values_decoder(channel))
        except (DecodeError, InvalidNameError) as error:
            self._counts.left_out.setdefault(channel.topic, str(error))
            return None

    def _transforms_of(
        self, channel: ForeignChannel, columns_of: Callable[[bytes], Columns]
    ) -> _Read | None:
        name, namespace, is_static = self._place_of(channel)
        if not self._selection.takes_transforms(name, static=is_static):
            return None
        node = f"/{channel.publisher.strip('/')}" if channel.publisher else ""

        def read(message: ForeignMessage) -> TransformItem | None:
            rows = _without_slashes(columns_of(message.data))
            _check_stamps(rows)
            epoch_ns = self._epochs.setdefault(name, message.log_ns)
            stream = RecordedStream(name, node, namespace, epoch_ns)
            if not is_static:
                return TransformItem(message.log_ns, stream, rows)
            statics = self._statics.setdefault(name, _StaticSet())
            if not statics.update(rows):
                return None
            return TransformItem(message.log_ns, stream, statics.rows(), static=True)

        return read

    def _place_of(self, channel: ForeignChannel) -> tuple[str, str, bool]:
        """The stream's name and namespace, and whether its transforms are static."""
        above, _, last = channel.topic.strip("/").rpartition("/")
        is_static = last == STATIC_TRANSFORMS
        source = "foxglove" if "foxglove" in channel.type_name else "ros"
        own = channel.publisher.strip("/").replace("/", "_") or self._default_stream or source
        if not is_static and last != TRANSFORMS:
            # Transforms on a topic that is not tf2's: a stream apart, named after the topic.
            return channel.topic.strip("/").replace("/", "_") or own, "", False
        namespace = check_namespace(above)
        return (f"{namespace}/{own}" if namespace else own), namespace, is_static


def _topic_of(channel: ForeignChannel, topic: str, decode: ValuesDecoder) -> _Read:
    is_clock = channel.type_name == _CLOCK and topic.rpartition("/")[2] == CLOCK_TOPIC

    counterpart = counterpart_of_ros(channel.type_name, "", topic)

    def read(message: ForeignMessage) -> TopicItem:
        values, encoded = decode(message.data)
        if is_clock:
            # ROS's simulated time says neither rate nor pause.
            clock = {"stamp_ns": _stamp_of_clock(values), "rate": 1.0, "paused": False}
            return TopicItem(message.log_ns, topic, "Clock", clock)
        type_name, is_retained = channel.type_name, channel.retained
        if counterpart is not None and encoded is not None:
            type_name, values = counterpart.type_name, counterpart.of_ros(dict(values))
            # Its publisher retains it, whatever the file says.
            is_retained |= type_name == "RobotDescription"
        return TopicItem(message.log_ns, topic, type_name, values, encoded, is_retained)

    return read


def _stamp_of_clock(values: Mapping[str, Any]) -> int:
    try:
        return ns_of(values["clock"])
    except (AttributeError, KeyError, TypeError) as error:
        raise DecodeError(f"a {_CLOCK} has other fields than ROS's own") from error


def _check_stamps(rows: Columns) -> None:
    """Raises DecodeError for a stamp that no message of ROS 2, and so no recording, can hold."""
    for stamp_ns in rows.stamps_as_ints():
        if not -(2**31) <= stamp_ns // _NS_PER_S < 2**31:
            raise DecodeError(
                f"the stamp {stamp_text(stamp_ns)} s is not between 1901 and 2038, as recordings "
                "can hold"
            )


def _without_slashes(rows: Columns) -> Columns:
    if not any(frame.startswith("/") for frame in rows.frames):
        return rows
    return rows.with_frames(tuple(frame.lstrip("/") for frame in rows.frames))


class _StaticSet:
    """The static transforms of a stream. ROS sends some of them at a time: the last of each child
    counts.
    """

    def __init__(self) -> None:
        self._row_of: dict[str, tuple[str, bytes, bytes]] = {}

    def update(self, rows: Columns) -> bool:
        """Set rows; whether any is new or differs from the row before."""
        stamps, poses = rows.stamps_bytes(), rows.poses_bytes()
        is_new = False
        for at, (parent, child) in enumerate(rows.pairs()):
            row = (
                rows.frames[parent],
                stamps[STAMP_SIZE * at : STAMP_SIZE * (at + 1)],
                poses[POSE_SIZE * at : POSE_SIZE * (at + 1)],
            )
            name = rows.frames[child]
            is_new = is_new or self._row_of.get(name) != row
            self._row_of[name] = row
        return is_new

    def rows(self) -> Columns:
        """All of them."""
        index_of: dict[str, int] = {}
        edges = bytearray()
        for child, (parent, _, _) in self._row_of.items():
            for name in (parent, child):
                edges += index_of.setdefault(name, len(index_of)).to_bytes(
                    EDGE_SIZE // 2, sys.byteorder
                )
        return Columns.of_bytes(
            tuple(index_of),
            bytes(edges),
            b"".join([stamp for _, stamp, _ in self._row_of.values()]),
            b"".join([pose for _, _, pose in self._row_of.values()]),
        )
