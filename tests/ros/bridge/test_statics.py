"""Static transforms cross, and late joiners on either side have all of them."""

from functools import partial

import pytest

from tests.builders import S, at, x_of
from tests.buses import eventually
from tests.fakes import Lines
from tests.ros.bridge.conftest import Bridged
from tests.ros.bridge.fake_leg import FakeRos, FakeSender
from tests.ros.bridge.tf_node import TfNode
from tests.simulated_bus import Bus
from tfbus import (
    Buffer,
    InvalidArgumentException,
    Node,
    StaticTransformBroadcaster,
    TfbusError,
    TransformBroadcaster,
    TransformListener,
    TransformStamped,
)
from tfbus.ros.tf_message import TFMessageReader


def test_late_joiners_of_ros_get_one_message_with_all(
    bus: Bus, ros: FakeRos, bridged: Bridged
) -> None:
    """Of all streams of the bus."""
    for name in ("arm", "head"):
        StaticTransformBroadcaster(bus.node(name)).send_transform(at(1.0, f"{name}_camera"))
    bridged()
    early = TfNode(ros, "early")
    eventually(lambda: set(early.statics) == {"arm_camera", "head_camera"})
    ros.settle()
    late = TfNode(ros, "late")
    ros.settle()
    assert [{each.child_frame_id for each in message} for message in late.static_messages] == [
        {"arm_camera", "head_camera"}
    ]


def test_late_joiners_of_the_bus_get_those_of_all_nodes_of_ros(
    bus: Bus, ros: FakeRos, bridged: Bridged
) -> None:
    """Static transforms that a node has sent in several messages are, too."""
    first, second = TfNode(ros, "first"), TfNode(ros, "second")
    first.broadcast_static(at(1.0, "a"))
    second.broadcast_static(at(1.0, "b"))
    bridged()
    second.broadcast_static(at(2.0, "c"))
    node = bus.node("late")
    buffer = Buffer()
    with TransformListener(buffer, node):
        eventually(lambda: {"a", "b", "c"} <= set(buffer.frames()))
        assert buffer.frame("a").authority == "ros2/first"
        assert buffer.frame("c").authority == "ros2/second"
        assert all(buffer.frame(each).static for each in "abc")


