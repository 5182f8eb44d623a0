"""ROS in memory works as a middleware does."""

from collections.abc import Iterator

import pytest

from tests.builders import at
from tests.ros.bridge.fake_leg import FakeRos
from tests.ros.bridge.tf_node import TF, TF_STATIC, TfNode
from tfbus.ros.bridge.legs import Leg, RosPublisher


@pytest.fixture
def ros() -> Iterator[FakeRos]:
    ros = FakeRos()
    yield ros
    ros.close()


def test_messages_of_others_come_with_their_gid(ros: FakeRos) -> None:
    """Own ones do not."""
    one, other = ros.leg("one"), ros.leg("other")
    came: list[tuple[bytes, str]] = []
    leg: Leg = one
    leg.subscribe(TF, lambda payload, gid: came.append((payload, gid)))
    one.publisher(TF).send(b"own")
    sender = other.publisher(TF)
    sender.send(b"a")
    ros.settle()
    assert came == [(b"a", sender.gid)]
    assert one.publishers("/tf") == [RosPublisher(sender.gid, "/other")]


def test_a_leg_that_cannot_tell_has_messages_without_gids(ros: FakeRos) -> None:
    """Own ones do not come back all the same."""
    leg = ros.leg("one", tells_publishers=False)
    came: list[tuple[bytes, str]] = []
    leg.subscribe(TF, lambda payload, gid: came.append((payload, gid)))
    leg.publisher(TF).send(b"own")
    ros.leg("other").publisher(TF).send(b"a")
    ros.settle()
    assert came == [(b"a", "")]


def test_late_ones_get_what_is_retained(ros: FakeRos) -> None:
    """The last message of each publisher that is still there."""
    for name in ("one", "two", "gone"):
        sender = ros.leg(name).publisher(TF_STATIC)
        for text in (b"old", name.encode()):
            sender.send(text)
    sender.close()
    came: list[bytes] = []
    ros.leg("late").subscribe(TF_STATIC, lambda payload, gid: came.append(payload))
    ros.settle()
    assert came == [b"one", b"two"]


def test_nodes_broadcast_and_listen(ros: FakeRos) -> None:
    """Static transforms of late joiners too."""
    robot = TfNode(ros, "robot")
    robot.broadcast_static(at(1.0, "laser"))
    robot.broadcast_static(at(2.0, "camera"))
    rviz = TfNode(ros, "rviz")
    robot.broadcast(at(3.0, "base"))
    ros.settle()
    assert set(rviz.statics) == {"laser", "camera"} and rviz.heard == [at(3.0, "base")]
