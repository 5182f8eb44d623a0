"""The topic `clock`: who tells the simulated time, and who follows it."""

import logging

from tfbus.bus.session import Session
from tfbus.errors import DecodeError
from tfbus.messages import Clock
from tfbus.node.endpoint import Interface
from tfbus.runtime.clock import SimulatedClock
from tfbus.runtime.executor import Executor
from tfbus.wire.codec import decode_message, encode_message
from tfbus.wire.keys import ALL_NODES_EVERYWHERE

TOPIC = "clock"

# A message that was told already is told again so often: to who came late, or lost it.
_REPEAT_S = 0.2

# Namespaces come from the bus: no more than so many are told the time.
_MOST_NAMESPACES = 1000

# So many jumps back are more than somebody sets a clock by hand.
_MANY_JUMPS = 10


class ClockPublisher(Interface):
    """Tells the simulated time to all nodes of its namespace, and of each within it where it sees
    a node.

    What was told last is told again five times a second of real time, so that nodes that start
    late know the time, too, while it stands still. So nothing has to be retained, and no
    node that has stopped holds up the clock.
    """

    def __init__(self, session: Session, executor: Executor, topic: str):
        super().__init__(topic, Clock)
        self._session = session
        self._executor = executor
        self._publishers = {"": session.publisher(topic)}
        self._last: bytes | None = None
        self._told = False
        self._timer = executor.every(_REPEAT_S, self._repeat)
        self._parts = [
            self._publishers[""],
            session.watch_living(ALL_NODES_EVERYWHERE, self._on_node),
        ]

    def publish(self, message: Clock) -> None:
        """Tell the time."""
        self._last = encode_message(message)
        self._told = True
        self._put(self._last)

    def close(self) -> None:
        """Tell it no more. Twice is fine."""
        self._timer.cancel()
        super().close()

    def _repeat(self) -> None:
        if self._last is not None and not self._told:
            self._put(self._last)
        self._told = False

    def _put(self, payload: bytes) -> None:
        for publisher in [*self._publishers.values()]:
            publisher.put(payload)

    def _on_node(self, key: str, alive: bool) -> None:
        # One publication for all namespaces, on `**/clock`, would also be one on `tf/**`.
        namespace = key.partition("@tfbus/")[0]
        if alive and namespace not in self._publishers:
            self._executor.submit("the clock's namespaces", lambda: self._add(namespace))

    def _add(self, namespace: str) -> None:
        if namespace not in self._publishers and len(self._publishers) < _MOST_NAMESPACES:
            publisher = self._session.publisher(f"{namespace}{self.name}")
            self._publishers[namespace] = publisher
            self._parts.append(publisher)


class ClockSubscription(Interface):
    """Sets a simulated clock by the messages of the topic, on the threads that bring them.

    A message of the wrong shape is counted in `rejected`, reported once, and dropped.
    """

    def __init__(
        self, session: Session, log: logging.Logger, topic: str, clock: SimulatedClock
    ) -> None:
        super().__init__(topic, Clock)
        self.rejected = 0
        self._log = log
        self._clock = clock
        self._jumps = 0
        self._parts = [session.subscriber(topic, self._on_message)]

    def _on_message(self, key: str, payload: bytes) -> None:
        try:
            message = decode_message(Clock, payload)
        except DecodeError as error:
            self._reject(error)
            return
        back_ns = self._clock.set(message.stamp_ns)
        if back_ns:
            self._tell_jump(back_ns, message.stamp_ns)

    def _tell_jump(self, back_ns: int, now_ns: int) -> None:
        self._jumps += 1
        if str(self._jumps).strip("0") == "1":  # a power of ten
            many = f", {self._jumps} times so far; do two tell the time?"
            self._log.warning(
                "The clock jumped back by %.3f s to %d.%09d s%s",
                back_ns / 1e9,
                *divmod(now_ns, 1_000_000_000),
                many if self._jumps >= _MANY_JUMPS else "",
            )

    def _reject(self, error: DecodeError) -> None:
        self.rejected += 1
        if self.rejected == 1:
            self._log.warning(
                "Dropped a message on topic %r that tells no time: %s. More of them are only "
                "counted",
                self.name,
                error,
            )
