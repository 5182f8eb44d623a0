"""The parts of a stream that later listeners query: its description, and its last messages."""

import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from itertools import islice, takewhile
from typing import NamedTuple

from tfbus.base import scheduler
from tfbus.base.errors import BusError, InvalidArgumentException, LookupException
from tfbus.base.executor import Executor
from tfbus.base.wording import near_names, quoted
from tfbus.bus.network_session import BytesPublisher
from tfbus.bus.query import Query, within
from tfbus.geometry.transform import check_frame_id
from tfbus.wire.pages import KeptMessage, Page, encode_page
from tfbus.wire.transforms import (
    TransformMessage,
    decode_transforms,
    encode_transforms,
    is_numbered,
)

# For each child frame its parent, and whether the transform is static.
Edges = Mapping[str, tuple[str, bool]]
FrameRows = tuple[tuple[str, str, bool], ...]

# New frames often come in a burst: one description has all of them. A long description is sent less
# often, so that frames that come one by one do not cost more than this.
_ANNOUNCE_AFTER_S = 0.02
_MOST_BYTES_A_SECOND = 1e6
_ANNOUNCE_WITHIN_S = 1.0

_KINDS = {
    False: "is dynamic: remove it with a TransformBroadcaster",
    True: "is static: remove it with a StaticTransformBroadcaster",
}


class FrameAnnouncer:
    """Holds the frames of a stream and announces each change soon, on the node's thread.

    `check_right(child)` raises if the stream may not have a frame. `publisher` sends
    `describe(rows)` of all rows (parent, child, static), and `described` is the last that it has
    sent. `reparented` counts how often a known frame got another parent, or became static or
    dynamic.
    """

    def __init__(
        self,
        stream: str,
        publisher: BytesPublisher,
        describe: Callable[[FrameRows], bytes],
        executor: Executor,
        check_right: Callable[[str], object] = lambda child: None,
    ) -> None:
        self._stream = stream
        self._check_right = check_right
        self._publisher = publisher
        self._describe = describe
        self._executor = executor
        # Held while one is sent: descriptions leave in their order.
        self._announcing = scheduler.Lock()
        self._lock = scheduler.Lock()
        self._edges: dict[str, tuple[str, bool]] = {}
        self._is_due = False
        self._is_closed = False
        self.described = b""
        self._described_s = -math.inf
        self.reparented = 0

    def add(self, edges: Edges) -> None:
        """Add edges that the stream is about to send.

        Raises InvalidArgumentException if a frame name is invalid, or parent and child are the
        same: no buffer would take them. Raises as `check_right(child)`.
        """
        with self._lock:
            if edges.items() <= self._edges.items():
                return
            for child, (parent, _) in edges.items():
                _check(parent, child)
                self._check_right(child)
            self.reparented += any(
                self._edges.get(child, edge) != edge for child, edge in edges.items()
            )
            self._edges |= edges
        self.announce_soon()

    def remove(self, *children: str, static: bool) -> None:
        """Take frames out, all of them or, if it raises, none.

        Raises LookupException if the stream does not send one, InvalidArgumentException if it
        is of the other kind, static or dynamic.
        """
        with self._lock:
            for child in children:
                if child not in self._edges:
                    raise self._unknown(child, static)
                if self._edges[child][1] is not static:
                    raise InvalidArgumentException(
                        f"frame {child!r} of stream {self._stream!r} {_KINDS[not static]}"
                    )
        # Listeners remove a frame that is in one description and not in the next.
        self.announce()
        with self._lock:
            for child in children:
                self._edges.pop(child, None)
        self.announce_soon()

    def lists_any_of(self, children: Iterable[str]) -> bool:
        """Whether one of these frames is a child frame of the stream."""
        with self._lock:
            return not self._edges.keys().isdisjoint(children)

    def announce_soon(self, after_s: float = _ANNOUNCE_AFTER_S) -> None:
        """Send the description after this time, once for all changes until then; later if a long
        one was sent just now.
        """
        with self._lock:
            if self._is_due:
                return
            self._is_due = True
            pause_s = min(len(self.described) / _MOST_BYTES_A_SECOND, _ANNOUNCE_WITHIN_S)
            pause_s -= scheduler.monotonic() - self._described_s
        self._executor.after(max(after_s, pause_s), self.announce)

    def close(self) -> None:
        """Announce nothing from now on. Twice is fine."""
        with self._announcing:
            self._is_closed = True
            self._publisher.close()

    def announce(self) -> None:
        """Send the description now, if it has changed; it may wait for the link."""
        with self._announcing:
            with self._lock:
                if not self._is_due or self._is_closed:
                    return
                self._is_due = False
                rows = tuple((parent, child, kind) for child, (parent, kind) in self._edges.items())
            self.described = self._describe(rows)
            self._described_s = scheduler.monotonic()
            self._publisher.put(self.described)

    def _unknown(self, child: str, static: bool) -> LookupException:
        sent = [other for other, (_, other_static) in self._edges.items() if other_static is static]
        kind = "static frame" if static else "frame"
        named = quoted(sent) or "none"
        return LookupException(
            f"stream {self._stream!r} sends no {kind} {child!r}; it sends {named}",
            frame=child,
            nearest=near_names(child, sent),
        )


def _check(parent: str, child: str) -> None:
    check_frame_id(parent)
    check_frame_id(child)
    if parent == child:
        raise InvalidArgumentException(
            f"frame {child!r} cannot be its own parent: frame_id and child_frame_id must differ"
        )


# Key and payload of a message; or None and the name of a frame that was removed then.
Entry = tuple[str | None, bytes]

