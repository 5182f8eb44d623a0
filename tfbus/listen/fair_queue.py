"""Descriptions that wait to be read: in the order of each sender, the senders in turn."""

from collections import deque
from typing import NamedTuple

from tfbus.runtime import scheduler

# As much may wait as a thousand large streams say of themselves.
_MOST_BYTES = 64 * 2**20
_OVERHEAD_BYTES = 500


class Received(NamedTuple):
    """A description: the key that it came at, its bytes, the session it is from, "" for one
    that does not say, and when it came by a clock that never goes back.
    """

    key: str
    payload: bytes
    sender: str
    came_s: float = 0.0


class FairQueue:
    """Descriptions that wait, at most `most_bytes` of them; safe from any thread.

    However many one sender writes, the others have their turn after each. If there is no room
    the oldest of the sender that has most of them is thrown away. No other is: a frame that is in
    one description and not in the next was removed.
    """

    def __init__(self, most_bytes: int = _MOST_BYTES) -> None:
        self._most_bytes = most_bytes
        self._lock = scheduler.Lock()
        self._waiting: dict[str, deque[Received]] = {}
        self._sums: dict[str, int] = {}
        self._bytes = 0
        self._is_read = False

    def enqueue(self, received: Received) -> bool:
        """Add a description; whether the reading has to begin.

        It goes on until `has_more` is False.
        """
        with self._lock:
            self._waiting.setdefault(received.sender, deque()).append(received)
            self._count(received.sender, _size(received))
            while self._bytes > self._most_bytes:
                self._dequeue_from(max(self._sums, key=self._sums.__getitem__))
            was_read, self._is_read = self._is_read, True
            return not was_read

    def has_more(self) -> bool:
        """Whether a description waits; if none does, the reading ends until the next."""
        with self._lock:
            self._is_read = bool(self._waiting)
            return self._is_read

    def dequeue(self) -> Received | None:
        """The next of the sender whose turn it is; None for none, which ends the reading."""
        with self._lock:
            sender = next(iter(self._waiting), None)
            if sender is None:
                self._is_read = False
                return None
            received = self._dequeue_from(sender)
            if sender in self._waiting:
                self._waiting[sender] = self._waiting.pop(sender)
            return received

    def _dequeue_from(self, sender: str) -> Received:
        received = self._waiting[sender].popleft()
        self._count(sender, -_size(received))
        if not self._waiting[sender]:
            del self._waiting[sender], self._sums[sender]
        return received

    def _count(self, sender: str, more: int) -> None:
        self._sums[sender] = self._sums.get(sender, 0) + more
        self._bytes += more


def _size(received: Received) -> int:
    return len(received.payload) + _OVERHEAD_BYTES
