"""The bridge: transforms, static ones, the clock and other topics, between the bus and ROS."""

import time
from contextlib import ExitStack

from tfbus.base.errors import TfbusError
from tfbus.base.executor import Executor
from tfbus.base.log import LogOnce
from tfbus.base.wording import counted, printable, quoted
from tfbus.node.node import Node
from tfbus.ros.bridge.bridges import Bridges, CrossingRule, RosBridge, check_name_is_free
from tfbus.ros.bridge.common import (
    BridgeOptions,
    BusStreams,
    Common,
    Crossed,
    RosFrameNames,
    RosPublishers,
    SentBySeniors,
)
from tfbus.ros.bridge.from_ros import FromRos
from tfbus.ros.bridge.legs import Endable, Leg, RosTopic
from tfbus.ros.bridge.ros_clock import RosClock
from tfbus.ros.bridge.to_ros import ToRos
from tfbus.ros.bridge.topics import TopicBridge, TopicTable
from tfbus.ros.definitions import TF_MESSAGE
from tfbus.ros.rmw import is_bridge

# How often it looks who is there.
_POLL_EVERY_S = 1.0

# The crossing frames are logged once the frames of one side have been the same for this many looks.
_SETTLED_POLLS = 2

# After this time without anything of ROS it says so.
_NOTHING_AFTER_S = 5.0


