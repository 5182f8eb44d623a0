"""tf2_msgs: messages of transforms, on the topics /tf and /tf_static and on others."""

import math
from types import ModuleType

import pytest

from tests.builders import x_of
from tests.buses import eventually, send_static
from tests.compat.spinning import publish_until
from tests.simulated_bus import Bus
from tfbus import (
    Buffer,
    StaticTransformBroadcaster,
    Transform,
    TransformBroadcaster,
    TransformListener,
    TransformStamped,
)
from tfbus.compat import tf2_ros
from tfbus.compat.geometry_msgs.msg import TransformStamped as Message
from tfbus.compat.rclpy.qos import DurabilityPolicy, QoSProfile
from tfbus.compat.rclpy.time import Time
from tfbus.compat.tf2_msgs.msg import TFMessage
from tfbus.compat.tf2_msgs.srv import FrameGraph
from tfbus.compat.tf2_ros import InvalidArgumentException
from tfbus.ros.transforms import message_of, stamped_of


def edge(parent: str, child: str, x: float = 1.0) -> Message:
    """A child at x in its parent, at 5 s."""
    message = Message(child_frame_id=child)
    message.header.frame_id = parent
    message.header.stamp = Time(seconds=5.0).to_msg()
    message.transform.translation.x = x
    return message


@pytest.mark.parametrize("topic", ["/tf", "tf_static"])
def test_what_is_published_on_the_topics_of_transforms_is_heard(
    rclpy: ModuleType, topic: str
) -> None:
    """By a TransformListener, as what a broadcaster sends, and by a subscription."""
    node, buffer, got = rclpy.create_node("both"), Buffer(), []
    node.create_subscription(TFMessage, topic, got.append, 10)
    publisher = node.create_publisher(TFMessage, topic, 10)
    sent = TFMessage(transforms=[edge("map", "base"), edge("base", "cam")])
    with TransformListener(buffer, node.tfbus_node):
        publish_until(node, publisher, sent, lambda: got and buffer.can_transform("map", "cam"))
    assert got[0] == sent
    assert x_of(buffer, "map", "cam") == 2.0


def test_a_subscription_of_tf_hears_every_stream(rclpy: ModuleType, bus: Bus) -> None:
    """Also split ones, and of nodes of tfbus; what a buffer would refuse comes as it was sent."""
    node, own, got = rclpy.create_node("ported"), bus.node("own"), []
    node.create_subscription(TFMessage, "/tf", lambda m: got.extend(m.transforms), 100)
    split = TransformBroadcaster(own, stream="arm", split=True)
    turned = Transform.from_rpy(0.1, 0.2, 0.3, (1.0, 2.0, 3.0))
    stamped = TransformStamped(7_000_000_001, "map", "hand", turned)

    def heard() -> bool:
        split.send_transform(stamped)
        rclpy.spin_once(node, timeout_sec=0.01)
        return bool(got)

    eventually(heard)
    assert got[0] == message_of(stamped)
    assert stamped_of(got[0]) == stamped


def test_static_transforms_come_to_a_subscription_that_is_late(rclpy: ModuleType, bus: Bus) -> None:
    """As they are kept for it."""
    send_static(bus.node("own"), "map", "camera")
    node, got = rclpy.create_node("late"), []
    latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    subscription = node.create_subscription(TFMessage, "/tf_static", got.append, latched)
    eventually(lambda: rclpy.spin_once(node, timeout_sec=0.01) or got)
    assert got[0].transforms[0].child_frame_id == "camera"
    node.destroy_subscription(subscription)


@pytest.mark.parametrize("kind", ["tf", "tf_static"])
def test_the_topic_of_a_robot_is_that_of_its_namespace(
    rclpy: ModuleType, bus: Bus, kind: str
) -> None:
    """Heard and sent by a node that is in none."""
    robot, node, got = bus.node("arm", namespace="robot_1"), rclpy.create_node("relay"), []
    node.create_subscription(TFMessage, f"/robot_1/{kind}", got.append, 10)
    send = TransformBroadcaster if kind == "tf" else StaticTransformBroadcaster
    broadcaster = send(robot)

    def heard() -> bool:
        broadcaster.send_transform(TransformStamped(5, "odom", "base", Transform.identity()))
        rclpy.spin_once(node, timeout_sec=0.01)
        return bool(got)

    eventually(heard)
    assert got[0].transforms[0].child_frame_id == "base"
    buffer = Buffer()
    publisher = node.create_publisher(TFMessage, f"/robot_1/{kind}", 10)
    with TransformListener(buffer, robot):
        publish_until(
            node,
            publisher,
            TFMessage(transforms=[edge("base", "cam")]),
            lambda: buffer.can_transform("base", "cam"),
        )


