"""The page's topics: subscriptions to drawable types, and the publishers of RViz's tools."""

import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, Protocol

import numpy as np

from tfbus import messages
from tfbus.base import scheduler
from tfbus.base.errors import TfbusError
from tfbus.base.log import LogOnce
from tfbus.base.wording import printable
from tfbus.buffer.buffer import Buffer
from tfbus.bus.graph import TopicInfo, graph_of
from tfbus.bus.graph_watch import GraphWatch
from tfbus.bus.network_session import HeardWatch
from tfbus.node.node import Node
from tfbus.node.topic import Publisher, Subscription
from tfbus.view.settings import TopicSettings, ViewSettings, topic_of
from tfbus.wire.codec import type_name
from tfbus.wire.descriptions import NodeDescription
from tfbus.wire.fleet import Fleet, FrameNames
from tfbus.wire.keys import namespace_of_node, relative

# Of the others the newest message is all that is drawn.
EVERY = (messages.Marker, messages.MarkerArray, messages.Log, messages.Odometry)
POINTS = (messages.PointCloud, messages.LaserScan)
_DRAWN = (
    *EVERY,
    messages.PointCloud,
    messages.LaserScan,
    messages.Image,
    messages.CompressedImage,
    messages.Path,
    messages.PointStamped,
    messages.PolygonStamped,
    messages.PoseArray,
    messages.PoseStamped,
    messages.PoseWithCovarianceStamped,
    messages.OccupancyGrid,
    messages.Range,
)
TYPES: Mapping[str, type] = {type_name(each): each for each in _DRAWN}

_INFO_TYPE = type_name(messages.CameraInfo)

# Anyone on the bus can make topics: at most this many are offered, and messages kept of each.
MOST_TOPICS = 100
_MOST_KEPT = 1000
# All that waits of a topic; and a message without its arrays and texts.
MOST_BYTES = 32_000_000
_EMPTY_BYTES = 100
# Nobody has asked for the topics for so long: the nodes need not be watched.
_UNASKED_S = 10.0
# The newest message that has a transform is chosen among so many.
MOST_CHOICES = 5


# Messages that came at a time, in s, with the buffer by which they have their places.
Past = tuple[Buffer, float, list[Any]]


class DataSource(Protocol):
    """The topics of a bus, or of a recording; safe from any thread but for `catch_up` and `past`,
    which are for the one that draws. A topic that is shown twice is wanted by two names.

    Of a recording all that is drawn depends on its cursor only: other settings, and another fixed
    frame, begin anew with the `past`.
    """

    is_recorded: bool

    def topics(self) -> Mapping[str, TopicInfo]:
        """All topics as they were known last; it does not wait."""

    def want(self, topics: Mapping[str, TopicInfo]) -> None:
        """Subscribe to these, and to no others."""

    def waiting(self, topic: str) -> "Waiting | None":
        """The messages of a topic that are to be drawn; None without a subscription."""

    def catch_up(self, now_s: float) -> float:
        """Take the messages that have come by now, of a steady clock; the time in s by which they
        come.
        """

    def past(self, topic: str, settings: TopicSettings) -> Iterable[Past]:
        """The earlier messages that a drawing still needs, the oldest first."""

    def rejected(self, topic: str) -> int:
        """How many messages could not be read."""

    def now_ns(self) -> int:
        """The time by which messages are stamped."""

    def close(self) -> None:
        """End it. Twice is fine."""


class Waiting:
    """The messages of a topic that are not drawn yet, of a type: in bounded number and bytes. The
    newest stay; `dropped` older ones did not. `names` translates the frames of its robot.

    Safe from any thread: messages come on one, and another draws.
    """

    def __init__(self, message_type: type, names: FrameNames | None = None) -> None:
        self.message_type = message_type
        self.names = names
        self.is_every = message_type in EVERY
        self._most = _MOST_KEPT if self.is_every else MOST_CHOICES
        self._lock = scheduler.Lock()
        self._kept: deque[tuple[Any, int]] = deque()
        self._bytes = 0
        self.received = self.dropped = 0

    def put(self, message: Any) -> None:
        """Add the newest message."""
        size = size_of(message)
        with self._lock:
            self.received += 1
            self._kept.append((message, size))
            self._bytes += size
            self._bound()

    def __len__(self) -> int:
        return len(self._kept)

    def take(self) -> list[Any]:
        """All messages, the oldest first; none is left."""
        with self._lock:
            taken = [message for message, _ in self._kept]
            self._kept.clear()
            self._bytes = 0
        return taken

    def put_back(self, taken: list[Any]) -> None:
        """Keep messages whose transform is not known yet, before newer ones."""
        sizes = list(map(size_of, taken))
        with self._lock:
            self._kept.extendleft(reversed(list(zip(taken, sizes, strict=True))))
            self._bytes += sum(sizes)
            self._bound()

    def _bound(self) -> None:
        # The newest stays, however large it is: the bus bounds that.
        while len(self._kept) > self._most or (self._bytes > MOST_BYTES and len(self._kept) > 1):
            self._bytes -= self._kept.popleft()[1]
            self.dropped += 1