class Bridge:
    """Joins a node's bus and the ROS that a leg reaches, until `close()`; the leg is the bridge's
    from now on, and is closed if this raises. `ros_node` is the full name that it has in ROS.
    Raises TfbusError if another bridge on the bus has the node's name. Its parts are its
    attributes: `from_ros`, `clock`, and the other `bridges`.
    """

    def __init__(
        self,
        node: Node,
        leg: Leg,
        options: BridgeOptions,
        *,
        ros_node: str = "",
        table: TopicTable | None = None,
    ) -> None:
        try:
            check_name_is_free(node)
        except TfbusError:
            leg.close()
            raise
        self._is_built = False
        self.node = node
        self.leg = leg
        self._options = options
        self._ros_node = ros_node
        self._once = LogOnce(node.log)
        self._executor = Executor(f"{node.full_name} ROS", node.log)
        # `close()` ends these, the last one first.
        self._parts = ExitStack()
        self._parts.callback(leg.close)
        try:
            self._build(node, leg, options, table)
        except BaseException:
            self.close()
            raise

    def _build(
        self, node: Node, leg: Leg, options: BridgeOptions, table: TopicTable | None
    ) -> None:
        self._dynamic = RosTopic(options.topic("tf"), TF_MESSAGE)
        self._static = RosTopic(options.topic("tf_static"), TF_MESSAGE, retained=True, depth=1)
        self._publishers = RosPublishers(leg, (self._dynamic.name, self._static.name))
        self._bus = BusStreams(node, self._publishers, self._reconsider_soon)
        self._parts.callback(self._bus.close)
        self._crossed = Crossed(self._reconsider_soon)
        self._names = RosFrameNames(options)
        common = Common(
            node,
            options,
            self._names,
            self._publishers,
            self._bus,
            self._crossed,
            SentBySeniors(self._reconsider_soon),
            self._executor,
            self._once,
        )
        self._gids: tuple[str, ...] = ()
        self._to_ros = self._way_to_ros(common) if options.to_ros else None
        self.bridges = Bridges(node, self._status({}, {}), self._on_bridge)
        self._parts.callback(self.bridges.close)
        rule = CrossingRule(
            common, self.bridges, self._to_ros, tells_publishers=leg.tells_publishers
        )
        self.from_ros = FromRos(common, leg, self.bridges, rule, self._to_ros)
        self._parts.callback(self.from_ros.close)
        self.clock = RosClock(
            node,
            leg,
            options.clock,
            to_ros=options.to_ros,
            from_ros=options.from_ros,
            executor=self._executor,
            once=self._once,
            bridges=self.bridges,
            publishers=self._publishers,
            on_way=self._announce,
        )
        self._parts.callback(self.clock.close)
        if table is not None:
            self._parts.callback(self._topic_bridge(table).close)
        self._begin()

    def _way_to_ros(self, common: Common) -> ToRos:
        dynamic, static = self.leg.publisher(self._dynamic), self.leg.publisher(self._static)
        self._gids = tuple(each.gid for each in (dynamic, static) if each.gid)
        to_ros = ToRos(common, dynamic, static, on_statics=self._reconsider_soon)
        self._parts.callback(to_ros.close)
        return to_ros

    def _begin(self) -> None:
        """With all parts there: let transforms cross."""
        self._publishers.poll()
        if self._to_ros is not None:
            self._to_ros.listen()
        if self._options.from_ros:
            self.from_ros.listen(self._dynamic, self._static)
        self._started_s = time.monotonic()
        self._said: dict[str, bool] = {}
        self._seen: dict[str, tuple[dict[str, int], int]] = {}
        self._is_built = True
        self._executor.every(_POLL_EVERY_S, self._poll)

    def close(self) -> None:
        """Leave ROS; the node stays. Twice is fine."""
        self._executor.close()
        self._parts.close()

    @property
    def announcement(self) -> str:
        """The two sides that are joined, in a line."""
        topics = f"{self._dynamic.name} and {self._static.name}"
        prefix = self._options.frame_prefix
        named = f", frames of ROS as '{printable(prefix, 60)}…'" if prefix else ""
        return f"Bridges {topics} by {self.leg.name}, {self._options.directions}{named}"

    def _topic_bridge(self, table: TopicTable) -> Endable:
        bridge: Endable = TopicBridge(
            self.node,
            self.leg,
            table,
            to_ros=self._options.to_ros,
            from_ros=self._options.from_ros,
            ros_namespace=self._options.ros_namespace.strip("/"),
            log=self.node.log,
            bridges=self.bridges,
            names=self._names,
        )
        return bridge

    # Changes

    def _reconsider_soon(self) -> None:
        self._executor.submit("what crosses", self._reconsider, limit=1)

    def _reconsider(self) -> None:
        if not self._is_built:
            return
        self.from_ros.reconsider()
        if self._to_ros is not None:
            self._to_ros.reconsider()

    def _on_bridge(self) -> None:
        self._executor.submit("another bridge", self._meet_bridges, limit=1)

    def _meet_bridges(self) -> None:
        """Of two bridges between the same bus and the same ROS, one sends a frame."""
        there = self._publishers.nodes
        for other in self.bridges.others if self._is_built else ():
            if not other.joins(there) or other.session in self.bridges.met:
                continue
            self.bridges.met.add(other.session)
            self.node.log.warning(
                "Bridge %s joins the same bus and the same ROS as this one: %s. One is enough: a "
                "frame, a topic or the clock crosses by the one that was started first",
                printable(other.node, 60),
                "it was started first" if self.bridges.is_senior(other) else "it came later",
            )
            if not self._options.from_ros and self.bridges.is_senior(other):
                self.from_ros.listen(self._dynamic, self._static)
        self._reconsider()

    def _poll(self) -> None:
        self.from_ros.poll()
        if self._to_ros is not None:
            self._to_ros.poll()
        self._meet_new_bridges()
        for warning in self.leg.warnings():
            self._once.warning(("leg", warning), "%s", warning)
        self._say_lost()
        to_ros = self._to_ros.streams if self._to_ros else {}
        from_ros = self.from_ros.streams
        self._say("to ROS", to_ros)
        self._say("from ROS", from_ros)
        self._say_nothing_came(from_ros)
        self._announce()

    def _meet_new_bridges(self) -> None:
        there = self._publishers.nodes
        if any(
            other.session not in self.bridges.met and other.joins(there)
            for other in self.bridges.others
        ):
            self._meet_bridges()

    # Announcements and the log

    def _announce(self) -> None:
        to_ros = self._to_ros.streams if self._to_ros else {}
        self.bridges.announce(self._status(to_ros, self.from_ros.streams, self.clock.way))

    def _status(
        self, to_ros: dict[str, int], from_ros: dict[str, int], clock: str = ""
    ) -> RosBridge:
        return RosBridge(
            self.node.full_name,
            self.node.session.id,
            self.node.started_ns,
            self._ros_node,
            self.leg.name,
            self._gids,
            sum(to_ros.values()),
            sum(from_ros.values()),
            clock,
            sum(self.leg.lost().values()),
        )

    def _say_lost(self) -> None:
        for topic, count in self.leg.lost().items():
            self._once.warning(
                ("lost", topic),
                "Lost %s or more of ROS on %s: this process, or the way to it, is too slow",
                counted(count, "message"),
                printable(topic, 100),
            )

    def _say_nothing_came(self, from_ros: dict[str, int]) -> None:
        is_late = time.monotonic() > self._started_s + _NOTHING_AFTER_S
        is_awaited = is_late and self._options.from_ros
        if not is_awaited or self._said.get("ROS") or self.leg.warnings():
            return
        self._said["ROS"] = True
        if not from_ros and all(map(is_bridge, self._publishers.nodes.values())):
            self.node.log.info(
                "No node of ROS publishes %s or %s yet", self._dynamic.name, self._static.name
            )

    def _say(self, way: str, streams: dict[str, int]) -> None:
        """Log once the streams that cross, as soon as they stay the same."""
        before, looks = self._seen.get(way, ({}, 0))
        looks = looks + 1 if streams == before else 0
        self._seen[way] = streams, looks
        if not streams or looks < _SETTLED_POLLS or self._said.get(way):
            return
        self._said[way] = True
        self.node.log.info(
            "%s: %s of %s",
            way[0].upper() + way[1:],
            counted(sum(streams.values()), "frame"),
            quoted(sorted(streams)),
        )
