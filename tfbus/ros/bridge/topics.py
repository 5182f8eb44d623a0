"""Topics other than transforms, between the bus and ROS: which cross, and each on its way."""

import logging
import re
import threading
import time
from collections.abc import Callable, Collection, Mapping
from typing import Any

from tfbus import messages
from tfbus.base.errors import DecodeError, TfbusError
from tfbus.base.log import LogOnce
from tfbus.base.wording import listed, printable
from tfbus.bus.graph import Graph, TopicInfo, graph_of
from tfbus.bus.graph_watch import GraphWatch
from tfbus.node.node import Node
from tfbus.node.topic import RawPublisher
from tfbus.ros.bridge.bridges import Bridges, RosBridge
from tfbus.ros.bridge.common import BridgeOptions, RosFrameNames
from tfbus.ros.bridge.legs import LEAST_READER_DEPTH, Leg, RosPublisher, RosTopic
from tfbus.ros.bridge.topic_table import TopicLine
from tfbus.ros.bridge.topic_table import TopicTable as TopicTable
from tfbus.ros.counterparts import AS_IN_ROS, fitted, on_bus
from tfbus.ros.message_type import MessageType, Sequence, Text, Type, message_of
from tfbus.ros.rmw import is_bridge
from tfbus.ros.schema import MessageCodec
from tfbus.ros.value_codec import UnfitError
from tfbus.wire.codec import as_map, decode_map, encode_map, from_map
from tfbus.wire.descriptions import NodeDescription
from tfbus.wire.keys import CLOCK_TOPIC

# Fields of ROS that name frames.
_FRAMES = ("frame_id", "child_frame_id")

# The fields of a message in which there are names of frames, each with the fields below it.
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
        # Types that are on the bus as in ROS have arrays as one binary there.
        self._has_arrays = line.counterpart.type_name in AS_IN_ROS
        self._stamps = line.stamps
        self._now_ns = now_ns
        self._type = _supplied_type(line.type_name)

    def to_ros(self, payload: bytes) -> bytes:
        """The message of ours as one of ROS. Raises DecodeError if it does not fit."""
        values = decode_map(payload, in_place=self._has_arrays)
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
        of_ros = self._codec.decode(payload, arrays=self._has_arrays)
        _rename(of_ros, self._frames, self._names.on_bus)
        try:
            values = self._counterpart.of_ros(of_ros)
        except UnfitError as error:
            raise DecodeError(str(error)) from error
        if self._stamps:
            values["stamp_ns"] = self._now_ns()
        if self._has_arrays:
            values = on_bus(values, self._message)
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
        self._subscription = leg.subscribe(topic, self._publish)

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

    def _publish(self, payload: bytes, gid: str) -> None:
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


# The link to a node may be lost for a while; its topics stay that long.
_GONE_AFTER_S = 10.0

# Names come from the bus, and each topic takes memory here and in ROS.
_MOST_TOPICS = 2000

# The type of the messages that bridges send each other on the bus.
_BRIDGE_TYPE = RosBridge.__name__

_ROS_NAME = re.compile(r"[A-Za-z]\w*(/[A-Za-z]\w*)*", re.ASCII)


