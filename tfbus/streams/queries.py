"""Queries to the publishers of streams for their descriptions and static transforms.

If many peers meet at once, the declaration of a queryable may be lost for good
(eclipse-zenoh/zenoh#2516): no query reaches it by that link, also none of Zenoh's own. So each
thing that a stream retains has two queryables, and queries alternate between them.

Zenoh sends retained messages to peers that join, and requests lost ones again. But if many peers
meet at once, its request may precede the route to the publisher, or the publisher's queryable may
be lost for good: then no answer comes, and nothing is sent again until something changes. A static
transform is sent once, so here the descriptions of streams are the check.
"""

import logging
from collections.abc import Callable, Iterable

from tfbus.base.executor import Executor
from tfbus.base.structs import Struct
from tfbus.bus.query import Answer, AskUntil, OnEnd, Pauses
from tfbus.bus.retained import retained_selector
from tfbus.bus.session import Session
from tfbus.streams.reception import StreamReception
from tfbus.wire.codec import encode_message
from tfbus.wire.descriptions import FramesAsked
from tfbus.wire.keys import (
    description_selector,
    may_describe,
    static_transforms_key_beside,
)

ANSWER_WITHIN_S = 2.0
# An answer by a slow path takes longer: from this turn on it is waited for.
PATIENT_FROM_TURN = 4
_LATE_ANSWER_WITHIN_S = 10.0


def _answer_within_s(turn: int) -> float:
    return ANSWER_WITHIN_S if turn < PATIENT_FROM_TURN else _LATE_ANSWER_WITHIN_S


class StreamQuestion(Struct):
    """A question to the publishers of streams, at a selector. The keys of answers are within
    `answers_at` if that is not the selector's.

    A question that is put `beside`, at the keys of static transforms, is for descriptions; earlier
    versions of tfbus answer it with static transforms, which are left out.
    """

    selector: str
    timeout_s: float
    answers_at: str = ""
    beside: bool = False
    payload: bytes | None = None

    def ask(self, session: Session, on_answer: Callable[[Answer], None], on_end: OnEnd) -> None:
        """Ask, and return at once, as `Session.ask_later`."""

        def on_description(answer: Answer) -> None:
            if answer.refusal is not None or may_describe(answer.key):
                on_answer(answer)

        session.ask_later(
            self.selector,
            self.payload,
            on_description if self.beside else on_answer,
            on_end,
            timeout_s=self.timeout_s,
            answers_at=self.answers_at,
            priority="urgent",
        )


def statics_question(stream_key: str, turn: int) -> StreamQuestion:
    """For the static transforms of the stream of this token; `turn` counts from 0."""
    key = static_transforms_key_beside(stream_key)
    within_s = _answer_within_s(turn)
    return StreamQuestion(key, within_s) if turn % 2 else _for_retained(key, within_s)


def description_question(stream_key: str, turn: int) -> StreamQuestion:
    """For the description of the stream of this token; `turn` counts from 0."""
    within_s = _answer_within_s(turn)
    return _beside(stream_key, within_s) if turn % 2 else _for_retained(stream_key, within_s)


# Of many streams some may not answer; they are asked one by one afterwards.
_ALL_WITHIN_S = 1.0


def descriptions_question(keys: str) -> StreamQuestion:
    """For the descriptions of all streams whose tokens lie within `keys`, at once."""
    return _for_retained(keys, _ALL_WITHIN_S)


def listing_question(stream_keys: str, children: Iterable[str]) -> StreamQuestion:
    """For the descriptions that list one of these child frames, of the streams whose tokens lie
    within `stream_keys`. Publishers of earlier versions answer whatever they list.
    """
    payload = encode_message(FramesAsked(tuple(sorted(children))))
    return _beside(stream_keys, ANSWER_WITHIN_S, payload)


def _for_retained(key: str, within_s: float) -> StreamQuestion:
    return StreamQuestion(retained_selector(key), within_s, key)


def _beside(stream_key: str, within_s: float, payload: bytes | None = None) -> StreamQuestion:
    selector = description_selector(static_transforms_key_beside(stream_key))
    return StreamQuestion(selector, within_s, stream_key, beside=True, payload=payload)


_PAUSES = Pauses((0.1, 0.4, 1.0, 2.0, 4.0, 8.0), forever=True, lost_after_s=0.5)
_REQUESTS_BEFORE_WARNING = 7

_STATICS = "static transforms"


class StaticRecovery:
    """Requests the static transforms that streams lack from their publishers.

    It asks, and looks at the answers, on the executor's thread: one thing at a time, and never
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
            self._executor.submit(_STATICS, self._begin, key, stream)

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
        if not self._closed and not self.is_asking(stream.name):
            asking = self._asking[stream.name] = _AskStatics(self, key, stream)
            asking.start()


class _AskStatics(AskUntil):
    """Asks for the static transforms of the stream of a token."""

    def __init__(self, recovery: StaticRecovery, key: str, stream: StreamReception) -> None:
        super().__init__(recovery._executor, _STATICS, _PAUSES)
        self._recovery = recovery
        self._key = key
        self._stream = stream

    def ask(self, turn: int, on_end: OnEnd) -> None:
        question = statics_question(self._key, turn)
        question.ask(self._recovery._session, self._receive, on_end)

    def _receive(self, answer: Answer) -> None:
        if answer.refusal is None and not self.is_over:
            self._stream.statics.receive(answer.payload)

    def is_settled(self) -> bool:
        return not self._stream.statics.are_lacking()

    def on_unanswered(self, turn: int) -> None:
        if turn + 1 == _REQUESTS_BEFORE_WARNING:
            self._recovery._log.warning(
                "Static transforms of stream %r are still missing after %d requests; retrying. If "
                "they do not come, restart its publisher",
                self._stream.name,
                turn + 1,
            )

    def on_over(self) -> None:
        if self._recovery._asking.get(self._stream.name) is self:
            del self._recovery._asking[self._stream.name]
