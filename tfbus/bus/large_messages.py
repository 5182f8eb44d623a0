"""Large messages of topics on networks that carry less than is sent: readers ask for the newest.

A link drops most of such messages, each after it has carried a part of it. So a publisher keeps the
newest, and a subscriber that gets none asks for it, part by part: little waits on the way, and each
subscriber has its own pace. A message is known by its CRC-32, also one that came unasked.
"""

import itertools
import zlib
from collections import OrderedDict, deque
from typing import TYPE_CHECKING, NamedTuple

import zenoh

from tfbus.base import scheduler
from tfbus.base.errors import BusError, DecodeError
from tfbus.bus import zenoh_library
from tfbus.bus.callbacks import OnSample
from tfbus.bus.network_session import LARGE_BYTES, BytesSubscriber, Declaration
from tfbus.bus.query import Answer, Query
from tfbus.wire.codec import decode_map, encode_map

if TYPE_CHECKING:
    from tfbus.bus.session import Session

# A publisher that can be asked has a token and a queryable below its topic.
_BELOW = "/@adv/parts/"

# Small enough that none holds up for long what its publisher sends behind it.
_PART_BYTES = 16_000

# So many times the bytes that TCP has under way are asked for at a time: the link is never idle
# while a question goes there and its answer back.
_AHEAD = 3

# A reader to which large messages come by themselves asks for none.
_QUIET_S = 1.0

# The pauses between questions while there is nothing new: the first, and the longest.
_PAUSE_S, _LONGEST_PAUSE_S = 0.1, 1.0

# The end of a session waits at most so long for the end of its readers.
_LAST_QUESTION_S = 2.0

# A part comes later only if the link carries hardly anything.
_ANSWER_WITHIN_S = 10.0

# For so long the newest message is answered: subscribers that come later get none from before, as
# on other networks.
_NEW_FOR_S = 5.0

# So many messages, and bytes of them, are kept for readers that have a part of them.
_KEPT, _KEPT_BYTES = 16, 32_000_000

# A question names so many messages that the reader has: one of each publisher of its topic. An
# answer names so many before it, which may still come unasked.
_KNOWN, _OLDER = 8, 16

# A publisher that sent less at a time would have its readers ask for ever.
_LEAST_BYTES = 4_000

# Anyone may have tokens, and each costs a reader a thread.
_MOST_PUBLISHERS = 16

_numbers = itertools.count(1)


class _Part(NamedTuple):
    """A part of a message: the message's CRC-32 and size, the place of the part, and its bytes; the
    first one has the CRC-32 of messages before, too.
    """

    crc: int
    size: int
    at: int
    part: bytes
    older: list[int] = []  # noqa: RUF012 (never changed)


def _encoded(part: _Part) -> bytes:
    return encode_map(part._asdict())


def _decoded(payload: bytes) -> _Part | None:
    """A part; None if there is none. Raises DecodeError if it is nothing like that."""
    values = decode_map(payload)
    if not values:
        return None
    crc, size, at, part = (values.get(name) for name in ("crc", "size", "at", "part"))
    older = values.get("older", [])
    if not isinstance(part, bytes) or not isinstance(older, list):
        raise DecodeError("a part of a message has part, a binary, and older, an array")
    if not all(type(each) is int and each >= 0 for each in (crc, size, at, *older)):
        raise DecodeError("a part of a message has crc, size, at and older, integers from 0 on")
    return _Part(crc, size, at, part, older)  # type: ignore[arg-type]


