"""The ported listener and broadcasters on a bus, beside tfbus's own."""

import gc
import weakref
from types import ModuleType
from typing import Any

import pytest

from tests.builders import x_of
from tests.buses import eventually, send_static, send_until
from tests.simulated_bus import Bus
from tfbus import Buffer as TfbusBuffer
from tfbus import Node, Transform, TransformBroadcaster, TransformListener, TransformStamped
from tfbus.compat import tf2_ros
from tfbus.compat.geometry_msgs.msg import TransformStamped as Message
from tfbus.compat.rclpy.duration import Duration
from tfbus.compat.rclpy.qos import QoSProfile
from tfbus.compat.rclpy.time import Time

LONG = Duration(seconds=20)


def edge(parent: str, child: str, seconds: float, x: float = 1.0) -> Message:
    """A child at x in its parent."""
    message = Message(child_frame_id=child)
    message.header.frame_id = parent
    message.header.stamp = Time(seconds=seconds).to_msg()
    message.transform.translation.x = x
    return message


def test_what_is_sent_is_heard(rclpy: ModuleType) -> None:
    """Within one node, without spinning; the same message comes out."""
    node = rclpy.create_node("both")
    buffer = tf2_ros.Buffer()
    listener = tf2_ros.TransformListener(buffer, node)
    broadcaster = tf2_ros.TransformBroadcaster(node)
    sent = edge("foo", "bar", 100.0)
    broadcaster.sendTransform(sent)
    assert buffer.lookup_transform("foo", "bar", sent.header.stamp, LONG) == sent
    broadcaster.sendTransform((edge("foo", "bar", 101.0), edge("bar", "baz", 101.0)))
    assert buffer.can_transform("foo", "baz", Time(seconds=101), LONG)
    listener.unregister()


def test_a_new_buffer_of_a_listener_is_filled_from_then_on(rclpy: ModuleType) -> None:
    """The former one keeps what it had; static transforms are in the new one too."""
    node = rclpy.create_node("both")
    listener = tf2_ros.TransformListener(tf2_ros.Buffer(), node)
    static = tf2_ros.StaticTransformBroadcaster(node)
    static.sendTransform(edge("foo", "bar", 1.0))
    static.sendTransform(edge("foo", "baz", 1.0))
    first, listener.buffer = listener.buffer, tf2_ros.Buffer()
    found = listener.buffer.lookup_transform("bar", "baz", Time(seconds=1.5), LONG)
    assert found.header.stamp == Time(seconds=1.5).to_msg()
    assert listener.buffer is not first


def test_a_static_transform_is_replaced(rclpy: ModuleType) -> None:
    """By the next one of the same child, which tf2's Python broadcaster once left out."""
    node = rclpy.create_node("both")
    buffer = tf2_ros.Buffer()
    tf2_ros.TransformListener(buffer, node)
    static = tf2_ros.StaticTransformBroadcaster(node)
    for x in (1.0, 2.0):
        static.sendTransform([edge("foo", "bar", 1.0, x)])
    eventually(lambda: x_of(buffer.tfbus_buffer, "foo", "bar") == 2.0)


def test_a_listener_that_nothing_holds_goes_on(rclpy: ModuleType) -> None:
    """As long as its node."""
    node, buffer = rclpy.create_node("both"), tf2_ros.Buffer()
    tf2_ros.TransformListener(buffer, node)
    gc.collect()
    tf2_ros.TransformBroadcaster(node).sendTransform(edge("foo", "bar", 1.0))
    assert buffer.can_transform("foo", "bar", Time(), LONG)


def test_a_listener_that_is_unregistered_is_kept_no_longer(rclpy: ModuleType) -> None:
    """Neither by its node, which goes on; others of the node still end its `spin_once`."""
    node, buffer = rclpy.create_node("both"), tf2_ros.Buffer()
    listener = tf2_ros.TransformListener(tf2_ros.Buffer(), node)
    tf2_ros.TransformListener(buffer, node)
    listener.unregister()
    listener.unregister()
    kept = weakref.ref(listener)
    del listener
    gc.collect()
    assert kept() is None
    tf2_ros.TransformBroadcaster(node).sendTransform(edge("foo", "bar", 1.0))
    rclpy.spin_once(node)
    assert buffer.can_transform("foo", "bar", Time(), LONG)


