"""The simulated time goes from the side that has a clock to the other."""

import time
from functools import partial

import pytest

from tests.builders import S
from tests.buses import eventually, send_until
from tests.fakes import Clock as FakeClock
from tests.fakes import Lines
from tests.ros.bridge.conftest import Bridged
from tests.ros.bridge.fake_leg import FakeRos
from tests.simulated_bus import Bus
from tfbus import Node
from tfbus.base.errors import DecodeError
from tfbus.messages import Clock
from tfbus.ros.bridge import ros_clock
from tfbus.ros.bridge.bridge import Bridge
from tfbus.ros.bridge.ros_clock import TOPIC, read_clock, write_clock

STAMP_NS = 1670400305709085026


def test_the_message_is_that_of_ros() -> None:
    """A header, seconds, and nanoseconds."""
    message = bytes.fromhex("00010000 31499063 e28e432a".replace(" ", ""))
    assert (
        read_clock(message) == 1670400305709070562 and write_clock(read_clock(message)) == message
    )
    for wrong in (b"", message[:-1], message + b"1234", message[:8] + b"\xff" * 4):
        with pytest.raises(DecodeError):
            read_clock(wrong)


def test_the_time_of_ros_is_that_of_the_bus(bus: Bus, ros: FakeRos, bridged: Bridged) -> None:
    """Nodes of the bus follow it, also back."""
    gazebo = ros.leg("gazebo").publisher(TOPIC)
    node = bus.node("follower", sim_time=True)
    bridged()
    send_until(lambda: gazebo.send(write_clock(100 * S)), lambda: node.now_ns() == 100 * S)
    send_until(lambda: gazebo.send(write_clock(10 * S)), lambda: node.now_ns() == 10 * S)


def test_the_time_of_the_bus_is_that_of_ros(ros: FakeRos, bridged: Bridged, sender: Node) -> None:
    """And does not come back."""
    came: list[int] = []
    ros.leg("nav2").subscribe(TOPIC, lambda payload, gid: came.append(read_clock(payload)))
    bridge = bridged(tells_publishers=False)
    clock = sender.create_clock_publisher()
    send_until(lambda: clock.publish(Clock(STAMP_NS)), lambda: STAMP_NS in came)
    ros.settle()
    assert bridge.clock.way == "to ROS"
    assert "from ROS" not in bridge.clock.last_s


def test_where_both_sides_have_a_clock_neither_crosses(
    ros: FakeRos, bridged: Bridged, sender: Node
) -> None:
    """Which is said, with what to do."""
    came: list[bytes] = []
    ros.leg("nav2").subscribe(TOPIC, lambda payload, gid: came.append(payload))
    gazebo = ros.leg("gazebo").publisher(TOPIC)
    clock = sender.create_clock_publisher()
    bridge = bridged()
    lines = Lines(bridge.node.log)

    def send() -> None:
        gazebo.send(write_clock(10 * S))
        clock.publish(Clock(100 * S))

    send_until(send, lambda: any("neither crosses" in each for each in lines.lines))
    assert {read_clock(each) for each in came} == {10 * S}


