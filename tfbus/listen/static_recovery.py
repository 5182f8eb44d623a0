"""Static transforms that a stream lists and that have not come: they are asked for.

Zenoh brings retained messages to those who join, and asks again for ones that were lost. But where
many meet at once, its question may come before the way to the publisher is open, or the publisher's
offer to answer is lost for good (eclipse-zenoh/zenoh#2516); then nobody answers, and nothing is
sent again until something changes. A static transform is sent once, so here the streams'
descriptions are the check, and a stream answers on two keys: by turns each of them is asked.
"""

import logging
from collections.abc import Callable
from contextlib import suppress

from tfbus.bus.query import Answer
from tfbus.bus.retained import ask_retained_later
from tfbus.bus.session import Session
from tfbus.errors import BusError
from tfbus.listen.reception import StreamReception
from tfbus.runtime.executor import Executor
from tfbus.wire.keys import static_transforms_key_beside

_ANSWER_WITHIN_S = 2.0
# A question that is lost is not worth the wait for its end; while it is open others are asked.
_ASK_ANOTHER_S = 0.5
# The last of them is the pause before all further questions.
_ASK_AGAIN_S = (0.1, 0.4, 1.0, 2.0, 4.0, 8.0)


class StaticRecovery:
    """Asks the publishers of streams for the static transforms that are lacking.

    It asks, and looks at what has come, on the thread of the executor: one thing after the other,
    and not where Zenoh may hold locks.
    """

    def __init__(self, session: Session, log: logging.Logger, executor: Executor) -> None:
        self._session = session
        self._log = log
        self._executor = executor
        self._asking: set[str] = set()
        self._closed = False

    def check(self, key: str, stream: StreamReception) -> None:
        """Ask while the stream of this token lacks static transforms, for as long as it lives."""
        if stream.lacks_statics():
            self._do(lambda: self._begin(static_transforms_key_beside(key), stream))

    def leave(self, stream: str) -> None:
        """The static transforms of this stream are not read any more."""
        self._asking.discard(stream)

    def close(self) -> None:
        """Ask no more. Twice is fine."""
        self._closed = True
        self._asking.clear()

    def _do(self, job: Callable[[], None]) -> None:
        self._executor.submit("static transforms", job)

    def _begin(self, key: str, stream: StreamReception) -> None:
        if stream.lacks_statics() and stream.name not in self._asking and not self._closed:
            self._asking.add(stream.name)
            self._ask(key, stream, 0)

    def _ask(self, key: str, stream: StreamReception, turn: int) -> None:
        if not self._is_wanted(stream):
            return

        def on_answer(answer: Answer) -> None:
            if answer.refusal is None and stream.name in self._asking:
                stream.receive_static(answer.payload)

        is_over = False

        def end() -> None:
            nonlocal is_over
            if not is_over:
                is_over = True
                self._ask_again(key, stream, turn)

        def on_end() -> None:
            self._do(end)

        with suppress(BusError):  # the session has been closed
            if turn % 2:
                self._session.ask_later(key, None, on_answer, on_end, timeout_s=_ANSWER_WITHIN_S)
            else:
                ask_retained_later(
                    self._session, key, on_answer, on_end, timeout_s=_ANSWER_WITHIN_S
                )
            self._executor.after(_ASK_ANOTHER_S, end)

    def _ask_again(self, key: str, stream: StreamReception, turn: int) -> None:
        if not self._is_wanted(stream):
            return
        if turn == len(_ASK_AGAIN_S):
            self._log.warning(
                "Stream %r lists static transforms that have not come, though its publisher was "
                "asked for them %d times; it is asked on. If that does not help, start it again",
                stream.name,
                turn + 1,
            )
        pause_s = _ASK_AGAIN_S[min(turn, len(_ASK_AGAIN_S) - 1)]
        self._executor.after(pause_s, lambda: self._ask(key, stream, turn + 1))

    def _is_wanted(self, stream: StreamReception) -> bool:
        """Whether it is to be asked on; where nothing is lacking any more, it is not."""
        if not stream.lacks_statics():
            self._asking.discard(stream.name)
        return stream.name in self._asking