def test_ported_and_own_programs_hear_each_other(rclpy: ModuleType, bus: Bus) -> None:
    """A ported node and a node of tfbus, which the ported names take, too."""
    ported, own = rclpy.create_node("ported"), bus.node("own")
    theirs, ours = tf2_ros.Buffer(), TfbusBuffer()
    tf2_ros.TransformListener(theirs, ported)
    send_own, send_by_own = TransformBroadcaster(own), tf2_ros.TransformBroadcaster(own)
    send_ported = tf2_ros.TransformBroadcaster(ported)
    send_static(own, "own", "camera")

    def send() -> None:
        send_own.send_transform(TransformStamped(1, "world", "own", Transform.identity()))
        send_by_own.sendTransform(edge("world", "own2", 1.0))
        send_ported.sendTransform(edge("world", "ported", 1.0))

    frames = ("own", "own2", "ported", "camera")
    with TransformListener(ours, own):
        for buffer in (theirs.tfbus_buffer, ours):
            send_until(
                send,
                lambda buffer=buffer: all(buffer.can_transform("world", each) for each in frames),
            )


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"tf_topic": "/robot1/tf"}, "namespace"),
        ({"tf_static_topic": "/robot1/tf_static"}, "namespace"),
        ({"static_only": True}, "static_only"),
    ],
)
def test_what_a_listener_cannot_is_an_error(
    rclpy: ModuleType, given: dict[str, Any], says: str
) -> None:
    """That says what to do."""
    with pytest.raises(TypeError, match=says):
        tf2_ros.TransformListener(tf2_ros.Buffer(), rclpy.create_node("a"), **given)


def test_qos_of_transforms_is_not_applied_and_says_so(
    rclpy: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    """In a line of the log each; without a QoS in none."""
    node = rclpy.create_node("a")
    tf2_ros.TransformBroadcaster(node)
    assert "QoS" not in capsys.readouterr().err
    tf2_ros.TransformBroadcaster(node, QoSProfile(depth=1))
    tf2_ros.StaticTransformBroadcaster(node, 1)
    tf2_ros.TransformListener(tf2_ros.Buffer(), node, qos=5)
    assert capsys.readouterr().err.count("is not applied: ") == 3


@pytest.mark.parametrize("node", [None, "node", object()])
def test_a_node_of_another_kind_is_refused(node: Any) -> None:
    """As a node of ROS itself is not on the bus."""
    with pytest.raises(TypeError, match="ROS itself"):
        tf2_ros.TransformBroadcaster(node)


def test_a_buffer_of_tfbus_is_refused(sender: Node) -> None:
    """Its methods are others."""
    with pytest.raises(TypeError, match=r"tfbus\.compat\.tf2_ros"):
        tf2_ros.TransformListener(TfbusBuffer(), sender)


def test_swapped_arguments_of_a_listener_name_their_order(rclpy: ModuleType) -> None:
    """The buffer comes before the node."""
    with pytest.raises(TypeError, match=r"TransformListener\(buffer, node\)"):
        tf2_ros.TransformListener(rclpy.create_node("a"), tf2_ros.Buffer())


def test_a_message_that_is_no_transform_is_refused(rclpy: ModuleType) -> None:
    """It is not sent: a TypeError names what is missing, an InvalidArgument what cannot be."""
    broadcaster = tf2_ros.TransformBroadcaster(rclpy.create_node("a"))
    with pytest.raises(TypeError, match=r"expected a .*\.TransformStamped"):
        broadcaster.sendTransform(Message().transform)
    turned = edge("a", "b", 1.0)
    turned.transform.rotation.w = 0.0
    for wrong in (turned, edge("a", "a", 1.0), edge("/a", "b", 1.0), Message()):
        with pytest.raises(tf2_ros.InvalidArgumentException):
            broadcaster.sendTransform(wrong)
