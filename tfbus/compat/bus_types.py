"""ROS's messages on the bus: types of another layout there are converted, /tf is its streams.

All others go by the names of their fields, under their names in ROS, and every dataclass of a
program as it is.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

from tfbus.base.clock import Clock
from tfbus.base.errors import DecodeError
from tfbus.base.log import LogOnce
from tfbus.bus.retained import declare_retained_subscriber
from tfbus.frames.named import NamedMessages
from tfbus.geometry.transform import TransformStamped
from tfbus.node.endpoint import NodeEndpoint
from tfbus.node.node import Node
from tfbus.ros.counterparts import BY_ROS_TYPE, LIVE_COUNTERPARTS, Counterpart
from tfbus.ros.definitions import STRING, TURTLE_POSE
from tfbus.ros.message_classes import RosMessage
from tfbus.ros.transforms import TFMessage, message_with, stamped_of
from tfbus.ros.value_codec import UnfitError
from tfbus.streams.broadcaster import StaticTransformBroadcaster, TransformBroadcaster
from tfbus.wire.keys import STATIC_TRANSFORMS, TRANSFORMS, is_foreign
from tfbus.wire.transform_bytes import TransformMessage


@dataclass(frozen=True)
class BusType:
    """The type of a topic's messages on the bus, and the way there and back."""

    type: type[Any]
    to_bus: Callable[[Any], Any]
    from_bus: Callable[[Any], Any]


def bus_type_of(message_type: type, topic: str, clock: Clock) -> BusType:
    """How messages of this type go over the bus; `clock` stamps them if ROS does not."""
    ros_type = getattr(message_type, "__ros_name__", "")
    counterpart = BY_ROS_TYPE.get(ros_type)
    if ros_type == STRING.name and topic.rpartition("/")[2] == "robot_description":
        counterpart = LIVE_COUNTERPARTS["RobotDescription"]
    if counterpart is None:
        return BusType(message_type, _as_it_is, _as_it_is)
    carried = _carried_type(message_type, counterpart)
    if ros_type != TURTLE_POSE.name:
        return BusType(carried, carried, _message_in)

    def stamped(message: Any) -> _Carried:
        made = carried(message)
        made.stamp_ns = clock.now_ns()
        return made

    return BusType(carried, stamped, _message_in)


class _Carried:
    """A message of ROS that is one of tfbus's on the bus; a subclass says which."""

    __slots__ = ("message", "stamp_ns")
    __msgtype__ = ""
    __message_type__: type[RosMessage]
    __counterpart__: Counterpart

    def __init__(self, message: Any) -> None:
        self.message = message
        self.stamp_ns: int | None = None

    def __bus_map__(self) -> dict[str, Any]:
        values = self.__counterpart__.of_ros(self.message.__listed__())
        return values if self.stamp_ns is None else {**values, "stamp_ns": self.stamp_ns}

    @classmethod
    def __of_bus_map__(cls, values: dict[str, Any], path: str, unknown_fields: bool) -> Any:
        try:
            of_ros = cls.__counterpart__.to_ros(values)
        except UnfitError as error:
            raise DecodeError(str(error) or "it has other fields") from error
        return cls(cls.__message_type__.__of_bus_map__(of_ros))


@cache
def _carried_type(message_type: type, counterpart: Counterpart) -> type[_Carried]:
    contents = {
        "__slots__": (),
        "__msgtype__": counterpart.type_name,
        "__message_type__": message_type,
        "__counterpart__": counterpart,
    }
    return type(counterpart.type_name, (_Carried,), contents)


def _message_in(carried: _Carried) -> Any:
    return carried.message


def _as_it_is(message: Any) -> Any:
    return message


@dataclass(frozen=True)
class TransformsTopic:
    """The transforms of a namespace, dynamic or static ones: `tf` or `tf_static`."""

    kind: str
    namespace: str

    def key(self, node: Node) -> str:
        """The key of its streams, as the node's session has it."""
        return self.kind if self.namespace == node.namespace else self.ros_name

    @property
    def ros_name(self) -> str:
        """The topic in ROS."""
        return f"/{self.namespace}/{self.kind}" if self.namespace else f"/{self.kind}"


def transforms_topic(node: Node, topic: str) -> TransformsTopic | None:
    """The transforms of a topic of TFMessage, after remapping; None for a topic of another name.

    `/tf` is, as for a TransformListener, the one of the node's namespace; `/robot7/tf` is robot7's.
    """
    resolved = node._resolve(topic)
    above, _, kind = resolved.rpartition("/")
    if kind not in (TRANSFORMS, STATIC_TRANSFORMS):
        return None
    if resolved == f"/{kind}" or not above:
        return TransformsTopic(kind, node.namespace)
    if resolved.startswith("/"):
        return TransformsTopic(kind, above[1:])
    return TransformsTopic(kind, f"{node.namespace}/{above}".lstrip("/"))


class TransformsPublisher(NodeEndpoint):
    """Sends the transforms of messages as a broadcaster of a node in their namespace does."""

    def __init__(self, node: Node, kind: str) -> None:
        super().__init__(kind, TFMessage)
        is_static = kind == STATIC_TRANSFORMS
        self._broadcaster = (StaticTransformBroadcaster if is_static else TransformBroadcaster)(
            node
        )

    def publish(self, transforms: list[TransformStamped]) -> None:
        """Send them; nothing after `close()`."""
        if not self.closed:
            self._broadcaster.send_transform(transforms)


class TransformsSubscription(NodeEndpoint):
    """Calls `callback(message)` for each message of any stream, static ones at once, on a thread
    of Zenoh.
    """

    def __init__(
        self, node: Node, topic: TransformsTopic, callback: Callable[[TransformMessage], object]
    ) -> None:
        super().__init__(topic.kind, TFMessage)
        self._once = LogOnce(node.log)
        self._named = NamedMessages(node, lambda key, message, size: callback(message))
        key = f"{topic.key(node)}/**"  # each stream has its own, and each frame of a split one
        if topic.kind == STATIC_TRANSFORMS:
            self._parts.append(declare_retained_subscriber(node.session, key, self._take))
        else:
            self._parts.append(node.session.subscriber(key, self._take))
        self._parts.append(self._named)

    def _take(self, key: str, payload: bytes) -> None:
        if self.closed or is_foreign(key):
            return
        try:
            self._named.decode(key, payload)
        except DecodeError as error:
            self._once.warning(("unreadable", key), "Skipped a message on %r: %s", key, error)


def _to_bus(message: Any) -> list[TransformStamped]:
    return [stamped_of(each) for each in message.transforms]


def _from_bus(message: TransformMessage) -> Any:
    """The transforms as they were sent, with the ones that a buffer refuses."""
    rows = message.rows
    named = ((rows.frames[parent], rows.frames[child]) for parent, child in rows.pairs())
    poses = rows.as_batch().poses.tolist()
    return TFMessage(
        transforms=[
            message_with(stamp_ns, parent, child, pose)
            for (parent, child), stamp_ns, pose in zip(
                named, rows.stamps_as_ints(), poses, strict=True
            )
        ]
    )


ON_TRANSFORM_TOPICS = BusType(TFMessage, _to_bus, _from_bus)
