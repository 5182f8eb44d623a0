"""Queries to the publishers of streams: descriptions, static transforms, and kept transforms.

If many peers meet at once, the declaration of a queryable may be lost for good
(eclipse-zenoh/zenoh#2516): no query reaches it by that link, also none of Zenoh's own. So each
thing that a stream retains has two queryables, and queries alternate between them.

Zenoh sends retained messages to those who join, and requests lost ones again. But where many peers
meet at once, its request may precede the route to the publisher, or the publisher's queryable may
be lost for good: then no answer comes, and nothing is sent again until something changes. A static
transform is sent once, so here the descriptions of streams are the check.
"""

import logging
from collections.abc import Callable, Iterable

from tfbus.buffer.buffer import Buffer
from tfbus.bus.query import Answer, AskUntil, Pauses
from tfbus.bus.retained import ask_retained_later
from tfbus.bus.session import Session
from tfbus.listen.reception import StreamReception
from tfbus.runtime import scheduler
from tfbus.runtime.executor import Executor
from tfbus.wire.codec import encode_message
from tfbus.wire.descriptions import FramesAsked
from tfbus.wire.keys import (
    description_selector,
    kept_transforms_selector,
    may_describe,
    static_transforms_key_beside,
)

ANSWER_WITHIN_S = 2.0
# An answer by a slow path takes longer: from this turn on it is waited for.
PATIENT_FROM_TURN = 4
_LATE_ANSWER_WITHIN_S = 10.0


def _answer_within_s(turn: int) -> float:
    return ANSWER_WITHIN_S if turn < PATIENT_FROM_TURN else _LATE_ANSWER_WITHIN_S


def ask_for_statics(
    session: Session,
    stream_key: str,
    turn: int,
    on_answer: Callable[[Answer], None],
    on_end: Callable[[], None],
) -> None:
    """Query the static transforms of the stream of this token; `turn` counts from 0."""
    key = static_transforms_key_beside(stream_key)
    if turn % 2:
        within_s = _answer_within_s(turn)
        session.ask_later(key, None, on_answer, on_end, timeout_s=within_s, urgent=True)
    else:
        ask_retained_later(session, key, on_answer, on_end, timeout_s=_answer_within_s(turn))


def ask_for_description(
    session: Session,
    stream_key: str,
    turn: int,
    on_answer: Callable[[Answer], None],
    on_end: Callable[[], None],
) -> None:
    """Query the description of the stream of this token; `turn` counts from 0."""
    within_s = _answer_within_s(turn)
    if turn % 2 == 0:
        ask_retained_later(session, stream_key, on_answer, on_end, timeout_s=within_s)
    else:
        _ask_beside(session, stream_key, None, on_answer, on_end, within_s)


def ask_who_lists(
    session: Session,
    stream_keys: str,
    children: Iterable[str],
    on_answer: Callable[[Answer], None],
    on_end: Callable[[], None],
) -> None:
    """Query the descriptions that list one of these child frames, of the streams whose tokens lie
    within `stream_keys`. Publishers of earlier versions answer whatever they list.
    """
    payload = encode_message(FramesAsked(tuple(sorted(children))))
    _ask_beside(session, stream_keys, payload, on_answer, on_end, ANSWER_WITHIN_S)


def _ask_beside(
    session: Session,
    stream_key: str,
    payload: bytes | None,
    on_answer: Callable[[Answer], None],
    on_end: Callable[[], None],
    within_s: float,
) -> None:
    """Query descriptions at the keys of static transforms."""

    def on_any_answer(answer: Answer) -> None:
        # Earlier versions of tfbus answer with the static transforms, at their key.
        if answer.refusal is not None or may_describe(answer.key):
            on_answer(answer)

    session.ask_later(
        description_selector(static_transforms_key_beside(stream_key)),
        payload,
        on_any_answer,
        on_end,
        timeout_s=within_s,
        answers_at=stream_key,
        urgent=True,
    )


# Of many streams some may not answer; those are asked one by one afterwards.
_ALL_WITHIN_S = 1.0


def ask_for_descriptions(
    session: Session,
    keys: str,
    on_answer: Callable[[Answer], None],
    on_end: Callable[[], None],
) -> None:
    """Query the descriptions of all streams whose tokens lie within `keys`, by one question."""
    ask_retained_later(session, keys, on_answer, on_end, timeout_s=_ALL_WITHIN_S)


_PAUSES = Pauses((0.1, 0.4, 1.0, 2.0, 4.0, 8.0), forever=True, lost_after_s=0.5)
_REQUESTS_BEFORE_WARNING = 7

_STATICS = "static transforms"


