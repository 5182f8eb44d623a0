"""Legs: how a bridge reaches ROS, each by one middleware.

A leg carries the bytes of messages, in CDR as ROS 2 has them, and knows their publishers; the
meaning of messages is the affair of the bridge.
"""

import logging
import threading
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Protocol

from tfbus.base.wording import listed, printable
from tfbus.ros.definitions import Definition

# A leg calls it for each message: `on_message(payload, gid)`; the gid is the publisher's.
OnMessage = Callable[[bytes, str], None]

# All publishers of a topic together are behind one subscription: each of their last messages must
# fit.
LEAST_READER_DEPTH = 100

# Of transforms, which are small, and which all nodes of a robot publish: so many wait where this
# process is short of CPU for a second or two.
TRANSFORMS_READER_DEPTH = 5000


@dataclass(frozen=True)
class LegSettings:
    """How a leg appears in ROS: as a node of this name, in this namespace ("" or "robot1").

    `domain` is ROS 2's, or None for the one of ROS's own environment. `connect` are endpoints
    of the middleware, as the `--ros-connect` of the command; () for its usual ones. `distro` is the
    distribution of the ROS around, "" for any that has the present wire.
    """

    node: str = "tfbus_ros2"
    namespace: str = ""
    domain: int | None = None
    connect: tuple[str, ...] = ()
    distro: str = ""

    @property
    def full_name(self) -> str:
        """The full name of the node in ROS: "/robot1/tfbus_ros2"."""
        return f"/{self.namespace}/{self.node}" if self.namespace else f"/{self.node}"


@dataclass(frozen=True)
class RosTopic:
    """A topic in ROS by its full name, such as "/tf", and how it is published and subscribed to.

    `retained` is transient local in ROS's words: the last `depth` messages of each publisher reach
    subscribers that come later. All are reliable, and keep the last `depth`.
    """

    name: str
    definition: Definition
    retained: bool = False
    depth: int = 100


@dataclass(frozen=True)
class RosPublisher:
    """A publisher in ROS, by its gid in hexadecimal, and the full name of its node, "" if the
    middleware does not tell.
    """

    gid: str
    node: str = ""


class RosSender(Protocol):
    """Publishes a topic in ROS."""

    @property
    def gid(self) -> str:
        """Its gid in hexadecimal, "" if the middleware does not tell."""

    @property
    def heard(self) -> bool:
        """Whether ROS has a subscriber of the topic."""

    def send(self, payload: bytes) -> None:
        """Publish one message in CDR, with its header. Safe from any thread."""

    def close(self) -> None:
        """End it. Twice is fine."""


class Endable(Protocol):
    """An object that ends."""

    def close(self) -> None:
        """End it: its callback is not called after that, and a call under way has ended, if it
        is not that which closes it. Twice is fine.
        """


class Leg(Protocol):
    """A node in ROS, until `close()`.

    Messages of its own publishers do not come back to its subscriptions. The callbacks of one
    subscription are called one after the other, on a thread of the leg's.
    """

    @property
    def name(self) -> str:
        """The middleware as users know it: "rmw_zenoh", "DDS", "rclpy (rmw_fastrtps_cpp)"."""

    @property
    def tells_publishers(self) -> bool:
        """Whether each message comes with the gid of its publisher; "" otherwise."""

    def publisher(self, topic: RosTopic) -> RosSender:
        """Begin to publish a topic."""

    def subscribe(self, topic: RosTopic, on_message: OnMessage) -> Endable:
        """Call `on_message(payload, gid)` for each message of others on a topic."""

    def publishers(self, topic: str) -> Sequence[RosPublisher]:
        """The publishers of a topic that are there now, its own ones left out. Quick enough to be
        asked every second.
        """

    def lost(self) -> Mapping[str, int]:
        """How many messages of each topic never came here, as far as the middleware lets one know:
        at least as many were lost.
        """

    def warnings(self) -> Sequence[str]:
        """Notes on the ROS around, in sentences; such as that there is none."""

    def close(self) -> None:
        """Leave ROS. Twice is fine."""


