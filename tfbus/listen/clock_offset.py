"""How far the clocks of others are from ours, as NTP measures it.

Four times tell: when we asked, when it was asked, when it answered, and when we had the answer.
The offset is known to half of the way there and back, whatever the two ways were.
"""

import logging
import queue
import threading
import time
from contextlib import suppress
from dataclasses import dataclass, field

from tfbus.bus.query import Answer
from tfbus.bus.session import Session
from tfbus.errors import BusError, DecodeError
from tfbus.wire.codec import decode_map
from tfbus.wire.descriptions import StreamDescription
from tfbus.wire.keys import clock_key

# So many are asked for in a row; the one with the shortest way is the most exact.
_SAMPLES = 4
# A clock of a computer drifts by a few ms in this time.
_AGAIN_S = 30.0
# One is asked at a time, and then nobody for so long: a thousand within the time above.
_BETWEEN_S = 0.03
_PATIENCE_S = 1.0

# A clock that is farther off than this, and farther than the way takes, is worth a warning.
_SKEW_S = 0.1


@dataclass(frozen=True)
class ClockOffset:
    """How far another clock is ahead of ours, known to half of `round_trip_s`."""

    offset_s: float
    round_trip_s: float

    @property
    def is_skewed(self) -> bool:
        """Whether lookups at the time of one clock go wrong with stamps of the other."""
        return abs(self.offset_s) > max(_SKEW_S, self.round_trip_s)


def measured(asked_ns: int, received_ns: int, answered_ns: int, back_ns: int) -> ClockOffset:
    """The offset by four times: the first and the last by our clock, the others by the other.

    The formula is NTP's (RFC 5905, section 8).
    """
    offset_ns = ((received_ns - asked_ns) + (answered_ns - back_ns)) / 2
    round_trip_ns = (back_ns - asked_ns) - (answered_ns - received_ns)
    return ClockOffset(offset_ns / 1e9, round_trip_ns / 1e9)


@dataclass
class _Publisher:
    """A node whose clock is watched; due_s is when to ask it next, by the monotonic clock."""

    key: str
    node: str
    host: str
    due_s: float
    streams: set[str] = field(default_factory=set)
    offset: ClockOffset | None = None
    is_told: bool = False


class ClockOffsets:
    """Knows how far the system's clocks of other nodes are from ours, and says once of each that
    is too far.

    They are asked one at a time, on a thread of its own: each when it is watched first, and then
    twice a minute. Safe from any thread.
    """

    def __init__(self, session: Session, log: logging.Logger, *, warns: bool = True) -> None:
        self._session = session
        self._log = log
        self._warns = warns
        self._changed = threading.Condition()
        # By the id of their session; and the session of each stream that is watched.
        self._publishers: dict[str, _Publisher] = {}
        self._sessions: dict[str, str] = {}
        self._thread: threading.Thread | None = None
        self._closed = False

    def watch(self, stream: str, told: StreamDescription) -> None:
        """Measure the clock of the node that publishes a stream; again is fine."""
        session = told.session
        with self._changed:
            if self._sessions.get(stream, session) != session:
                self._leave(stream)
            if not session or session == self._session.id:
                return
            if session not in self._publishers and not self._closed:
                key = _key(told.node, self._session.settings.namespace)
                publisher = _Publisher(key, told.node, told.host, time.monotonic())
                self._publishers[session] = publisher
                self._start()
            if session in self._publishers:
                self._publishers[session].streams.add(stream)
                self._sessions[stream] = session

    def forget(self, stream: str) -> None:
        """The stream is gone: measure its node no more, unless another stream of it is there."""
        with self._changed:
            self._leave(stream)

    def of(self, session: str) -> ClockOffset | None:
        """What was measured last of the node of a session; None where nothing was yet."""
        if session == self._session.id:
            return ClockOffset(0.0, 0.0)
        publisher = self._publishers.get(session)
        return publisher.offset if publisher else None

    def close(self) -> None:
        """Measure no more; what is known stays. Twice is fine."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def _leave(self, stream: str) -> None:
        session = self._sessions.pop(stream, "")
        publisher = self._publishers.get(session)
        if publisher is not None:
            publisher.streams.discard(stream)
            if not publisher.streams:
                del self._publishers[session]

    def _start(self) -> None:
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="clock offsets", daemon=True)
            self._thread.start()
        self._changed.notify_all()

    def _run(self) -> None:
        while (publisher := self._next()) is not None:
            offset = self._measure(publisher.key)
            if offset is not None:
                publisher.offset = offset
                self._warn(publisher, offset)
            with self._changed:
                publisher.due_s = time.monotonic() + _AGAIN_S
                self._changed.wait_for(lambda: self._closed, _BETWEEN_S)

    def _next(self) -> _Publisher | None:
        """The one to ask next, once it is due; None when closed."""
        with self._changed:
            while not self._closed:
                first = min(self._publishers.values(), key=lambda each: each.due_s, default=None)
                wait_s = None if first is None else first.due_s - time.monotonic()
                if wait_s is not None and wait_s <= 0.0:
                    return first
                self._changed.wait(wait_s)
            return None

    def _measure(self, key: str) -> ClockOffset | None:
        """The most exact of a few samples; None where nobody answers."""
        samples: list[ClockOffset] = []
        for _ in range(_SAMPLES):
            sample = None if self._closed else self._ask(key)
            if sample is None:
                break
            samples.append(sample)
        return min(samples, key=lambda each: each.round_trip_s, default=None)

    def _ask(self, key: str) -> ClockOffset | None:
        samples: queue.SimpleQueue[ClockOffset | None] = queue.SimpleQueue()
        asked_ns = time.time_ns()

        def on_answer(answer: Answer) -> None:
            # Here and not where it is waited for, which would be some time later.
            back_ns = time.time_ns()
            with suppress(DecodeError):
                samples.put(_sample(asked_ns, answer, back_ns))

        try:
            self._session.ask_later(
                key, None, on_answer, lambda: samples.put(None), timeout_s=_PATIENCE_S
            )
        except BusError:  # the session has ended
            return None
        return samples.get()

    def _warn(self, publisher: _Publisher, offset: ClockOffset) -> None:
        if self._warns and offset.is_skewed and not publisher.is_told and not self._closed:
            publisher.is_told = True
            ahead = offset.offset_s > 0
            self._log.warning(
                "The clock of %s on host %s is %.3f s %s ours (known to %.1f ms): a lookup at the "
                "present time %s. Keep the clocks of both by NTP, with chrony for instance",
                publisher.node,
                publisher.host or "unknown",
                abs(offset.offset_s),
                "ahead of" if ahead else "behind",
                offset.round_trip_s * 500.0,
                "answers where its frames were so long ago" if ahead else "waits so long, or fails",
            )


def _sample(asked_ns: int, answer: Answer, back_ns: int) -> ClockOffset | None:
    """The offset that an answer tells; raises DecodeError where it cannot be read."""
    if answer.refusal is not None:
        return None
    times = decode_map(answer.payload)
    answered_ns = times.get("now")
    received_ns = times.get("received", answered_ns)
    if type(received_ns) is not int or type(answered_ns) is not int:
        return None
    return measured(asked_ns, received_ns, answered_ns, back_ns)


def _key(node: str, namespace: str) -> str:
    """Where the node of this full name tells the time, as seen from within the namespace."""
    path = node.strip("/")
    inside = path.removeprefix(f"{namespace}/") if namespace else path
    prefix, _, name = inside.rpartition("/")
    return "/".join(filter(None, (prefix, clock_key(name))))
