"""Messages as they came, on their way from the bus to the thread that writes them."""

from collections import Counter
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

from tfbus.recording.items import EventItem, Item
from tfbus.runtime import scheduler
from tfbus.wire.codec import encode_map

# What Python's objects of a message take, besides its payload.
OVERHEAD_BYTES = 200

# What the objects of a description take, for a byte of its encoding.
_BYTES_OF_OBJECTS = 5

# The thread that writes wakes at once where this much of the room is taken.
_MUCH = 1 / 16


# Of ten seconds of a clock that was set back, log times go on by nine, until it has caught up.
_CATCHES_UP_BY = 10


class Source(Protocol):
    """The kind of messages of one key, and how to read them.

    `kind` is counted where messages are dropped: "transforms", "statics", "topics" or "events".
    `is_essential` is what the messages after it are not understood without.
    """

    kind: str
    is_essential: bool

    def is_described(self) -> bool:
        """Whether all is known that its messages do not say themselves."""

    def item(self, log_ns: int, payload: Any) -> Item:
        """A message, read. Raises DecodeError."""


class Raw(NamedTuple):
    """A message as it came: when (ns since the Unix epoch), from what, and its bytes. That of an
    event is the event.
    """

    log_ns: int
    source: Source
    payload: Any

    @property
    def size(self) -> int:
        """The memory that it takes, in bytes."""
        return _size(self.payload)

    def item(self) -> Item:
        """The message, read. Raises DecodeError."""
        return self.source.item(self.log_ns, self.payload)


class RawQueue:
    """Takes messages from any thread, at most `most_bytes` of them; one thread takes them out.

    Beyond that a message is `dropped`, and counted by its kind. Essential ones have as much room
    again. An item that was taken out counts until the next `take`, and what its taker holds then
    longer.

    Log times never go back: if the system's clock is set back, they go on from the last one, by
    `set_back_ns` ahead of the clock, and a tenth more slowly until it has caught up.
    """

    def __init__(
        self, most_bytes: int, clock_ns: Callable[[], int] = lambda: scheduler.time_ns()
    ) -> None:
        self.dropped: Counter[str] = Counter()
        self.is_paused = False
        # The newest log time, and by how much it is ahead of the system's clock.
        self.last_ns = self.set_back_ns = 0
        self._most_bytes = most_bytes
        self._clock_ns = clock_ns
        self._lock = scheduler.Lock()
        self._waiting: list[Raw] = []
        self._bytes = self._taken_bytes = 0
        self._wakes = scheduler.Event()

    def put(self, source: Source, payload: Any) -> bool:
        """Note that a message has come now; whether it was taken. While the queue is paused only
        essential ones are.
        """
        is_essential = source.is_essential
        if self.is_paused and not is_essential:
            return False
        size = _size(payload)
        with self._lock:
            taken = self._bytes + size
            if taken + self._taken_bytes > self._most_bytes * (2 if is_essential else 1):
                self.dropped[source.kind] += 1
                return False
            self._bytes = taken
            log_ns = self._clock_ns()
            if self.set_back_ns or log_ns < self.last_ns:
                log_ns += self._ahead(log_ns)
            self.last_ns = log_ns
            self._waiting.append(Raw(log_ns, source, payload))
        if taken > self._most_bytes * _MUCH:
            self._wakes.set()
        return True

    def _ahead(self, clock_ns: int) -> int:
        """By how much the log time of now is ahead of the clock: of the time since the last message
        a tenth less than was the last.
        """
        passed_ns = max(0, clock_ns - (self.last_ns - self.set_back_ns))
        behind_ns = self.set_back_ns - passed_ns // _CATCHES_UP_BY
        self.set_back_ns = max(0, self.last_ns - clock_ns, behind_ns)
        return self.set_back_ns

    def now_ns(self) -> int:
        """The log time of now."""
        return self._clock_ns() + self.set_back_ns

    def wake(self) -> None:
        """End the wait of `take`."""
        self._wakes.set()

    def take(self, wait_s: float, held_bytes: int = 0) -> list[Raw]:
        """All that waits, in the order in which it came, after at most `wait_s` seconds.

        `held_bytes` is the size of those taken before that are still to be written.
        """
        with self._lock:
            self._taken_bytes = held_bytes
        self._wakes.wait(wait_s)
        self._wakes.clear()
        with self._lock:
            waiting, self._waiting = self._waiting, []
            self._taken_bytes, self._bytes = held_bytes + self._bytes, 0
        return waiting


def _size(payload: Any) -> int:
    if payload.__class__ is bytes:
        return OVERHEAD_BYTES + len(payload)
    facts = payload.facts if isinstance(payload, EventItem) else {}
    return OVERHEAD_BYTES + (len(encode_map(facts)) * _BYTES_OF_OBJECTS if facts else 0)
