"""What streams sent before a listener met them: asked for, and waited for by lookups."""

import threading
from collections.abc import Callable, Iterable
from contextlib import suppress

from tfbus.buffer.buffer import Buffer
from tfbus.bus.query import Answer
from tfbus.bus.session import Session
from tfbus.errors import BusError
from tfbus.listen.reception import StreamReception
from tfbus.runtime.executor import Executor
from tfbus.wire.keys import kept_transforms_selector

_KEPT_WITHIN_S = 5.0
# The way to a stream that was just met may not be open for questions.
_ASK_AGAIN_S = (0.1, 0.4, 1.0)

# Lookups of the past wait no longer than this for a stream's history.
_EXPECTED_WITHIN_S = 5.0


class _Expected:
    """The past of one stream, as long as it may come: how many questions for it are open, and
    what tells the buffer that it comes no more.
    """

    def __init__(self, end: Callable[[], None]) -> None:
        self.end = end
        self.questions = 0


class AskedHistory:
    """Asks streams for their last `history_s` seconds; where that is 0 it does nothing.

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
        self._lock = threading.Lock()
        self._closed = False
        # Keys that were asked for, and the streams that they are of.
        self._asked: set[str] = set()
        self._streams: set[str] = set()
        self._expected: dict[str, _Expected] = {}

    def close(self) -> None:
        """Expect no more. Twice is fine."""
        self._closed = True
        for stream, expected in list(self._expected.items()):
            self._expect_no_more(stream, expected)

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
            self._executor.after(_EXPECTED_WITHIN_S, lambda: self._expect_no_more(stream, made))
        else:
            made.end()

    def keeps_nothing(self, stream: str) -> None:
        """The stream says that there is nothing to ask it for."""
        expected = self._expected.get(stream)
        if expected is not None and not expected.questions:
            self._expect_no_more(stream, expected)

    def leave(self, keys: Iterable[str], stream: str) -> None:
        """Have the keys asked for again when the stream is there again, or is read again."""
        self._asked.difference_update(keys)
        self._streams.discard(stream)

    def ask(self, key: str, stream: StreamReception) -> None:
        """Ask for what was sent on a key, unless that was done."""
        if not self._history_s or key in self._asked:
            return
        self._asked.add(key)
        self._streams.add(stream.name)
        self.expect(stream.name)
        with self._lock:
            expected = self._expected.get(stream.name)
            if expected is not None:
                expected.questions += 1
        self._ask(key, stream, expected, _ASK_AGAIN_S)

    def _ask(
        self,
        key: str,
        stream: StreamReception,
        expected: _Expected | None,
        pauses_s: tuple[float, ...],
    ) -> None:
        """Ask until there is an answer; a stream that has sent nothing so far gives none."""
        is_answered = False

        def on_answer(answer: Answer) -> None:
            nonlocal is_answered
            if answer.refusal is None and key in self._asked:
                is_answered = True
                stream.receive_kept(answer.payload)

        def on_end() -> None:
            if pauses_s and not is_answered:
                self._executor.after(pauses_s[0], ask_again)
            else:
                self._end_question(stream.name, expected)

        def ask_again() -> None:
            if key in self._asked:
                self._ask(key, stream, expected, pauses_s[1:])
            else:
                self._end_question(stream.name, expected)

        with suppress(BusError):  # the session has been closed, and the listener with it
            self._session.ask_later(
                kept_transforms_selector(key, self._history_s),
                None,
                on_answer,
                on_end,
                timeout_s=_KEPT_WITHIN_S,
            )

    def _end_question(self, stream: str, expected: _Expected | None) -> None:
        if expected is None:
            return
        with self._lock:
            expected.questions -= 1
            is_last = not expected.questions
        if is_last:
            self._expect_no_more(stream, expected)

    def _expect_no_more(self, stream: str, expected: _Expected) -> None:
        with self._lock:
            if self._expected.get(stream) is not expected:
                return
            del self._expected[stream]
        expected.end()
