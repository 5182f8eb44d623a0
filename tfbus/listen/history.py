"""The history of streams before a listener met them; lookups of the past wait for it."""

from collections.abc import Callable, Iterable

from tfbus.buffer.buffer import Buffer
from tfbus.bus.ask_until import AskUntil, Pauses
from tfbus.bus.query import Answer
from tfbus.bus.session import Session
from tfbus.listen.reception import StreamReception
from tfbus.runtime import scheduler
from tfbus.runtime.executor import Executor
from tfbus.wire.keys import kept_transforms_selector

_KEPT_WITHIN_S = 5.0
# The route to a stream that was just met may not be open for questions yet.
_PAUSES = Pauses((0.1, 0.4, 1.0))

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
            _PAUSES,
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
