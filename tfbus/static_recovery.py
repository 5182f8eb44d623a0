"""Static transforms that a stream lists and that have not come: they are asked for.

Zenoh brings retained messages to those who join, and asks again for ones that were lost. But where
many meet at once, its question may come before the way to the publisher is open, or the publisher's
offer to answer is lost for good (eclipse-zenoh/zenoh#2516); then nobody answers, and nothing is
sent again until something changes. A static transform is sent once, so here the streams'
descriptions are the check, and a stream answers on two keys: by turns each of them is asked.
"""

import logging
from contextlib import suppress

from tfbus.errors import BusError
from tfbus.executor import Executor
from tfbus.keys import static_transforms_key_beside
from tfbus.reception import StreamReception
from tfbus.retained import ask_retained_later
from tfbus.session import Answer, Session

_ANSWER_WITHIN_S = 2.0
_ASK_AGAIN_S = (0.1, 0.4, 1.0, 2.0, 4.0, 8.0)


class StaticRecovery:
    """Asks the publishers of streams for the static transforms that are lacking.

    It asks again on the thread of the executor, since a thread of Zenoh's may hold locks.
    """

    def __init__(self, session: Session, log: logging.Logger, executor: Executor) -> None:
        self._session = session
        self._log = log
        self._executor = executor
        self._asking: set[str] = set()
        self._closed = False

    def check(self, key: str, stream: StreamReception) -> None:
        """Ask, now and a few times more, while the stream of this token lacks static transforms."""
        if stream.lacks_statics() and stream.name not in self._asking:
            self._asking.add(stream.name)
            self._ask(static_transforms_key_beside(key), stream, list(_ASK_AGAIN_S))

    def close(self) -> None:
        """Ask no more. Twice is fine."""
        self._closed = True

    def _ask(self, key: str, stream: StreamReception, pauses_s: list[float]) -> None:
        def on_answer(answer: Answer) -> None:
            if answer.refusal is None and not self._closed:
                stream.receive_static(answer.payload)

        def on_end() -> None:
            if self._closed or not stream.lacks_statics():
                self._asking.discard(stream.name)
            elif pauses_s:
                self._executor.after(pauses_s[0], lambda: self._ask(key, stream, pauses_s[1:]))
            else:
                self._asking.discard(stream.name)
                self._log.warning(
                    "Stream %r lists static transforms that have not come, though its publisher "
                    "was asked for them %d times: start it again",
                    stream.name,
                    len(_ASK_AGAIN_S) + 1,
                )

        with suppress(BusError):  # the session has been closed
            if len(pauses_s) % 2:
                self._session.ask_later(key, None, on_answer, on_end, timeout_s=_ANSWER_WITHIN_S)
            else:
                ask_retained_later(
                    self._session, key, on_answer, on_end, timeout_s=_ANSWER_WITHIN_S
                )
