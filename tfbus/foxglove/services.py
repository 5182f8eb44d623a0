"""Requests of clients to the bus: they call services, and drive by publishing velocities."""

import json
import struct
import threading
from collections.abc import Mapping, Sequence
from typing import Any

from tfbus import messages
from tfbus.bus.session import Session
from tfbus.discover.graph import Graph, ServiceInfo
from tfbus.errors import DecodeError, ServiceError
from tfbus.foxglove.as_json import json_of, json_schema, values_of
from tfbus.foxglove.nodes import absolute
from tfbus.foxglove.protocol import ClientChannel
from tfbus.foxglove.server import Server, Service
from tfbus.messages import Twist
from tfbus.node.node import Node
from tfbus.node.topic import Publisher
from tfbus.runtime.log import LogOnce
from tfbus.wire.codec import as_map, decode_map, encode_map, from_map
from tfbus.wording import listed, printable

# A service answers at once; an action may take long, and the panel waits for its result.
_TIMEOUT_S = 60.0

_MOST_SERVICES = 2000


class LiveServices:
    """The services of the bus, as of the last `update`.

    An action is a service whose request is the goal and whose response is the result.
    """

    def __init__(self, session: Session, server: Server) -> None:
        self._session = session
        self._server = server
        self._offered: dict[str, str] = {}

    def update(self, graph: Graph) -> None:
        """Take the services of the graph."""
        present = {
            absolute(name): _type_of(info)
            for name, info in list(graph.services.items())[:_MOST_SERVICES]
            if info.servers
        }
        gone = [name for name, of in self._offered.items() if present.get(name) != of]
        if gone:
            self._server.remove_services(gone)
        for name in gone:
            del self._offered[name]
        for name, type_name in present.items():
            if name not in self._offered:
                self._offered[name] = type_name
                self._server.add_service(self._service(name, type_name))

    def _service(self, name: str, type_name: str) -> Service:
        request, response = _parts(type_name)
        return Service(
            name,
            type_name or "unknown",
            _schema(request),
            _schema(response),
            lambda asked: self._call(name, request, asked),
        )

    def _call(self, name: str, request_type: type | None, asked: bytes) -> bytes:
        values = values_of(asked, request_type)
        if request_type is not None:
            values = as_map(from_map(request_type, values, unknown_fields=False))
        return json_of(self._last_answer(name, values))

    def _last_answer(self, name: str, values: Mapping[str, Any]) -> Mapping[str, Any]:
        last: Mapping[str, Any] | None = None
        self._session.settings.check_right("calls", name)
        for answer in self._session.ask(name, encode_map(values), timeout_s=_TIMEOUT_S):
            if answer.refusal is not None:
                raise ServiceError(answer.refusal or f"{name} did not answer in time")
            last = decode_map(answer.payload)
        if last is None:
            raise ServiceError(f"{name} did not answer")
        return last


def _type_of(info: ServiceInfo) -> str:
    return next(iter(info.types), "")


def _parts(type_name: str) -> tuple[type | None, type | None]:
    """The types of request and response, as far as tfbus.messages has them."""
    found = getattr(messages, type_name, None)
    request = getattr(found, "Request", None) or getattr(found, "Goal", None)
    return request, getattr(found, "Response", None)


def _schema(message_type: type | None) -> tuple[str, str]:
    """The name of a type, and its schema in JSON."""
    if message_type is None:
        return "", json.dumps({"type": "object"})
    return message_type.__qualname__, json.dumps(json_schema(message_type))


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
