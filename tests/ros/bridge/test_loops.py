"""Nothing goes round, whatever the loop."""

import time
from collections import Counter
from collections.abc import Iterator
from functools import partial

import pytest

from tests.builders import S, at, x_of
from tests.buses import eventually, send_until
from tests.fakes import Lines
from tests.ros.bridge.conftest import Bridged
from tests.ros.bridge.fake_leg import FakeRos
from tests.ros.bridge.tf_node import TfNode
from tests.simulated_bus import Bus
from tfbus import (
    Buffer,
    Node,
    StaticTransformBroadcaster,
    TransformBroadcaster,
    TransformListener,
)
from tfbus.testing import Network


@pytest.fixture
def other_ros(bus: Bus) -> Iterator[FakeRos]:
    """A second ROS, apart from the first."""
    ros = FakeRos()
    yield ros
    ros.close()


@pytest.fixture
def other_bus(network: Network) -> Iterator[Bus]:
    """A second bus, on a host that is cut off from the first."""
    network.host("other")
    network.partition("other")
    bus = Bus(network, "other")
    yield bus
    bus.close()


def streams_with(listener: TransformListener, child: str) -> set[str]:
    """The living streams that list a frame."""
    return {
        each.name
        for each in listener.streams()
        if each.alive and child in {frame for _, frame, _ in each.frames}
    }


def is_of(listener: TransformListener, child: str, count: int, stream: str = "") -> bool:
    """Whether this number of streams list a frame, and this one does."""
    streams = streams_with(listener, child)
    return len(streams) == count and (not stream or stream in streams)


def repeated(node: TfNode, child: str) -> int:
    """How often a stamp of a frame came again in ROS."""
    stamps = Counter(each.stamp_ns for each in node.heard if each.child_frame_id == child)
    return sum(stamps.values()) - len(stamps)


