"""The simulated time: the side that has a clock gives it to the other."""

import struct
import threading
from collections.abc import Callable, Sequence
from typing import Literal

from tfbus.base import scheduler
from tfbus.base.errors import DecodeError, RightsError, TfbusError
from tfbus.base.executor import Executor
from tfbus.base.log import LogOnce
from tfbus.base.wording import printable
from tfbus.messages import Clock
from tfbus.node.clock_topic import ClockPublisher
from tfbus.node.node import Node
from tfbus.ros.bridge.bridges import Bridges, RosBridge
from tfbus.ros.bridge.common import ClockWay, RosPublishers
from tfbus.ros.bridge.legs import Endable, Leg, RosSender, RosTopic
from tfbus.ros.cdr import HEADER, CdrReader
from tfbus.ros.definitions import CLOCK
from tfbus.ros.rmw import is_bridge
from tfbus.wire.codec import decode_message

TOPIC = RosTopic("/clock", CLOCK, depth=1)

# A clock that is there is heard within this time: nodes of tfbus repeat theirs five times a second.
_DECIDE_S = 1.0
# One that has been silent for this long is gone.
_SILENT_S = 3.0

_TIME = struct.Struct("<iI")
_SECOND_NS = 1_000_000_000
_LATEST_NS = 2**31 * _SECOND_NS - 1


