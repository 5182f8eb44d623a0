"""Queries for what streams retain: descriptions, and static transforms that have not come.

If many peers meet at once, the declaration of a queryable may be lost for good
(eclipse-zenoh/zenoh#2516): no query reaches it by that link, also none of Zenoh's own. So each
thing that a stream retains has two queryables, and queries alternate between them.

Zenoh sends retained messages to those who join, and requests lost ones again. But where many peers
meet at once, its request may precede the route to the publisher, or the publisher's queryable may
be lost for good: then no answer comes, and nothing is sent again until something changes. A static
transform is sent once, so here the descriptions of streams are the check.
"""

import logging
from collections.abc import Callable

from tfbus.bus.ask_until import AskUntil, Pauses
from tfbus.bus.query import Answer
from tfbus.bus.retained import ask_retained_later
from tfbus.bus.session import Session
from tfbus.listen.reception import StreamReception
from tfbus.runtime.executor import Executor
from tfbus.wire.keys import description_selector, static_transforms_key_beside

_ANSWER_WITHIN_S = 2.0


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
        session.ask_later(key, None, on_answer, on_end, timeout_s=_ANSWER_WITHIN_S)
    else:
        ask_retained_later(session, key, on_answer, on_end, timeout_s=_ANSWER_WITHIN_S)


def ask_for_description(
    session: Session,
    stream_key: str,
    turn: int,
    on_answer: Callable[[Answer], None],
    on_end: Callable[[], None],
) -> None:
    """Query the description of the stream of this token; `turn` counts from 0."""
    if turn % 2 == 0:
        ask_retained_later(session, stream_key, on_answer, on_end, timeout_s=_ANSWER_WITHIN_S)
        return
    static_key = static_transforms_key_beside(stream_key)

    def on_any_answer(answer: Answer) -> None:
        # Earlier versions of tfbus answer with the static transforms, at their key.
        if answer.key != static_key:
            on_answer(answer)

    session.ask_later(
        description_selector(static_key),
        None,
        on_any_answer,
        on_end,
        timeout_s=_ANSWER_WITHIN_S,
        answers_at=stream_key,
    )


_PAUSES = Pauses((0.1, 0.4, 1.0, 2.0, 4.0, 8.0), forever=True, lost_after_s=0.5)
_REQUESTS_BEFORE_WARNING = 7

_WHAT = "static transforms"


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
            self._executor.submit(_WHAT, lambda: self._begin(key, stream))

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
        former = self._asking.get(stream.name)
        if self._closed or (former is not None and not former.is_over):
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
            _WHAT,
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
