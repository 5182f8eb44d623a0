"""A leg: how a bridge reaches ROS, by one middleware.

It carries the bytes of messages, in CDR as ROS 2 has them, and knows who publishes; what they mean
is the bridge's affair.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from tfbus.ros.definitions import Definition

# What it calls for each message: `on_message(payload, gid)`; the gid is that of the publisher.
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

    `domain` is that of ROS 2, or None for what ROS's own environment says. `connect` are endpoints
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


class Closing(Protocol):
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

    def subscribe(self, topic: RosTopic, on_message: OnMessage) -> Closing:
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
