"""The bus as Foxglove shows it: frames, topics, parameters, services, the graph, and the time."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tfbus.discover.graph import graph_of
from tfbus.discover.parameters import set_parameter
from tfbus.discover.presence import GraphWatch
from tfbus.errors import ParameterError
from tfbus.foxglove.client import Requests
from tfbus.foxglove.front import Front, Serving
from tfbus.foxglove.nodes import Connections, NodeParameters, connections
from tfbus.foxglove.protocol import Capability, ClientChannel, Parameter
from tfbus.foxglove.robots import GivenRobot, ShownRobots
from tfbus.foxglove.server import Server
from tfbus.foxglove.services import LiveServices, Teleop
from tfbus.foxglove.topics import LiveTopics, TransformChannels
from tfbus.listen.listener import TransformListener
from tfbus.listen.passing_buffer import PassingBuffer
from tfbus.node.node import Node
from tfbus.node.robot_meshes import RobotMeshes
from tfbus.robot.robot import Robot
from tfbus.runtime.executor import Executor
from tfbus.runtime.log import LogOnce
from tfbus.wire.descriptions import NodeDescription, ParameterDescription
from tfbus.wire.fleet import Fleet
from tfbus.wire.keys import namespace_of, relative_name

# Nodes that take longer to describe themselves are left out until the next time.
_ASK_WITHIN_S = 0.8

_TIME_HZ = 20.0

# How far back Foxglove's clients could look up is their own affair; here only the last counts.
_CACHE_S = 10.0


class LiveBridge(Requests):
    """Serves Foxglove what a node sees, until `close()`.

    Without a fleet that is the node's namespace, with one also those below. Clients may drive on
    the topics `teleop`. Clients of a `read_only` bridge can neither drive nor set parameters nor
    call services. Raises TfbusError if it cannot listen.

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
        fetch = RobotMeshes(node).fetch if robot is None else None
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
        self._graph = GraphWatch(node.session, node.log, answer_within_s=_ASK_WITHIN_S)
        self._graph.start(self._executor, self._adapt)
        if node.clock.is_simulated:
            self._executor.every(1.0 / _TIME_HZ, self._tell_time)
        self.front = Front(serving, self._server, self._on_refused)

    def close(self) -> None:
        """Stop serving. Twice is fine."""
        self.front.close()
        self._node.clock.remove_jump_callback(self._on_jump_back)
        self._listener.close()
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

    # What clients ask and send, on the server's threads

    def subscribed(self, channel_id: int) -> None:
        """Late ones get static transforms, and where each dynamic frame is."""
        if self._transforms.have(channel_id):
            self._executor.submit("transforms", self._send_present, limit=1)
        elif self._robot is not None and self._robot.have(channel_id):
            self._executor.submit("robot", self._send_robot, limit=1)
        else:
            self._executor.submit(
                f"channel {channel_id}", lambda: self._topics.subscribed(channel_id), limit=1
            )

    def unsubscribed(self, channel_id: int) -> None:
        """The bus need not send what no client watches."""
        self._executor.submit("topics", self._topics.adapt, limit=1)

    def asset(self, uri: str) -> bytes:
        return self._robots.asset(uri)

    def _shown(self, topic: str, values: Mapping[str, Any]) -> Mapping[str, Any]:
        """The description for clients, as this node calls the frames of its namespace."""
        origin = relative_name(topic, self._node.namespace).rpartition("/")[0]
        names = self._fleet.names(origin) if self._fleet is not None else None
        return self._robots.shown(values, names, origin)

    def get_parameters(self, names: Sequence[str]) -> list[Parameter]:
        return self._parameters.get(names)

    def set_parameters(self, given: Sequence[Parameter]) -> list[Parameter]:
        return self._parameters.set(given)

    def parameters_subscribed(self, names: Sequence[str]) -> None:
        self._executor.submit("parameters", lambda: self._parameters.publish(names), limit=100)

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

    # What changes, on the executor's thread

    def _adapt(self, described: list[NodeDescription]) -> None:
        """Offer what the nodes have now."""
        nodes = [each for each in described if self._sees(each)]
        streams = [
            each
            for key, each in self._graph.streams().items()
            if self._fleet or not namespace_of(key)
        ]
        graph = graph_of(nodes, {})
        self._parameters.update(nodes)
        self._topics.update(graph)
        if not self._read_only:
            self._services.update(graph)
        found = connections(nodes, streams)
        if found != self._connections:
            self._connections = found
            self._server.publish_graph(found)

    def _sees(self, node: NodeDescription) -> bool:
        name = relative_name(node.name, self._node.namespace)
        return not name.startswith("/") and (self._fleet is not None or "/" not in name)

    def _send_present(self) -> None:
        self._transforms.send_present(self._buffer)

    def _send_robot(self) -> None:
        if self._robot is not None:
            self._robot.send(self._node.now_ns())

    def _tell_time(self) -> None:
        if self._node.clock.is_running:
            self._server.tell_time(self._node.now_ns())

    def _on_jump_back(self, now_ns: int) -> None:
        """Clients keep transforms of what is now the future until they forget all."""
        self._server.forget_the_past()
        self._send_present()

    # What is wrong

    def _on_refused(self, reason: str) -> None:
        self._once.warning(("refused", reason), "Refused a client: %s", reason)

    def _refuse(self, reason: str) -> None:
        self._server.say(reason)
        self._once.info(("refused", reason), "%s", reason)