# At most this much memory a stream, whatever its seconds are.
MOST_BYTES = 16 * 2**20

# The bytes of Python's objects of a message, besides its payload.
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
        # The number of the oldest message: they are numbered in their order, and once.
        self._first = 0
        # No other history has this name, also none of a publisher that was restarted.
        self._name = f"{scheduler.time_ns():x}"

    def append(self, key: str | None, payload: bytes) -> None:
        """Keep a message that is sent now on `key`."""
        now_ns = self._clock_ns()
        messages = self._messages
        messages.append((now_ns, key, payload))
        self._bytes += len(payload) + _OVERHEAD_BYTES
        too_old_ns = now_ns - self._history_ns
        while messages and (messages[0][0] < too_old_ns or self._bytes > self._most_bytes):
            self._bytes -= len(messages.popleft()[2]) + _OVERHEAD_BYTES
            self._first += 1

    def remove(self, frame: str) -> None:
        """Keep nothing that was sent of a child frame so far."""
        self.append(None, frame.encode())

    def last(self, last_s: float) -> list[Entry]:
        """The entries of the last `last_s` seconds, oldest first, for `without_removed`."""
        return list(self.span(last_s).entries)

    def span(self, last_s: float, place: str = "") -> "HistorySpan":
        """The entries of the last `last_s` seconds, or the entries that are left from a place that
        a span of this history has named.
        """
        start, end = self._within(place)
        if start is None:
            since_ns = self._clock_ns() - min(_ns(last_s), self._history_ns)
            older = takewhile(lambda each: each[0] < since_ns, self._messages)
            start = self._first + sum(1 for _ in older)
        entries = [
            (key, payload) for _, key, payload in islice(self._messages, start - self._first, None)
        ]
        return HistorySpan(self._name, start, min(end, start + len(entries)), entries)

    def _within(self, place: str) -> tuple[int | None, int]:
        """The numbers of the first entry at a place and of the one behind its last; None if it is
        no place of this history.
        """
        newest = self._first + len(self._messages)
        name, _, numbers = place.partition(".")
        start, _, end = numbers.partition(".")
        if name != self._name or not (start.isdecimal() and end.isdecimal()):
            return None, newest
        return min(max(int(start), self._first), newest), min(int(end), newest)

    def clear(self) -> None:
        """Drop all entries."""
        self._first += len(self._messages)
        self._messages.clear()
        self._bytes = 0


class HistorySpan(NamedTuple):
    """Entries of a history, with all after them, as frames may be removed later: `start` is the
    number of the first, `end` that behind the last one that is asked for.
    """

    name: str
    start: int
    end: int
    entries: Sequence[Entry]

    def page(self, expression: str, most_bytes: int) -> Page:
        """The first messages at keys within an expression: of at most so many bytes, or one."""
        taken: list[KeptMessage] = []
        size, next_number = 0, None
        is_within: dict[str, bool] = {}
        for number, key, payload in _without_removed(self.entries, self.start):
            if number >= self.end:
                break
            if key not in is_within:
                is_within[key] = within(key, expression)
            if not is_within[key]:
                continue
            size += len(payload)
            if taken and size > most_bytes:
                next_number = number
                break
            taken.append(KeptMessage(key, 0, payload))
        after = "" if next_number is None else f"{self.name}.{next_number}.{self.end}"
        return Page(taken, after)


# The bytes of messages in a page, before they are packed.
_LARGEST_PAGE = 1_000_000

Span = Callable[[float, str], HistorySpan]


def answer_from_history(query: Query, stream_key: str, span: Span) -> None:
    """Answer a query for the kept messages of a stream: `span(last_s, place)` as of `SentHistory`.

    A query that names the size of a page is answered by one, at `stream_key` or, if that is not
    within its key, there; any other by each message at its own key.
    """
    # The session may be closed meanwhile.
    with suppress(BusError), query.answering("the stream's history"):
        found = span(_seconds(query.parameter("last_s")), query.parameter("from") or "")
        if (size := query.parameter("page")) is not None:
            page = found.page(query.key, _page_bytes(size))
            at = stream_key if within(stream_key, query.key) else query.key
            query.answer(at, encode_page(page))
            return
        messages = without_removed(found.entries)
        asked = {key for key in {key for key, _ in messages} if within(key, query.key)}
        for key, payload in messages:
            if key in asked:
                query.answer(key, payload)


def _page_bytes(text: str) -> int:
    if text.isdecimal() and len(text) < 10:
        return min(int(text), _LARGEST_PAGE)
    raise InvalidArgumentException(f"page must be a number of bytes, not {text!r:.40}")


def without_removed(kept: Sequence[Entry]) -> list[tuple[str, bytes]]:
    """Key and payload of each message, oldest first, without frames that were removed later."""
    return [(key, payload) for _, key, payload in _without_removed(kept, 0)]


def _without_removed(kept: Sequence[Entry], first: int) -> list[tuple[int, str, bytes]]:
    """As `without_removed`, each with its number, from `first` on."""
    removed: set[bytes] = set()
    messages = []
    for number, (key, payload) in zip(
        range(first + len(kept) - 1, first - 1, -1), reversed(kept), strict=True
    ):
        if key is None:
            removed.add(payload)
        elif not removed:
            messages.append((number, key, payload))
        elif left := _without(payload, removed):
            messages.append((number, key, left))
    return messages[::-1]


def _without(payload: bytes, removed: set[bytes]) -> bytes:
    """The message without these child frames; b"" if nothing is left of it."""
    # Listeners drop the rows of numbers that the stream's description has no longer.
    if is_numbered(payload):
        return payload
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
