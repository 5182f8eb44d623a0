"""Messages of ROS that are lost on their way are counted, and said."""

import logging

from tests.buses import eventually
from tests.fakes import Lines
from tests.ros.bridge.conftest import Bridged
from tests.ros.bridge.fake_leg import FakeRos
from tests.simulated_bus import Bus
from tfbus.ros.bridge.bridges import RosBridge
from tfbus.ros.bridge.legs import TRANSFORMS_READER_DEPTH, LostMessages


class TestNumbers:
    def test_a_gap_is_counted(self) -> None:
        """Of each publisher by itself, from the first message that came."""
        lost = LostMessages()
        for gid, number in (("a", 7), ("b", 1), ("a", 8), ("a", 11), ("b", 2), ("a", 12)):
            lost.came("/tf", gid, number)
        assert lost.counts == {"/tf": 2}

    def test_what_is_kept_for_late_ones_is_no_gap(self) -> None:
        """Numbers that have come before count for nothing."""
        lost = LostMessages()
        for number in (5, 6, 2, 3, 7):
            lost.came("/tf_static", "a", number)
        assert lost.counts == {}


def test_a_bridge_says_what_was_lost(bridged: Bridged, ros: FakeRos, bus: Bus) -> None:
    """Once in its log, and with its counts on the bus."""
    bridge = bridged()
    lines = Lines(bridge.node.log, logging.WARNING)
    counts: list[int] = []
    receiver = bus.node("receiver")
    receiver.create_subscription(
        RosBridge, "ros_bridges", lambda each: counts.append(each.lost), retained=True
    )
    leg = bridge.leg
    leg.lost_messages["/tf"] = 12  # type: ignore[attr-defined]  # the test's own leg
    eventually(lambda: counts and counts[-1] == 12)
    leg.lost_messages["/tf"] = 20  # type: ignore[attr-defined]
    eventually(lambda: counts[-1] == 20)
    [said] = [line for line in lines.lines if "Lost" in line]
    assert "Lost 12 messages" in said and "on /tf" in said


def test_a_bridge_has_room_for_many_transforms(bridged: Bridged, ros: FakeRos) -> None:
    """For dynamic and static ones alike."""
    bridged()
    depths = {each.topic.name: each.topic.depth for each in ros.subscriptions}
    assert depths["/tf"] == depths["/tf_static"] == TRANSFORMS_READER_DEPTH
