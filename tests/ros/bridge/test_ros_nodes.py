"""Each node of ROS is a publisher of its own on the bus, which may be gone and come back."""

from functools import partial

import pytest

from tests.builders import S, at, x_of
from tests.buses import eventually, send_until
from tests.fakes import Clock, Lines
from tests.ros.bridge.conftest import Bridged
from tests.ros.bridge.fake_leg import FakeRos
from tests.ros.bridge.tf_node import TfNode
from tests.simulated_bus import Bus
from tfbus import Buffer, Node, TfbusError, TransformListener, TransformStamped
from tfbus.geometry.columns import Columns
from tfbus.ros.bridge import ros_sources
from tfbus.ros.tf_message import TFMessageWriter
from tfbus.wire.keys import node_key


def message_of(*transforms: TransformStamped) -> bytes:
    """A message of ROS."""
    return TFMessageWriter().write(Columns.of_transforms(transforms))


def is_there(buffer: Buffer, name: str) -> bool:
    """Whether a frame has a publisher."""
    return name in buffer.frames() and not buffer.frame(name).gone


def test_frames_name_the_node_of_ros(ros: FakeRos, bridged: Bridged, buffer: Buffer) -> None:
    """Its namespace too."""
    plain, named = TfNode(ros, "amcl"), ros.leg("unused")
    bridged()
    send_until(lambda: plain.broadcast(at(1.0, "a", S)), lambda: "a" in buffer.frames())
    named.settings = type(named.settings)("ekf", "robot1")
    sender = named.publisher(plain.tf.topic)
    message = plain.tf.sent[-1].replace(b"a\0", b"b\0")
    send_until(lambda: sender.send(message), lambda: "b" in buffer.frames())
    assert buffer.frame("a").authority == "ros2/amcl"
    assert buffer.frame("b").authority == "ros2/robot1/ekf"


def test_a_node_that_is_gone_takes_its_stream_with_it(
    ros: FakeRos, bridged: Bridged, buffer: Buffer
) -> None:
    """Its frames are marked as gone, those of others are not; back again, they are back."""
    first, other = TfNode(ros, "first"), TfNode(ros, "other")
    bridged()
    first.broadcast_static(at(1.0, "fixed"))
    send_until(lambda: first.broadcast(at(1.0, "a", S)), lambda: "a" in buffer.frames())
    send_until(lambda: other.broadcast(at(1.0, "b", S)), lambda: "b" in buffer.frames())
    first.close()
    eventually(lambda: buffer.frame("a").gone and buffer.frame("fixed").gone)
    assert not buffer.frame("b").gone
    first = TfNode(ros, "first")
    first.broadcast_static(at(1.0, "fixed"))
    send_until(lambda: first.broadcast(at(2.0, "a", S)), lambda: x_of(buffer, source="a") == 2.0)
    eventually(lambda: not buffer.frame("a").gone and not buffer.frame("fixed").gone)


def test_a_node_that_is_started_again_begins_a_new_epoch(
    ros: FakeRos, bridged: Bridged, receiver: Node
) -> None:
    """Its former samples are forgotten, also those with later stamps; static ones that it no longer
    has are gone.
    """
    buffer = Buffer()
    with TransformListener(buffer, receiver) as listener:
        robot = TfNode(ros, "robot")
        bridged()
        robot.broadcast_static(at(1.0, "former"), at(1.0, "both"))
        send_until(lambda: robot.broadcast(at(1.0, "a", 100 * S)), lambda: "a" in buffer.frames())
        epoch = {each.name: each.epoch_ns or 0 for each in listener.streams()}["ros2/robot"]
        robot.close()
        robot = TfNode(ros, "robot")
        robot.broadcast_static(at(1.0, "both"))
        send_until(
            lambda: robot.broadcast(at(2.0, "a", 99 * S)), lambda: x_of(buffer, source="a") == 2.0
        )
        eventually(lambda: "former" not in buffer.frames() or buffer.frame("former").gone)
        assert not buffer.frame("both").gone
        later = {each.name: each.epoch_ns or 0 for each in listener.streams()}["ros2/robot"]
        assert later > epoch


