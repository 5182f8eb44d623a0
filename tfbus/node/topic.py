"""Topics: publishers and subscriptions of messages of one type."""

import logging
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterator
from typing import Any, Generic, TypeVar

from tfbus.base import scheduler
from tfbus.base.arguments import is_async
from tfbus.base.clock import LoopBell
from tfbus.base.errors import DecodeError
from tfbus.base.log import LogOnce
from tfbus.base.signals import StopSignals, Wakeup
from tfbus.bus.callbacks import OnSample
from tfbus.bus.network_session import BytesPublisher, BytesSubscriber
from tfbus.bus.session import Session
from tfbus.node.endpoint import Lane, NodeEndpoint
from tfbus.wire.codec import is_of_ros, type_name

M = TypeVar("M")

# A subscription whose node is busy keeps at most this many messages, the newest.
PENDING_MESSAGES = 10

REJECTED = "rejected"

# A signal ends `async for` within this time.
_LOOK_UP_S = 0.5


class Publisher(NodeEndpoint, Generic[M]):
    """Sends messages of one type to all subscribers of the topic."""

    def __init__(
        self, session: Session, message_type: type[M], topic: str, *, retained: bool = False
    ):
        # A node alone, as of a listener, has no messages of its own.
        from tfbus.wire.forms import Encoder

        super().__init__(topic, message_type, retained=retained)
        self.message_type = message_type
        self._encode = Encoder(message_type).encode
        self._publisher = _publisher(session, topic, retained)
        self._parts = [self._publisher]

    def publish(self, message: M) -> None:
        """Send a message. Raises TypeError if it is not of the publisher's type."""
        if not isinstance(message, self.message_type):
            raise TypeError(
                f"topic {self.name!r} carries {self.type_name}, not {type_name(type(message))}"
            )
        self._publisher.put(self._encode(message))


class RawPublisher(NodeEndpoint):
    """Sends messages that are bytes already; others see `type_name` as their type, and may ask for
    its `definition`.
    """

    def __init__(
        self,
        session: Session,
        topic: str,
        type_name: str,
        *,
        retained: bool = False,
        definition: str = "",
    ):
        super().__init__(topic, type_name, retained=retained, definition=definition)
        self._publisher = _publisher(session, topic, retained)
        self._parts = [self._publisher]

    def publish(self, payload: bytes) -> None:
        """Send a message as it is: one msgpack map."""
        self._publisher.put(payload)


class RawSubscription(NodeEndpoint):
    """Calls `callback(payload)` for each message, on a thread of Zenoh's: return soon.

    For tools that measure, record or forward messages of any type. Messages of ROS 2 are skipped,
    and with `others` messages of the same node.
    """

    def __init__(
        self,
        session: Session,
        topic: str,
        callback: Callable[[bytes], object],
        type_name: str,
        *,
        retained: bool = False,
        others: bool = False,
    ):
        super().__init__(topic, type_name, retained=retained)

        def on_message(key: str, payload: bytes) -> None:
            if not is_of_ros(payload):
                callback(payload)

        self._parts = [_subscriber(session, topic, retained, on_message, others=others)]