class NewestLarge:
    """Sends the messages of one key after all others, and answers who asks for the newest."""

    def __init__(self, session: "Session", key: str):
        self._session = session
        self._key = key
        self._priority = zenoh.Priority.DATA_LOW
        self._lock = scheduler.Lock()
        self._newest = b""
        self._put_s = 0.0
        self._crcs: deque[int] = deque(maxlen=_OLDER)
        # Those that readers asked for, the last one at the end.
        self._kept: OrderedDict[int, bytes] = OrderedDict()
        self._declared: list[Declaration] = []
        self._is_closed = False

    def put(self, payload: bytes) -> None:
        """Send a message to all that subscribe, as far as links have room."""
        if self._session.network.reads_large and len(payload) >= LARGE_BYTES:
            with self._lock:
                self._newest, self._put_s = bytes(payload), scheduler.monotonic()
                self._crcs.append(zlib.crc32(payload))
            if not self._declared:
                self._declare()
        drop = zenoh.CongestionControl.DROP
        self._session.zenoh.put(
            self._key, payload, congestion_control=drop, priority=self._priority
        )

    def close(self) -> None:
        """Answer no more. Twice is fine."""
        with self._lock:
            self._is_closed = True
            declared = list(self._declared)
        for each in declared:
            each.close()

    def _declare(self) -> None:
        with self._lock:
            if self._declared or self._is_closed:
                return
            session = self._session
            key = f"{self._key}{_BELOW}{session.zenoh.zid()}_{next(_numbers)}"
            self._declared = [session.queryable(key, self._answer, long=True), session.token(key)]

    def _answer(self, query: Query) -> None:
        with query.answering("the newest message"):
            part = self._asked(query)
            if part is not None:
                # What is sent unasked comes after the answers from now on. It stays so: no message
                # is to overtake another.
                self._priority = zenoh.Priority.BACKGROUND
            query.answer(query.key, encode_map({}) if part is None else _encoded(part))

    def _asked(self, query: Query) -> _Part | None:
        of = query.parameter("of")
        if of is None:
            with self._lock:
                payload, (*older, crc), at = self._newest, self._crcs, 0
                is_old = scheduler.monotonic() > self._put_s + _NEW_FOR_S
            if is_old or str(crc) in (query.parameter("has") or "").split(","):
                return None
        else:
            crc, at, older = _number(of), _number(query.parameter("from") or "0"), []
            payload = self._kept.get(crc, b"")
            if not payload:
                return None
        self._keep(crc, payload)
        return _Part(crc, len(payload), at, payload[at : at + _PART_BYTES], older)

    def _keep(self, crc: int, payload: bytes) -> None:
        """Keep a message for the reader that has just asked for a part of it."""
        kept = self._kept
        with self._lock:
            kept[crc] = payload
            kept.move_to_end(crc)
            while len(kept) > _KEPT or (
                len(kept) > 1 and sum(map(len, kept.values())) > _KEPT_BYTES
            ):
                kept.popitem(last=False)


def _number(text: str) -> int:
    if not text.isdecimal() or len(text) > 10:
        raise BusError(f"{text!r:.20} is not a number of at most ten digits")
    return int(text)


class ReadingSubscriber(BytesSubscriber):
    """A subscriber to messages of a topic; where large ones do not come, it asks for the newest."""

    def __init__(self, session: "Session", topic: str, callback: OnSample, *, others: bool):
        self._callback = callback
        self._session, self._topic = session.placed(topic)
        self.most_bytes = session.settings.limits.limit_of("topic")
        # The newest that came, and when the last one came unasked.
        self._known: deque[int] = deque(maxlen=_KNOWN)
        self._came_s = scheduler.monotonic()
        # Those that were asked for, and others before them.
        self._outdated: deque[int] = deque(maxlen=_KNOWN * _OLDER)
        self._lock = scheduler.Lock()
        self._readers: dict[str, _Reader] = {}
        self._is_closed = False
        subscriber = session.subscriber(topic, self._on_message, others=others)
        super().__init__(subscriber._declared, subscriber._dropped)
        self._forget = session.at_close(self._end_with_session)
        self._watch = self._session.watch_living(f"{self._topic}{_BELOW}*", self._on_token)

    def close(self) -> None:
        """End it; twice is fine."""
        super().close()
        self._forget()
        self._end()
        self._watch.close()

    def _end(self) -> "list[_Reader]":
        with self._lock:
            self._is_closed = True
            readers, self._readers = list(self._readers.values()), {}
        for each in readers:
            each.close()
        return readers

    def _end_with_session(self) -> None:
        # A thread that is in Zenoh when Python shuts down aborts the process.
        for each in self._end():
            each.join(_LAST_QUESTION_S)

    def _on_message(self, key: str, payload: bytes) -> None:
        if len(payload) >= LARGE_BYTES:
            crc = zlib.crc32(payload)
            with self._lock:
                if crc in self._outdated:
                    return
                self._known.append(crc)
            self._came_s = scheduler.monotonic()
        self._callback(key, payload)

    def _on_token(self, key: str, alive: bool) -> None:
        with self._lock:
            former = self._readers.pop(key, None)
            if alive and not self._is_closed and len(self._readers) < _MOST_PUBLISHERS:
                self._readers[key] = _Reader(self, key)
        if former is not None:
            former.close()

    # Used by readers

    def quiet_in_s(self) -> float:
        """How long until large messages have stayed away long enough to be asked for."""
        return self._came_s + _QUIET_S - scheduler.monotonic()

    def known(self) -> str:
        """The messages that are known, as a question names them."""
        with self._lock:
            return ",".join(map(str, self._known))

    def take(self, key: str, first: _Part, payload: bytes) -> None:
        """Hand on a message that was asked for at a key."""
        topic = key.rpartition(_BELOW)[0]
        with self._lock:
            self._known.append(first.crc)
            self._outdated.extend((*first.older[-_OLDER:], first.crc))
        self._session.callbacks.guarded(
            f"message of {topic}", lambda _: self._callback(topic, payload)
        )(None)


