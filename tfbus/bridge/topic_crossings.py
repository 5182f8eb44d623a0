"""A topic on its way in one direction: from the bus to ROS, or from ROS to the bus."""

import threading
from collections.abc import Callable, Mapping
from typing import Any

from tfbus import messages
from tfbus.bridge.common import RosFrameNames
from tfbus.bridge.legs import LEAST_READER_DEPTH, Leg, RosTopic
from tfbus.bridge.topic_table import TopicLine
from tfbus.errors import DecodeError, TfbusError
from tfbus.node.node import Node
from tfbus.node.topic import RawPublisher
from tfbus.ros.counterparts import fitted
from tfbus.ros.definition_text import message_of
from tfbus.ros.message_type import MessageType, Sequence, Text, Type
from tfbus.ros.schema import MessageCodec
from tfbus.ros.value_codec import UnfitError
from tfbus.runtime.log import LogOnce
from tfbus.wire.codec import as_map, decode_map, encode_map, from_map
from tfbus.wording import printable

# Fields of ROS that name frames.
_FRAMES = ("frame_id", "child_frame_id")

# The fields of a message in which there are names of frames, each with those below it.
_FrameFields = Mapping[str, "_FrameFields"]


class Translation:
    """Messages of a line's types, as bytes, in both directions. Thread-safe."""

    def __init__(self, line: TopicLine, names: RosFrameNames, now_ns: Callable[[], int]) -> None:
        self._names = names
        self._counterpart = line.counterpart
        definition = line.counterpart.definition
        self._message = message_of(definition)
        self._frames = _frame_fields(self._message) if line.has_fields_of_ros else {}
        self._codec = MessageCodec(self._message, definition)
        self._stamps = line.stamps
        self._now_ns = now_ns
        self._type = _supplied_type(line.type_name)

    def to_ros(self, payload: bytes) -> bytes:
        """The message of ours as one of ROS. Raises DecodeError if it does not fit."""
        values = decode_map(payload)
        if self._type is not None:
            values = as_map(from_map(self._type, values))
        try:
            of_ros = fitted(self._counterpart.to_ros(values), self._message)
        except UnfitError as error:
            raise DecodeError(str(error)) from error
        _rename(of_ros, self._frames, self._in_ros)
        message = self._codec.encode(of_ros)
        if message is None:
            raise DecodeError("it has a text that is not valid Unicode")
        return message

    def of_ros(self, payload: bytes) -> bytes:
        """The message of ROS as one of ours. Raises DecodeError if it does not fit."""
        of_ros = self._codec.decode(payload)
        _rename(of_ros, self._frames, self._names.on_bus)
        try:
            values = self._counterpart.of_ros(of_ros)
        except UnfitError as error:
            raise DecodeError(str(error)) from error
        if self._stamps:
            values["stamp_ns"] = self._now_ns()
        if self._type is not None:
            from_map(self._type, values)
        return encode_map(values)

    def _in_ros(self, frame: str) -> str:
        name = self._names.in_ros(frame)
        if name is None:
            raise DecodeError(f"ROS has another frame '{printable(frame, 60)}'")
        return name


def _frame_fields(type_: Type) -> _FrameFields:
    type_ = type_.item if isinstance(type_, Sequence) else type_
    found: dict[str, _FrameFields] = {}
    for field in type_.fields if isinstance(type_, MessageType) else ():
        below = _frame_fields(field.type)
        if below or (field.name in _FRAMES and isinstance(field.type, Text)):
            found[field.key] = below
    return found


def _rename(values: Any, fields: _FrameFields, rename: Callable[[str], str]) -> None:
    """Rename the frames in a message of ROS, or in each of a list. Some leave a name empty."""
    for each in values if isinstance(values, list) else [values]:
        for name, below in fields.items():
            if below:
                _rename(each[name], below, rename)
            elif each[name]:
                each[name] = rename(each[name])


