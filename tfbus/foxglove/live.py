"""The bus as Foxglove shows it: frames, topics, parameters, services, the graph, and the time.

Clients may call its services, set parameters, and drive by publishing velocities.
"""

import json
import struct
import threading
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from tfbus import messages
from tfbus.base.errors import DecodeError, ParameterError, ServiceError
from tfbus.base.executor import Executor
from tfbus.base.log import LogOnce
from tfbus.base.wording import listed, printable
from tfbus.bus.graph import Graph, ServiceInfo, graph_of
from tfbus.bus.graph_watch import GraphWatch
from tfbus.bus.remote_parameters import set_parameter
from tfbus.bus.session import Session
from tfbus.foxglove.client import Requests
from tfbus.foxglove.front import Front, Serving
from tfbus.foxglove.nodes import Connections, NodeParameters, absolute, connections
from tfbus.foxglove.protocol import Capability, ClientChannel, ShownParameter
from tfbus.foxglove.robots import GivenRobot, ShownRobots
from tfbus.foxglove.server import ServedService, Server
from tfbus.foxglove.topics import LiveTopics, TransformChannels, json_of, json_schema, values_of
from tfbus.messages import Twist
from tfbus.node.node import Node
from tfbus.node.robot_meshes import fetch_mesh
from tfbus.node.topic import Publisher
from tfbus.robot.robot import Robot
from tfbus.streams.listener import TransformListener
from tfbus.streams.passing_buffer import PassingBuffer
from tfbus.wire.codec import as_map, decode_map, encode_map, from_map
from tfbus.wire.descriptions import NodeDescription, ParameterDescription
from tfbus.wire.fleet import Fleet
from tfbus.wire.keys import relative_name

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

    def _service(self, name: str, type_name: str) -> ServedService:
        request, response = _parts(type_name)
        return ServedService(
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
    """Publishes clients' messages on these topics; safe from any thread.

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


_TIME_HZ = 20.0

# How far back Foxglove's clients could look up is their own affair; here only the last counts.
_CACHE_S = 10.0


class LiveBridge(Requests):
    """Serves Foxglove a node's view of the bus, until `close()`.

    Without a fleet that is the node's namespace, with one also the namespaces below. Clients may
    drive on the topics `teleop`. Clients of a `read_only` bridge can neither drive nor set
    parameters nor call services. Raises TfbusError if it cannot listen.

    Robots that are described on the bus are shown, or with a `robot` that one alone; their meshes
    are also looked for in `package_path`.
    """

    def __init__(
        self,
        node: Node,
        serving: Serving,
        *,
        fleet: Fleet | None = None,
        teleop: Sequence[str] = (),
        read_only: bool = False,
        robot: Robot | None = None,
        package_path: Sequence[Path] = (),
    ) -> None:
        self._node = node
        self._fleet = fleet
        self._read_only = read_only
        self._once = LogOnce(node.log)
        self._connections = Connections()
        self._server = Server(f"tfbus {node.full_name}", self, self._capabilities(teleop), node.log)
        self._transforms = TransformChannels(self._server, node.now_ns, self._once)
        fetch = partial(fetch_mesh, node) if robot is None else None
        self._robots = ShownRobots(self._once, package_path, fetch)
        shown = self._shown if robot is None else None
        self._robot = None if robot is None else GivenRobot(self._server, self._robots, robot)
        self._topics = LiveTopics(node, self._server, self._once, shown)
        self._parameters = NodeParameters(
            self._set_parameter, self._server.publish_parameters, self._refuse
        )
        self._services = LiveServices(node.session, self._server)
        self._teleop = Teleop(node, teleop, self._once)
        self._executor = Executor(f"{node.full_name} foxglove", node.log)
        self._buffer = PassingBuffer(
            _CACHE_S, on_rows=lambda rows, static, _: self._transforms.send(rows, static=static)
        )
        # With history, so that frames which seldom move are known at once, too.
        self._listener = TransformListener(self._buffer, node, history_s=_CACHE_S, fleet=fleet)
        node.clock.add_jump_callback(self._on_jump_back)
        self._nodes: Sequence[NodeDescription] = ()
        self._graph = GraphWatch(
            node.session, node.log, everywhere=fleet is not None, on_nodes=self._on_nodes
        )
        if node.clock.is_simulated:
            self._executor.every(1.0 / _TIME_HZ, self._tell_time)
        self.front = Front(serving, self._server, self._on_refused)

    def close(self) -> None:
        """Stop serving. Twice is fine."""
        self.front.close()
        self._node.clock.remove_jump_callback(self._on_jump_back)
        self._listener.close()
        self._graph.close()
        self._executor.close()
        self._server.close()
        self._topics.close()

    def _capabilities(self, teleop: Sequence[str]) -> list[Capability]:
        found = [Capability.GRAPH, Capability.PARAMETERS]
        if not self._read_only:
            found.append(Capability.SERVICES)
        if teleop:
            found.append(Capability.PUBLISH)
        if self._node.clock.is_simulated:
            found.append(Capability.TIME)
        return found

    # Requests and messages of clients, on the server's threads

    def subscribed(self, channel_id: int) -> None:
        """Send a late client static transforms, and the present pose of each dynamic frame."""
        if self._transforms.have(channel_id):
            self._executor.submit("transforms", self._send_present, limit=1)
        elif self._robot is not None and self._robot.have(channel_id):
            self._executor.submit("robot", self._send_robot, limit=1)
        else:
            self._executor.submit(
                f"channel {channel_id}", self._topics.subscribed, channel_id, limit=1
            )

    def unsubscribed(self, channel_id: int) -> None:
        """Unsubscribe from topics that no client watches."""
        self._executor.submit("topics", self._topics.adapt, limit=1)

    def asset(self, uri: str) -> bytes:
        return self._robots.asset(uri)

    def _shown(self, topic: str, values: Mapping[str, Any]) -> Mapping[str, Any]:
        """The description for clients, as this node calls the frames of its namespace."""
        origin = relative_name(topic, self._node.namespace).rpartition("/")[0]
        names = self._fleet.names(origin) if self._fleet is not None else None
        return self._robots.shown(values, names, origin)

    def get_parameters(self, names: Sequence[str]) -> list[ShownParameter]:
        return self._parameters.get(names)

    def set_parameters(self, given: Sequence[ShownParameter]) -> list[ShownParameter]:
        return self._parameters.set(given)

    def parameters_subscribed(self, names: Sequence[str]) -> None:
        self._executor.submit("parameters", self._parameters.publish, names, limit=100)

    def _set_parameter(self, node: str, name: str, value: object) -> ParameterDescription:
        if self._read_only:
            raise ParameterError("tfbus foxglove runs with --read-only")
        return set_parameter(self._node.session, node, name, value, self._refuse)

    def advertised(self, client_id: int, channel: ClientChannel) -> None:
        if mistake := self._teleop.begin(client_id, channel):
            self._refuse(mistake)

    def unadvertised(self, client_id: int, channel_id: int) -> None:
        self._teleop.end(client_id, channel_id)

    def published(self, client_id: int, channel_id: int, data: bytes) -> None:
        self._teleop.send(client_id, channel_id, data)

    # Changes, on the executor's thread

    def _on_nodes(self, nodes: Sequence[NodeDescription]) -> None:
        self._nodes = nodes
        self._executor.submit("nodes", self._adapt, limit=1)

    def _adapt(self) -> None:
        """Offer the parameters, topics and services that the nodes have now."""
        nodes = self._nodes
        streams = [each for each in self._listener.streams() if each.alive]
        graph = graph_of(nodes, {})
        self._parameters.update(nodes)
        self._topics.update(graph)
        if not self._read_only:
            self._services.update(graph)
        found = connections(nodes, streams)
        if found != self._connections:
            self._connections = found
            self._server.publish_graph(found)

    def _send_present(self) -> None:
        self._transforms.send_present(self._buffer)

    def _send_robot(self) -> None:
        if self._robot is not None:
            self._robot.send(self._node.now_ns())

    def _tell_time(self) -> None:
        if self._node.clock.is_running:
            self._server.tell_time(self._node.now_ns())

    def _on_jump_back(self, now_ns: int) -> None:
        """Have clients forget all: they keep transforms that are in the future now."""
        self._server.forget_the_past()
        self._send_present()

    # Warnings

    def _on_refused(self, reason: str) -> None:
        self._once.warning(("refused", reason), "Refused a client: %s", reason)

    def _refuse(self, reason: str) -> None:
        self._server.say(reason)
        self._once.info(("refused", reason), "%s", reason)