def test_a_leg_that_hears_itself_does_not_echo(
    ros: FakeRos, bridged: Bridged, sender: Node, receiver: Node
) -> None:
    """Frames that the bridge sends do not come back, dynamic or static; others come."""
    buffer = Buffer()
    with TransformListener(buffer, receiver) as listener:
        robot, rviz = TfNode(ros, "robot"), TfNode(ros, "rviz")
        bridged(tells_publishers=False)
        StaticTransformBroadcaster(sender).send_transform(at(1.0, "fixed"))
        broadcaster = TransformBroadcaster(sender)
        numbers = iter(range(1, 100_000))

        def send() -> None:
            broadcaster.send_transform(at(1.0, "of_bus", next(numbers) * S // 100))
            robot.broadcast(at(1.0, "of_ros", next(numbers) * S // 100))

        send_until(
            send,
            lambda: (
                len(rviz.heard) > 40 and "of_ros" in buffer.frames() and "fixed" in rviz.statics
            ),
        )
        for child in ("of_bus", "fixed"):
            assert streams_with(listener, child) == {"sender"}
        assert not repeated(rviz, "of_ros")


@pytest.mark.parametrize("tells", [True, False])
def test_two_bridges_between_the_same_bus_and_the_same_ros(
    tells: bool, bus: Bus, ros: FakeRos, bridged: Bridged, sender: Node, receiver: Node
) -> None:
    """Each frame has one stream on the bus, and crosses to ROS once; the second bridge says so, and
    goes on when the first is gone.
    """
    buffer = Buffer()
    with TransformListener(buffer, receiver) as listener:
        robot, rviz = TfNode(ros, "robot"), TfNode(ros, "rviz")
        numbers = iter(range(1, 100_000))
        broadcaster = TransformBroadcaster(sender)
        StaticTransformBroadcaster(sender).send_transform(at(1.0, "fixed"))
        robot.broadcast_static(at(1.0, "bolted"))

        def send() -> None:
            broadcaster.send_transform(at(1.0, "of_bus", next(numbers) * S // 100))
            robot.broadcast(at(1.0, "of_ros", next(numbers) * S // 100))

        first = bridged("one", tells_publishers=tells)
        send_until(
            send,
            lambda: (
                {"of_ros", "bolted"} <= set(buffer.frames()) and "of_bus" in rviz.frames_heard()
            ),
        )
        second = bridged("two", tells_publishers=tells)
        lines = Lines(second.node.log)
        if tells:
            send_until(
                send, lambda: any("Bridge /one joins the same bus" in x for x in lines.lines)
            )
        start = next(numbers)
        send_until(send, lambda: next(numbers) > start + 400)
        ros.settle()
        for child in ("of_bus", "fixed"):
            eventually(partial(is_of, listener, child, 1, "sender"))
        assert not repeated(rviz, "of_ros")
        if tells:
            for child in ("of_ros", "bolted"):
                eventually(partial(is_of, listener, child, 1))
            late = TfNode(ros, "late")
            eventually(lambda: set(late.statics) == {"fixed", "bolted"})
            eventually_once(late, "of_bus", send)
        late_x = x_of(buffer, source="of_ros")
        assert late_x == 1.0
        first.close()
        first.node.close()
        end = TfNode(ros, "end")
        send_until(
            send,
            lambda: (
                "of_bus" in end.frames_heard()
                and "fixed" in end.statics
                and any("two" in each for each in streams_with(listener, "of_ros"))
            ),
        )


def eventually_once(late: TfNode, child: str, send: object) -> None:
    """From now on a frame comes once."""
    assert callable(send)

    def comes_once() -> bool:
        late.heard.clear()
        for _ in range(30):
            send()
        time.sleep(0.01)
        late.leg.ros.settle()
        came = [each for each in late.heard if each.child_frame_id == child]
        return bool(came) and not repeated(late, child)

    eventually(comes_once)


@pytest.mark.parametrize("ways", [("to_ros", "from_ros"), ("to_ros", "to_ros")])
def test_bridges_of_one_direction_each(
    ways: tuple[str, str],
    ros: FakeRos,
    bridged: Bridged,
    sender: Node,
    receiver: Node,
) -> None:
    """One to ROS and one from it are as good as one of both; of two to ROS one sends."""
    buffer = Buffer()
    with TransformListener(buffer, receiver) as listener:
        robot, rviz = TfNode(ros, "robot"), TfNode(ros, "rviz")
        numbers = iter(range(1, 100_000))
        broadcaster = TransformBroadcaster(sender)

        def send() -> None:
            broadcaster.send_transform(at(1.0, "of_bus", next(numbers) * S // 100))
            robot.broadcast(at(1.0, "of_ros", next(numbers) * S // 100))

        for number, way in enumerate(ways):
            bridged(f"bridge_{number}", **{"to_ros": False, "from_ros": False, way: True})
        send_until(send, lambda: "of_bus" in rviz.frames_heard())
        if "from_ros" in ways:
            send_until(send, lambda: "of_ros" in buffer.frames())
        eventually_once(rviz, "of_bus", send)
        eventually(lambda: streams_with(listener, "of_bus") == {"sender"})
        assert not repeated(rviz, "of_ros")


def test_bridges_of_two_robots_exchange_frames(
    bus: Bus, ros: FakeRos, other_ros: FakeRos, bridged: Bridged
) -> None:
    """Each robot has a ROS of its own; the bus joins them."""
    robots = [TfNode(ros, "robot_state_publisher"), TfNode(other_ros, "robot_state_publisher")]
    bridged("ros2_a", to=ros)
    bridged("ros2_b", to=other_ros)
    for number, robot in enumerate(robots):
        robot.broadcast_static(at(1.0, f"laser_{number}"))

    def send() -> None:
        for number, robot in enumerate(robots):
            robot.broadcast(at(1.0, f"base_{number}", bus_time()))

    times = iter(range(1, 100_000))

    def bus_time() -> int:
        return next(times) * S // 100

    send_until(
        send,
        lambda: (
            "base_1" in robots[0].frames_heard()
            and "base_0" in robots[1].frames_heard()
            and "laser_1" in robots[0].statics
            and "laser_0" in robots[1].statics
        ),
    )
    for robot in robots:
        robot.heard.clear()
    for _ in range(100):
        send()
    ros.settle()
    other_ros.settle()
    assert "base_0" not in robots[0].frames_heard() and "base_1" not in robots[1].frames_heard()
    assert not repeated(robots[0], "base_1")


def test_two_buses_are_joined_by_ros(
    bus: Bus, other_bus: Bus, ros: FakeRos, bridged: Bridged
) -> None:
    """Frames of one are on the other, in the stream of the bridge that sends them in ROS."""
    bridged("here")
    bridged("there", on=other_bus)
    sender, receiver = bus.node("sender"), other_bus.node("receiver")
    broadcaster = TransformBroadcaster(sender)
    StaticTransformBroadcaster(sender).send_transform(at(1.0, "fixed"))
    buffer = Buffer()
    numbers = iter(range(1, 100_000))
    rviz = TfNode(ros, "rviz")
    with TransformListener(buffer, receiver):
        send_until(
            lambda: broadcaster.send_transform(at(1.0, "base", next(numbers) * S // 100)),
            lambda: {"base", "fixed"} <= set(buffer.frames()),
        )
        assert buffer.frame("base").authority == "there/tfbus_here"
        assert buffer.frame("fixed").authority == "there/tfbus_here"
    ros.settle()
    assert not repeated(rviz, "base")


@pytest.mark.parametrize("delay", [0, 30])
def test_a_relay_in_ros_does_not_make_a_circle(
    delay: int, ros: FakeRos, bridged: Bridged, sender: Node, receiver: Node
) -> None:
    """What a node of ROS repeats, at once or some messages later, does not come back to the bus."""
    rviz = TfNode(ros, "rviz")
    relay = TfNode(ros, "relay")
    sent: list[bytes] = []

    def repeat(payload: bytes, gid: str) -> None:
        if gid != relay.tf.gid:
            sent.append(payload)
            if len(sent) > delay:
                relay.tf.send(sent[-1 - delay])

    relay.leg.subscribe(relay.tf.topic, repeat)
    buffer = Buffer()
    with TransformListener(buffer, receiver) as listener:
        bridged()
        broadcaster = TransformBroadcaster(sender)
        numbers = iter(range(1, 100_000))
        send_until(
            lambda: broadcaster.send_transform(at(1.0, "base", next(numbers) * S // 100)),
            lambda: len(rviz.heard) > 300,
        )
        assert next((x for x in listener.streams() if x.name == "ros2/relay"), None) is None or (
            next(x for x in listener.streams() if x.name == "ros2/relay").transforms == 0
        )
        assert buffer.frame("base").authority == "sender"


def test_two_publishers_of_a_frame_are_a_conflict_that_names_the_node_of_ros(
    ros: FakeRos, bridged: Bridged, sender: Node, receiver: Node
) -> None:
    """As within the bus."""
    robot = TfNode(ros, "robot")
    lines = Lines(receiver.log)
    buffer = Buffer()
    with TransformListener(buffer, receiver):
        bridged()
        broadcaster = TransformBroadcaster(sender)
        numbers = iter(range(1, 100_000))

        def send() -> None:
            broadcaster.send_transform(at(1.0, "base", next(numbers) * S // 100))
            robot.broadcast(at(2.0, "base", next(numbers) * S // 100))

        send_until(
            send, lambda: any("Two publishers" in x and "'ros2/robot'" in x for x in lines.lines)
        )
