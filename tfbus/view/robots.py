"""Robots as the page needs them: given by a program, described on a bus, or in a recording."""

import time
from collections import deque
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from threading import Lock
from typing import Protocol

from tfbus.base.bounded import Bounded
from tfbus.base.errors import DecodeError, InvalidNameError, RightsError, TfbusError, UrdfError
from tfbus.base.log import LogOnce
from tfbus.base.wording import printable
from tfbus.bus.network_session import Declaration
from tfbus.bus.retained import declare_signed_subscriber
from tfbus.messages import JointState, RobotDescription
from tfbus.node.node import Node
from tfbus.node.robot_meshes import fetch_mesh
from tfbus.node.topic import Publisher, Subscription
from tfbus.recording.items import Selection, TopicItem
from tfbus.recording.reader import RecordingReader
from tfbus.robot.mesh_files import package_folder, parts_of
from tfbus.robot.model import Collision, Mesh, Visual
from tfbus.robot.robot import Robot, read_described
from tfbus.view.meshes.loader import MeshSource
from tfbus.view.meshes.mesh import MeshError
from tfbus.view.replay import Replay
from tfbus.wire.codec import decode_message, is_of_ros
from tfbus.wire.fleet import Fleet, FrameNames
from tfbus.wire.keys import check_namespace, check_no_transforms


@dataclass(frozen=True, eq=False)
class ShownRobot:
    """A robot whose links have the frames of their names behind `prefix`, as `names` calls them
    here.

    `is_described` is whether it comes from a bus or a recording, by a process that publishes its
    frames, `is_fetched` whether meshes that are not on this machine can be had from there, in the
    namespace `origin`. `sender` tells who describes it from others, whose meshes take turns.
    """

    robot: Robot
    prefix: str = ""
    names: FrameNames | None = None
    is_described: bool = False
    is_fetched: bool = False
    sender: str = ""

    @property
    def origin(self) -> str:
        """The namespace that it is in, relative to ours."""
        return self.names.namespace if self.names else ""

    @property
    def title(self) -> str:
        """The key that tells it from other robots."""
        return "/".join(filter(None, (self.origin, self.prefix.strip("/_"), self.robot.name)))

    @cached_property
    def frames(self) -> dict[str, str]:
        """The frame of each link."""
        return {link: self._called(link) for link in self.robot.links}

    def frame_of(self, link: str) -> str:
        """The frame of a link."""
        return self.frames[link]

    def _called(self, link: str) -> str:
        frame = f"{self.prefix}{link}"
        return self.names.outside(frame) if self.names else frame

    @cached_property
    def visuals(self) -> tuple[Visual, ...]:
        """The visuals of all links."""
        return tuple(each for link in self.robot.links.values() for each in link.visuals)

    @cached_property
    def collisions(self) -> tuple[Collision, ...]:
        """The collisions of all links."""
        return tuple(each for link in self.robot.links.values() for each in link.collisions)

    @cached_property
    def shaped_links(self) -> tuple[str, ...]:
        """The links that have shapes."""
        shown = [each.link for each in self.visuals]
        collide = [each.link for each in self.collisions]
        return tuple(dict.fromkeys((*shown, *collide)))

    def source_of(self, mesh: Mesh, texture: str = "") -> MeshSource | str:
        """The file of a mesh, with a texture of the URDF, or why it cannot be."""
        file = mesh.file
        if file is not None and file.is_file():
            return source_at(mesh.name, file, texture, mesh.beside(texture) if texture else None)
        if self.is_fetched:
            return MeshSource(mesh.name, origin=self.origin, texture=texture)
        package, _ = parts_of(mesh.name)
        remedy = f"; --package-path names the folder with package {package!r}" if package else ""
        if file is None:
            return f"it is not on this machine{remedy}"
        return f"no file {file}{remedy}"


def source_at(name: str, file: Path, texture: str = "", picture: Path | None = None) -> MeshSource:
    """The mesh of this name in a file that is there, with a texture that is in another."""
    status = file.stat()
    version = f"{status.st_mtime_ns} {status.st_size}"
    # Pictures may lie beside the folder of meshes.
    root = package_folder(name, file) or file.parent.parent
    return MeshSource(name, file, root, "", version, texture, picture)


