"""Transforms cross between the bus and ROS, in both directions."""

import math
import time

import pytest

from tests.builders import S, at, x_of
from tests.buses import eventually, send_until
from tests.fakes import Lines
from tests.ros.bridge.conftest import Bridged
from tests.ros.bridge.fake_leg import FakeRos
from tests.ros.bridge.tf_node import TfNode
from tfbus import (
    Buffer,
    Node,
    StaticTransformBroadcaster,
    Transform,
    TransformBroadcaster,
    TransformStamped,
)

STAMP_NS = 1670400305709085026
EXACT = TransformStamped(
    STAMP_NS, "map", "base_link", Transform((0.1, -2.25, 1e-9), (0.5, -0.5, 0.5, 0.5))
)


def test_transforms_go_to_ros_bit_by_bit(ros: FakeRos, bridged: Bridged, sender: Node) -> None:
    """With names, stamps and numbers; a batch is one message."""
    rviz = TfNode(ros, "rviz")
    bridged()
    broadcaster = TransformBroadcaster(sender)
    batch = [EXACT, at(1.0, "laser", STAMP_NS, parent="base_link")]
    send_until(lambda: broadcaster.send_transform(batch), lambda: bool(rviz.messages))
    assert rviz.messages[-1] == batch


def test_compact_transforms_go_to_ros_within_their_precision(
    ros: FakeRos, bridged: Bridged, sender: Node
) -> None:
    """Their frames, which have numbers on the bus, have names."""
    rviz = TfNode(ros, "rviz")
    bridged()
    broadcaster = TransformBroadcaster(sender, poses="compact")
    batch = [EXACT, at(1.0, "laser", STAMP_NS, parent="base_link")]
    send_until(lambda: broadcaster.send_transform(batch), lambda: bool(rviz.messages))
    for came, sent in zip(rviz.messages[-1], batch, strict=True):
        assert (came.stamp_ns, came.frame_id) == (STAMP_NS, sent.frame_id)
        assert came.child_frame_id == sent.child_frame_id
        assert came.transform.distance(sent.transform) < 1e-4
        assert came.transform.angle(sent.transform) < 2e-4


def test_transforms_come_from_ros_bit_by_bit(
    ros: FakeRos, bridged: Bridged, buffer: Buffer
) -> None:
    """In a stream that has the name of the node in ROS."""
    amcl = TfNode(ros, "amcl")
    bridged()
    send_until(lambda: amcl.broadcast(EXACT), lambda: "base_link" in buffer.frames())
    assert buffer.lookup_transform("map", "base_link") == EXACT
    assert buffer.frame("base_link").authority == "ros2/amcl"


