"""Retained topics: the last message reaches subscribers that join later."""

import msgpack

from tests.buses import eventually
from tests.simulated_bus import Bus
from tfbus.cli.bus import look
from tfbus.messages import RobotDescription

ONE, TWO = RobotDescription("<one/>"), RobotDescription("<two/>")


def test_late_subscribers_get_the_last_message(bus: Bus) -> None:
    """A late joiner gets the last message, and then each new one."""
    publisher = bus.node("sender").create_publisher(RobotDescription, "robot", retained=True)
    publisher.publish(ONE)
    publisher.publish(TWO)
    heard: list[RobotDescription] = []
    bus.node("late").create_subscription(RobotDescription, "robot", heard.append, retained=True)
    eventually(lambda: heard)
    assert heard == [TWO]
    publisher.publish(ONE)
    eventually(lambda: heard == [TWO, ONE])


def test_early_subscribers_get_what_a_late_publisher_sends(bus: Bus) -> None:
    """A subscriber that was there before gets what is published at once."""
    heard: list[RobotDescription] = []
    bus.node("early").create_subscription(RobotDescription, "robot", heard.append, retained=True)
    publisher = bus.node("sender").create_publisher(RobotDescription, "robot", retained=True)
    publisher.publish(ONE)
    eventually(lambda: heard == [ONE])


def test_it_works_across_namespaces(bus: Bus) -> None:
    """A subscriber by an absolute name gets the retained message of another namespace."""
    sender = bus.node("sender", namespace="robot7")
    sender.create_publisher(RobotDescription, "robot", retained=True).publish(ONE)
    heard: list[RobotDescription] = []
    bus.node("late", namespace="robot8").create_subscription(
        RobotDescription, "/robot7/robot", heard.append, retained=True
    )
    eventually(lambda: heard == [ONE])


def test_bytes_can_be_retained_too(bus: Bus) -> None:
    """Raw publishers and subscriptions retain as the others do."""
    publisher = bus.node("sender").create_raw_publisher("raw", type_name="X", retained=True)
    payload = msgpack.packb({"x": 1})
    publisher.publish(payload)
    heard: list[bytes] = []
    bus.node("late").create_raw_subscription("raw", heard.append, retained=True)
    eventually(lambda: heard == [payload])


def test_a_node_says_what_it_retains(bus: Bus) -> None:
    """The description of a node, and so the graph, tells retained topics from others."""
    node = bus.node("sender")
    kept = node.create_publisher(RobotDescription, "kept", retained=True)
    node.create_publisher(RobotDescription, "plain")
    assert node.describe()["retained"] == ["kept"]
    looks = bus.node("looks")
    topics = eventually(lambda: found if "kept" in (found := look(looks.session).topics) else None)
    assert (topics["kept"].retained, topics["plain"].retained) == (True, False)
    kept.close()
    assert node.describe()["retained"] == []


def test_tools_print_what_is_retained(bus: Bus) -> None:
    """`tfbus topic echo` prints it though it was sent before, and `topic info` says so."""
    publisher = bus.node("sender").create_publisher(RobotDescription, "robot", retained=True)
    publisher.publish(ONE)
    shown = bus.run("topic", "echo", "robot", "--once", "--timeout", "20")
    assert shown.returncode == 0 and "<one/>" in shown.stdout
    # A tool takes one look, which on a busy machine may end before the node has answered.
    eventually(lambda: "Retained: " in bus.run("topic", "info", "robot", "-v").stdout)
