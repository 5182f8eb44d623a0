"""A foreign file as values: its channels, and its messages as bytes."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, Protocol

from tfbus.errors import DecodeError
from tfbus.geometry.columns import Columns
from tfbus.recording.foreign import foxglove
from tfbus.ros.definition_text import with_ros2_names
from tfbus.ros.definitions import Definition
from tfbus.ros.ros1 import decode_ros1_tf_message
from tfbus.ros.schema import MessageCodec
from tfbus.ros.tf_message import TFMessageReader


@dataclass(frozen=True)
class ForeignChannel:
    """Messages of one topic, type and, where the file says so, publisher.

    `type_name` is as ROS 2 has it, `tf2_msgs/msg/TFMessage`, or as Foxglove, and `encoding` that of
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
    `note` is what a user should know of it, "" for nothing.
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
        return lambda data: foxglove.of_values(values(data)[0])
    if name in _FOXGLOVE and channel.encoding == "json":
        return foxglove.of_json
    if name in _FOXGLOVE and channel.encoding == "protobuf":
        return partial(foxglove.of_protobuf, many=name == _FOXGLOVE[1])
    if name in (*_TF_MESSAGES, *_FOXGLOVE):
        raise DecodeError(f"transforms in {channel.encoding or 'an unknown encoding'} are not read")
    return None


def values_decoder(channel: ForeignChannel) -> ValuesDecoder:
    """The reader of the messages of a channel into maps. Raises DecodeError if nothing can."""
    if channel.encoding == "json":
        return lambda data: (foxglove.json_map(data), None)
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
    """By way of ROS 2, whose bytes rosbags makes of those of ROS 1."""
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
    except Exception as error:  # rosbags raises what its parts do
        raise DecodeError(f"the definition of its type cannot be read: {error}") from error
    decode = _cdr_values(with_ros2_names(Definition(name, text)))

    def read(data: bytes) -> DecodedValues:
        try:
            as_ros2 = bytes(store.ros1_to_cdr(data, name))
        except Exception as error:
            raise DecodeError(f"a message does not fit its type: {error}") from error
        return decode(as_ros2)

    return read
