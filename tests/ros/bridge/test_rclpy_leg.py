"""The leg over rclpy of a ROS that names no publishers of messages, as Jazzy; one in memory."""

import logging
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator
from enum import Enum
from importlib import import_module
from types import ModuleType, SimpleNamespace
from typing import Any, ClassVar

import pytest

import tfbus.ros.bridge.legs
from tfbus.ros.bridge.legs import Leg, LegSettings, RosTopic
from tfbus.ros.definitions import STRING

CHATTER = RosTopic("/chatter", STRING)
KEPT = RosTopic("/kept", STRING, retained=True, depth=1)
LEG = "tfbus.ros.bridge.legs.rclpy"

Policy = Enum("Policy", ["RELIABLE", "BEST_EFFORT", "VOLATILE", "TRANSIENT_LOCAL"])


class FakeNode:
    """A node, and all of ROS: what is published comes to all its subscriptions at once."""

    made: ClassVar[list["FakeNode"]] = []

    def __init__(self, name: str, **_: object) -> None:
        self.made.append(self)
        self.name = name
        self.subscriptions: list[FakeSubscription] = []
        self.publishers: list[FakePublisher] = []

    def create_publisher(self, _: object, topic: str, qos: SimpleNamespace) -> "FakePublisher":
        publisher = FakePublisher(self, topic, qos)
        self.publishers.append(publisher)
        return publisher

    def create_subscription(
        self, _: object, topic: str, take: Any, qos: SimpleNamespace, *, raw: bool
    ) -> "FakeSubscription":
        assert raw
        subscription = FakeSubscription(topic, take)
        self.subscriptions.append(subscription)
        for publisher in self.publishers:
            if publisher.topic == topic and qos.durability is Policy.TRANSIENT_LOCAL:
                for payload in publisher.kept:
                    subscription.hear(payload)
        return subscription

    def destroy_publisher(self, publisher: "FakePublisher") -> None:
        self.publishers.remove(publisher)

    def destroy_subscription(self, subscription: "FakeSubscription") -> None:
        self.subscriptions.remove(subscription)

    def get_publishers_info_by_topic(self, _: str) -> list[object]:
        return []

    def destroy_node(self) -> None:
        """It is gone."""


class FakeSubscription:
    """A subscription of rclpy."""

    def __init__(self, topic: str, take: Callable[[bytes, dict[str, Any]], None]) -> None:
        self.topic = topic
        self._take = take

    def hear(self, payload: bytes) -> None:
        """A message comes; it does not say from where."""
        self._take(payload, {})


class FakePublisher:
    """A publisher of rclpy."""

    def __init__(self, node: FakeNode, topic: str, qos: SimpleNamespace) -> None:
        self.topic = topic
        self.kept: deque[bytes] = deque(maxlen=qos.depth)
        self._node = node

    def publish(self, payload: bytes) -> None:
        """To all, as of another node, too."""
        self.kept.append(payload)
        for each in [*self._node.subscriptions]:
            if each.topic == self.topic:
                each.hear(payload)


class FakeExecutor:
    """Has nothing to do until it ends."""

    def __init__(self, **_: object) -> None:
        self._ended = threading.Event()

    def add_node(self, node: FakeNode) -> None:
        """Nothing."""

    def spin_once(self) -> None:
        """Wait for the end."""
        self._ended.wait()

    def shutdown(self, **_: object) -> None:
        """The end."""
        self._ended.set()


