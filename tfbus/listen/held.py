"""Messages of epochs that are not confirmed yet: kept until they are, or thrown away."""

from collections import deque
from collections.abc import Callable

from tfbus.runtime import scheduler

# A description follows its stream's new epoch within a second. Any peer can send such messages, so
# the listener keeps few of them, of all streams together.
MOST_BYTES = 4 * 2**20
_OVERHEAD_BYTES = 300

Receive = Callable[[bytes], None]


class DisputedMessages:
    """Messages of disputed epochs, at most `most_bytes` of all streams; safe from any thread.

    The oldest go first.
    """

    def __init__(self, most_bytes: int = MOST_BYTES) -> None:
        self._most_bytes = most_bytes
        self._lock = scheduler.Lock()
        self._messages: deque[tuple[str, int, Receive, bytes]] = deque()
        self._bytes = 0

    def keep(self, stream: str, epoch_ns: int, receive: Receive, payload: bytes) -> None:
        """Keep a message of this epoch, which `receive` takes once the epoch is confirmed."""
        with self._lock:
            self._messages.append((stream, epoch_ns, receive, payload))
            self._bytes += len(payload) + _OVERHEAD_BYTES
            while self._bytes > self._most_bytes:
                self._bytes -= len(self._messages.popleft()[3]) + _OVERHEAD_BYTES

    def release(self, stream: str, epoch_ns: int) -> None:
        """The stream is in this epoch: have its messages received, and forget those of others."""
        with self._lock:
            mine = [message for message in self._messages if message[0] == stream]
            if not mine:
                return
            self._messages = deque(message for message in self._messages if message[0] != stream)
            self._bytes -= sum(len(payload) + _OVERHEAD_BYTES for *_, payload in mine)
        for _, its_epoch_ns, receive, payload in mine:
            if its_epoch_ns == epoch_ns:
                receive(payload)