class Subscription(NodeEndpoint, Generic[M]):
    """Calls `callback(message)` for each message of a topic, on the node's thread or its callback
    group's.

    A message of the wrong shape, or larger than the limit of topics, is dropped and counted in
    `rejected`; the first that is not one of ROS 2 is logged. If messages come faster than the
    callback returns, at most 10 wait; the oldest are dropped and counted in `dropped`. Of an `async
    def` at most 10 calls are awaited at once, which began in the order of their messages.

    Without a callback it is iterated over, by `for` or `async for`, in any thread, until it is
    closed or the node shut down.
    """

    def __init__(
        self,
        session: Session,
        lane: Lane,
        log: logging.Logger,
        message_type: type[M],
        topic: str,
        callback: Callable[[M], Any] | None,
        *,
        signals: StopSignals,
        retained: bool = False,
    ):
        from tfbus.wire.forms import Decoder

        super().__init__(topic, message_type, retained=retained)
        self.message_type = message_type
        self._decode = Decoder(message_type).decode
        self._signals = signals
        # Of the threads that iterate, while they wait.
        self._wakes: dict[Callable[[], object], None] = {}
        self.received = 0
        self.dropped = 0
        self._lane = lane
        self._what = f"topic {topic}"
        self._log_once = LogOnce(log)
        self._callback: Callable[[M], Any] = self._wake if callback is None else callback
        self._is_iterated = callback is None
        self._deliver = self._deliver_async if is_async(callback) else self._deliver_now
        self._awaited = 0
        # Guards the counts, the pending messages, and that each of them has one delivery.
        self._lock = scheduler.Lock()
        self._pending: deque[M] = deque()
        # So many more may wait of those that were handed over together.
        self._beside = 0
        self._of_ros = 0
        self._subscriber = _subscriber(session, topic, retained, self._on_message)
        self._parts = [self._subscriber]

    @property
    def rejected(self) -> int:
        """How many messages were of the wrong shape, or too large to be read."""
        return self._log_once.counts[REJECTED] + self._subscriber.too_large + self._of_ros

    def close(self) -> None:
        """End it, also for messages that wait. Twice is fine."""
        super().close()
        with self._lock:
            self._pending.clear()
        self._wake()

    def __iter__(self) -> Iterator[Any]:
        """The messages from now on, with their transforms if it was made `in_frame`."""
        self._check_iterable()
        while not self.closed:
            if (message := self._next()) is None:
                if self._is_stopped():
                    return
            elif (item := self._item(message)) is not None:
                yield item

    async def __aiter__(self) -> AsyncIterator[Any]:
        """The same, for asyncio."""
        self._check_iterable()
        changed = LoopBell()
        self._wakes[changed.ring] = None
        try:
            while not self.closed and not self._signals.stopped:
                if (message := self._next()) is None:
                    await changed.wait(_LOOK_UP_S)
                elif (item := self._item(message)) is not None:
                    yield item
        finally:
            self._wakes.pop(changed.ring, None)

    def _check_iterable(self) -> None:
        if not self._is_iterated:
            raise TypeError(
                f"the subscription of {self.name!r} has a callback: make one without, "
                "create_subscription(message_type, topic), to iterate over its messages"
            )

    def _is_stopped(self) -> bool:
        """Wait until there may be another message; whether the node was shut down meanwhile."""
        with Wakeup() as wakeup:
            self._wakes[wakeup.wake] = None
            try:
                if self._pending or self.closed:
                    return False
                return self._signals.wait(None, wakeup)
            finally:
                self._wakes.pop(wakeup.wake, None)

    def _item(self, message: M) -> Any:
        """A message as an iterator has it; None if it is dropped after all."""
        return message

    def _wake(self, message: object = None) -> None:
        for wake in list(self._wakes):
            wake()

    def _on_message(self, key: str, payload: bytes) -> None:
        try:
            message = self._decode(payload)
        except DecodeError as error:
            if is_of_ros(payload):
                self._of_ros += 1
                return
            warn_rejected(self._log_once, self, error)
            return
        with self._lock:
            self.received += 1
        self._receive(message)

    def _receive(self, message: M) -> None:
        """Take a message, which has been counted."""
        self._hand_over(message)

    def _hand_over(self, *messages: M, most_beside: int = 0) -> None:
        """Let the callback have messages. Messages that come together do not drop each other,
        unless more than `most_beside` wait that way.
        """
        for number, message in enumerate(messages):
            with self._lock:
                if number and self._beside < most_beside:
                    self._beside += 1
                full = len(self._pending) >= PENDING_MESSAGES + self._beside
                if full:
                    self._pending.popleft()
                    self.dropped += 1
                self._pending.append(message)
            if self._is_iterated:
                self._wake()
            elif full:
                self._lane.dropped(self._what, PENDING_MESSAGES)
            else:
                self._lane.submit(self._what, self._deliver)

    def _deliver_now(self) -> Any:
        message = self._next()
        return None if message is None else self._callback(message)

    async def _deliver_async(self) -> None:
        # All of it runs on the node's thread. A message that finds too many others awaited stays
        # pending, until one of them ends.
        if self._awaited == PENDING_MESSAGES or (message := self._next()) is None:
            return
        self._awaited += 1
        try:
            await self._callback(message)
        finally:
            self._awaited -= 1
            if self._pending:
                self._lane.submit(self._what, self._deliver)

    def _next(self) -> M | None:
        with self._lock:
            if not self._pending:
                return None
            self._beside = max(self._beside - 1, 0)
            return self._pending.popleft()


def warn_rejected(log_once: LogOnce, topic: NodeEndpoint, error: DecodeError) -> None:
    """Count a message of the wrong shape as REJECTED; the first is logged."""
    log_once.warning(
        REJECTED,
        "Dropped a message on topic %r that is not %s: %s",
        topic.name,
        topic.type_name,
        error,
    )


def _publisher(session: Session, topic: str, retained: bool) -> BytesPublisher:
    if not retained:
        return session.publisher(topic)
    # Zenoh's extensions take long to load, and most nodes do not need them.
    from tfbus.bus.retained import declare_retained_publisher

    return declare_retained_publisher(session, topic, urgent=False)


def _subscriber(
    session: Session,
    topic: str,
    retained: bool,
    callback: OnSample,
    *,
    others: bool = False,
) -> BytesSubscriber:
    if not retained and session.network.reads_large:
        from tfbus.bus.large_messages import ReadingSubscriber

        return ReadingSubscriber(session, topic, callback, others=others)
    if not retained:
        return session.subscriber(topic, callback, others=others)
    from tfbus.bus.retained import declare_retained_subscriber

    return declare_retained_subscriber(session, topic, callback, others=others)