def test_nothing_comes_back(ros: FakeRos, bridged: Bridged, sender: Node, buffer: Buffer) -> None:
    """What comes from ROS does not go there, and what goes there does not come."""
    robot, rviz = TfNode(ros, "robot"), TfNode(ros, "rviz")
    bridged()
    broadcaster = TransformBroadcaster(sender)
    statics = StaticTransformBroadcaster(sender)
    statics.send_transform(at(1.0, "of_bus_static"))
    robot.broadcast_static(at(2.0, "of_ros_static"))
    sent: list[int] = []

    def send() -> None:
        sent.append((len(sent) + 1) * S // 100)
        robot.broadcast(at(1.0, "of_ros", sent[-1]))
        broadcaster.send_transform(at(2.0, "of_bus", sent[-1]))

    send_until(
        send, lambda: x_of(buffer, source="of_ros") == 1.0 and x_of(buffer, source="of_bus") == 2.0
    )
    for _ in range(60):
        send()
        time.sleep(0.01)
    # Sent so fast that all may come before the bridge knows the stream.
    send_until(
        lambda: broadcaster.send_transform(at(2.0, "of_bus", sent[-1] + S)),
        lambda: rviz.frames_heard() >= {"of_bus", "of_ros"},
    )
    eventually(lambda: len(rviz.statics) == 2)
    eventually(lambda: "of_bus_static" in buffer.frames())
    ros.settle()
    stamps = [each.stamp_ns for each in rviz.heard if each.child_frame_id == "of_ros"]
    assert stamps == sent
    assert buffer.frame("of_bus").authority == "sender"
    assert buffer.frame("of_bus_static").authority == "sender"
    assert [len(each) for each in rviz.static_messages].count(2) == 0


@pytest.mark.parametrize("way", ["to_ros", "from_ros"])
def test_one_direction_alone(
    way: str, ros: FakeRos, bridged: Bridged, sender: Node, buffer: Buffer
) -> None:
    """Only to ROS, or only from it."""
    robot, rviz = TfNode(ros, "robot"), TfNode(ros, "rviz")
    bridged(**{"to_ros": False, "from_ros": False, way: True})
    broadcaster = TransformBroadcaster(sender)

    def send() -> None:
        robot.broadcast(at(1.0, "of_ros", sender.now_ns()))
        broadcaster.send_transform(at(2.0, "of_bus", sender.now_ns()))

    if way == "to_ros":
        send_until(send, lambda: "of_bus" in rviz.frames_heard())
        assert "of_ros" not in buffer.frames()
        assert not robot.leg.publishers("/clock")
    else:
        send_until(send, lambda: "of_ros" in buffer.frames())
        ros.settle()
        assert "of_bus" not in rviz.frames_heard()
        assert [each.node for each in rviz.leg.publishers("/tf")] == ["/robot"]


def test_only_the_frames_of_the_patterns_cross(
    ros: FakeRos, bridged: Bridged, sender: Node, buffer: Buffer
) -> None:
    """Child frames by the names of the bus, dynamic and static, in both directions."""
    robot, rviz = TfNode(ros, "robot"), TfNode(ros, "rviz")
    bridged(frames=("arm_*", "base"))
    broadcaster = TransformBroadcaster(sender)
    StaticTransformBroadcaster(sender).send_transform(
        [at(1.0, "arm_camera"), at(1.0, "leg_camera")]
    )
    robot.broadcast_static(at(1.0, "arm_lidar"), at(1.0, "leg_lidar"))

    def send() -> None:
        robot.broadcast(at(1.0, "leg_1", sender.now_ns()), at(1.0, "base", sender.now_ns()))
        broadcaster.send_transform(
            [at(2.0, "leg_2", sender.now_ns()), at(2.0, "arm_2", sender.now_ns())]
        )

    send_until(
        send,
        lambda: (
            {"base", "arm_lidar"} <= set(buffer.frames())
            and "arm_2" in rviz.frames_heard()
            and "arm_camera" in rviz.statics
        ),
    )
    assert not {"leg_1", "leg_lidar"} & set(buffer.frames())
    assert "leg_2" not in rviz.frames_heard() and "leg_camera" not in rviz.statics


def test_a_prefix_is_put_on_and_taken_off(
    ros: FakeRos, bridged: Bridged, sender: Node, buffer: Buffer
) -> None:
    """Frames of ROS have it on the bus; those of the bus that have it go to ROS without."""
    robot, rviz = TfNode(ros, "robot"), TfNode(ros, "rviz")
    bridged(frame_prefix="robot1/")
    broadcaster = TransformBroadcaster(sender)
    robot.broadcast_static(at(1.0, "laser", parent="base"))

    def send() -> None:
        robot.broadcast(at(1.0, "base", sender.now_ns(), parent="odom"))
        broadcaster.send_transform(
            [
                at(2.0, "robot1/odom", sender.now_ns(), parent="robot1/map"),
                at(3.0, "robot2/base", sender.now_ns(), parent="world"),
            ]
        )

    send_until(
        send,
        lambda: (
            {"robot1/base", "robot1/laser"} <= set(buffer.frames())
            and {"odom", "robot2/base"} <= rviz.frames_heard()
        ),
    )
    parents = {each.child_frame_id: each.frame_id for each in rviz.heard}
    assert parents["odom"] == "map" and parents["robot2/base"] == "world"
    assert buffer.frame("robot1/laser").parent == "robot1/base"


def test_a_frame_that_has_another_name_there_does_not_go(
    ros: FakeRos, bridged: Bridged, sender: Node, buffer: Buffer
) -> None:
    """With a prefix, `odom` of the bus is not the `odom` of ROS."""
    robot, rviz = TfNode(ros, "robot"), TfNode(ros, "rviz")
    lines = Lines(bridged(frame_prefix="robot1/").node.log)
    broadcaster = TransformBroadcaster(sender)
    send_until(
        lambda: robot.broadcast(at(1.0, "base", sender.now_ns(), parent="odom")),
        lambda: "robot1/base" in buffer.frames(),
    )

    def send() -> None:
        broadcaster.send_transform(
            [at(2.0, "odom", sender.now_ns()), at(3.0, "other", sender.now_ns())]
        )

    send_until(send, lambda: "other" in rviz.frames_heard())
    assert "odom" not in rviz.frames_heard()
    assert any("'odom', without the prefix" in each for each in lines.lines)


def test_at_most_so_many_transforms_a_second_cross(
    ros: FakeRos, bridged: Bridged, sender: Node, buffer: Buffer
) -> None:
    """Of each frame; the newest goes at the end."""
    robot, rviz = TfNode(ros, "robot"), TfNode(ros, "rviz")
    bridged(rate_limit_hz=1.0)
    broadcaster = TransformBroadcaster(sender)
    eventually(lambda: robot.leg.publishers("/tf"))
    send_until(
        lambda: broadcaster.send_transform(at(0.0, "first", S)),
        lambda: "first" in rviz.frames_heard(),
    )
    for number in range(1, 101):
        broadcaster.send_transform(at(float(number), "base", number * S // 100))
        robot.broadcast(at(float(number), "laser", number * S // 100))
    eventually(
        lambda: any(
            each.transform.x == 100.0 for each in rviz.heard if each.child_frame_id == "base"
        )
    )
    eventually(lambda: x_of(buffer, source="laser") == 100.0)
    assert len([each for each in rviz.heard if each.child_frame_id == "base"]) < 50


# What no buffer would take


def test_a_message_that_is_none_is_counted_and_named_once(
    ros: FakeRos, bridged: Bridged, buffer: Buffer
) -> None:
    """By the node of ROS that sent it."""
    robot = TfNode(ros, "robot")
    bridge = bridged()
    lines = Lines(bridge.node.log)
    for _ in range(3):
        robot.tf.send(b"\x00\x01\x00\x00\xff\xff\xff\xff")
    send_until(lambda: robot.broadcast(EXACT), lambda: "base_link" in buffer.frames())
    said = [each for each in lines.lines if "Dropped a message" in each]
    assert len(said) == 1 and "node /robot on /tf" in said[0]
    assert bridge.from_ros.rejected >= 3


def test_bad_transforms_do_not_take_good_ones_with_them(
    ros: FakeRos, bridged: Bridged, buffer: Buffer
) -> None:
    """Numbers that are not finite, no rotation, a frame that is its own parent, names that cannot
    be shown: they are dropped, the first of each reason is logged, and none counts as crossing.
    """
    robot = TfNode(ros, "robot")
    bridge = bridged()
    lines = Lines(bridge.node.log)
    frames = ("world", "nan", "twisted", "own", "odd\n", "", "good")
    pose = [0.0, 0, 0, 0, 0, 0, 1]
    poses = [
        [math.nan, 0, 0, 0, 0, 0, 1],
        [0.0, 0, 0, 0, 0, 0, 0],
        *[pose] * 4,
    ]
    edges = [(0, 1), (0, 2), (3, 3), (0, 4), (0, 5), (0, 6)]
    rows = batch(frames, edges, poses)
    send_until(lambda: robot.tf.send(rows), lambda: "good" in buffer.frames())
    send_until(lambda: robot.tf_static.send(rows), lambda: buffer.frame("good").static)
    assert set(buffer.frames()) == {"world", "good"}
    said = [each for each in lines.lines if "Dropped a transform" in each]
    reasons = ("norm of the quaternion", "its own parent", "a name of a frame")
    assert [sum(reason in each for each in said) for reason in reasons] == [1, 1, 1]
    assert len(said) == 3 and all("ROS node /robot" in each for each in said)
    assert bridge.from_ros.streams == {"ros2/robot": 1}


def test_each_transform_is_judged_though_its_frames_have_come(
    ros: FakeRos, bridged: Bridged, buffer: Buffer
) -> None:
    """A bad one after good ones is dropped, and good ones after it cross."""
    robot = TfNode(ros, "robot")
    bridge = bridged()

    def send(x: float, stamp_ns: int) -> None:
        pose = [x, 0.0, 0, 0, 0, 0, 1]
        robot.tf.send(batch(("world", "base"), [(0, 1)], [pose], stamp_ns))

    send_until(lambda: send(1.0, S), lambda: "base" in buffer.frames())
    send(math.nan, 2 * S)
    eventually(lambda: bridge.from_ros.rejected == 1)
    send_until(lambda: send(3.0, 3 * S), lambda: x_of(buffer, "world", "base") == 3.0)
    assert bridge.from_ros.streams == {"ros2/robot": 1}


def batch(
    frames: tuple[str, ...],
    edges: list[tuple[int, int]],
    poses: list[list[float]],
    stamp_ns: int = S,
) -> bytes:
    """The message of these rows, which need not be valid."""
    import numpy as np

    from tfbus.geometry.columns import Columns
    from tfbus.ros.tf_message import TFMessageWriter

    rows = Columns.of_bytes(
        frames,
        np.array(edges, np.uint32).tobytes(),
        np.full(len(edges), stamp_ns, np.int64).tobytes(),
        np.array(poses, np.float64).tobytes(),
    )
    return TFMessageWriter().write(rows)


def test_slashes_of_ros_1_are_taken_off(ros: FakeRos, bridged: Bridged, buffer: Buffer) -> None:
    """Which is said once."""
    robot = TfNode(ros, "robot")
    lines = Lines(bridged().node.log)
    pose = [0.0, 0, 0, 0, 0, 0, 1]
    rows = batch(("/map", "/base"), [(0, 1)], [pose])
    send_until(lambda: robot.tf.send(rows), lambda: "base" in buffer.frames())
    assert buffer.frame("base").parent == "map"
    [said] = [each for each in lines.lines if "leading slash" in each]
    assert "'/base'" in said


def test_stamps_of_zero_cross(ros: FakeRos, bridged: Bridged, sender: Node, buffer: Buffer) -> None:
    """As they are, in both directions."""
    robot, rviz = TfNode(ros, "robot"), TfNode(ros, "rviz")
    bridged()
    broadcaster = TransformBroadcaster(sender)

    def send() -> None:
        robot.broadcast(at(1.0, "of_ros", 0))
        broadcaster.send_transform(at(1.0, "of_bus", 0))

    send_until(send, lambda: "of_ros" in buffer.frames() and "of_bus" in rviz.frames_heard())
    assert buffer.lookup_transform("world", "of_ros").stamp_ns == 0
    assert {each.stamp_ns for each in rviz.heard} == {0}


def test_a_stamp_that_ros_cannot_have_is_left_out(
    ros: FakeRos, bridged: Bridged, sender: Node
) -> None:
    """After 2038; the others of its batch go."""
    rviz = TfNode(ros, "rviz")
    lines = Lines(bridged().node.log)
    broadcaster = TransformBroadcaster(sender)
    send_until(
        lambda: broadcaster.send_transform([at(1.0, "late", 2**31 * S), at(1.0, "good", S)]),
        lambda: bool(rviz.heard),
    )
    assert rviz.frames_heard() == {"good"}
    assert any("from 1901 to 2038" in each for each in lines.lines)
