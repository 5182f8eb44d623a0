"""How far the clocks of other nodes are from ours, as NTP measures it.

It takes four times: when we asked, when the question came, when it was answered, and when the
answer came. The offset is known to half of the round trip, however it divides into two ways.
"""

import logging
from contextlib import suppress
from operator import attrgetter
from typing import NamedTuple

from tfbus.base import scheduler
from tfbus.base.errors import BusError, DecodeError
from tfbus.base.structs import Struct, field
from tfbus.bus.query import Answer
from tfbus.bus.session import Session
from tfbus.wire.codec import decode_map
from tfbus.wire.descriptions import StreamDescription
from tfbus.wire.keys import clock_key

# Samples in a row; the one with the shortest round trip is the most exact.
_SAMPLES = 4
# A clock of a computer drifts by a few ms in this time.
AGAIN_S = 30.0
# So many nodes are asked at a time, with a pause in between: a thousand within 5 s, and one that
# does not answer holds up few.
_AT_A_TIME = 10
_BETWEEN_S = 0.03
_PATIENCE_S = 1.0

# A clock that is off by more than this, and by more than the round trip, is worth a warning.
_SKEW_S = 0.1


class ClockOffset(NamedTuple):
    """How far another clock is ahead of ours, known to half of `round_trip_s`."""

    offset_s: float
    round_trip_s: float

    @property
    def is_skewed(self) -> bool:
        """Whether the offset is more than 100 ms, and more than the round trip."""
        return abs(self.offset_s) > max(_SKEW_S, self.round_trip_s)


def measured(asked_ns: int, received_ns: int, answered_ns: int, back_ns: int) -> ClockOffset:
    """The offset by four times: the first and the last by our clock, the others by the other clock.

    The formula is NTP's (RFC 5905, section 8).
    """
    offset_ns = ((received_ns - asked_ns) + (answered_ns - back_ns)) / 2
    round_trip_ns = (back_ns - asked_ns) - (answered_ns - received_ns)
    return ClockOffset(offset_ns / 1e9, round_trip_ns / 1e9)


class _Publisher(Struct, frozen=False):
    """A node whose clock is measured; due_s is when to ask it next, by the monotonic clock."""

    key: str
    node: str
    host: str
    due_s: float
    streams: set[str] = field(default_factory=set)
    offset: ClockOffset | None = None
    has_warned: bool = False


class _Answered(Struct):
    """A sample of the clock that was asked under this number; None for the end of the question."""

    number: int
    sample: ClockOffset | None