def test_one_that_ros_cannot_have_keeps_no_other_away(
    bus: Bus, ros: FakeRos, bridged: Bridged, sender: Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As ROS 1 has no time before 1970; it is left out, and logged once."""
    send = FakeSender.send

    def send_as_ros1(self: FakeSender, payload: bytes) -> None:
        if any(each.stamp_ns < 0 for each in TFMessageReader().read(payload)):
            raise InvalidArgumentException("it must be from 1970 to 2106")
        send(self, payload)

    monkeypatch.setattr(FakeSender, "send", send_as_ros1)
    statics = StaticTransformBroadcaster(sender)
    statics.send_transform([at(1.0, "early", -5 * S), at(1.0, "camera", 5 * S)])
    node = bus.node("ros2")
    lines = Lines(node.log)
    bridged(on=node)
    rviz = TfNode(ros, "rviz")
    eventually(lambda: set(rviz.statics) == {"camera"})
    statics.send_transform(at(1.0, "laser", 5 * S))
    eventually(lambda: set(rviz.statics) == {"camera", "laser"})
    assert sum("from 1970 to 2106" in each for each in lines.lines) == 1


def test_one_that_could_not_be_sent_is_sent_later(
    bus: Bus, ros: FakeRos, bridged: Bridged, sender: Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And the log says why."""
    send = FakeSender.send
    failures = ["no network"]

    def send_at_last(self: FakeSender, payload: bytes) -> None:
        if self.topic.name == "/tf_static" and failures:
            raise TfbusError(failures.pop())
        send(self, payload)

    monkeypatch.setattr(FakeSender, "send", send_at_last)
    node = bus.node("ros2")
    lines = Lines(node.log)
    bridged(on=node)
    StaticTransformBroadcaster(sender).send_transform(at(1.0, "camera"))
    rviz = TfNode(ros, "rviz")
    eventually(lambda: set(rviz.statics) == {"camera"})
    assert any("ROS: no network" in each for each in lines.lines)


def test_a_changed_static_transform_is_sent_again(
    ros: FakeRos, bridged: Bridged, sender: Node, buffer: Buffer
) -> None:
    """In both directions."""
    robot, rviz = TfNode(ros, "robot"), TfNode(ros, "rviz")
    bridged()
    statics = StaticTransformBroadcaster(sender)
    for x in (1.0, 2.0):
        statics.send_transform(at(x, "of_bus"))
        robot.broadcast_static(at(x, "of_ros"))
        eventually(partial(is_at, rviz.statics, "of_bus", x))
        eventually(partial(comes_at, buffer, "of_ros", x))


def is_at(statics: dict[str, TransformStamped], child: str, x: float) -> bool:
    """Whether ROS has the frame there."""
    return child in statics and statics[child] == at(x, child)


def comes_at(buffer: Buffer, child: str, x: float) -> bool:
    """Whether the bus has the frame there."""
    return x_of(buffer, source=child) == x


def test_one_that_is_removed_is_not_in_the_next_message(
    ros: FakeRos, bridged: Bridged, sender: Node
) -> None:
    """So that late joiners do not get it."""
    bridged()
    rviz = TfNode(ros, "rviz")
    statics = StaticTransformBroadcaster(sender)
    statics.send_transform([at(1.0, "a"), at(1.0, "b")])
    eventually(lambda: set(rviz.statics) == {"a", "b"})
    statics.remove("a")
    eventually(lambda: [each.child_frame_id for each in rviz.static_messages[-1]] == ["b"])


def test_those_of_a_publisher_that_is_gone_are_taken_back(
    bus: Bus, ros: FakeRos, bridged: Bridged, sender: Node
) -> None:
    """And are there again when it is back."""
    rviz = TfNode(ros, "rviz")
    bridged()
    StaticTransformBroadcaster(sender).send_transform(at(1.0, "stays"))
    arm = bus.node("arm")
    StaticTransformBroadcaster(arm).send_transform(at(1.0, "goes"))
    eventually(lambda: set(rviz.statics) == {"stays", "goes"})
    arm.close()
    eventually(lambda: [each.child_frame_id for each in rviz.static_messages[-1]] == ["stays"])
    StaticTransformBroadcaster(bus.node("arm")).send_transform(at(1.0, "goes"))
    eventually(lambda: len(rviz.static_messages[-1]) == 2)


def test_a_static_frame_may_become_dynamic(
    ros: FakeRos, bridged: Bridged, sender: Node, buffer: Buffer
) -> None:
    """In both directions."""
    robot, rviz = TfNode(ros, "robot"), TfNode(ros, "rviz")
    bridged()
    StaticTransformBroadcaster(sender).send_transform(at(1.0, "of_bus"))
    robot.broadcast_static(at(1.0, "of_ros"))
    eventually(lambda: "of_bus" in rviz.statics and "of_ros" in buffer.frames())
    broadcaster = TransformBroadcaster(sender)
    broadcaster.send_transform(at(2.0, "of_bus", S))
    robot.broadcast(at(2.0, "of_ros", S))
    eventually(lambda: not buffer.frame("of_ros").static)
    eventually(lambda: "of_bus" in rviz.frames_heard() and rviz.static_messages[-1] == [])


def test_the_same_static_transform_on_both_sides_is_one(
    ros: FakeRos, bridged: Bridged, sender: Node, buffer: Buffer
) -> None:
    """As where both sides read the same URDF: no conflict; without that of the bus, ROS's comes."""
    robot = TfNode(ros, "robot")
    statics = StaticTransformBroadcaster(sender)
    statics.send_transform([at(1.0, "laser"), at(1.0, "other")])
    bridged()
    rviz = TfNode(ros, "rviz")
    eventually(lambda: "laser" in rviz.statics)
    robot.broadcast_static(at(1.0, "laser"), at(1.0, "more"))
    eventually(lambda: "more" in buffer.frames())
    assert buffer.frame("laser").authority == "sender"
    statics.remove("laser")
    eventually(
        lambda: "laser" in buffer.frames() and buffer.frame("laser").authority == "ros2/robot"
    )