class TopicBridge:
    """Passes topics on in both directions, or one, until `close()`.

    Topics of the bus are the ones that nodes of the node's namespace describe, of types that the
    table has. In ROS it looks for topics that the bus subscribes to, and for names in the table.
    No message comes back to where it is from: own ones do not, neither by the bus nor by ROS, and
    messages of another bridge are left out if this side has their source. `names` are the names of
    frames in messages: on the bus and in ROS the same, without it. It does not send the topics of
    other `bridges` between the same bus and the same ROS that were there before.
    """

    def __init__(
        self,
        node: Node,
        leg: Leg,
        table: TopicTable,
        *,
        to_ros: bool,
        from_ros: bool,
        ros_namespace: str,
        log: logging.Logger,
        bridges: Bridges | None = None,
        names: RosFrameNames | None = None,
    ) -> None:
        self._node = node
        self._leg = leg
        self._table = table
        self._names = names or RosFrameNames(BridgeOptions())
        self._is_to_ros = to_ros
        self._is_from_ros = from_ros
        self._above = f"/{ros_namespace}" if ros_namespace else ""
        self._log = log
        self._bridges = bridges
        self._once = LogOnce(log)
        self._lock = threading.Lock()
        self._topics: dict[str, _Topic] = {}
        self._is_closed = False
        self._graph = GraphWatch(node.session, log, on_nodes=self._adapt_all)

    def close(self) -> None:
        """No longer pass anything on. Twice is fine."""
        self._graph.close()
        # A look may still be under way, where ROS answers late.
        with self._lock:
            self._is_closed = True
            while self._topics:
                self._topics.popitem()[1].close()

    def crossing(self) -> tuple[list[str], list[str]]:
        """The topics that go to ROS now, and the ones that come from there, by their names on the
        bus.
        """
        with self._lock:
            topics = sorted(self._topics.items())
        return (
            [name for name, topic in topics if topic.goes],
            [name for name, topic in topics if topic.comes],
        )

    def _adapt_all(self, nodes: list[NodeDescription]) -> None:
        bridges = {each.name for each in nodes if _is_bridge(each)}
        graph = graph_of(nodes, {}, self._node.namespace)
        for name in sorted({*graph.topics, *self._table.names, *self._topics}):
            if name != CLOCK_TOPIC and not name.startswith("/"):
                with self._lock:
                    if self._is_closed:
                        return
                    self._try_to_adapt(name, graph, bridges)

    def _try_to_adapt(self, name: str, graph: Graph, bridges: set[str]) -> None:
        try:
            self._adapt(name, graph, bridges)
        except TfbusError as error:
            self._once.warning(("topic", name), "Topic %r does not cross: %s", name, error)
        topic = self._topics.get(name)
        is_known = name in graph.topics or name in self._table.names
        if topic is not None and not is_known and not topic.goes and not topic.comes:
            del self._topics[name]

    def _adapt(self, name: str, graph: Graph, bridges: set[str]) -> None:
        """Have a topic cross as both sides have it now."""
        info = graph.topics.get(name, TopicInfo(name))
        topic = self._topics.get(name)
        line = self._line(name, info, topic)
        if line is None or line.direction == "off":
            return
        if topic is None:
            if not _ROS_NAME.fullmatch(name):
                self._once.warning(
                    ("name", name), "Topic %r does not cross: ROS cannot have that name", name
                )
                return
            if len(self._topics) >= _MOST_TOPICS:
                self._once.warning(
                    "topics", "More than %d topics: the rest does not cross", _MOST_TOPICS
                )
                return
            ros_name = f"{self._above}/{name}"
            topic = _Topic(self._node, self._leg, name, ros_name, self._names)
            self._topics[name] = topic
        elif topic.line is not None and topic.line.counterpart != line.counterpart:
            topic.close()
        topic.line = line
        seniors = self._bridges.seniors if self._bridges is not None else ()
        topic.poll(info, bridges, seniors, to_ros=self._is_to_ros, from_ros=self._is_from_ros)

    def _line(self, name: str, info: TopicInfo, topic: "_Topic | None") -> TopicLine | None:
        """The line for a topic; None if it does not cross."""
        types = sorted({end.type for end in info.publishers or info.subscribers or ()} - {""})
        lines = [line for each in types if (line := self._table.line_of(name, each)) is not None]
        if types and not lines and name in self._table.names:
            wanted = self._table.names[name]
            raise TfbusError(
                f"on the bus it carries {listed(types)}; {wanted.type_name} is what becomes a "
                f"{wanted.ros_type} of ROS"
            )
        if lines:
            return lines[0]
        if topic is not None:
            return topic.line
        return None if types else self._table.names.get(name)


