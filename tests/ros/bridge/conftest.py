"""A ROS in memory, and bridges to it, that end with the test."""

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from tests.ros.bridge.fake_leg import FakeRos
from tests.simulated_bus import Bus
from tfbus import Node
from tfbus.ros.bridge.bridge import Bridge
from tfbus.ros.bridge.common import BridgeOptions
from tfbus.ros.bridge.legs import LegSettings
from tfbus.ros.bridge.topic_table import TopicTable

Bridged = Callable[..., Bridge]


@pytest.fixture
def ros(bus: Bus) -> Iterator[FakeRos]:
    """A ROS of the test's own."""
    ros = FakeRos()
    yield ros
    ros.close()


@pytest.fixture
def bridged(bus: Bus, ros: FakeRos) -> Iterator[Bridged]:
    """Starts a bridge: `bridged("ros2", frames=("a*",))`, on the test's bus and ROS or others."""
    bridges: list[Bridge] = []

    def start(
        name: str = "ros2",
        *,
        on: Bus | Node | None = None,
        to: FakeRos | None = None,
        tells_publishers: bool = True,
        table: TopicTable | None = None,
        **options: Any,
    ) -> Bridge:
        node = on if isinstance(on, Node) else (on or bus).node(name)
        settings = LegSettings(f"tfbus_{name}")
        leg = (to or ros).leg(settings, tells_publishers=tells_publishers)
        bridge = Bridge(
            node, leg, BridgeOptions(**options), ros_node=settings.full_name, table=table
        )
        bridges.append(bridge)
        return bridge

    yield start
    for bridge in bridges:
        bridge.close()
