"""The messages of a stream's last seconds, kept for listeners that ask for them."""

import math
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress

from tfbus.bus.query import Query, within
from tfbus.errors import BusError, InvalidArgumentException
from tfbus.runtime import scheduler
from tfbus.wire.transforms import TransformMessage, decode_transforms, encode_transforms

# Key and payload of a message; or None and the name of a frame that was removed then.
Entry = tuple[str | None, bytes]

# At most this much memory a stream, whatever its seconds are.
MOST_BYTES = 16 * 2**20

# What Python's objects of a message take, besides its payload.
_OVERHEAD_BYTES = 200


class SentHistory:
    """The messages of the last `history_s` seconds as they were sent, at most `most_bytes`.

    The oldest go first. Used by one thread at a time.
    """

    def __init__(
        self,
        history_s: float,
        *,
        most_bytes: int = MOST_BYTES,
        clock_ns: Callable[[], int] = lambda: scheduler.monotonic_ns(),
    ) -> None:
        self._history_ns = _ns(history_s)
        self._most_bytes = most_bytes
        self._clock_ns = clock_ns
        self._messages: deque[tuple[int, str | None, bytes]] = deque()
        self._bytes = 0

    def append(self, key: str | None, payload: bytes) -> None:
        """Keep a message that is sent now on `key`."""
        now_ns = self._clock_ns()
        messages = self._messages
        messages.append((now_ns, key, payload))
        self._bytes += len(payload) + _OVERHEAD_BYTES
        too_old_ns = now_ns - self._history_ns
        while messages and (messages[0][0] < too_old_ns or self._bytes > self._most_bytes):
            self._bytes -= len(messages.popleft()[2]) + _OVERHEAD_BYTES

    def remove(self, frame: str) -> None:
        """Keep nothing that was sent of a child frame so far."""
        self.append(None, frame.encode())

    def last(self, last_s: float) -> list[Entry]:
        """The entries of the last `last_s` seconds, oldest first, for `without_removed`."""
        since_ns = self._clock_ns() - min(_ns(last_s), self._history_ns)
        return [(key, payload) for sent_ns, key, payload in self._messages if sent_ns >= since_ns]

    def clear(self) -> None:
        """Keep nothing of what was sent so far."""
        self._messages.clear()
        self._bytes = 0


def answer_from_history(query: Query, last: Callable[[float], Sequence[Entry]]) -> None:
    """Answer a query for what a stream has kept: `last(last_s)` has the entries of that time."""
    # The session may be closed meanwhile.
    with suppress(BusError), query.answering("the stream's history"):
        messages = without_removed(last(_seconds(query.parameter("last_s"))))
        asked = {key for key in {key for key, _ in messages} if within(key, query.key)}
        for key, payload in messages:
            if key in asked:
                query.answer(key, payload)


def without_removed(kept: Sequence[Entry]) -> list[tuple[str, bytes]]:
    """Key and payload of each message, oldest first, without frames that were removed later."""
    removed: set[bytes] = set()
    messages = []
    for key, payload in reversed(kept):
        if key is None:
            removed.add(payload)
        elif not removed:
            messages.append((key, payload))
        elif left := _without(payload, removed):
            messages.append((key, left))
    return messages[::-1]


def _without(payload: bytes, removed: set[bytes]) -> bytes:
    """The message without these child frames; b"" if nothing is left of it."""
    # Names are in it as they are: only messages that may have one are decoded, which is slow.
    named = {frame.decode() for frame in removed if frame in payload}
    if not named:
        return payload
    message = decode_transforms(payload)
    rows = message.rows.without(named)
    if not len(rows):
        return b""
    return encode_transforms(TransformMessage(rows, message.epoch_ns, message.seq))


def _seconds(text: str | None) -> float:
    """The seconds in the text; all that there are for None."""
    if text is None:
        return math.inf
    with suppress(ValueError):
        if (seconds := float(text)) >= 0.0:
            return seconds
    raise InvalidArgumentException(
        f"last_s must be a number of seconds, 0 or more, not {text!r:.40}"
    )


def _ns(seconds: float) -> int:
    return round(min(seconds, 1e9) * 1e9)