class Joints(Protocol):
    """The joints of one robot on the bus."""

    @property
    def positions(self) -> Mapping[str, float]:
        """Their last known positions, in rad and m."""

    @property
    def is_heard(self) -> bool:
        """Whether a process takes targets."""

    def send(self, targets: Mapping[str, float]) -> None:
        """Send targets to it, in rad and m."""


class RobotSource(Protocol):
    """The robots of a bus, a recording or a program; safe from any thread."""

    def robots(self) -> Sequence[ShownRobot]:
        """The robots now; one that has not changed is the same object."""

    def mistakes(self) -> Sequence[str]:
        """Why there are not more, in sentences that can be printed."""

    def joints(self, robot: ShownRobot) -> Joints | None:
        """The joints of a robot; None if nothing can move them."""

    def fetch(self, origin: str, mesh: str, within_s: float) -> bytes:
        """The content of a mesh that is not on this machine. Raises MeshError, also if it takes
        longer.
        """

    def close(self) -> None:
        """End it. Twice is fine."""


class GivenRobots:
    """The robots that a program has given."""

    def __init__(self, robots: Sequence[ShownRobot] = ()) -> None:
        self._robots = list(robots)

    def robots(self) -> Sequence[ShownRobot]:
        """The given robots."""
        return list(self._robots)

    def add(self, robot: ShownRobot) -> None:
        """Add a robot; it replaces one of the same title."""
        self._robots = [
            *(each for each in self._robots if each.title != robot.title),
            robot,
        ]

    def mistakes(self) -> Sequence[str]:
        """None."""
        return ()

    def joints(self, robot: ShownRobot) -> Joints | None:
        """None: nothing is on a bus."""
        return None

    def fetch(self, origin: str, mesh: str, within_s: float) -> bytes:
        """Nothing is fetched."""
        raise MeshError("it is not on this machine")

    def close(self) -> None:
        """Nothing to end."""


_TOPIC = "robot_description"

# Descriptions come from anyone on the bus: at most this many are shown, their mistakes named, and
# bytes of them wait to be read.
_MOST_ROBOTS = 200
_MOST_MISTAKES = 20
_MOST_WAITING = 1000
_MOST_WAITING_BYTES = 100_000_000

# In the place of a namespace, which has no slash in front.
_TOO_MANY, _TOO_FAST = "/too many", "/too fast"


@dataclass(frozen=True)
class _Described:
    """A description, the robot that it is, and the id of the session that it came from."""

    description: RobotDescription
    shown: ShownRobot
    sender: str


