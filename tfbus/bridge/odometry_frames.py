"""The poses of Odometry as transforms: what a node of ROS says on odom, as if it were on /tf."""

import threading
from collections.abc import Mapping, Sequence

from tfbus.bridge.legs import Endable, Leg, OnMessage, RosPublisher, RosSender, RosTopic
from tfbus.bridge.topic_table import TopicTable
from tfbus.errors import DecodeError
from tfbus.ros.definitions import ODOMETRY, TF_MESSAGE
from tfbus.ros.schema import MessageCodec


class OdometryFrames:
    """A leg in whose `/tf` are also the poses of the Odometry on some topics, by their publishers.

    `topics` are their full names in ROS.
    """

    def __init__(self, leg: Leg, topics: Sequence[str]) -> None:
        self._leg = leg
        self._topics = tuple(topics)
        # That of transforms, once it is subscribed to.
        self._tf = ""

    @property
    def name(self) -> str:
        return self._leg.name

    @property
    def tells_publishers(self) -> bool:
        return self._leg.tells_publishers

    def publisher(self, topic: RosTopic) -> RosSender:
        return self._leg.publisher(topic)

    def subscribe(self, topic: RosTopic, on_message: OnMessage) -> Endable:
        if topic.definition != TF_MESSAGE or topic.retained:
            return self._leg.subscribe(topic, on_message)
        self._tf = topic.name
        return _Both(self._leg, topic, self._topics, on_message)

    def publishers(self, topic: str) -> Sequence[RosPublisher]:
        found = list(self._leg.publishers(topic))
        if topic == self._tf:
            known = {each.gid for each in found}
            for name in self._topics:
                found += [each for each in self._leg.publishers(name) if each.gid not in known]
        return found

    def lost(self) -> Mapping[str, int]:
        return self._leg.lost()

    def warnings(self) -> Sequence[str]:
        return self._leg.warnings()

    def close(self) -> None:
        self._leg.close()


def with_odometry_frames(leg: Leg, table: TopicTable, ros_namespace: str) -> Leg:
    """The leg with the frames of the topics that the table has as Odometry."""
    above = f"/{ros_namespace}" if ros_namespace else ""
    names = [
        f"{above}/{name}"
        for name, line in table.names.items()
        if line.ros_type == ODOMETRY.name and line.comes_from_ros
    ]
    return OdometryFrames(leg, names)


class _Both:
    """Subscriptions of transforms and of Odometry, whose callbacks come one at a time."""

    def __init__(
        self, leg: Leg, topic: RosTopic, odometry: Sequence[str], on_message: OnMessage
    ) -> None:
        lock = threading.Lock()
        codec = MessageCodec.of_definition(ODOMETRY)
        transforms = MessageCodec.of_definition(TF_MESSAGE)

        def take(payload: bytes, gid: str) -> None:
            with lock:
                on_message(payload, gid)

        def take_odometry(payload: bytes, gid: str) -> None:
            try:
                values = codec.decode(payload)
            except DecodeError:
                return  # the bridge of topics reads it as well, and says so
            pose = values["pose"]["pose"]
            transform = {
                "header": values["header"],
                "child_frame_id": values["child_frame_id"],
                "transform": {"translation": pose["position"], "rotation": pose["orientation"]},
            }
            message = transforms.encode({"transforms": [transform]})
            if message is not None:
                take(message, gid)

        self._parts = [leg.subscribe(topic, take)]
        for name in odometry:
            self._parts.append(leg.subscribe(RosTopic(name, ODOMETRY), take_odometry))

    def close(self) -> None:
        for part in self._parts:
            part.close()