def test_a_topic_of_transforms_may_be_remapped(rclpy: ModuleType, bus: Bus) -> None:
    """Of broadcasters, listeners, publishers and subscriptions, by the name and in a namespace."""
    remapped = ["--ros-args", "-r", "/tf:=/robot_1/tf", "-r", "/tf_static:=/robot_1/tf_static"]
    node = rclpy.create_node("relay", cli_args=remapped)
    buffer, ported = Buffer(), tf2_ros.Buffer()
    listener = tf2_ros.TransformListener(ported, node)
    broadcaster = tf2_ros.TransformBroadcaster(node)
    publisher = node.create_publisher(TFMessage, "tf", 10)
    with TransformListener(buffer, bus.node("arm", namespace="robot_1")):

        def sent() -> bool:
            broadcaster.sendTransform(edge("map", "odom"))
            publisher.publish(TFMessage(transforms=[edge("odom", "base")]))
            return buffer.can_transform("map", "base")

        eventually(sent)
    eventually(lambda: ported.can_transform("map", "base", Time()))
    listener.unregister()


@pytest.mark.parametrize("topic", ["/other", "/robot_1/other"])
def test_a_listener_of_another_topic_is_refused(rclpy: ModuleType, topic: str) -> None:
    """With the topics there are; so are two topics of two namespaces."""
    node, buffer = rclpy.create_node("a"), tf2_ros.Buffer()
    with pytest.raises(TypeError, match="/robot7/tf"):
        tf2_ros.TransformListener(buffer, node, tf_topic=topic)
    with pytest.raises(TypeError, match="of one namespace"):
        tf2_ros.TransformListener(buffer, node, tf_topic="/robot_1/tf")


def test_what_cannot_be_a_transform_is_refused_by_the_publisher(rclpy: ModuleType) -> None:
    """As by a broadcaster; another message too."""
    publisher = rclpy.create_node("a").create_publisher(TFMessage, "/tf", 10)
    with pytest.raises(InvalidArgumentException):
        publisher.publish(TFMessage(transforms=[edge("a", "b", math.nan)]))
    with pytest.raises(TypeError, match="TFMessage, not TransformStamped"):
        publisher.publish(edge("a", "b"))


def test_a_message_that_cannot_be_read_is_skipped_with_one_warning(
    rclpy: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    """Others still come."""
    node, got = rclpy.create_node("a"), []
    node.create_subscription(TFMessage, "/tf", got.append, 10)
    raw = node.tfbus_node.create_raw_publisher("tf/broken")
    publisher = node.create_publisher(TFMessage, "/tf", 10)
    for _ in range(2):
        raw.publish(b"\x00")
    publish_until(node, publisher, TFMessage(transforms=[edge("a", "b")]), lambda: got)
    assert capsys.readouterr().err.count(" on 'tf/broken'") == 1


def test_on_another_topic_the_message_goes_as_it_is(rclpy: ModuleType) -> None:
    """As every dataclass."""
    node, got = rclpy.create_node("a"), []
    node.create_subscription(TFMessage, "filtered_tf", got.append, 10)
    sent = TFMessage(transforms=[edge("a", "b")])
    publish_until(node, node.create_publisher(TFMessage, "filtered_tf", 10), sent, lambda: got)
    assert got[0] == sent


def test_a_program_may_serve_the_tree_as_ros_does(rclpy: ModuleType) -> None:
    """FrameGraph is a service as any other."""
    node, asking = rclpy.create_node("a"), rclpy.create_node("b")

    def answer(request: FrameGraph.Request, response: FrameGraph.Response) -> FrameGraph.Response:
        response.frame_yaml = "base: {parent: map}"
        return response

    node.create_service(FrameGraph, "tf2_frames", answer)
    client = asking.create_client(FrameGraph, "tf2_frames")
    assert client.wait_for_service(20)
    future = client.call_async(FrameGraph.Request())
    eventually(lambda: rclpy.spin_once(node, timeout_sec=0.01) or future.done())
    assert future.result().frame_yaml == "base: {parent: map}"
