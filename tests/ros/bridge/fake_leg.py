"""ROS in memory: participants that publish and subscribe as a middleware lets them."""

import queue
import threading
import uuid
from collections import deque
from collections.abc import Callable, Mapping, Sequence

from tests.buses import DEADLINE_S
from tfbus.base.errors import TfbusError
from tfbus.ros.bridge.legs import LegSettings, OnMessage, RosPublisher, RosTopic


class FakeRos:
    """A ROS network. Each `leg` is a participant with a node of its own; `settings` as of a real
    one, or only the name of the node.

    One that `tells_publishers` is False gets messages without gids, as rclpy of Jazzy. One that
    `names_nodes` is False knows gids without nodes, as with a bare DDS.
    """

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.senders: list[FakeSender] = []
        self.subscriptions: list[FakeSubscription] = []
        self._legs: list[FakeLeg] = []

    def leg(
        self,
        settings: LegSettings | str = "tfbus_ros2",
        *,
        tells_publishers: bool = True,
        names_nodes: bool = True,
    ) -> "FakeLeg":
        """A participant that joins now."""
        if isinstance(settings, str):
            settings = LegSettings(settings)
        leg = FakeLeg(self, settings, tells_publishers, names_nodes)
        self._legs.append(leg)
        return leg

    def new_gid(self) -> str:
        """A gid that no publisher had before, in any ROS."""
        return uuid.uuid4().hex

    def settle(self) -> None:
        """Wait until all participants have taken all messages so far, and their answers."""
        while not all([each.settle() for each in self._legs]):
            pass

    def close(self) -> None:
        """End all participants; what their callbacks raised fails the test."""
        for leg in self._legs:
            leg.close()
        errors = [error for leg in self._legs for error in leg.errors]
        assert not errors, errors


class FakeSender:
    """A publisher; `matches` decides as DDS which subscriptions get its messages."""

    def __init__(self, leg: "FakeLeg", topic: RosTopic) -> None:
        self.leg = leg
        self.topic = topic
        self.gid = leg.ros.new_gid()
        # What it has sent, for tests to look at.
        self.sent: list[bytes] = []
        self.kept: deque[bytes] = deque(maxlen=topic.depth)
        with leg.ros.lock:
            leg.ros.senders.append(self)

    @property
    def heard(self) -> bool:
        """Whether another participant subscribes to the topic."""
        with self.leg.ros.lock:
            return any(each.leg is not self.leg for each in self._matching())

    def send(self, payload: bytes) -> None:
        """Publish one message."""
        with self.leg.ros.lock:
            if self not in self.leg.ros.senders:
                raise TfbusError(f"the publisher of {self.topic.name} is closed")
            self.sent.append(payload)
            if self.topic.retained:
                self.kept.append(payload)
            for each in self._matching():
                each.take(payload, self)

    def close(self) -> None:
        """It is gone, and what it kept."""
        with self.leg.ros.lock:
            if self in self.leg.ros.senders:
                self.leg.ros.senders.remove(self)

    def matches(self, subscription: "FakeSubscription") -> bool:
        """A volatile publisher does not reach a subscriber that wants what was before."""
        wanted = subscription.topic
        return (
            wanted.name == self.topic.name
            and wanted.definition.name == self.topic.definition.name
            and (self.topic.retained or not wanted.retained)
        )

    def _matching(self) -> list["FakeSubscription"]:
        return [each for each in self.leg.ros.subscriptions if self.matches(each)]


