"""The leg to ROS 1 with a master and a rospy in memory."""

import logging
import sys
import threading
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from tests.buses import eventually
from tfbus.ros.bridge.legs import RosTopic
from tfbus.ros.bridge.legs.rospy import RospyLeg
from tfbus.ros.definitions import STRING
from tfbus.ros.ros1 import Ros1State

NAME = "/tfbus_ros1"
CHATTER = RosTopic("/chatter", STRING)
# "hi", as ROS 1 has it.
HI = b"\x02\x00\x00\x00hi"


class FakeMaster:
    """What a master knows, and who has asked it; a leg reaches it, and all nodes, by `client`."""

    def __init__(self) -> None:
        self.publishers: dict[str, list[str]] = {}
        self.parameters: dict[str, object] = {}
        self.is_away = False
        # Nodes that were killed.
        self.killed: set[str] = set()
        self.calls: list[str] = []
        self.askers: set[threading.Thread] = set()

    def client(self, uri: str, caller: str, within_s: float = 2.0) -> "FakeClient":
        """As `Ros1Master` is made; the URI of a node is its name."""
        return FakeClient(self, uri)

    def look(self) -> None:
        """Wait until the leg has asked for all that there is, and has taken the answer."""
        looks = self.calls.count("state") + 2
        eventually(lambda: self.calls.count("state") >= looks)


class FakeClient:
    """Asks the master, or a node."""

    def __init__(self, master: FakeMaster, uri: str) -> None:
        self._master = master
        self._uri = uri

    def state(self) -> Ros1State:
        """What the master knows."""
        self._called("state")
        return Ros1State(self._master.publishers, {}, {})

    def call(self, method: str, *values: Any) -> Any:
        """The answer to a call."""
        self._called(method)
        if method == "getPid" and self._uri in self._master.killed:
            raise OSError("connection refused")
        if method != "getParam":
            return values[0] if values else 1
        if values[0] not in self._master.parameters:
            raise OSError("it is not set")
        return self._master.parameters[values[0]]

    def _called(self, method: str) -> None:
        self._master.askers.add(threading.current_thread())
        if self._master.is_away:
            raise OSError("timed out")
        self._master.calls.append(method)


class FakeSubscriber:
    """A subscriber of rospy's."""

    made: "list[FakeSubscriber]"

    def __init__(
        self, name: str, data_class: type, callback: Any, queue_size: int | None, **_: object
    ) -> None:
        self.callback: Callable[[Any], None] = callback
        self.queue_size = queue_size
        self.made.append(self)

    def hear(self, node: str) -> None:
        """A message of a node comes."""
        self.callback(SimpleNamespace(_connection_header={"callerid": node}, payload=HI))

    def unregister(self) -> None:
        """It ends."""


@pytest.fixture
def master(monkeypatch: pytest.MonkeyPatch) -> FakeMaster:
    master = FakeMaster()
    monkeypatch.setattr("tfbus.ros.bridge.legs.rospy.Ros1Master", master.client)
    monkeypatch.setattr("tfbus.ros.bridge.legs.rospy._POLL_EVERY_S", 0.01)
    monkeypatch.setitem(sys.modules, "genpy", SimpleNamespace(Message=object))
    return master


@pytest.fixture
def leg(master: FakeMaster) -> Iterator[RospyLeg]:
    FakeSubscriber.made = []
    rospy = SimpleNamespace(
        Subscriber=FakeSubscriber,
        get_node_uri=lambda: NAME,
        is_shutdown=lambda: False,
        signal_shutdown=lambda reason: None,
    )
    leg = RospyLeg(rospy, "http://localhost:11311", NAME, logging.getLogger("leg"))
    yield leg
    leg.close()


def nodes(leg: RospyLeg) -> list[str]:
    return [each.node for each in leg.publishers("/chatter")]


def test_who_asks_the_leg_does_not_wait_for_the_master(master: FakeMaster, leg: RospyLeg) -> None:
    """Threads of its own ask, also while the master is gone: then all is as it was."""
    master.askers.clear()
    master.publishers = {"/chatter": ["/talker", NAME]}
    master.parameters = {"/use_sim_time": True}
    eventually(lambda: nodes(leg) == ["/talker"])
    assert "/use_sim_time" in leg.warnings()[0]
    master.is_away = True
    master.publishers = {}
    assert nodes(leg) == ["/talker"] and leg.warnings()
    master.is_away = False
    eventually(lambda: not nodes(leg))
    assert threading.current_thread() not in master.askers


def test_a_node_that_sends_is_a_publisher_before_the_master_says_so(
    monkeypatch: pytest.MonkeyPatch, master: FakeMaster
) -> None:
    """Its first messages are not held up until the leg asks again."""
    monkeypatch.setattr("tfbus.ros.bridge.legs.rospy._POLL_EVERY_S", 1000.0)
    rospy = SimpleNamespace(Subscriber=FakeSubscriber, signal_shutdown=lambda reason: None)
    FakeSubscriber.made = []
    leg = RospyLeg(rospy, "http://localhost:11311", NAME, logging.getLogger("leg"))
    known: list[list[str]] = []
    leg.subscribe(CHATTER, lambda *_: known.append(nodes(leg)))
    for node in ("/talker", NAME, "/talker"):
        FakeSubscriber.made[0].hear(node)
    assert known == [["/talker"], ["/talker"]]
    leg.close()


def test_a_node_that_was_killed_is_no_publisher(master: FakeMaster, leg: RospyLeg) -> None:
    """Though the master has it still; without the master all nodes are as they were."""
    master.publishers = {"/chatter": ["/robot", "/talker"]}
    eventually(lambda: nodes(leg) == ["/robot", "/talker"])
    master.killed = {"/talker"}
    eventually(lambda: nodes(leg) == ["/robot"])
    master.is_away = True
    assert nodes(leg) == ["/robot"]
    master.is_away = False
    master.killed = set()
    eventually(lambda: nodes(leg) == ["/robot", "/talker"])


def test_a_topic_is_registered_again_while_one_of_its_ends_is_there(
    master: FakeMaster, leg: RospyLeg
) -> None:
    """A master that was started again knows nothing of this node; here none ever does."""
    first, second = [leg.subscribe(CHATTER, lambda *_: None) for _ in range(2)]
    first.close()
    first.close()
    master.look()
    calls = master.calls.count("registerSubscriber")
    eventually(lambda: master.calls.count("registerSubscriber") > calls)
    second.close()
    master.look()
    calls = master.calls.count("registerSubscriber")
    master.look()
    assert master.calls.count("registerSubscriber") == calls


def test_rospy_drops_nothing_that_it_has_read(leg: RospyLeg) -> None:
    """A burst of small messages, of which it reads thousands at once, comes whole."""
    leg.subscribe(CHATTER, lambda *_: None)
    assert FakeSubscriber.made[-1].queue_size is None


def test_a_message_that_cannot_be_taken_is_said(
    leg: RospyLeg, caplog: pytest.LogCaptureFixture
) -> None:
    """Once, and the next ones are taken; rospy would write it to a file of its own."""
    came: list[bytes] = []

    def take(payload: bytes, gid: str) -> None:
        came.append(payload)
        raise ValueError("no room")

    leg.subscribe(CHATTER, take)
    for _ in range(2):
        FakeSubscriber.made[-1].hear("/talker")
    assert len(came) == 2
    [line] = caplog.messages
    assert "not taken: no room" in line