class Calls:
    """The calls of a subscription: one after the other, from any thread, until `close()`."""

    def __init__(self, on_message: OnMessage) -> None:
        self._on_message: OnMessage | None = on_message
        # A call may close it.
        self._lock = threading.RLock()

    def call(self, payload: bytes, gid: str) -> None:
        """A message has come."""
        with self._lock:
            on_message = self._on_message
            if on_message is not None:
                on_message(payload, gid)

    def close(self) -> bool:
        """End it: no call begins after this, and a call under way has ended, if it is not that
        which closes it. Whether it was open.
        """
        on_message, self._on_message = self._on_message, None
        with self._lock:
            return on_message is not None


# Publishers come from ROS: of at most as many the last number is known.
_MOST_PUBLISHERS = 10_000


class LostMessages:
    """Counts by the numbers of messages, and by rooms that were full. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._counts: Counter[str] = Counter()
        self._last: dict[tuple[str, str], int] = {}

    @property
    def counts(self) -> dict[str, int]:
        """How many messages of each topic were lost, at least."""
        with self._lock:
            return dict(self._counts)

    def came(self, topic: str, gid: str, number: int) -> None:
        """A message has come that its publisher, with this gid, gave this number."""
        key = topic, gid
        last = self._last.get(key)
        if last is not None and number <= last:
            return  # one that was kept, for late subscribers
        if last is None and len(self._last) >= _MOST_PUBLISHERS:
            self._last.clear()
        self._last[key] = number
        if last is not None and number > last + 1:
            self._lose(topic, number - last - 1)

    def was_full(self, topic: str) -> None:
        """As many messages waited as may wait: earlier ones are lost, one at least."""
        self._lose(topic, 1)

    def _lose(self, topic: str, count: int) -> None:
        with self._lock:
            self._counts[topic] += count


@dataclass(frozen=True)
class Offer:
    """How a node publishes a topic; `node` is "" if it has no name, `type` as the middleware
    names it.
    """

    node: str
    type: str
    is_reliable: bool
    is_retained: bool


def unheard(topic: RosTopic, own_type: str, offers: Iterable[Offer]) -> Sequence[str]:
    """The note on publishers whose messages do not come to a subscriber of the topic."""
    best_effort, volatile = [], []
    said = []
    for each in offers:
        name = printable(each.node or "a node without a name", 100)
        if each.type != own_type:
            shown = printable(each.type, 100)
            said.append(f"{name} publishes {topic.name} as {shown}, not {own_type}")
        elif not each.is_reliable:
            best_effort.append(name)
        elif topic.retained and not each.is_retained:
            volatile.append(name)
    if best_effort:
        said.append(
            f"{_publish(best_effort)} {topic.name} as best effort, and it is read as reliable: "
            "such messages do not come"
        )
    if volatile:
        said.append(
            f"{_publish(volatile)} {topic.name} as volatile, and it is read as transient local: "
            "such messages do not come"
        )
    return list(dict.fromkeys(said))


def _publish(nodes: Sequence[str]) -> str:
    """The nodes, each once, with their verb."""
    names = list(dict.fromkeys(nodes))
    return f"{listed(names)} {'publish' if names[1:] else 'publishes'}"


# The module of each leg has a function `open_leg(settings, log)`.
_MODULES = {
    "zenoh": "tfbus.ros.bridge.legs.zenoh",
    "dds": "tfbus.ros.bridge.legs.dds",
    "rclpy": "tfbus.ros.bridge.legs.rclpy",
    "rospy": "tfbus.ros.bridge.legs.rospy",
}


def open_leg(via: str, settings: LegSettings, log: logging.Logger) -> Leg:
    """Join ROS by "zenoh", "dds", "rclpy" or "rospy".

    Raises TfbusError if the middleware is not installed, with the command that installs it, or if
    it cannot be joined.
    """
    leg: Leg = import_module(_MODULES[via]).open_leg(settings, log)
    return leg
