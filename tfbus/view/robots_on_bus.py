"""The robots on the bus: their descriptions, their joints, and their meshes from other machines."""

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from threading import Lock

from tfbus.bus.handles import Declaration
from tfbus.bus.retained import declare_retained_subscriber
from tfbus.errors import DecodeError, RightsError, TfbusError, UrdfError
from tfbus.messages import JointState, RobotDescription, RobotMesh
from tfbus.node.node import Node
from tfbus.node.service import Client
from tfbus.node.topic import Publisher, Subscription
from tfbus.robot.robot import Robot
from tfbus.runtime.log_once import LogOnce
from tfbus.view.meshes.guard import MeshError
from tfbus.view.meshes.limits import MOST_BYTES
from tfbus.view.model.shown_robot import ShownRobot
from tfbus.view.robot_source import Joints
from tfbus.wire.codec import decode_message
from tfbus.wire.fleet import Fleet
from tfbus.wording import printable

_TOPIC = "robot_description"

# Descriptions come from the bus: at most this many are shown.
_MOST_ROBOTS = 200

# How long one part of a mesh may take, and how often a file may change while it is read.
_PATIENCE_S = 10.0
_MOST_CHANGES = 3


class RobotsOnBus:
    """The robots that are described on the bus: of the node's namespace, and with a fleet also of
    those below. With a `robot` it shows that one, and no descriptions.
    """

    def __init__(
        self,
        node: Node,
        fleet: Fleet | None = None,
        package_path: Sequence[Path] = (),
        robot: Robot | None = None,
    ) -> None:
        self._node = node
        self._fleet = fleet
        self._package_path = tuple(package_path)
        self._log_once = LogOnce(node.log)
        self._lock = Lock()
        self._texts: dict[tuple[str, str], str] = {}
        self._robots: dict[tuple[str, str], ShownRobot] = {}
        self._mistakes: dict[str, str] = {}
        self._joints: dict[str, _JointTopics | None] = {}
        self._meshes: dict[str, Client] = {}
        self._subscription: Declaration | None = None
        if robot is not None:
            self._robots["", ""] = ShownRobot(robot)
            return
        within = f"**/{_TOPIC}" if fleet is not None else _TOPIC
        self._subscription = declare_retained_subscriber(node.session, within, self._on_message)

    def robots(self) -> Sequence[ShownRobot]:
        """Those described, by namespace."""
        with self._lock:
            return [self._robots[key] for key in sorted(self._robots)]

    def mistakes(self) -> Sequence[str]:
        """Which descriptions are none."""
        with self._lock:
            return list(self._mistakes.values())

    def joints(self, robot: ShownRobot) -> Joints | None:
        """The joints of a robot, by the topics of its namespace; None where this identity may not
        move them.
        """
        with self._lock:
            if robot.origin not in self._joints:
                try:
                    self._joints[robot.origin] = _JointTopics(self._node, robot.origin)
                except RightsError:
                    self._joints[robot.origin] = None
            return self._joints[robot.origin]

    def fetch(self, origin: str, mesh: str) -> bytes:
        """A mesh of a robot, from the machine that describes it."""
        try:
            client = self._client(origin)
        except RightsError as error:
            raise MeshError(f"it is not on this machine, and {printable(str(error))}") from error
        for _ in range(_MOST_CHANGES):
            found = self._fetch(client, mesh)
            if found is not None:
                return found
        raise MeshError("it changed while it was read")

    def close(self) -> None:
        """End the subscription."""
        if self._subscription is not None:
            self._subscription.close()

    # Descriptions

    def _on_message(self, key: str, payload: bytes) -> None:
        # To read a large URDF takes longer than Zenoh's thread should.
        self._node.executor.submit(f"topic {_TOPIC}", lambda: self._read(key, payload))

    def _read(self, key: str, payload: bytes) -> None:
        origin = key.removesuffix(_TOPIC).strip("/")
        where = f" in {printable(origin)}" if origin else ""
        try:
            described = decode_message(RobotDescription, payload)
            self._take(origin, described)
        except (DecodeError, UrdfError) as error:
            mistake = f"The robot_description{where} is not shown: {printable(str(error), 400)}"
            with self._lock:
                self._mistakes[origin] = mistake
            self._log_once.warning(mistake, "%s", mistake)

    def _take(self, origin: str, described: RobotDescription) -> None:
        slot = (origin, described.prefix)
        with self._lock:
            if self._texts.get(slot) == described.urdf:
                return
            if slot not in self._robots and len(self._robots) >= _MOST_ROBOTS:
                self._mistakes["/most"] = f"only {_MOST_ROBOTS} robots are shown"
                return
        source = Path(described.source)
        folder = source.parent if source.is_absolute() and source.is_file() else None
        robot = Robot.from_text(
            described.urdf,
            folder=folder,
            package_path=self._package_path,
            name_of_source=printable(described.source or "the robot_description"),
        )
        names = self._fleet.names(origin) if self._fleet is not None else None
        with self._lock:
            self._texts[slot] = described.urdf
            self._robots[slot] = ShownRobot(
                robot, described.prefix, names, is_described=True, is_fetched=True
            )
            self._mistakes.pop(origin, None)

    # Meshes

    def _client(self, origin: str) -> Client:
        with self._lock:
            client = self._meshes.get(origin)
            if client is None:
                name = f"{origin}/robot_mesh" if origin else "robot_mesh"
                client = self._meshes[origin] = self._node.create_client(RobotMesh, name)
            return client

    def _fetch(self, client: Client, mesh: str) -> bytes | None:
        """The whole file; None where it changed meanwhile."""
        parts: list[bytes] = []
        got, size, version = 0, 1, None
        while got < size:
            try:
                request = RobotMesh.Request(mesh, got)
                answer: RobotMesh.Response = client.call(request, timeout_s=_PATIENCE_S)
            except TfbusError as error:
                reason = printable(str(error), 300)
                raise MeshError(
                    f"it is not on this machine, and could not be fetched: {reason}"
                ) from error
            if version is not None and answer.version != version:
                return None
            version, size = answer.version, answer.size
            if size > MOST_BYTES:
                raise MeshError(
                    f"it has {size / 1e6:.0f} MB, at most {MOST_BYTES / 1e6:.0f} are read"
                )
            if not answer.data and got < size:
                raise MeshError("it is not on this machine, and came in part only")
            parts.append(answer.data)
            got += len(answer.data)
        return b"".join(parts)


class _JointTopics:
    """`joint_states` and `joint_targets` of one namespace."""

    def __init__(self, node: Node, origin: str) -> None:
        lead = f"{origin}/" if origin else ""
        self._node = node
        self._positions: dict[str, float] = {}
        topic = f"{lead}joint_targets"
        # First, since an identity may have no right to it.
        self._targets: Publisher[JointState] = node.create_publisher(JointState, topic)
        self._states: Subscription[JointState] = node.create_subscription(
            JointState, f"{lead}joint_states", self._on_states
        )
        self._watch = node.session.watch_heard(topic)

    @property
    def positions(self) -> Mapping[str, float]:
        return self._positions

    @property
    def is_heard(self) -> bool:
        return self._watch.heard

    def send(self, targets: Mapping[str, float]) -> None:
        names, positions = tuple(targets), tuple(targets.values())
        self._targets.publish(JointState(self._node.now_ns() or time.time_ns(), names, positions))

    def _on_states(self, states: JointState) -> None:
        if states.positions:
            # Replaced as a whole: other threads read it.
            new = dict(zip(states.names, states.positions, strict=True))
            self._positions = {**self._positions, **new} if len(self._positions) < 10_000 else new