class _Reader:
    """Asks one publisher for its newest message, again and again, on a thread of its own."""

    def __init__(self, subscriber: ReadingSubscriber, key: str):
        self._subscriber = subscriber
        self._session = subscriber._session
        self._key = key
        self._closed = scheduler.Event()
        self._cancellation = zenoh_library.new_cancellation()
        zenoh_library.holders.add(self, "_cancellation")
        self._thread = scheduler.Thread(target=self._run, name=f"reads {key}", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Ask no further; twice is fine. In a forked child it does nothing else."""
        self._closed.set()
        if not zenoh_library.is_lost_by_fork():
            self._cancellation.cancel()

    def join(self, patience_s: float) -> None:
        """Wait until it has ended, at most `patience_s` seconds; not on its own thread."""
        if scheduler.current_thread() is not self._thread:
            self._thread.join(patience_s)

    def _run(self) -> None:
        pause_s = _PAUSE_S
        while not self._closed.wait(max(pause_s, self._subscriber.quiet_in_s())):
            if self._subscriber.quiet_in_s() > 0.0:
                continue
            try:
                has_read = self._read()
            except (BusError, DecodeError):
                has_read = False
            pause_s = 0.0 if has_read else min(max(2.0 * pause_s, _PAUSE_S), _LONGEST_PAUSE_S)

    def _read(self) -> bool:
        """Read the newest message; whether there was one, and all of it came."""
        subscriber = self._subscriber
        parts: scheduler.SimpleQueue[_Part | None] = scheduler.SimpleQueue()
        self._ask(f"has={subscriber.known()}", parts)
        first = parts.get()
        if first is None or first.at or not 0 < first.size <= subscriber.most_bytes:
            return False
        step = len(first.part)
        if step < min(first.size, _LEAST_BYTES):
            return False
        most = _AHEAD * self._session.network.tcp_bytes // _PART_BYTES
        found = {0: first.part}
        missing = deque(range(step, first.size, step))
        under_way = 0
        while missing or under_way:
            while missing and under_way < most:
                self._ask(f"of={first.crc};from={missing.popleft()}", parts)
                under_way += 1
            part = parts.get()
            under_way -= 1
            if part is None or len(part.part) > step or subscriber.quiet_in_s() > 0.0:
                return False
            found[part.at] = part.part
        payload = b"".join(found[at] for at in sorted(found))
        if zlib.crc32(payload) != first.crc:
            return False
        subscriber.take(self._key, first, payload)
        return True

    def _ask(self, parameters: str, parts: "scheduler.SimpleQueue[_Part | None]") -> None:
        """Ask for a part; it, or None for none, is put into `parts` once."""
        found: list[_Part] = []

        def on_answer(answer: Answer) -> None:
            if answer.refusal is None and (part := _decoded(answer.payload)) is not None:
                found[:] = [part]

        self._session.ask_later(
            f"{self._key}?{parameters}",
            None,
            on_answer,
            lambda: parts.put(found[0] if found else None),
            timeout_s=_ANSWER_WITHIN_S,
            others=True,
            priority="low",
            cancellation=self._cancellation,
        )