class RosClock:
    """Passes the time on in one direction, until `close()`.

    With `way` "auto" it is the first heard clock's; if both sides have one,
    neither crosses, also if the second comes later, which is logged. Messages come on threads of
    the leg's and of Zenoh's.

    While there are other bridges between the same bus and the same ROS, a clock may be theirs: then
    nothing is logged, and a way that has begun stays, unless one that was there first has the same.
    `on_way()` is called when the way has changed.
    """

    def __init__(
        self,
        node: Node,
        leg: Leg,
        way: ClockWay,
        *,
        to_ros: bool,
        from_ros: bool,
        executor: Executor,
        once: LogOnce,
        bridges: Bridges,
        publishers: RosPublishers,
        on_way: Callable[[], object],
    ) -> None:
        self.way: Literal["", "to ROS", "from ROS"] = ""
        self._node = node
        self._leg = leg
        self._may = {
            "to ROS": to_ros and way in ("auto", "to-ros"),
            "from ROS": from_ros and way in ("auto", "from-ros"),
        }
        self._is_auto = way == "auto"
        self._bridges = bridges
        self._publishers = publishers
        self._on_way = on_way
        self._once = once
        self._lock = threading.Lock()
        # When each side was heard first, and last.
        self.first_s: dict[str, float] = {}
        self.last_s: dict[str, float] = {}
        # When the clock of other bridges is gone.
        self._alone_from_s = 0.0
        self._bridge_gids: frozenset[str] = frozenset()
        self._sender: RosSender | None = None
        self._publisher: ClockPublisher | None = None
        self._subscriptions: list[Endable] = []
        if any(self._may.values()):
            self._subscriptions = [
                leg.subscribe(TOPIC, self._on_ros),
                node.create_raw_subscription(
                    "clock", self._on_bus, type_name=Clock.__name__, others=True
                ),
            ]
            self._timer = executor.every(_DECIDE_S / 2, self.poll)

    def close(self) -> None:
        """Pass nothing on. Twice is fine."""
        if self._subscriptions:
            self._timer.cancel()
        for each in self._subscriptions:
            each.close()
        with self._lock:
            self._end()

    def poll(self) -> None:
        """Decide which way it goes; call it about every second."""
        self._bridge_gids = frozenset(
            each.gid for each in self._leg.publishers(TOPIC.name) if is_bridge(each.node)
        )
        others = self._bridges.living(self._publishers.nodes)
        with self._lock:
            former = self.way
            self._decide(others)
        if self.way != former:
            self._on_way()

    def _decide(self, others: Sequence[RosBridge]) -> None:
        now_s = scheduler.monotonic()
        there = {side for side, last_s in self.last_s.items() if now_s < last_s + _SILENT_S}
        for side in self.first_s.keys() - there:
            del self.first_s[side]
        if others:
            self._alone_from_s = now_s + _SILENT_S + _DECIDE_S
        if self._has_two(now_s) and now_s >= self._alone_from_s:
            self._once.warning(
                "two clocks",
                "The bus has a clock, and ROS has one: neither crosses. Stop one of them, or "
                "choose one by --clock to-ros or --clock from-ros",
            )
            self._end()
        if self.way and self.way not in there:
            self._end()
        if self.way and (senior := self._senior_with(self.way, others)):
            self._node.log.info(
                "The simulated time goes by bridge %s, which was started first: this one stands by",
                printable(senior.node, 60),
            )
            self._end()
        if not self.way and there:
            self._choose(there, now_s, others)

    def _has_two(self, now_s: float) -> bool:
        """Whether both sides have had a clock for some time; another bridge is known by then."""
        firsts_s = self.first_s.values()
        return self._is_auto and len(firsts_s) == 2 and now_s >= max(firsts_s) + _DECIDE_S

    def _senior_with(self, way: str, others: Sequence[RosBridge]) -> RosBridge | None:
        return next(
            (each for each in others if each.clock == way and self._bridges.is_senior(each)), None
        )

    def _choose(self, there: set[str], now_s: float, others: Sequence[RosBridge]) -> None:
        if self._is_auto and len(there) == 2:
            return
        # One that was there first goes first.
        after_s = _DECIDE_S * (1 + any(map(self._bridges.is_senior, others)))
        for way in there:
            is_due = now_s >= self.first_s[way] + after_s
            if self._may[way] and is_due and not self._is_theirs(way, others):
                self._begin(way)

    def _is_theirs(self, way: str, others: Sequence[RosBridge]) -> bool:
        """Whether another bridge has the way, or this clock from the other side."""
        return bool(self._senior_with(way, others)) or any(
            each.clock not in ("", way) and each.gids for each in others
        )

    def _begin(self, way: str) -> None:
        if way == "to ROS":
            self._sender = self._leg.publisher(TOPIC)
            self.way = "to ROS"
        else:
            try:
                publisher = self._node.create_clock_publisher()
            except RightsError as error:
                self._may["from ROS"] = False
                self._node.log.warning("The time of ROS does not come to the bus: %s", error)
                return
            # Before the first message of its own comes.
            self.way = "from ROS"
            self._publisher = publisher
        self._node.log.info(
            "The simulated time goes %s", "to ROS" if way == "to ROS" else "from ROS to the bus"
        )

    def _end(self) -> None:
        self.way = ""
        for each in (self._sender, self._publisher):
            if each is not None:
                each.close()
        self._sender = self._publisher = None

    def _heard(self, way: str) -> None:
        now_s = scheduler.monotonic()
        self.last_s[way] = now_s
        self.first_s.setdefault(way, now_s)

    def _on_ros(self, payload: bytes, gid: str) -> None:
        if gid in self._bridge_gids and gid:
            return
        try:
            stamp_ns = read_clock(payload)
        except DecodeError as error:
            self._once.warning("clock", "Dropped a message of ROS on /clock: %s", error)
            return
        with self._lock:
            # Where messages do not tell their publisher, this bridge hears itself.
            if self.way == "to ROS" and not gid:
                return
            self._heard("from ROS")
            publisher = self._publisher
        if publisher is None:
            return
        # Without the lock: the message comes to this session too, on this thread.
        try:
            publisher.publish(Clock(stamp_ns))
        except TfbusError as error:
            if publisher is not self._publisher:
                return  # the way has ended meanwhile
            self._once.warning("clock", "The time does not come from ROS: %s", error)

    def _on_bus(self, payload: bytes) -> None:
        try:
            clock = decode_message(Clock, payload)
        except DecodeError:
            return  # its followers log it
        with self._lock:
            self._heard("to ROS")
            sender = self._sender
        if sender is not None and 0 <= clock.stamp_ns <= _LATEST_NS:
            try:
                sender.send(write_clock(clock.stamp_ns))
            except TfbusError as error:
                if sender is not self._sender:
                    return  # the way has ended meanwhile
                self._once.warning("clock", "The time does not go to ROS: %s", error)


def read_clock(payload: bytes) -> int:
    """The time in a message, in ns since the Unix epoch. Raises DecodeError."""
    reader = CdrReader(payload)
    seconds, nanoseconds = struct.unpack_from(f"{reader.order}iI", payload, reader.skip(8, 4))
    reader.finish()
    if nanoseconds >= _SECOND_NS or seconds < 0:
        raise DecodeError(f"{seconds} s and {nanoseconds} ns are no time")
    stamp_ns: int = seconds * _SECOND_NS + nanoseconds
    return stamp_ns


def write_clock(stamp_ns: int) -> bytes:
    """The message of a time, in ns since the Unix epoch, from 0 to the year 2038."""
    return HEADER + _TIME.pack(*divmod(stamp_ns, _SECOND_NS))