class RobotsOnBus:
    """The robots that are described on the bus: of the node's namespace, and with a fleet also of
    the namespaces below. With a `robot` it shows that one, and no descriptions.
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
        self._waiting: deque[tuple[str, bytes, str]] = deque()
        # By namespace and prefix, which tell their frames apart.
        self._described: dict[tuple[str, str], _Described] = {}
        self._given = None if robot is None else ShownRobot(robot)
        self._mistakes: Bounded[str, str] = Bounded(_MOST_MISTAKES)
        self._joints: dict[str, _JointTopics | None] = {}
        self._subscription: Declaration | None = None
        if robot is not None:
            return
        within = f"**/{_TOPIC}" if fleet is not None else _TOPIC
        self._subscription = declare_signed_subscriber(node.session, within, self.take)

    def robots(self) -> Sequence[ShownRobot]:
        """The described robots, by namespace."""
        if self._given is not None:
            return [self._given]
        with self._lock:
            return [self._described[slot].shown for slot in sorted(self._described)]

    def mistakes(self) -> Sequence[str]:
        """The mistakes of descriptions that are no robots."""
        with self._lock:
            return list(self._mistakes.values())

    def joints(self, robot: ShownRobot) -> Joints | None:
        """The joints of a robot, by the topics of its namespace; None if this identity may not
        move them.
        """
        with self._lock:
            if robot.origin not in self._joints:
                try:
                    self._joints[robot.origin] = _JointTopics(self._node, robot.origin)
                except RightsError as error:
                    self._joints[robot.origin] = None
                    self._log_once.warning("rights", "The joints cannot be moved: %s", error)
            return self._joints[robot.origin]

    def fetch(self, origin: str, mesh: str, within_s: float) -> bytes:
        """A mesh of a robot, from the machine that describes it."""
        try:
            return fetch_mesh(self._node, origin, mesh, within_s)
        except TfbusError as error:
            reason = printable(str(error), 400)
            raise MeshError(f"it is not on this machine, and {reason}") from error

    def close(self) -> None:
        """End the subscription."""
        if self._subscription is not None:
            self._subscription.close()

    # Descriptions

    def take(self, key: str, payload: bytes, sender: str) -> None:
        """Read a description that came on a key, later and on a thread of the node."""
        if is_of_ros(payload):
            return
        origin = key.removesuffix(_TOPIC).strip("/")
        with self._lock:
            size = len(payload) + sum(len(waiting) for _, waiting, _ in self._waiting)
            if size > _MOST_WAITING_BYTES or len(self._waiting) >= _MOST_WAITING:
                self._name_mistake(
                    _TOO_FAST,
                    "Some robot_descriptions are not shown: they came too fast to be read",
                )
                return
            self._waiting.append((origin, payload, sender))
            is_first = len(self._waiting) == 1
        if is_first:
            self._read_later()

    def _read_later(self) -> None:
        # To read a large URDF takes longer than Zenoh's thread should.
        self._node.executor.submit(f"topic {_TOPIC}", self._read_next)

    def _read_next(self) -> None:
        try:
            self._read(*self._waiting[0])
        finally:
            with self._lock:
                self._waiting.popleft()
                more = bool(self._waiting)
            if more:
                self._read_later()

    def _read(self, origin: str, payload: bytes, sender: str) -> None:
        try:
            if origin:
                # Its meshes and joints are there too.
                check_no_transforms(check_namespace(origin))
            self._take(origin, decode_message(RobotDescription, payload), sender)
        except (DecodeError, UrdfError, InvalidNameError) as error:
            where = f" in {printable(origin)}" if origin else ""
            with self._lock:
                text = f"The robot_description{where} is not shown: {printable(str(error), 400)}"
                # Bytes that are no description have as many reasons as there are bytes.
                kind = ("unread", origin) if isinstance(error, DecodeError) else None
                self._name_mistake(origin, text, kind)

    def _name_mistake(self, origin: str, mistake: str, kind: Hashable = None) -> None:
        self._mistakes[origin] = mistake
        self._log_once.warning(mistake if kind is None else kind, "%s", mistake)

    def _take(self, origin: str, described: RobotDescription, sender: str) -> None:
        slot = (origin, described.prefix)
        with self._lock:
            known = self._described.get(slot)
            if known is not None and known.description == described:
                self._mistakes.pop(origin, None)
                return
            former = self._former(origin, described, sender)
            if known is None and former is None and len(self._described) >= _MOST_ROBOTS:
                self._name_mistake(_TOO_MANY, f"Only {_MOST_ROBOTS} robots are shown")
                return
        robot = read_described(
            described.urdf, described.source, self._package_path, "the robot_description"
        )
        names = self._fleet.names(origin) if self._fleet is not None else None
        # One that sets no source is a plain publisher: its namespace tells it from others.
        by = sender or origin
        shown = ShownRobot(
            robot, described.prefix, names, is_described=True, is_fetched=True, sender=by
        )
        with self._lock:
            if former is not None:
                del self._described[former]
            self._described[slot] = _Described(described, shown, sender)
            self._mistakes.pop(origin, None)

    def _former(
        self, origin: str, described: RobotDescription, sender: str
    ) -> tuple[str, str] | None:
        """The former place of a robot that its publisher now describes with another prefix. Two of
        one session differ by where they are from.
        """
        if not (described.source and sender):
            return None
        for slot, each in self._described.items():
            is_same = (each.description.source, each.sender) == (described.source, sender)
            if is_same and slot[0] == origin and slot[1] != described.prefix:
                return slot
        return None


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
        if states.position:
            # Replaced as a whole: other threads read it.
            new = dict(zip(states.name, states.position, strict=True))
            self._positions = {**self._positions, **new} if len(self._positions) < 10_000 else new


# As many descriptions are remembered.
_MOST_RECORDED = 1000


@dataclass(frozen=True)
class _Recorded:
    """A description from a log time on: of ours, or a string as ROS has it."""

    log_ns: int
    topic: str
    text: str
    prefix: str = ""
    source: str = ""


class RecordedRobots:
    """The robots of the namespace that a replay shows, and with a fleet of namespaces below, at its
    cursor.

    Before its first description a robot is shown by that one.
    """

    def __init__(
        self, reader: RecordingReader, replay: Replay, package_path: Sequence[Path] = ()
    ) -> None:
        self._replay = replay
        self._package_path = tuple(package_path)
        self._mistakes: dict[str, None] = {}
        self._described: dict[tuple[str, str], list[_Recorded]] = {}
        try:
            for each in self._descriptions(reader):
                same = self._described.setdefault((each.topic, each.prefix), [])
                if not same or same[-1].text != each.text:
                    same.append(each)
                if sum(map(len, self._described.values())) >= _MOST_RECORDED:
                    break
        except DecodeError as error:
            self._mistakes[f"The robot_description cannot be read: {printable(str(error))}"] = None
        self._read: dict[_Recorded, ShownRobot | None] = {}
        self._given = GivenRobots()

    def robots(self) -> Sequence[ShownRobot]:
        """The robots as they were described at the cursor."""
        log_ns = self._replay.playhead.progress.log_ns
        found = [self._shown(_at(same, log_ns)) for same in self._described.values()]
        return [*(robot for robot in found if robot is not None), *self._given.robots()]

    def add(self, robot: ShownRobot) -> None:
        """Add a robot of the program; it replaces one of the same title."""
        self._given.add(robot)

    def mistakes(self) -> Sequence[str]:
        """Which descriptions are none."""
        return list(self._mistakes)

    def joints(self, robot: ShownRobot) -> Joints | None:
        """None: they were where they were."""
        return None

    def fetch(self, origin: str, mesh: str, within_s: float) -> bytes:
        """Meshes are not recorded."""
        raise MeshError("it is not on this machine")

    def close(self) -> None:
        """Nothing to end."""

    def _shown(self, described: _Recorded) -> ShownRobot | None:
        if described not in self._read:
            try:
                self._read[described] = self._make(described)
            except UrdfError as error:
                text = f"The robot_description is not shown: {printable(str(error), 400)}"
                self._mistakes[text] = None
                self._read[described] = None
        return self._read[described]

    def _make(self, described: _Recorded) -> ShownRobot:
        robot = read_described(
            described.text, described.source, self._package_path, "the recorded description"
        )
        names = None
        if self._replay.fleet is not None:
            own = self._replay.namespace
            namespace = _namespace(described.topic)
            names = self._replay.fleet.names(namespace.removeprefix(own).strip("/"))
        return ShownRobot(robot, described.prefix, names, is_described=True)

    def _is_seen(self, topic: str) -> bool:
        namespace, own = _namespace(topic), self._replay.namespace
        if topic.rpartition("/")[2] != _TOPIC:
            return False
        is_below = not own or namespace.startswith(f"{own}/")
        return namespace == own or (self._replay.fleet is not None and is_below)

    def _descriptions(self, reader: RecordingReader) -> Iterator[_Recorded]:
        names = tuple(each.name for each in reader.topics if self._is_seen(each.name))
        for item in reader.items(selection=Selection(topics=names)) if names else ():
            if not isinstance(item, TopicItem):
                continue
            values = item.values
            text = values.get("urdf", values.get("data"))
            if isinstance(text, str):
                prefix, source = values.get("prefix", ""), values.get("source", "")
                is_plain = isinstance(prefix, str) and isinstance(source, str)
                given = (prefix, source) if is_plain else ()
                yield _Recorded(item.log_ns, item.topic, text, *given)


def _namespace(topic: str) -> str:
    return topic.strip("/").rpartition("/")[0]


def _at(same: Sequence[_Recorded], log_ns: int) -> _Recorded:
    until = [each for each in same if each.log_ns <= log_ns]
    return until[-1] if until else same[0]