class _Topic:
    """A topic, as it crosses at present."""

    def __init__(
        self,
        node: Node,
        leg: Leg,
        name: str,
        ros_name: str,
        names: RosFrameNames,
    ) -> None:
        self.line: TopicLine | None = None
        self._node = node
        self._leg = leg
        self._name = name
        self._ros_name = ros_name
        self._names = names
        self._to: TopicToRos | None = None
        self._from: TopicFromRos | None = None
        self._to_until_s = self._from_until_s = self._heard_until_s = 0.0
        # Read by callbacks of the leg, too.
        self._lock = threading.Lock()
        self._nodes: dict[str, str] = {}
        self._has_source = False

    @property
    def goes(self) -> bool:
        """Whether it goes to ROS."""
        return self._to is not None

    @property
    def comes(self) -> bool:
        """Whether it comes from ROS."""
        return self._from is not None

    def poll(
        self,
        info: TopicInfo,
        bridges: set[str],
        seniors: Collection[RosBridge],
        *,
        to_ros: bool,
        from_ros: bool,
    ) -> None:
        """Begin or end either direction, by the publishers and subscribers of both sides."""
        assert self.line is not None
        sources = [end for end in info.publishers if end.node not in bridges]
        in_ros = self._ask()
        with self._lock:
            self._has_source = bool(info.publishers)
        goes = to_ros and self.line.goes_to_ros and bool(info.publishers)
        comes = from_ros and self.line.comes_from_ros and bool(in_ros or info.subscribers)
        if goes and not sources and in_ros:
            # Another bridge has it from there.
            goes = False
            self._end_to_ros()
        if {each.node for each in in_ros} & {each.ros_node for each in seniors} - {""}:
            goes = False
            self._end_to_ros()
        if {end.node for end in info.publishers} & {each.node for each in seniors}:
            comes = False
            self._end_from_ros()
        if self.line.retained and goes and comes:
            # One side's kept message would come back from the other: the bus's counts.
            comes = False
            self._end_from_ros()
        self._keep_to_ros(goes)
        self._keep_from_ros(comes, bool(in_ros))

    def close(self) -> None:
        """It crosses no longer."""
        self._end_to_ros()
        self._end_from_ros()

    def _end_to_ros(self) -> None:
        if self._to is not None:
            self._to.close()
            self._to = None

    def _end_from_ros(self) -> None:
        if self._from is not None:
            self._from.close()
            self._from = None

    def _keep_to_ros(self, is_wanted: bool) -> None:
        now_s = time.monotonic()
        if is_wanted:
            self._to_until_s = now_s + _GONE_AFTER_S
            if self._to is None and self.line is not None:
                self._to = TopicToRos(
                    self._node,
                    self._leg,
                    self._name,
                    self._ros_name,
                    self.line,
                    self._names,
                )
                self._node.log.info(
                    "Topic %r (%s) goes to ROS as %s (%s)",
                    self._name,
                    self.line.type_name,
                    self._ros_name,
                    self.line.ros_type,
                )
        elif now_s > self._to_until_s:
            self._end_to_ros()

    def _keep_from_ros(self, is_wanted: bool, has_publishers: bool) -> None:
        now_s = time.monotonic()
        if has_publishers:
            self._heard_until_s = now_s + _GONE_AFTER_S
        if is_wanted:
            self._from_until_s = now_s + _GONE_AFTER_S
            if self._from is None and self.line is not None:
                self._from = TopicFromRos(
                    self._node,
                    self._leg,
                    self._name,
                    self._ros_name,
                    self.line,
                    self._names,
                    self._accepts,
                )
        elif now_s > self._from_until_s:
            self._end_from_ros()
        if self._from is not None and now_s > self._heard_until_s:
            self._from.silence()

    def _ask(self) -> list[RosPublisher]:
        """The publishers in ROS."""
        found = list(self._leg.publishers(self._ros_name))
        with self._lock:
            self._nodes = {each.gid: each.node for each in found}
        return found

    def _accepts(self, gid: str) -> bool:
        """Whether a message of this publisher comes to the bus: not another bridge's, if
        the topic has a source there.
        """
        if not gid:
            return True
        with self._lock:
            is_known = gid in self._nodes
        if not is_known:
            self._ask()
        with self._lock:
            # Where it is still unknown it is not asked for again before the next look.
            node = self._nodes.setdefault(gid, "")
            return not (self._has_source and is_bridge(node))


def _is_bridge(node: NodeDescription) -> bool:
    return _BRIDGE_TYPE in node.publishes.values()
