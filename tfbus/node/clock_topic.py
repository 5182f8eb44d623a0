"""The topic `clock`: nodes that publish the simulated time, and nodes that follow it, or wait."""

import logging
from typing import NamedTuple

from tfbus.base.clock import SimulatedClock
from tfbus.base.errors import BusError, DecodeError
from tfbus.base.executor import Executor
from tfbus.base.log import LogOnce
from tfbus.base.wording import stamp_text
from tfbus.bus.network_session import BytesPublisher
from tfbus.bus.session import Session
from tfbus.messages import Clock
from tfbus.node.endpoint import NodeEndpoint
from tfbus.node.topic import REJECTED, warn_rejected
from tfbus.wire.codec import decode_message, encode_message, is_of_ros
from tfbus.wire.keys import ALL_NODES_EVERYWHERE

# The last message is repeated after this time, for nodes that came late or lost it.
_REPEAT_S = 0.2

# Namespaces come from the bus: at most this many below get the time.
_MOST_NAMESPACES = 1000

# A clock that is set by hand jumps back less often.
_MANY_JUMPS = 10


class ClockPublisher(NodeEndpoint):
    """Publishes the simulated time in its namespace, and in each namespace below with a node.

    Of more than a thousand namespaces, one gives way to a new one: one without a node if there is
    any, otherwise the one whose last node started first, which is logged once.

    The last message is repeated five times a second of real time: nodes that start while the time
    stands still know it too. So nothing is retained, and a node that has stopped does not hold up
    the clock.
    """

    def __init__(self, session: Session, log: logging.Logger, executor: Executor, topic: str):
        super().__init__(topic, Clock)
        self._session = session
        self._once = LogOnce(log)
        self._executor = executor
        self._own = session.publisher(topic)
        # The namespaces below, the one whose last node started first at the beginning.
        self._below: dict[str, _Below] = {}
        self._last: bytes | None = None
        self._is_fresh = False
        self._timer = executor.every(_REPEAT_S, self._repeat)
        self._parts = [self._own, session.watch_living(ALL_NODES_EVERYWHERE, self._on_node)]

    def publish(self, message: Clock) -> None:
        """Publish the time."""
        self._last = encode_message(message)
        self._is_fresh = True
        self._publish(self._last)

    def close(self) -> None:
        """End it, also the repetitions. Twice is fine."""
        self._timer.cancel()
        super().close()
        for below in [*self._below.values()]:
            below.publisher.close()

    def _repeat(self) -> None:
        if self._last is not None and not self._is_fresh:
            self._publish(self._last)
        self._is_fresh = False

    def _publish(self, payload: bytes) -> None:
        self._own.put(payload)
        for namespace, below in [*self._below.items()]:
            try:
                below.publisher.put(payload)
            except BusError:
                if namespace in self._below:  # else it has given way meanwhile
                    raise

    def _on_node(self, key: str, alive: bool) -> None:
        # A publisher of `**/clock`, for all namespaces, would publish on `tf/**` too.
        namespace = key.partition("@tfbus/")[0]
        if namespace and not self.name.startswith("/"):  # one topic outside of all of them
            change = self._note_node if alive else self._forget_node
            self._executor.submit("the clock's namespaces", change, namespace, key)

    def _note_node(self, namespace: str, key: str) -> None:
        below = self._below.pop(namespace, None)
        if below is None:
            if self.closed:
                return
            if len(self._below) >= _MOST_NAMESPACES:
                self._make_room(namespace)
            below = _Below(self._session.publisher(f"{namespace}{self.name}"), set())
        self._below[namespace] = below
        below.nodes.add(key)

    def _forget_node(self, namespace: str, key: str) -> None:
        # The publisher stays: the end of a node may be told after the begin of its successor.
        if below := self._below.get(namespace):
            below.nodes.discard(key)

    def _make_room(self, newcomer: str) -> None:
        empty = (name for name, below in self._below.items() if not below.nodes)
        leaving = next(empty, "")
        if not leaving:
            leaving = next(iter(self._below))
            self._once.warning(
                "namespaces",
                "The clock reaches %d namespaces, and more have nodes: %r stands still, and %r has "
                "the time. Remap 'clock' to one topic for all, '/clock', here and in the nodes",
                _MOST_NAMESPACES,
                leaving.rstrip("/"),
                newcomer.rstrip("/"),
            )
        self._below.pop(leaving).publisher.close()


class _Below(NamedTuple):
    """The publisher of a namespace below, and the tokens of the nodes that are there."""

    publisher: BytesPublisher
    nodes: set[str]


class ClockSubscription(NodeEndpoint):
    """Sets a simulated clock by the messages of the topic, on Zenoh's threads.

    A message of the wrong shape is dropped and counted in `rejected`; the first is logged. ROS 2's
    own clock is none of ours.
    """

    def __init__(
        self, session: Session, log: logging.Logger, topic: str, clock: SimulatedClock
    ) -> None:
        super().__init__(topic, Clock)
        self._log = log
        self._log_once = LogOnce(log)
        self._clock = clock
        self._jumps = 0
        self._parts = [session.subscriber(topic, self._on_message)]

    @property
    def rejected(self) -> int:
        """How many messages were of the wrong shape."""
        return self._log_once.counts[REJECTED]

    def _on_message(self, key: str, payload: bytes) -> None:
        try:
            message = decode_message(Clock, payload)
        except DecodeError as error:
            if is_of_ros(payload):
                return
            warn_rejected(self._log_once, self, error)
            return
        back_ns = self._clock.set(message.stamp_ns)
        if back_ns:
            self._log_jump(back_ns, message.stamp_ns)

    def _log_jump(self, back_ns: int, now_ns: int) -> None:
        self._jumps += 1
        if str(self._jumps).strip("0") == "1":  # a power of ten
            many = f", {self._jumps} times so far; are there two clocks?"
            self._log.warning(
                "The clock jumped back by %.3f s to %s s%s",
                back_ns / 1e9,
                stamp_text(now_ns),
                many if self._jumps >= _MANY_JUMPS else "",
            )


# A clock that is there reaches a new node within this time, and the log need not mention it.
_CLOCK_WITHIN_S = 1.0


class ClockStart:
    """Logs once that a node waits for the first message on its clock topic."""

    def __init__(
        self, clock: SimulatedClock, topic: str, executor: Executor, log: logging.Logger
    ) -> None:
        self._clock = clock
        self._topic = topic
        self._executor = executor
        self._log = log
        self._is_expected = False

    def expect(self) -> None:
        """Log it unless the clock starts within 1 s; only the first call does."""
        if not self._is_expected and not self._clock.is_running:
            self._is_expected = True
            self._executor.after(_CLOCK_WITHIN_S, self._report)

    def _report(self) -> None:
        if not self._clock.is_running:
            self._log.info("Waiting for the clock: no message on %r yet", self._topic)
            self._clock.call_when_running(self._greet)

    def _greet(self) -> None:
        if self._clock.is_running:  # and has not just been closed
            self._log.info("The clock is running")