class FakeSubscription:
    """A subscriber; what publishers retained comes first."""

    def __init__(self, leg: "FakeLeg", topic: RosTopic, on_message: OnMessage) -> None:
        self.leg = leg
        self.topic = topic
        self._on_message: OnMessage | None = on_message
        # Held while it calls; a call may close it.
        self._calling = threading.RLock()
        with leg.ros.lock:
            leg.ros.subscriptions.append(self)
            for sender in leg.ros.senders:
                if topic.retained and sender.matches(self):
                    for payload in sender.kept:
                        self.take(payload, sender)

    def take(self, payload: bytes, sender: FakeSender) -> None:
        """A message for it; with the lock of ROS held, so that they come in order."""
        leg = self.leg
        if sender.leg is leg:
            return
        gid = sender.gid if leg.tells_publishers else ""
        leg.call(lambda: self.hear(payload, gid))

    def close(self) -> None:
        """It takes no message after this."""
        self._on_message = None
        with self._calling:
            pass  # a call under way has ended
        with self.leg.ros.lock:
            if self in self.leg.ros.subscriptions:
                self.leg.ros.subscriptions.remove(self)

    def hear(self, payload: bytes, gid: str) -> None:
        with self._calling:
            on_message = self._on_message
            if on_message is not None:
                on_message(payload, gid)


class FakeLeg:
    """A participant: a `Leg`, for the bridge under test and for the nodes of ROS around alike."""

    name = "memory"

    def __init__(
        self, ros: FakeRos, settings: LegSettings, tells_publishers: bool, names_nodes: bool
    ) -> None:
        self.ros = ros
        self.settings = settings
        self.tells_publishers = tells_publishers
        self.names_nodes = names_nodes
        # Whether others see its publishers; messages may be faster.
        self.is_listed = True
        self.told: list[str] = []
        self.lost_messages: dict[str, int] = {}
        # What its callbacks raised: nothing, where they are right.
        self.errors: list[Exception] = []
        self._calls: queue.SimpleQueue[Callable[[], object] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name=settings.full_name, daemon=True)
        self._thread.start()

    def publisher(self, topic: RosTopic) -> FakeSender:
        """Begin to publish a topic."""
        return FakeSender(self, topic)

    def subscribe(self, topic: RosTopic, on_message: OnMessage) -> FakeSubscription:
        """Call `on_message(payload, gid)` on the leg's thread."""
        return FakeSubscription(self, topic, on_message)

    def publishers(self, topic: str) -> Sequence[RosPublisher]:
        """The publishers of others."""
        with self.ros.lock:
            return [
                RosPublisher(each.gid, each.leg.settings.full_name if self.names_nodes else "")
                for each in self.ros.senders
                if each.topic.name == topic and each.leg is not self and each.leg.is_listed
            ]

    def senders(self, topic: str) -> list[FakeSender]:
        """Its own publishers of a topic."""
        with self.ros.lock:
            return [
                each for each in self.ros.senders if each.leg is self and each.topic.name == topic
            ]

    def lost(self) -> Mapping[str, int]:
        """What a test has it say: `lost_messages`."""
        return self.lost_messages

    def warnings(self) -> Sequence[str]:
        """What a test has it say: `told`."""
        return self.told

    def close(self) -> None:
        """Leave ROS: its publishers are gone, and what they kept. So does one that dies."""
        with self.ros.lock:
            self.ros.senders[:] = [each for each in self.ros.senders if each.leg is not self]
            mine = [each for each in self.ros.subscriptions if each.leg is self]
        for each in mine:
            each.close()
        self._calls.put(None)
        if threading.current_thread() is not self._thread:
            self._thread.join(DEADLINE_S)

    def call(self, call: Callable[[], object]) -> None:
        """Call something on its thread, after what came before."""
        self._calls.put(call)

    def settle(self) -> bool:
        """Wait until it has taken what came; whether that was nothing."""
        if not self._thread.is_alive():
            return True
        was_idle = self._calls.empty()
        done = threading.Event()
        self._calls.put(done.set)
        assert done.wait(DEADLINE_S), f"{self.settings.full_name} does not come to an end"
        return was_idle and self._calls.empty()

    def _run(self) -> None:
        while (call := self._calls.get()) is not None:
            try:
                call()
            except Exception as error:
                self.errors.append(error)
