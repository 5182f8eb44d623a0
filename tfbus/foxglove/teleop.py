"""Driving by Foxglove's Teleop panel: its messages become Twists on a topic."""

import struct
import threading
from collections.abc import Mapping, Sequence
from typing import Any

from tfbus.errors import DecodeError
from tfbus.foxglove.as_json import values_of
from tfbus.foxglove.graph import absolute
from tfbus.foxglove.protocol import ClientChannel
from tfbus.messages import Twist
from tfbus.node.node import Node
from tfbus.node.topic import Publisher
from tfbus.runtime.log_once import LogOnce
from tfbus.wire.codec import from_map
from tfbus.wording import listed, printable

_TWISTS = ("geometry_msgs/Twist", "geometry_msgs/msg/Twist", "tfbus_msgs/msg/Twist")

# Of all clients together.
_MOST_CHANNELS = 1000

# In CDR: a header of 4 bytes, and six numbers.
_CDR = {0: struct.Struct(">4x6d"), 1: struct.Struct("<4x6d")}


class Teleop:
    """Publishes what clients send on these topics; safe from any thread.

    With one topic, messages go there whatever name the panel gives its own. If a client that
    drives is gone, the last thing that is sent is to stand still.
    """

    def __init__(self, node: Node, topics: Sequence[str], once: LogOnce) -> None:
        self._publishers = {
            absolute(topic): node.create_publisher(Twist, topic) for topic in topics
        }
        self._once = once
        self._lock = threading.Lock()
        self._driving: dict[tuple[int, int], tuple[Publisher[Twist], ClientChannel]] = {}
        self._moving: set[tuple[int, int]] = set()

    def begin(self, client_id: int, channel: ClientChannel) -> str:
        """A client is going to send; returns why that is of no use, "" if it is."""
        if channel.schema_name not in _TWISTS or channel.encoding not in ("json", "cdr"):
            return (
                f"{printable(channel.topic)} takes geometry_msgs/Twist as json or cdr, not "
                f"{printable(channel.schema_name)} as {printable(channel.encoding)}"
            )
        publisher = self._publishers.get(absolute(channel.topic))
        if publisher is None and len(self._publishers) == 1:
            publisher = next(iter(self._publishers.values()))
        if publisher is None:
            return f"publish on {listed(sorted(self._publishers))}, not {printable(channel.topic)}"
        with self._lock:
            if len(self._driving) >= _MOST_CHANNELS:
                return f"more than {_MOST_CHANNELS} channels are advertised"
            self._driving[client_id, channel.id] = publisher, channel
        return ""

    def end(self, client_id: int, channel_id: int) -> None:
        """A client no longer sends."""
        at = client_id, channel_id
        with self._lock:
            driving = self._driving.pop(at, None)
            if driving is not None and at in self._moving:
                driving[0].publish(Twist())
            self._moving.discard(at)

    def send(self, client_id: int, channel_id: int, data: bytes) -> None:
        """Publish a message of a client; one that cannot be read is dropped."""
        at = client_id, channel_id
        with self._lock:
            driving = self._driving.get(at)
        if driving is None:
            return
        publisher, channel = driving
        try:
            twist = _read_cdr(data) if channel.encoding == "cdr" else _read_json(data)
        except (DecodeError, ValueError) as error:
            self._once.warning("teleop", "Dropped a message of Foxglove's: %s", error)
            return
        with self._lock:
            # Not after the stop of a client that has gone meanwhile.
            if at in self._driving:
                (self._moving.discard if twist == Twist() else self._moving.add)(at)
                publisher.publish(twist)


def _read_json(data: bytes) -> Twist:
    return from_map(Twist, values_of(data, None))


def _read_cdr(data: bytes) -> Twist:
    layout = _CDR.get(data[1]) if len(data) == 52 and data[0] == 0 else None
    if layout is None:
        raise DecodeError("it is no Twist in CDR")
    x, y, z, roll, pitch, yaw = layout.unpack(data)
    return _read_map({"x": x, "y": y, "z": z}, {"x": roll, "y": pitch, "z": yaw})


def _read_map(linear: Mapping[str, Any], angular: Mapping[str, Any]) -> Twist:
    return from_map(Twist, {"linear": linear, "angular": angular})