@pytest.fixture
def leg(monkeypatch: pytest.MonkeyPatch) -> Iterator[Leg]:
    FakeNode.made.clear()
    modules: dict[str, dict[str, Any]] = {
        "rclpy": {"init": lambda **_: None},
        "rclpy.context": {
            "Context": lambda: SimpleNamespace(ok=lambda: True, try_shutdown=lambda: None)
        },
        "rclpy.executors": {
            "ExternalShutdownException": KeyboardInterrupt,
            "SingleThreadedExecutor": FakeExecutor,
        },
        "rclpy.node": {"Node": FakeNode},
        "rclpy.qos": {
            "DurabilityPolicy": Policy,
            "QoSProfile": SimpleNamespace,
            "ReliabilityPolicy": Policy,
        },
        "rclpy.signals": {"SignalHandlerOptions": SimpleNamespace(NO=None)},
        "rclpy.subscription": {},
        "rclpy.utilities": {"get_rmw_implementation_identifier": lambda: "rmw_of_test"},
        "std_msgs": {},
        "std_msgs.msg": {"String": object},
    }
    for name, values in modules.items():
        module = ModuleType(name)
        vars(module).update(values)
        monkeypatch.setitem(sys.modules, name, module)
        above, _, leaf = name.rpartition(".")
        if above:
            setattr(sys.modules[above], leaf, module)
    former = sys.modules.pop(LEG, None)
    leg = import_module(LEG).open_leg(LegSettings("one"), logging.getLogger("leg"))
    yield leg
    leg.close()
    del sys.modules[LEG], vars(tfbus.ros.bridge.legs)["rclpy"]
    if former is not None:
        sys.modules[LEG] = vars(tfbus.ros.bridge.legs)["rclpy"] = former


def stranger(topic: RosTopic) -> FakePublisher:
    """A publisher that is not of the leg."""
    [node] = FakeNode.made
    return FakePublisher(node, topic.name, SimpleNamespace(depth=topic.depth))


def test_own_messages_come_to_no_subscription(leg: Leg) -> None:
    """Each of several of one topic, as of odom, hears all of others, also equal messages."""
    heard: list[tuple[str, bytes]] = []
    for name in ("first", "second"):
        leg.subscribe(CHATTER, lambda data, _, name=name: heard.append((name, data)))
    sender = leg.publisher(CHATTER)
    for payload in (b"a", b"a", b"b"):
        sender.send(payload)
    assert heard == []
    stranger(CHATTER).publish(b"a")
    assert heard == [("first", b"a"), ("second", b"a")]


def test_own_retained_messages_come_to_no_later_subscription(leg: Leg) -> None:
    """What was sent before, and is kept no longer, is not waited for."""
    sender = leg.publisher(KEPT)
    for payload in (b"old", b"new"):
        sender.send(payload)
    heard: list[bytes] = []
    leg.subscribe(KEPT, lambda data, _: heard.append(data))
    assert heard == []
    for payload in (b"old", b"new"):
        stranger(KEPT).publish(payload)
    assert heard == [b"old", b"new"]
    other = leg.publisher(CHATTER)
    other.send(b"a")
    leg.subscribe(CHATTER, lambda data, _: heard.append(data))
    stranger(CHATTER).publish(b"a")
    assert heard[2:] == [b"a"]


def test_a_subscription_that_is_closed_hears_nothing(leg: Any) -> None:
    """Also where a call of it closes it."""
    heard: list[bytes] = []

    def hear(data: bytes, _: str) -> None:
        heard.append(data)
        subscription.close()

    subscription = leg.subscribe(CHATTER, hear)
    [node] = FakeNode.made
    [made] = node.subscriptions
    for payload in (b"a", b"b"):
        made.hear(payload)
    subscription.close()
    assert heard == [b"a"] and not node.subscriptions


def test_a_subscription_that_ros_refuses_is_none(leg: Leg, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is not taken for one of the leg's own, for which nothing needs to be sent."""

    def refuse(*_: object, **__: object) -> None:
        raise RuntimeError("no more resources")

    with monkeypatch.context() as refusing, pytest.raises(RuntimeError):
        refusing.setattr(FakeNode, "create_subscription", refuse)
        leg.subscribe(CHATTER, lambda data, _: None)
    monkeypatch.setattr(FakePublisher, "get_subscription_count", lambda _: 1, raising=False)
    assert leg.publisher(CHATTER).heard