def size_of(message: Any) -> int:
    """About how many bytes a message takes: its arrays and texts, and some for the rest."""
    if isinstance(message, np.ndarray):
        return int(message.nbytes)
    if isinstance(message, str | bytes):
        return len(message)
    if isinstance(message, tuple):
        return sum(map(size_of, message))
    if not is_dataclass(message):
        return 0
    values = (getattr(message, each.name) for each in fields(message))
    return _EMPTY_BYTES + sum(map(size_of, values))


def drawn_type(topic: TopicInfo) -> type | None:
    """The class of a topic's messages, by its publishers; None if they cannot be drawn."""
    named = {end.type for end in topic.publishers}
    return TYPES.get(named.pop()) if len(named) == 1 else None


def message_type_of(topic: TopicInfo) -> type | None:
    """The same, or CameraInfo, which is read for images."""
    return messages.CameraInfo if topic.types == (_INFO_TYPE,) else drawn_type(topic)


def camera_topic(topic: str, topics: Mapping[str, TopicInfo]) -> str:
    """The topic of the CameraInfo beside an image's, as in ROS: `camera_info` in the same
    namespace, or in the one above; "" without one.
    """
    above = topic
    for _ in range(2):
        above = above.rpartition("/")[0]
        beside = f"{above}/camera_info".lstrip("/")
        info = topics.get(beside)
        if info is not None and any(end.type == _INFO_TYPE for end in info.publishers):
            return beside
    return ""


class DataOnBus:
    """The topics of a node's bus; the nodes are asked for theirs while somebody wants to know.

    With a `fleet`, frames of messages of its robots have their names from outside: `robot7/lidar`.
    """

    is_recorded = False

    def __init__(self, node: Node, fleet: Fleet | None = None) -> None:
        self._node = node
        self._fleet = fleet
        self._log_once = LogOnce(node.log)
        self._lock = scheduler.Lock()
        self._subscriptions: dict[str, tuple[Subscription[Any], Waiting]] = {}
        self._topics: Mapping[str, TopicInfo] = {}
        self._graph: GraphWatch | None = None
        self._asked_s = 0.0

    def topics(self) -> Mapping[str, TopicInfo]:
        """All topics as they were known last; it does not wait."""
        self._asked_s = scheduler.monotonic()
        if self._graph is None:
            self._graph = GraphWatch(
                self._node.session, self._node.log, everywhere=True, on_nodes=self._take
            )
        return self._topics

    def _take(self, nodes: list[NodeDescription]) -> None:
        self._topics = graph_of(nodes, {}, self._node.session.settings.namespace).topics

    def now_ns(self) -> int:
        """The time by which messages are stamped."""
        return self._node.now_ns()

    def close(self) -> None:
        """End the subscriptions."""
        self.want({})
        self._end_watch()

    def _end_watch(self) -> None:
        if self._graph is not None:
            self._graph.close()
            self._graph = None

    def want(self, topics: Mapping[str, TopicInfo]) -> None:
        """Subscribe to these, and to no others."""
        if scheduler.monotonic() - self._asked_s > _UNASKED_S:
            self._end_watch()
        types = {name: message_type_of(info) for name, info in topics.items()}
        with self._lock:
            for name, (subscription, waiting) in list(self._subscriptions.items()):
                if types.get(name) is not waiting.message_type:
                    del self._subscriptions[name]
                    subscription.close()
            for name, message_type in types.items():
                if message_type is not None and name not in self._subscriptions:
                    retained = any(end.retained for end in topics[name].publishers)
                    self._subscribe(name, message_type, retained)
                if name in self._subscriptions:
                    self._subscriptions[name][1].names = self._names_of(topics[name])

    def waiting(self, topic: str) -> Waiting | None:
        """The messages of a topic that are to be drawn; None without a subscription."""
        with self._lock:
            found = self._subscriptions.get(topic)
            return found[1] if found else None

    def catch_up(self, now_s: float) -> float:
        """Messages come by themselves: the same time."""
        return now_s

    def past(self, topic: str, settings: TopicSettings) -> Iterable[Past]:
        """Nothing: a bus has no past."""
        return ()

    def rejected(self, topic: str) -> int:
        """How many messages could not be read."""
        with self._lock:
            found = self._subscriptions.get(topic)
            return found[0].rejected if found else 0

    def _names_of(self, topic: TopicInfo) -> FrameNames | None:
        """The names of the frames of its robot: the one whose nodes publish, else by the name of
        the topic.
        """
        if self._fleet is None:
            return None
        own = self._node.namespace
        above = {
            relative(f"/{namespace_of_node(end.node)}/", own).rstrip("/")
            for end in topic.publishers
        }
        origin = above.pop() if len(above) == 1 else topic.name.rpartition("/")[0]
        return self._fleet.names(origin)

    def _subscribe(self, name: str, message_type: type, retained: bool) -> None:
        waiting = Waiting(message_type)
        try:
            subscription: Subscription[Any] = self._node.create_subscription(
                message_type, topic_of(name), waiting.put, retained=retained
            )
        except TfbusError as error:
            self._log_once.warning(name, "Topic %s is not shown: %s", printable(name), error)
            return
        self._subscriptions[name] = subscription, waiting