def test_a_way_may_be_closed(
    bridged: Bridged, sender: Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the option: the clock of the other side is heard, and does not cross."""
    clock = bridged(clock="from-ros").clock
    publisher = sender.create_clock_publisher()
    send_until(lambda: publisher.publish(Clock(100 * S)), lambda: "to ROS" in clock.last_s)
    heard_s = clock.first_s["to ROS"]
    monkeypatch.setattr(ros_clock, "scheduler", FakeClock(round((heard_s + 2.0) * S)))
    clock.poll()
    assert clock.first_s and clock.way == ""


def test_with_off_ros_does_not_even_see_a_subscription(ros: FakeRos, bridged: Bridged) -> None:
    """Otherwise there is one."""
    bridged(clock="off")
    assert "/clock" not in [each.topic.name for each in ros.subscriptions]
    bridged("another")
    assert "/clock" in [each.topic.name for each in ros.subscriptions]


def test_it_goes_on_when_a_clock_is_gone_and_another_comes(
    ros: FakeRos, bridged: Bridged, sender: Node
) -> None:
    """From the other side."""
    bridge = bridged()
    clock = sender.create_clock_publisher()
    send_until(lambda: clock.publish(Clock(S)), lambda: bridge.clock.way == "to ROS")
    clock.close()
    eventually(lambda: bridge.clock.way == "")
    gazebo = ros.leg("gazebo").publisher(TOPIC)
    send_until(lambda: gazebo.send(write_clock(S)), lambda: bridge.clock.way == "from ROS")


@pytest.mark.parametrize("first", ["to ROS", "from ROS"])
def test_a_second_clock_ends_the_way_of_the_first(
    first: str, ros: FakeRos, bridged: Bridged, sender: Node
) -> None:
    """Neither crosses then, whichever came later; which is said."""
    gazebo = ros.leg("gazebo").publisher(TOPIC)
    clock = sender.create_clock_publisher()
    bridge = bridged()
    lines = Lines(bridge.node.log)

    def send_first() -> None:
        if first == "to ROS":
            clock.publish(Clock(100 * S))
        else:
            gazebo.send(write_clock(10 * S))

    send_until(send_first, lambda: bridge.clock.way == first)

    def send_both() -> None:
        gazebo.send(write_clock(10 * S))
        clock.publish(Clock(100 * S))

    send_until(send_both, lambda: bridge.clock.way == "")
    send_until(send_both, lambda: any("neither crosses" in each for each in lines.lines))
    assert bridge.clock.way == ""


@pytest.mark.parametrize("to_ros", [True, False])
def test_a_bridge_that_is_gone_does_not_hide_two_clocks(
    to_ros: bool, bus: Bus, ros: FakeRos, bridged: Bridged, sender: Node
) -> None:
    """Nor one to another ROS."""
    elsewhere = FakeRos()
    bridged("elsewhere", to=elsewhere)
    node = bus.node("former")
    former = bridged("former", on=node, to_ros=to_ros)
    bridge = bridged()
    eventually(lambda: len(bridge.bridges.others) == 2)
    former.close()
    node.close()
    gazebo = ros.leg("gazebo").publisher(TOPIC)
    clock = sender.create_clock_publisher()
    lines = Lines(bridge.node.log)

    def send() -> None:
        gazebo.send(write_clock(10 * S))
        clock.publish(Clock(100 * S))

    send_until(send, lambda: any("neither crosses" in each for each in lines.lines))


# Two bridges between the same bus and the same ROS


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bridges decide soon."""
    monkeypatch.setattr(ros_clock, "_DECIDE_S", 0.2)


def stands_by(bridge: Bridge, way: str) -> bool:
    """Whether it has had time to begin this way, and has none."""
    clock = bridge.clock
    first_s = clock.first_s.get(way)
    return first_s is not None and time.monotonic() > first_s + 1.0 and clock.way == ""


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("tells", [True, False])
def test_of_two_bridges_one_gives_the_time_to_ros(
    tells: bool, ros: FakeRos, bridged: Bridged, sender: Node
) -> None:
    """That which was started first; when it ends the other does."""
    nav2 = ros.leg("nav2")
    clock = sender.create_clock_publisher()
    send = partial(clock.publish, Clock(100 * S))
    one = bridged("one", tells_publishers=tells)
    send_until(send, lambda: one.clock.way == "to ROS")
    two = bridged("two", tells_publishers=tells)
    send_until(send, lambda: stands_by(two, "to ROS"))
    assert [each.node for each in nav2.publishers(TOPIC.name)] == ["/tfbus_one"]
    one.close()
    send_until(send, lambda: two.clock.way == "to ROS")
    assert [each.node for each in nav2.publishers(TOPIC.name)] == ["/tfbus_two"]


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("options", [{}, {"clock": "from-ros"}, {"to_ros": False}])
def test_of_two_bridges_one_gives_the_time_of_ros_to_the_bus(
    options: dict[str, object], ros: FakeRos, bridged: Bridged
) -> None:
    """That which was started first, whatever options both have; when it leaves the bus the other
    does, without a word of two clocks.
    """
    gazebo = ros.leg("gazebo").publisher(TOPIC)
    send = partial(gazebo.send, write_clock(100 * S))
    one, two = bridged("one", **options), bridged("two", **options)
    lines = Lines(two.node.log)
    send_until(send, lambda: one.clock.way == "from ROS" and stands_by(two, "from ROS"))
    one.node.close()
    send_until(send, lambda: two.clock.way == "from ROS")
    assert not [each for each in lines.lines if "neither crosses" in each]


@pytest.mark.usefixtures("quick")
def test_the_time_of_ros_does_not_go_back_by_another_bridge(ros: FakeRos, bridged: Bridged) -> None:
    """Even where that has to send the time to ROS."""
    nav2 = ros.leg("nav2")
    gazebo = ros.leg("gazebo").publisher(TOPIC)
    send = partial(gazebo.send, write_clock(100 * S))
    one = bridged("one", clock="from-ros")
    two = bridged("two", clock="to-ros")
    send_until(send, lambda: one.clock.way == "from ROS" and stands_by(two, "to ROS"))
    assert [each.node for each in nav2.publishers(TOPIC.name)] == ["/gazebo"]
