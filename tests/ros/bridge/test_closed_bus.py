"""A bridge on a closed bus: the rights of its identity, and the sentences if it lacks one."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from tests.builders import S, at
from tests.buses import eventually, send_until
from tests.fakes import Lines
from tests.ros.bridge.conftest import Bridged
from tests.ros.bridge.fake_leg import FakeRos
from tests.ros.bridge.tf_node import TfNode
from tfbus import Buffer, StaticTransformBroadcaster, TransformBroadcaster, TransformListener
from tfbus.ros.bridge.ros_clock import TOPIC, write_clock

pytest.importorskip("cryptography", reason="needs cryptography: pip install cryptography")

from tests.closed_bus import ClosedBus
from tfbus.bus.rights import Identity

pytestmark = pytest.mark.real

Closed = Callable[..., ClosedBus]


@pytest.fixture
def closed(tmp_path: Path) -> Iterator[Closed]:
    """Makes a closed bus with an identity for the bridge, which is given its rights: a publisher
    that is named ros2, beside one named arm and a reader.
    """
    with ExitStack() as opened:

        def make(**rights: tuple[str, ...]) -> ClosedBus:
            of_others = (Identity("arm", "publisher"), Identity("laptop", "reader"))
            bus = ClosedBus(tmp_path, Identity("ros2", "publisher", **rights), *of_others)
            opened.callback(bus.close)
            bus.open()
            return bus

        yield make


def frames_of(buffer: Buffer, *names: str) -> set[str]:
    """The streams of these frames, once all are there."""
    eventually(lambda: set(names) <= set(buffer.frames()))
    return {buffer.frame(name).authority for name in names}


def test_with_its_rights_it_bridges_as_on_an_open_bus(
    closed: Closed, ros: FakeRos, bridged: Bridged
) -> None:
    """A stream for each node of ROS, and the clock; a reader gets all, and ROS what others send."""
    bus = closed(nodes=("ros2*",), topics=("**", "clock"))
    amcl, gazebo = TfNode(ros, "amcl"), TfNode(ros, "gazebo")
    clock = gazebo.leg.publisher(TOPIC)
    amcl.broadcast_static(at(1.0, "bolted"))
    bridge = bridged(on=bus.node("ros2"))
    lines = Lines(bridge.node.log, 30)
    follower = bus.node("laptop", "laptop_sim", sim_time=True)
    arm = bus.node("arm")
    StaticTransformBroadcaster(arm).send_transform(at(1.0, "fixed"))
    broadcaster = TransformBroadcaster(arm)
    buffer = Buffer()

    def send() -> None:
        amcl.broadcast(at(1.0, "base", S))
        gazebo.broadcast(at(1.0, "model", S))
        clock.send(write_clock(100 * S))
        broadcaster.send_transform(at(1.0, "tool", S))

    def missing() -> dict[str, object]:
        """The frames and times still missing, by node."""
        waits = {
            "laptop": {"base", "bolted", "model", "tool"} - set(buffer.frames()),
            "clock": {100 * S} - {follower.now_ns()},
            "amcl": {"tool"} - set(amcl.frames_heard()) | {"fixed"} - set(amcl.statics),
        }
        return {who: what for who, what in waits.items() if what}

    with TransformListener(buffer, bus.node("laptop")):
        send_until(send, lambda: not missing(), state=lambda: (missing(), lines.lines, bus.links()))
        assert frames_of(buffer, "base", "bolted") == {"ros2/amcl"}
        assert frames_of(buffer, "model") == {"ros2/gazebo"}
    assert not lines.lines


def test_without_rights_it_says_which_to_give(
    closed: Closed, ros: FakeRos, bridged: Bridged
) -> None:
    """Nodes of ROS share its own stream then, and the clock stays where it is."""
    bus = closed()
    amcl, gazebo = TfNode(ros, "amcl"), TfNode(ros, "gazebo")
    clock = gazebo.leg.publisher(TOPIC)
    bridge = bridged(on=bus.node("ros2"))
    lines = Lines(bridge.node.log, 30)
    buffer = Buffer()

    def send() -> None:
        amcl.broadcast(at(1.0, "base", S))
        gazebo.broadcast(at(1.0, "model", S))
        clock.send(write_clock(100 * S))

    with TransformListener(buffer, bus.node("laptop")):
        send_until(send, lambda: len(lines.lines) >= 2)
        assert frames_of(buffer, "base", "model") == {"ros2"}
    [streams] = [each for each in lines.lines if "nodes of ROS share stream 'ros2'" in each]
    assert "nodes: ['ros2*']" in streams
    [of_clock] = [each for each in lines.lines if "The time of ROS does not come" in each]
    assert "publish topic 'clock'" in of_clock
    assert bridge.clock.way == ""


def test_frames_without_a_right_do_not_hold_up_others(
    closed: Closed, ros: FakeRos, bridged: Bridged
) -> None:
    """Of a message, dynamic or static, those come that may; the first of the others is logged."""
    bus = closed(nodes=("ros2*",), frames=("robot1/*",))
    robot = TfNode(ros, "robot")
    lines = Lines(bridged(on=bus.node("ros2")).node.log, 30)
    robot.broadcast_static(at(1.0, "robot1/bolted"), at(1.0, "robot2/bolted"))
    buffer = Buffer()
    with TransformListener(buffer, bus.node("laptop")):
        send_until(
            lambda: robot.broadcast(at(1.0, "robot1/base", S), at(1.0, "robot2/base", S)),
            lambda: {"robot1/base", "robot1/bolted"} <= set(buffer.frames()),
        )
        assert not {"robot2/base", "robot2/bolted"} & set(buffer.frames())
    [said] = lines.lines
    assert "ROS node /robot" in said and "publish frame 'robot2/" in said
