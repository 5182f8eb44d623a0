"""RViz's tools: the messages that a drag or a click on the scene sends, and their publishers."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from tfbus import messages
from tfbus.errors import TfbusError
from tfbus.node.node import Node
from tfbus.node.topic import Publisher
from tfbus.view.settings import ViewSettings
from tfbus.wording import printable

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
        self._publishers: dict[str, Publisher[Any]] = {}
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
                self._publishers[tool.name] = self._node.create_publisher(tool.message_type, topic)
            except TfbusError as error:
                self.mistakes[tool.name] = printable(str(error), 300)

    def topic(self, tool: Tool) -> str:
        """The topic of a tool as the bus has it; "" if it has no publisher."""
        publisher = self._publishers.get(tool.name)
        return publisher.name if publisher else ""

    def send(
        self, tool: Tool, frame_id: str, xyz: tuple[float, float, float], yaw_rad: float
    ) -> bool:
        """Publish the message of a tool, as of now; False if it has no publisher."""
        publisher = self._publishers.get(tool.name)
        if publisher is None:
            return False
        publisher.publish(tool.make(self._node.now_ns(), frame_id, xyz, yaw_rad))
        return True

    def close(self) -> None:
        """End the publishers. Twice is fine."""
        for name in list(self._publishers):
            self._end(name)

    def _end(self, name: str) -> None:
        self.mistakes.pop(name, None)
        if (publisher := self._publishers.pop(name, None)) is not None:
            publisher.close()
