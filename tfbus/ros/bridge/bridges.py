"""Other bridges: their notices on the bus, and which of two bridges sends a frame."""

import threading
from collections.abc import Callable, Container
from contextlib import suppress
from dataclasses import dataclass, replace

from tfbus.base import scheduler
from tfbus.base.bounded import Bounded
from tfbus.base.errors import DecodeError, RightsError, TfbusError
from tfbus.base.wording import printable
from tfbus.geometry.transform import TransformStamped
from tfbus.node.node import Node
from tfbus.node.topic import Publisher
from tfbus.ros.bridge.common import Common
from tfbus.ros.bridge.ros_sources import RosSource
from tfbus.ros.bridge.to_ros import ToRos
from tfbus.ros.rmw import is_bridge
from tfbus.wire.codec import decode_message
from tfbus.wire.descriptions import NodeDescription
from tfbus.wire.keys import ALL_NODES, full_name, node_key

TOPIC = "ros_bridges"

# Bridges come from the bus: at most this many are remembered.
_MOST = 100

# A node that takes longer to answer is not waited for.
_ANSWER_WITHIN_S = 1.0


@dataclass(frozen=True)
class RosBridge:
    """A bridge: its node on the bus (full name) and its session, its node in ROS and the middleware
    that reaches it. `started_ns` is when it started, in ns since the Unix epoch; `gids` are its
    publishers of transforms in ROS. `to_ros` and `from_ros` are how many frames cross, and
    `clock` is which way it passes the simulated time on: "to ROS", "from ROS" or "". `lost` is how
    many messages of ROS never came to it, at least.
    """

    node: str
    session: str
    started_ns: int
    ros_node: str
    via: str
    gids: tuple[str, ...] = ()
    to_ros: int = 0
    from_ros: int = 0
    clock: str = ""
    lost: int = 0

    def joins(self, publishers: Container[str]) -> bool:
        """Whether it joins the ROS that has these publishers of transforms, by their gids."""
        return any(gid in publishers for gid in self.gids)


def check_name_is_free(node: Node) -> None:
    """Raise TfbusError if another bridge has the node's name: streams would have two owners."""
    for answer in node.session.ask(node_key(node.name), timeout_s=_ANSWER_WITHIN_S):
        if answer.refusal is not None:
            continue
        try:
            other = decode_message(NodeDescription, answer.payload)
        except DecodeError:
            continue
        is_bridge = RosBridge.__name__ in other.publishes.values()
        if is_bridge and other.session != node.session.id:
            raise TfbusError(
                f"Bridge {printable(node.full_name, 60)} runs already, on "
                f"{printable(other.host, 60)} with pid {other.pid}, and streams have the bridge's "
                "name: give this one another by --name"
            )