def test_a_clock_of_ros_that_goes_back_begins_a_new_epoch(
    ros: FakeRos, bridged: Bridged, buffer: Buffer
) -> None:
    """As of a bag that plays in a loop."""
    robot = TfNode(ros, "robot")
    bridged()
    send_until(lambda: robot.broadcast(at(1.0, "a", 100 * S)), lambda: "a" in buffer.frames())
    send_until(
        lambda: robot.broadcast(at(2.0, "a", 10 * S)), lambda: x_of(buffer, source="a") == 2.0
    )
    assert buffer.frame("a").newest_ns == 10 * S


def test_where_ros_does_not_tell_there_is_one_stream(
    ros: FakeRos, bridged: Bridged, buffer: Buffer
) -> None:
    """With all frames; it ends with the last publisher."""
    first, second = TfNode(ros, "first"), TfNode(ros, "second")
    bridged(tells_publishers=False)

    def send() -> None:
        first.broadcast(at(1.0, "a", S))
        second.broadcast(at(1.0, "b", S))

    send_until(send, lambda: {"a", "b"} <= set(buffer.frames()))
    assert {buffer.frame(each).authority for each in "ab"} == {"ros2"}
    first.close()
    second.close()
    eventually(lambda: buffer.frame("a").gone)


def test_names_of_nodes_that_cannot_be_shown_are_left_out(
    ros: FakeRos, bridged: Bridged, buffer: Buffer
) -> None:
    """Their frames come in the stream of the bridge, or with what can be shown of it."""
    robot = TfNode(ros, "\u202eevil" + "x" * 300)
    bridged()
    send_until(lambda: robot.broadcast(at(1.0, "a", S)), lambda: "a" in buffer.frames())
    assert buffer.frame("a").authority == "ros2"


def test_a_bridge_that_is_started_again_goes_on(
    bus: Bus, ros: FakeRos, bridged: Bridged, buffer: Buffer
) -> None:
    """Listeners on the bus have everything again, static ones too."""
    robot = TfNode(ros, "robot")
    robot.broadcast_static(at(1.0, "fixed"))
    node = bus.node("ros2")
    bridge = bridged(on=node)
    send_until(lambda: robot.broadcast(at(1.0, "a", S)), lambda: "a" in buffer.frames())
    bridge.close()
    node.close()
    eventually(lambda: buffer.frame("a").gone and buffer.frame("fixed").gone)
    bridged()
    send_until(
        lambda: robot.broadcast(at(2.0, "a", 2 * S)), lambda: x_of(buffer, source="a") == 2.0
    )
    eventually(lambda: not buffer.frame("fixed").gone)


def test_a_second_bridge_of_the_same_name_is_refused(bus: Bus, bridged: Bridged) -> None:
    """Its streams would be those of the first."""
    bridged()
    second = bus.node("ros2")
    eventually(lambda: len(list(second.session.ask(node_key("ros2"), timeout_s=1.0))) == 2)
    with pytest.raises(TfbusError, match=r"/ros2 .*--name"):
        bridged(on=second)
    bridged("ros2_too")


def test_it_says_once_what_crosses(ros: FakeRos, bridged: Bridged, sender: Node) -> None:
    """How many frames, and of which node of ROS."""
    robot = TfNode(ros, "robot")
    lines = Lines(bridged().node.log)
    send_until(
        lambda: robot.broadcast(at(1.0, "a", sender.now_ns()), at(1.0, "b", sender.now_ns())),
        lambda: "From ROS: 2 frames of 'ros2/robot'" in lines.lines,
    )


def test_it_says_that_there_is_no_ros(ros: FakeRos, bridged: Bridged) -> None:
    """After a while, and what the leg has to say."""
    bridge = bridged()
    lines = Lines(bridge.node.log)
    eventually(lambda: "No node of ROS publishes /tf or /tf_static yet" in lines.lines)
    bridge.leg.told.append("no router of rmw_zenoh answers")  # a fake
    eventually(lambda: any("no router of rmw_zenoh" in each for each in lines.lines))