# As RViz: half a metre along x and y, and 15 degrees of yaw, as standard deviations.
_VARIANCES = {0: 0.25, 7: 0.25, 35: (math.pi / 12.0) ** 2}
_COVARIANCE = tuple(_VARIANCES.get(at, 0.0) for at in range(36))


def _pose(xyz: tuple[float, float, float], yaw_rad: float) -> messages.Pose3D:
    turn = messages.Quaternion(z=math.sin(yaw_rad / 2.0), w=math.cos(yaw_rad / 2.0))
    return messages.Pose3D(messages.Vector3(*xyz), turn)


Make = Callable[[int, str, tuple[float, float, float], float], Any]


@dataclass(frozen=True)
class Tool:
    """A tool: a drag gives a pose on the ground if it `has_heading`, else a click gives a point.

    `setting` is the field of ViewSettings that has its topic. `make(stamp_ns, frame_id, xyz,
    yaw_rad)` makes the message.
    """

    name: str
    title: str
    key: str
    setting: str
    message_type: type
    make: Make
    has_heading: bool
    color: tuple[int, int, int]

    def topic(self, settings: ViewSettings) -> str:
        """The topic that it publishes on."""
        return str(getattr(settings, self.setting))


TOOLS: Mapping[str, Tool] = {
    tool.name: tool
    for tool in (
        Tool(
            "goal",
            "Goal",
            "G",
            "goal_topic",
            messages.PoseStamped,
            lambda stamp_ns, frame_id, xyz, yaw_rad: messages.PoseStamped(
                stamp_ns, frame_id, _pose(xyz, yaw_rad)
            ),
            True,
            (190, 40, 170),
        ),
        Tool(
            "initial_pose",
            "Initial pose",
            "P",
            "initial_pose_topic",
            messages.PoseWithCovarianceStamped,
            lambda stamp_ns, frame_id, xyz, yaw_rad: messages.PoseWithCovarianceStamped(
                stamp_ns, frame_id, messages.PoseWithCovariance(_pose(xyz, yaw_rad), _COVARIANCE)
            ),
            True,
            (40, 160, 60),
        ),
        Tool(
            "point",
            "Point",
            "C",
            "point_topic",
            messages.PointStamped,
            lambda stamp_ns, frame_id, xyz, yaw_rad: messages.PointStamped(
                stamp_ns, frame_id, messages.Vector3(*xyz)
            ),
            False,
            (235, 120, 20),
        ),
    )
}


class ToolPublishers:
    """The publishers of the tools, on topics of a node; `mistakes` says of a tool why it has none.

    They are there before the first message, so that subscribers and bridges find them in time.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._topics: dict[str, str] = {}
        self._publishers: dict[str, tuple[Publisher[Any], HeardWatch]] = {}
        self.mistakes: dict[str, str] = {}

    def keep(self, settings: ViewSettings) -> None:
        """Have a publisher on the topic of each tool, and on no other."""
        for tool in TOOLS.values():
            topic = tool.topic(settings)
            if self._topics.get(tool.name) == topic:
                continue
            self._topics[tool.name] = topic
            self._end(tool.name)
            try:
                publisher: Publisher[Any] = self._node.create_publisher(tool.message_type, topic)
                heard = self._node.session.watch_heard(publisher.name)
                self._publishers[tool.name] = publisher, heard
            except TfbusError as error:
                self.mistakes[tool.name] = printable(str(error), 300)

    def topic(self, tool: Tool) -> str:
        """The topic of a tool as the bus has it; "" if it has no publisher."""
        found = self._publishers.get(tool.name)
        return found[0].name if found else ""

    def is_heard(self, tool: Tool) -> bool:
        """Whether anybody subscribes to the topic of a tool now."""
        found = self._publishers.get(tool.name)
        return found is not None and found[1].heard

    def send(
        self, tool: Tool, frame_id: str, xyz: tuple[float, float, float], yaw_rad: float
    ) -> bool:
        """Publish the message of a tool, as of now; False if it has no publisher."""
        found = self._publishers.get(tool.name)
        if found is None:
            return False
        found[0].publish(tool.make(self._node.now_ns(), frame_id, xyz, yaw_rad))
        return True

    def close(self) -> None:
        """End the publishers. Twice is fine."""
        for name in list(self._publishers):
            self._end(name)

    def _end(self, name: str) -> None:
        self.mistakes.pop(name, None)
        for part in self._publishers.pop(name, ()):
            part.close()