class ClockOffsets:
    """Measures the clocks of other nodes against ours, and warns once of each that is too far off.

    It asks a few nodes at a time, on a thread of its own: at once, and then twice a minute. Safe
    from any thread.
    """

    def __init__(self, session: Session, log: logging.Logger, *, warns: bool = True) -> None:
        self._session = session
        self._log = log
        self._warns = warns
        self._changed = scheduler.Condition()
        # By the id of their session; and the session of each stream that is watched.
        self._publishers: dict[str, _Publisher] = {}
        self._sessions: dict[str, str] = {}
        self._thread: scheduler.Thread | None = None
        self._answers: scheduler.SimpleQueue[_Answered | None] = scheduler.SimpleQueue()
        self._closed = False

    def watch(self, stream: str, description: StreamDescription) -> None:
        """Measure the clock of the node that publishes a stream; again is fine."""
        session = description.session
        with self._changed:
            if self._sessions.get(stream, session) != session:
                self._leave(stream)
            if not session or session == self._session.id:
                return
            if session not in self._publishers and not self._closed:
                key = _key(description.node, self._session.settings.namespace)
                publisher = _Publisher(
                    key, description.node, description.host, scheduler.monotonic()
                )
                self._publishers[session] = publisher
                self._start()
            if session in self._publishers:
                self._publishers[session].streams.add(stream)
                self._sessions[stream] = session

    def is_watching(self, stream: str) -> bool:
        """Whether the clock of the node that publishes a stream is measured."""
        return stream in self._sessions

    def forget(self, stream: str) -> None:
        """The stream is gone: stop measuring its node, unless another stream of it is there."""
        with self._changed:
            self._leave(stream)

    def last_of(self, session: str) -> ClockOffset | None:
        """The last offset of the node of a session; None before the first."""
        if session == self._session.id:
            return ClockOffset(0.0, 0.0)
        publisher = self._publishers.get(session)
        return publisher.offset if publisher else None

    def close(self) -> None:
        """Stop measuring; known offsets stay. Twice is fine."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
            self._answers.put(None)
            thread = self._thread
        if thread is not None and thread is not scheduler.current_thread():
            thread.join()

    def _leave(self, stream: str) -> None:
        session = self._sessions.pop(stream, "")
        publisher = self._publishers.get(session)
        if publisher is not None:
            publisher.streams.discard(stream)
            if not publisher.streams:
                del self._publishers[session]

    def _start(self) -> None:
        if self._thread is None:
            self._thread = scheduler.Thread(target=self._run, name="clock offsets", daemon=True)
            self._thread.start()
        self._changed.notify_all()

    def _run(self) -> None:
        while due := self._next():
            for publisher, offset in zip(
                due, self._measure([each.key for each in due]), strict=True
            ):
                if offset is not None:
                    publisher.offset = offset
                    self._warn(publisher, offset)
            with self._changed:
                for publisher in due:
                    publisher.due_s = scheduler.monotonic() + AGAIN_S
                self._changed.wait_for(lambda: self._closed, _BETWEEN_S)

    def _next(self) -> list[_Publisher]:
        """The nodes to ask next, once they are due; none when closed."""
        with self._changed:
            while not self._closed:
                now_s = scheduler.monotonic()
                waits = sorted(self._publishers.values(), key=attrgetter("due_s"))[:_AT_A_TIME]
                due = [each for each in waits if each.due_s <= now_s]
                if due:
                    return due
                self._changed.wait(waits[0].due_s - now_s if waits else None)
            return []

    def _measure(self, keys: list[str]) -> list[ClockOffset | None]:
        """The most exact of a few samples of each clock; None without an answer."""
        best: list[ClockOffset | None] = [None] * len(keys)
        asked = [*range(len(keys))]
        for _ in range(_SAMPLES):
            found = self._ask({number: keys[number] for number in asked})
            for number, sample in found.items():
                former = best[number]
                if former is None or sample.round_trip_s < former.round_trip_s:
                    best[number] = sample
            asked = [*found]
        return best

    def _ask(self, keys: dict[int, str]) -> dict[int, ClockOffset]:
        """A sample of each clock that answers."""
        answers: scheduler.SimpleQueue[_Answered | None] = scheduler.SimpleQueue()
        with self._changed:
            if self._closed:
                return {}
            self._answers = answers
        left = len(keys)
        found: dict[int, ClockOffset] = {}
        with suppress(BusError):  # the session is closed
            for number, key in keys.items():
                self._ask_one(number, key, answers)
            while left and (answered := answers.get()) is not None:
                if answered.sample is None:
                    left -= 1
                else:
                    found.setdefault(answered.number, answered.sample)
        return found

    def _ask_one(
        self, number: int, key: str, answers: "scheduler.SimpleQueue[_Answered | None]"
    ) -> None:
        asked_ns, asked_at_ns = scheduler.time_ns(), scheduler.monotonic_ns()

        def on_answer(answer: Answer) -> None:
            # Here, since the waiting thread may wake up late; by a clock that nobody sets.
            back_ns = asked_ns + scheduler.monotonic_ns() - asked_at_ns
            with suppress(DecodeError):
                if sample := _sample(asked_ns, answer, back_ns):
                    answers.put(_Answered(number, sample))

        def on_end() -> None:
            answers.put(_Answered(number, None))

        self._session.ask_later(key, None, on_answer, on_end, timeout_s=_PATIENCE_S)

    def _warn(self, publisher: _Publisher, offset: ClockOffset) -> None:
        if self._warns and offset.is_skewed and not publisher.has_warned and not self._closed:
            publisher.has_warned = True
            ahead = offset.offset_s > 0
            self._log.warning(
                "The clock of %s on host %s is %.3f s %s ours (within %.1f ms): lookups at the "
                "present time %s. Synchronize both clocks by NTP, for example with chrony",
                publisher.node,
                publisher.host or "unknown",
                abs(offset.offset_s),
                "ahead of" if ahead else "behind",
                offset.round_trip_s * 500.0,
                "return where its frames were that long ago"
                if ahead
                else "wait that long, or fail",
            )


def _sample(asked_ns: int, answer: Answer, back_ns: int) -> ClockOffset | None:
    """The offset by an answer, None if it has no times that can be; DecodeError if it cannot be
    read.
    """
    if answer.refusal is not None:
        return None
    times = decode_map(answer.payload)
    answered_ns = times.get("now")
    received_ns = times.get("received", answered_ns)
    if type(received_ns) is not int or type(answered_ns) is not int:
        return None
    sample = measured(asked_ns, received_ns, answered_ns, back_ns)
    # The other clock was set between its two times.
    return sample if sample.round_trip_s >= 0.0 else None


def _key(node: str, namespace: str) -> str:
    """The key of the clock of the node of this full name, as seen from within the namespace."""
    path = node.strip("/")
    inside = path.removeprefix(f"{namespace}/") if namespace else path
    prefix, _, name = inside.rpartition("/")
    return "/".join(filter(None, (prefix, clock_key(name))))
