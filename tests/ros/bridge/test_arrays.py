"""Arrays through a bridge: one binary on the bus, both ways."""

import numpy as np

from tfbus.messages import LaserScan, OccupancyGrid, PointCloud
from tfbus.ros.bridge.topic_table import TopicLine
from tfbus.ros.bridge.topics import Translation
from tfbus.ros.counterparts import AS_IN_ROS
from tfbus.wire.codec import encode_message, type_name


class SameNames:
    """Names of frames that are the same in ROS."""

    def in_ros(self, frame: str) -> str:
        """The name in ROS."""
        return frame

    def on_bus(self, frame: str) -> str:
        """The name on the bus."""
        return frame


def test_arrays_come_back_as_binaries() -> None:
    """A cloud, a scan and a map come from ROS with the bytes that a node of the bus would send."""
    for message in (
        PointCloud.from_xyz(5, "lidar", np.arange(30.0).reshape(10, 3)),
        LaserScan(5, "laser", -1.0, 1.0, 0.5, 0.0, 0.0, 0.5, 30.0, np.arange(99, dtype="f4")),
        OccupancyGrid(5, "map"),
    ):
        line = TopicLine(AS_IN_ROS[type_name(type(message))])
        translation = Translation(line, SameNames(), lambda: 0)  # type: ignore[arg-type]
        sent = encode_message(message)
        assert translation.of_ros(translation.to_ros(sent)) == sent