def test_gids_that_ros_does_not_list_are_few(
    ros: FakeRos, bridged: Bridged, buffer: Buffer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They may be made up; what comes by further ones comes in the stream of the bridge, and a node
    that is listed has a stream of its own all the same.
    """
    from_ros = bridged().from_ros
    clock = Clock()
    monkeypatch.setattr(ros_sources, "scheduler", clock)
    [dynamic] = [each for each in ros.subscriptions if each.topic.name == "/tf"]
    for number in range(300):
        clock.now_ns += S // 100
        dynamic.hear(message_of(at(1.0, f"made_up_{number}", S)), f"{number:032x}")
    assert len(from_ros.sources.unknown) + len([*from_ros.sources]) <= 102
    eventually(lambda: "made_up_299" in buffer.frames())
    robot = TfNode(ros, "robot")
    send_until(lambda: robot.broadcast(at(1.0, "a", S)), lambda: "a" in buffer.frames())
    send_until(
        lambda: robot.broadcast(at(1.0, "a", 2 * S)),
        lambda: buffer.frame("a").authority == "ros2/robot",
    )


def test_a_name_that_comes_late_takes_its_frames_along(
    ros: FakeRos, bridged: Bridged, buffer: Buffer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From the stream of the bridge to that of the node, static ones too."""
    robot = TfNode(ros, "robot")
    robot.leg.is_listed = False
    robot.broadcast_static(at(1.0, "fixed"))
    from_ros = bridged().from_ros
    clock = Clock()
    monkeypatch.setattr(ros_sources, "scheduler", clock)
    send_until(lambda: robot.broadcast(at(1.0, "a", S)), lambda: bool(from_ros.sources.unknown))
    clock.now_ns = 6 * S
    eventually(lambda: {"a", "fixed"} <= set(buffer.frames()))
    assert {buffer.frame(each).authority for each in ("a", "fixed")} == {"ros2"}
    robot.leg.is_listed = True
    send_until(
        lambda: robot.broadcast(at(1.0, "a", 2 * S)),
        lambda: buffer.frame("a").authority == "ros2/robot",
    )
    eventually(lambda: buffer.frame("fixed").authority == "ros2/robot")
    assert not buffer.frame("fixed").gone
    assert set(from_ros.streams) == {"ros2/robot"}


def test_a_publisher_that_ros_never_lists_is_gone_when_it_is_silent(
    ros: FakeRos, bridged: Bridged, buffer: Buffer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """There is no other sign that it is gone."""
    robot = TfNode(ros, "robot")
    robot.leg.is_listed = False
    from_ros = bridged().from_ros
    clock = Clock()
    monkeypatch.setattr(ros_sources, "scheduler", clock)
    robot.broadcast_static(at(1.0, "fixed"))
    eventually(lambda: bool(from_ros.sources.unknown))
    clock.now_ns = 3 * S
    eventually(lambda: "fixed" in buffer.frames())
    robot.close()
    assert not buffer.frame("fixed").gone
    clock.now_ns = 30 * S
    eventually(lambda: buffer.frame("fixed").gone)
    assert not [*from_ros.sources]


def test_a_node_whose_names_never_end_begins_again(
    ros: FakeRos, bridged: Bridged, buffer: Buffer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its frames are those that still come, as of a tracker that numbers what it sees."""
    monkeypatch.setattr("tfbus.ros.bridge.from_ros._MOST_FRAMES", 50)
    robot = TfNode(ros, "robot")
    robot.broadcast_static(at(1.0, "fixed"))
    bridge = bridged()
    lines = Lines(bridge.node.log)
    for number in range(120):
        robot.broadcast(at(1.0, "base", number), at(1.0, f"person_{number}", number))
    send_until(lambda: robot.broadcast(at(1.0, "base", S)), lambda: "person_119" in buffer.frames())
    assert bridge.from_ros.streams["ros2/robot"] < 60
    eventually(lambda: "person_0" not in buffer.frames() or buffer.frame("person_0").gone)
    for name in ("base", "fixed", "person_119"):
        eventually(partial(is_there, buffer, name))
    assert sum("begins again" in each for each in lines.lines) == 1
