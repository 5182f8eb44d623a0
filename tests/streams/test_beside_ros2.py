"""On one network with ROS 2: its messages are neither read nor missed, and not a line is logged."""

import logging
from collections.abc import Iterator

import pytest

from tests.builders import at, x_of
from tests.buses import eventually, send_until
from tests.fakes import Lines
from tests.ros2_on_zenoh import CLOCK, Ros2
from tests.simulated_bus import Bus
from tfbus import (
    Buffer,
    InvalidArgumentException,
    StaticTransformBroadcaster,
    TransformBroadcaster,
    TransformListener,
)
from tfbus.messages import Clock
from tfbus.wire.fleet import Fleet


@pytest.fixture
def ros2(bus: Bus) -> Iterator[Ros2]:
    """Nodes of rmw_zenoh, and zenoh-bridge-ros2dds."""
    ros2 = Ros2(bus.endpoint)
    ros2.rmw_zenoh()
    ros2.bridge()
    yield ros2
    ros2.close()


@pytest.mark.parametrize("fleet", [None, Fleet(["world"])], ids=["plain", "fleet"])
@pytest.mark.real
def test_a_listener_reads_streams_alone(bus: Bus, ros2: Ros2, fleet: Fleet | None) -> None:
    """It counts what comes from ROS 2, and has the frames of streams alone."""
    robot = bus.node("sim", namespace="robot1" if fleet else "")
    dynamic, buffer = TransformBroadcaster(robot), Buffer()
    StaticTransformBroadcaster(robot).send_transform(at(2, "post"))
    receiver = bus.node("listener")
    log = Lines(receiver.log, logging.INFO)
    lead = "robot1/" if fleet else ""
    with TransformListener(buffer, receiver, fleet=fleet) as listener:

        def has_all() -> bool:
            ros2.send()
            dynamic.send_transform(at(1, "arm"))
            frames = [x_of(buffer, "world", f"{lead}{name}") for name in ("arm", "post")]
            return frames == [1, 2] and listener.foreign > 50

        eventually(has_all)
        assert {each.name: each.messages for each in listener.streams()}.keys() == {f"{lead}sim"}
        assert set(buffer.frames()) == {"world", f"{lead}arm", f"{lead}post"}
        assert not listener.rejected
    assert log.lines == []


@pytest.mark.real
def test_topics_of_one_name_are_apart(bus: Bus, ros2: Ros2) -> None:
    """A message of ROS 2 on a topic of tfbus is counted, and not taken for one of its own."""
    receiver, sender = bus.node("receiver"), bus.node("sender")
    log = Lines(receiver.log, logging.INFO)
    came: list[Clock] = []
    raw: list[bytes] = []
    typed = receiver.create_subscription(Clock, "turtle1/pose", came.append)
    receiver.create_raw_subscription("turtle1/pose", raw.append)
    publisher = sender.create_publisher(Clock, "turtle1/pose")
    eventually(lambda: sender.session.watch_heard("turtle1/pose").heard)
    # Once: on a busy machine the callback's turn comes late, and only ten wait for it.
    publisher.publish(Clock(7))
    send_until(ros2.send, lambda: bool(came) and bool(raw) and typed.rejected > 1)
    assert {message.stamp_ns for message in came} == {7}
    assert CLOCK not in raw
    assert log.lines == []


def test_no_stream_is_called_as_a_key_of_ros_2(bus: Bus) -> None:
    """Listeners would skip it, so it is refused when it is created."""
    with pytest.raises(InvalidArgumentException, match="ROS 2's keys"):
        TransformBroadcaster(bus.node("sim"), stream="tf2_msgs::msg::dds_::TFMessage_")