class StaticRecovery:
    """Requests the static transforms that streams lack from their publishers.

    It asks, and looks at what has come, on the executor's thread: one thing at a time, and never
    in a callback of Zenoh, which may hold locks.
    """

    def __init__(self, session: Session, log: logging.Logger, executor: Executor) -> None:
        self._session = session
        self._log = log
        self._executor = executor
        self._asking: dict[str, AskUntil] = {}
        self._closed = False

    def check(self, key: str, stream: StreamReception) -> None:
        """Ask while the stream of this token lacks static transforms, until it is gone."""
        if stream.statics.are_lacking():
            self._executor.submit(_STATICS, lambda: self._begin(key, stream))

    def is_asking(self, stream: str) -> bool:
        """Whether the static transforms of this stream are asked for."""
        asking = self._asking.get(stream)
        return asking is not None and not asking.is_over

    def leave(self, stream: str) -> None:
        """The static transforms of this stream are no longer read."""
        asking = self._asking.pop(stream, None)
        if asking is not None:
            asking.close()

    def close(self) -> None:
        """Stop asking. Twice is fine."""
        self._closed = True
        for stream in list(self._asking):
            self.leave(stream)

    def _begin(self, key: str, stream: StreamReception) -> None:
        if self._closed or self.is_asking(stream.name):
            return

        def on_answer(answer: Answer) -> None:
            if answer.refusal is None and not asking.is_over:
                stream.statics.receive(answer.payload)

        def ask(turn: int, on_end: Callable[[], None]) -> None:
            ask_for_statics(self._session, key, turn, on_answer, on_end)

        def on_over() -> None:
            if self._asking.get(stream.name) is asking:
                del self._asking[stream.name]

        asking = self._asking[stream.name] = AskUntil(
            self._executor,
            _STATICS,
            _PAUSES,
            ask=ask,
            is_settled=lambda: not stream.statics.are_lacking(),
            on_unanswered=lambda turn: self._warn(stream.name, turn + 1),
            on_over=on_over,
        )
        asking.start()

    def _warn(self, stream: str, requests: int) -> None:
        if requests == _REQUESTS_BEFORE_WARNING:
            self._log.warning(
                "Static transforms of stream %r are still missing after %d requests; retrying. If "
                "they do not come, restart its publisher",
                stream,
                requests,
            )


_KEPT_WITHIN_S = 5.0
# The route to a stream that was just met may not be open for questions yet.
_HISTORY_PAUSES = Pauses((0.1, 0.4, 1.0))

# Lookups of the past wait at most this long for a stream's history.
_EXPECTED_WITHIN_S = 5.0


class _Expected:
    """The past of one stream while it may come: the count of open questions for it, and `end`,
    which ends the buffer's wait for it.
    """

    def __init__(self, end: Callable[[], None]) -> None:
        self.end = end
        self.questions = 0


class AskedHistory:
    """Requests the last `history_s` seconds of streams; if that is 0 it does nothing.

    The first message of a stream often comes before its description, and so before the question.
    Lookups with a timeout wait for its past from that message until the question is answered.
    """

    def __init__(
        self, session: Session, buffer: Buffer, executor: Executor, history_s: float
    ) -> None:
        self._session = session
        self._buffer = buffer
        self._executor = executor
        self._history_s = history_s
        self._lock = scheduler.Lock()
        self._closed = False
        # By key; and the streams that the keys are of.
        self._asked: dict[str, AskUntil] = {}
        self._streams: set[str] = set()
        self._expected: dict[str, _Expected] = {}

    def close(self) -> None:
        """Expect nothing further. Twice is fine."""
        self._closed = True
        for stream, expected in list(self._expected.items()):
            self._stop_expecting(stream, expected)

    def meet(self, stream: str) -> None:
        """A message on a new key of the stream has come."""
        if stream not in self._streams:
            self.expect(stream)

    def expect(self, stream: str) -> None:
        """From now on the stream's past may come: it is about to be asked for."""
        if not self._history_s or self._closed or stream in self._expected:
            return
        made = _Expected(self._buffer.expect_past(stream))
        with self._lock:
            is_first = self._expected.setdefault(stream, made) is made
        if is_first:
            self._executor.after(_EXPECTED_WITHIN_S, lambda: self._stop_expecting(stream, made))
        else:
            made.end()

    def keeps_nothing(self, stream: str) -> None:
        """The stream says that it keeps no history."""
        expected = self._expected.get(stream)
        if expected is not None and not expected.questions:
            self._stop_expecting(stream, expected)

    def leave(self, keys: Iterable[str], stream: str) -> None:
        """Have the keys asked for again when the stream is back, or is read again."""
        for key in keys:
            asking = self._asked.pop(key, None)
            if asking is not None:
                asking.close()
        self._streams.discard(stream)

    def ask(self, key: str, stream: StreamReception) -> None:
        """Ask for what was sent on a key, unless that was done."""
        if not self._history_s or key in self._asked:
            return
        self._streams.add(stream.name)
        self.expect(stream.name)
        with self._lock:
            expected = self._expected.get(stream.name)
            if expected is not None:
                expected.questions += 1
        asking = self._asked[key] = self._asking(key, stream, expected)
        asking.start()

    def _asking(self, key: str, stream: StreamReception, expected: _Expected | None) -> AskUntil:
        """Asks until there is an answer; a stream that has sent nothing so far gives none."""
        is_answered = False

        def ask(turn: int, on_end: Callable[[], None]) -> None:
            selector = kept_transforms_selector(key, self._history_s)
            self._session.ask_later(selector, None, on_answer, on_end, timeout_s=_KEPT_WITHIN_S)

        def on_answer(answer: Answer) -> None:
            nonlocal is_answered
            if answer.refusal is None and not asking.is_over:
                is_answered = True
                stream.receive_kept(answer.payload)

        asking = AskUntil(
            self._executor,
            "history",
            _HISTORY_PAUSES,
            ask=ask,
            is_settled=lambda: is_answered,
            on_over=lambda: self._end_question(stream.name, expected),
        )
        return asking

    def _end_question(self, stream: str, expected: _Expected | None) -> None:
        if expected is None:
            return
        with self._lock:
            expected.questions -= 1
            is_last = not expected.questions
        if is_last:
            self._stop_expecting(stream, expected)

    def _stop_expecting(self, stream: str, expected: _Expected) -> None:
        with self._lock:
            if self._expected.get(stream) is not expected:
                return
            del self._expected[stream]
        expected.end()
