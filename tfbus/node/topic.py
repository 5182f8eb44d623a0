"""Topics: publishers and subscriptions of messages of one type."""

import logging
import threading
from collections import deque
from collections.abc import Callable
from typing import Any, Generic, TypeVar

from tfbus.bus.session import Session
from tfbus.errors import DecodeError
from tfbus.node.endpoint import Interface
from tfbus.runtime.executor import Executor
from tfbus.wire.codec import decode_message, encode_message, type_name

M = TypeVar("M")

# A subscription whose node is busy keeps this many messages, and loses the oldest of more.
PENDING_MESSAGES = 10


class Publisher(Interface, Generic[M]):
    """Sends messages of one type to all who subscribe to the topic."""

    def __init__(self, session: Session, message_type: type[M], topic: str):
        super().__init__(topic, message_type)
        self.message_type = message_type
        self._publisher = session.publisher(topic)
        self._parts = [self._publisher]

    def publish(self, message: M) -> None:
        """Send a message. Raises TypeError where it is not of the publisher's type."""
        if not isinstance(message, self.message_type):
            raise TypeError(
                f"topic {self.name!r} carries {self.type_name}, this is {type_name(type(message))}"
            )
        self._publisher.put(encode_message(message))


class RawPublisher(Interface):
    """Sends messages that are bytes already; `type_name` is what others are told of them."""

    def __init__(self, session: Session, topic: str, type_name: str):
        super().__init__(topic, type_name)
        self._publisher = session.publisher(topic)
        self._parts = [self._publisher]

    def publish(self, payload: bytes) -> None:
        """Send a message as it is: one msgpack map."""
        self._publisher.put(payload)


class RawSubscription(Interface):
    """Calls back with the bytes of each message, on a thread of Zenoh's: be quick there.

    For what measures, records or hands on messages of any type.
    """

    def __init__(
        self, session: Session, topic: str, callback: Callable[[bytes], None], type_name: str
    ):
        super().__init__(topic, type_name)
        self._parts = [session.subscriber(topic, lambda key, payload: callback(payload))]


class Subscription(Interface, Generic[M]):
    """Calls back with each message of a topic, on the node's thread.

    A message of the wrong shape is counted in `rejected`, reported once, and dropped; where
    messages come faster than the callback returns, the oldest are dropped and counted in
    `dropped`.
    """

    def __init__(
        self,
        session: Session,
        executor: Executor,
        log: logging.Logger,
        message_type: type[M],
        topic: str,
        callback: Callable[[M], Any],
    ):
        super().__init__(topic, message_type)
        self.message_type = message_type
        self.received = 0
        self.rejected = 0
        self.dropped = 0
        self._executor = executor
        self._log = log
        self._callback = callback
        # Holds together the counts, what is pending, and one delivery for each that is.
        self._lock = threading.Lock()
        self._pending: deque[M] = deque(maxlen=PENDING_MESSAGES)
        self._parts = [session.subscriber(topic, self._on_message)]

    def close(self) -> None:
        """Call back no more. Twice is fine."""
        super().close()
        with self._lock:
            self._pending.clear()

    def _on_message(self, key: str, payload: bytes) -> None:
        try:
            message = decode_message(self.message_type, payload)
        except DecodeError as error:
            self._reject(error)
            return
        with self._lock:
            self.received += 1
            full = len(self._pending) == PENDING_MESSAGES
            self.dropped += full
            self._pending.append(message)
        if not full:
            self._executor.submit(f"topic {self.name}", self._deliver)

    def _deliver(self) -> None:
        with self._lock:
            message = self._pending.popleft() if self._pending else None
        if message is not None:
            self._callback(message)

    def _reject(self, error: DecodeError) -> None:
        with self._lock:
            self.rejected += 1
            first = self.rejected == 1
        if first:
            self._log.warning(
                "Dropped a message on topic %r that is not %s: %s. More of them are only counted",
                self.name,
                self.type_name,
                error,
            )
