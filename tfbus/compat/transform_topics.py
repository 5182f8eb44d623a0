"""ROS's topics /tf and /tf_static of messages: on the bus they are the streams of a namespace."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from tfbus.broadcast.broadcaster import StaticTransformBroadcaster, TransformBroadcaster
from tfbus.bus.retained import declare_retained_subscriber
from tfbus.compat.bus_types import BusType
from tfbus.compat.fields import message_with, stamped_of
from tfbus.compat.used_messages import TFMessage
from tfbus.errors import DecodeError
from tfbus.geometry.transform import TransformStamped
from tfbus.node.endpoint import Endpoint
from tfbus.node.node import Node
from tfbus.runtime.log_once import LogOnce
from tfbus.wire.keys import STATIC_TRANSFORMS, TRANSFORMS, is_foreign
from tfbus.wire.scan import TransformMessage
from tfbus.wire.transforms import decode_transforms


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
    """Which transforms a topic of TFMessage is, after remapping; None for a topic of another name.

    `/tf` is, as for a TransformListener, that of the node's namespace; `/robot7/tf` is robot7's.
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


class TransformsPublisher(Endpoint):
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


class TransformsSubscription(Endpoint):
    """Calls `callback(message)` for each message of any stream, static ones at once, on a thread
    of Zenoh.
    """

    def __init__(
        self, node: Node, topic: TransformsTopic, callback: Callable[[TransformMessage], object]
    ) -> None:
        super().__init__(topic.kind, TFMessage)
        self._callback = callback
        self._once = LogOnce(node.log)
        key = f"{topic.key(node)}/**"  # each stream has its own, and each frame of a split one
        if topic.kind == STATIC_TRANSFORMS:
            self._parts.append(declare_retained_subscriber(node.session, key, self._take))
        else:
            self._parts.append(node.session.subscriber(key, self._take))

    def _take(self, key: str, payload: bytes) -> None:
        if self.closed or is_foreign(key):
            return
        try:
            message = decode_transforms(payload)
        except DecodeError as error:
            self._once.warning(("unreadable", key), "Skipped a message on %r: %s", key, error)
            return
        self._callback(message)


def _to_bus(message: Any) -> list[TransformStamped]:
    return [stamped_of(each) for each in message.transforms]


def _from_bus(message: TransformMessage) -> Any:
    """The transforms as they were sent, with those that a buffer refuses."""
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