class TopicToRos:
    """A topic of the bus that goes to ROS, until `close()`."""

    def __init__(
        self,
        node: Node,
        leg: Leg,
        name: str,
        ros_name: str,
        line: TopicLine,
        names: RosFrameNames,
    ) -> None:
        self.line = line
        self._name = name
        self._once = LogOnce(node.log)
        self._translation = Translation(line, names, node.now_ns)
        definition = line.counterpart.definition
        self._sender = leg.publisher(RosTopic(ros_name, definition, line.retained, line.depth))
        try:
            self._subscription = node.create_raw_subscription(
                name,
                self._on_message,
                type_name=line.type_name,
                retained=line.retained,
                others=True,
            )
        except BaseException:
            self._sender.close()
            raise

    def close(self) -> None:
        """No longer publish it in ROS. Twice is fine."""
        self._subscription.close()
        self._sender.close()

    def _on_message(self, payload: bytes) -> None:
        try:
            message = self._translation.to_ros(payload)
            self._sender.send(message)
        except (DecodeError, TfbusError) as error:
            self._once.warning(
                type(error).__name__,
                "Dropped a message on topic %r on its way to ROS, as %s: %s",
                self._name,
                self.line.ros_type,
                error,
            )


class TopicFromRos:
    """A topic of ROS that comes to the bus, until `close()`.

    The publisher in the bus begins with the first message. `accepts(gid)` says whether messages of
    a publisher in ROS do.
    """

    def __init__(
        self,
        node: Node,
        leg: Leg,
        name: str,
        ros_name: str,
        line: TopicLine,
        names: RosFrameNames,
        accepts: Callable[[str], bool],
    ) -> None:
        self.line = line
        self._node = node
        self._name = name
        self._ros_name = ros_name
        self._once = LogOnce(node.log)
        self._accepts = accepts
        self._translation = Translation(line, names, node.now_ns)
        self._lock = threading.Lock()
        self._closed = False
        self._publisher: RawPublisher | None = None
        definition = line.counterpart.definition
        topic = RosTopic(ros_name, definition, line.retained, max(line.depth, LEAST_READER_DEPTH))
        self._subscription = leg.subscribe(topic, self._take)

    def silence(self) -> None:
        """Publish it no longer in the bus, until there is another message."""
        with self._lock:
            publisher, self._publisher = self._publisher, None
        if publisher is not None:
            publisher.close()

    def close(self) -> None:
        """No longer read it in ROS. Twice is fine."""
        self._subscription.close()
        with self._lock:
            self._closed = True
        self.silence()

    def _take(self, payload: bytes, gid: str) -> None:
        try:
            if not self._accepts(gid):
                return
            message = self._translation.of_ros(payload)
            publisher = self._begun()
            if publisher is not None:
                publisher.publish(message)
        except (DecodeError, TfbusError) as error:
            self._once.warning(
                type(error).__name__,
                "Dropped a message on %s of ROS, of type %s: %s",
                self._ros_name,
                self.line.ros_type,
                error,
            )

    def _begun(self) -> RawPublisher | None:
        with self._lock:
            if self._publisher is None and not self._closed:
                line = self.line
                definition = line.counterpart.definition.text
                self._publisher = self._node.create_raw_publisher(
                    self._name,
                    type_name=line.type_name,
                    definition=definition if line.type_name == line.ros_type else "",
                    retained=line.retained,
                )
                self._node.log.info(
                    "Topic %r (%s) comes from ROS, where it is %s (%s)",
                    self._name,
                    self.line.type_name,
                    self._ros_name,
                    self.line.ros_type,
                )
            return self._publisher


def _supplied_type(name: str) -> type | None:
    """A message of tfbus.messages by its name."""
    found = getattr(messages, name, None) if name.isidentifier() else None
    is_message = isinstance(found, type) and hasattr(found, "__dataclass_fields__")
    return found if is_message else None