class Bridges:
    """The bridges of this bus, on a retained topic. `on_change` is called, on a thread of Zenoh's,
    when another one comes.
    """

    def __init__(self, node: Node, own: RosBridge, on_change: Callable[[], object]) -> None:
        # The sessions of other bridges between this bus and this ROS.
        self.met: set[str] = set()
        self._own = own
        self._on_change = on_change
        self._lock = threading.Lock()
        self._others: Bounded[str, RosBridge] = Bounded(_MOST)
        # The full names of the nodes that are there.
        self._living: set[str] = set()
        self._namespace = node.namespace
        self._publisher: Publisher[RosBridge] | None = None
        try:
            self._publisher = node.create_publisher(RosBridge, TOPIC, retained=True)
            self._publisher.publish(own)
        except RightsError as error:
            node.log.warning("Other bridges do not know of this one: %s", error)
        self._subscription = node.create_raw_subscription(
            TOPIC, self._on_message, type_name=RosBridge.__name__, retained=True
        )
        self._tokens = node.session.watch_living(ALL_NODES, self._on_token)

    @property
    def others(self) -> list[RosBridge]:
        """The other bridges that there are or were."""
        with self._lock:
            return [*self._others.values()]

    @property
    def seniors(self) -> list[RosBridge]:
        """The other bridges between this bus and this ROS that were there before this one."""
        return [each for each in self.others if each.session in self.met and self.is_senior(each)]

    def living(self, publishers: Container[str]) -> list[RosBridge]:
        """The other bridges that are there, and join this bus and the ROS with these publishers, or
        may: one without gids sends nothing to ROS.
        """
        with self._lock:
            by_node = {each.node: each for each in self._others.values()}
        living = [each for each in by_node.values() if each.node in self._living]
        return [each for each in living if not each.gids or each.joins(publishers)]

    def of_gid(self, gid: str) -> RosBridge | None:
        """The other bridge of this bus that publishes in ROS by this gid."""
        with self._lock:
            return next((each for each in self._others.values() if gid in each.gids), None)

    def is_senior(self, other: RosBridge) -> bool:
        """Whether another was there before this one."""
        return (other.started_ns, other.session) < (self._own.started_ns, self._own.session)

    def announce(self, own: RosBridge) -> None:
        """Tell the others, if that is new."""
        if own != self._own:
            self._own = own
            if self._publisher is not None:
                self._publisher.publish(own)

    def close(self) -> None:
        """Tell and hear nothing more. Twice is fine."""
        self._tokens.close()
        self._subscription.close()
        if self._publisher is not None:
            # Its node may stay, or be gone already.
            with suppress(TfbusError):
                self.announce(replace(self._own, to_ros=0, from_ros=0, clock=""))
            self._publisher.close()

    def _on_message(self, payload: bytes) -> None:
        try:
            other = decode_message(RosBridge, payload)
        except DecodeError:
            return
        if other.session == self._own.session:
            return
        with self._lock:
            former = self._others.get(other.session)
            self._others[other.session] = other
        if former is None or former.gids != other.gids:
            self._on_change()

    def _on_token(self, key: str, alive: bool) -> None:
        (self._living.add if alive else self._living.discard)(full_name(key, self._namespace))


# A frame that another bridge sends may be one of this bus that is not known here yet.
_GRACE_S = 2.0

# Names come from ROS: of more than this, all are asked about again.
_MOST_NAMES = 100_000


class CrossingRule:
    """Says it for each frame by its name on the bus; `to_ros` sends frames of the bus to ROS."""

    def __init__(
        self,
        common: Common,
        bridges: Bridges,
        to_ros: ToRos | None,
        *,
        tells_publishers: bool,
    ) -> None:
        self._options = common.options
        self._publishers = common.publishers
        self._bus = common.bus
        self._sent_by_seniors = common.sent_by_seniors
        self._bridges = bridges
        self._to_ros = to_ros
        self._tells_publishers = tells_publishers
        # Frames that other bridges have sent: since when.
        self._met_s: dict[str, float] = {}

    def is_of_bridge(self, source: RosSource) -> bool:
        """Whether another bridge sends it, or may."""
        if source.node:
            return is_bridge(source.node)
        return any(map(is_bridge, self._publishers.nodes.values()))

    def crosses(self, source: RosSource, child: str) -> bool:
        """Whether a frame of a source crosses."""
        bridge = self._bridges.of_gid(source.gid) if source.gid else None
        if bridge is not None:
            # It comes from this bus.
            if self._bridges.is_senior(bridge):
                self._sent_by_seniors.record(child)
            return False
        if not self._options.from_ros or not self._options.selects(child):
            return False
        if not self._tells_publishers and self._to_ros is not None and self._to_ros.sends(child):
            return False
        if not self.is_of_bridge(source):
            return True
        gids = source.stream.gids | ({*self._publishers.nodes} if not source.gid else set())
        if self._bus.has_from_elsewhere(child, gids):
            return False
        if len(self._met_s) >= _MOST_NAMES:
            self._met_s.clear()
        now_s = scheduler.monotonic()
        return now_s >= self._met_s.setdefault(child, now_s) + _GRACE_S

    def static_crosses(self, source: RosSource, child: str, transform: TransformStamped) -> bool:
        """Whether a static transform crosses: not one that the bridge itself sends to ROS."""
        if not self.crosses(source, child):
            return False
        there = None if self._to_ros is None else self._to_ros.static_of(child)
        return (
            there is None
            or there.frame_id != transform.frame_id
            or there.transform != transform.transform
        )
