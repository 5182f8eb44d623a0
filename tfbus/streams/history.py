"""Queries for kept messages, page by page, and the history of streams that a listener asks for."""

import math
from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Iterable
from functools import partial

from tfbus.base import scheduler
from tfbus.base.bounded import Bounded
from tfbus.base.errors import BusError, DecodeError
from tfbus.base.executor import Executor
from tfbus.base.structs import Struct
from tfbus.buffer.buffer import Buffer
from tfbus.bus.query import Answer, AskUntil, OnEnd, Pauses
from tfbus.bus.session import Session
from tfbus.streams.reception import StreamReception
from tfbus.wire.keys import kept_transforms_selector, page_selector
from tfbus.wire.pages import Page, decode_page, is_page

_KEPT_WITHIN_S = 5.0
# The route to a stream that was just met may not be open for questions yet.
_HISTORY_PAUSES = Pauses((0.1, 0.4, 1.0))
# Who has answered once has more.
_GOING_ON_PAUSES = Pauses((0.1, 0.4, 1.0, 2.0, 4.0))

# The first page is small: it takes about a round trip. One after a page that took hardly longer has
# twice as many bytes, one after a page that took much longer half as many: messages sent now wait
# for no more, as a link sends one thing after the other.
_FIRST_PAGE = 4_000
_LEAST_PAGE, _LARGEST_PAGE = 1_000, 1_000_000
_HARDLY_S, _MUCH_S = 0.15, 0.4


# Asks for a page, and calls `on_end` at the end of the question.
Ask = Callable[[OnEnd], None]


class PagesInTurn:
    """Has at most a few pages asked for at once: of many, the next once one has come, or has not
    come for a while.
    """

    def __init__(self, executor: Executor, most: int = 8, lost_after_s: float = 1.0) -> None:
        self._executor = executor
        self._most = most
        self._lost_after_s = lost_after_s
        self._lock = scheduler.Lock()
        self._waiting: deque[Ask] = deque()
        self._open = 0

    def take(self, ask: Ask) -> None:
        """Call `ask(on_end)` once it is its turn, which ends with `on_end()`."""
        with self._lock:
            if self._open >= self._most:
                self._waiting.append(ask)
                return
            self._open += 1
        self._begin(ask)

    def _begin(self, ask: Ask) -> None:
        is_over = False

        def end() -> None:
            nonlocal is_over
            with self._lock:
                if is_over:
                    return
                is_over = True
                lost.cancel()
                following = self._waiting.popleft() if self._waiting else None
                self._open -= following is None
            if following is not None:
                self._executor.submit("history", self._begin, following)

        lost = self._executor.after(self._lost_after_s, end)
        ask(end)


class AskPages:
    """Asks for kept messages, page by page, until the last has come, `close()`, or no answer does.

    A subclass says what is asked, and takes the answers on Zenoh's thread. At the end
    `is_complete` says whether all have come, and `place` where to go on.
    """

    def __init__(
        self,
        session: Session,
        executor: Executor,
        turns: PagesInTurn,
        *,
        place: str = "",
        payload: bytes | None = None,
    ) -> None:
        self._session = session
        self._executor = executor
        self._turns = turns
        self._payload = payload
        self._bytes = _FIRST_PAGE
        self._quickest_s = math.inf
        self.place = place
        self.is_complete = self.is_over = False
        self._page: _AskPage | None = None

    @abstractmethod
    def selector(self) -> str:
        """The selector of all messages; called for each page."""

    @abstractmethod
    def on_page(self, page: Page) -> None:
        """A page has come."""

    def on_message(self, answer: Answer) -> bool:
        """An answer has come that is no page, as from earlier versions, which answer with all
        messages one by one; whether it is taken.
        """
        return False

    @abstractmethod
    def on_over(self) -> None:
        """Nothing further is asked for; called once."""

    def start(self) -> None:
        """Ask for the first page, on the calling thread."""
        self._page = _AskPage(self)
        self._page.start()

    def close(self) -> None:
        """Ask no further. Twice is fine."""
        if not self.is_over:
            self.is_over = True
            if self._page is not None:
                self._page.close()
            self.on_over()

    def _take(self, answer: Answer, took_s: float) -> bool:
        """Take an answer; whether it is one."""
        if not is_page(answer.payload):
            if not self.on_message(answer):
                return False
            self.is_complete = True
            return True
        try:
            page = decode_page(answer.payload)
        except DecodeError:
            return False
        if page.next and page.next == self.place:
            return False  # it would come again for ever
        self.place, self.is_complete = page.next, not page.next
        self._quickest_s = min(self._quickest_s, took_s)
        longer_s = took_s - self._quickest_s
        self._resize(2.0 if longer_s < _HARDLY_S else 0.5 if longer_s > _MUCH_S else 1.0)
        self.on_page(page)
        return True

    def _resize(self, factor: float) -> None:
        self._bytes = min(max(int(self._bytes * factor), _LEAST_PAGE), _LARGEST_PAGE)


class _AskPage(AskUntil):
    """Asks for the next page, each time when it is its turn."""

    def __init__(self, pages: AskPages) -> None:
        pauses = _GOING_ON_PAUSES if pages.place else _HISTORY_PAUSES
        super().__init__(pages._executor, "history", pauses)
        self._pages = pages
        self._is_answered = False

    def ask(self, turn: int, on_end: OnEnd) -> None:
        self._pages._turns.take(partial(self._ask_now, on_end))

    def _ask_now(self, on_end: OnEnd, end_turn: OnEnd) -> None:
        pages, asked_s = self._pages, scheduler.monotonic()

        def receive(answer: Answer) -> None:
            took_s = scheduler.monotonic() - asked_s
            if answer.refusal is None and not pages.is_over and pages._page is self:
                self._is_answered = pages._take(answer, took_s) or self._is_answered

        def end() -> None:
            end_turn()
            on_end()

        try:
            pages._session.ask_later(
                page_selector(pages.selector(), pages._bytes, pages.place),
                pages._payload,
                receive,
                end,
                timeout_s=_KEPT_WITHIN_S,
                priority="background",
            )
        except BusError:  # the session is closed, or no further page is wanted
            end_turn()
        except BaseException:
            end_turn()
            pages.close()
            raise

    def is_settled(self) -> bool:
        return self._is_answered

    def on_unanswered(self, turn: int) -> None:
        self._pages._resize(0.5)

    def on_over(self) -> None:
        pages = self._pages
        if pages.is_over or pages._page is not self:
            return
        if self._is_answered and not pages.is_complete:
            pages.start()
        else:
            pages.close()


# Lookups of the past wait at most this long for a stream's history.
_EXPECTED_WITHIN_S = 5.0

# The last messages before a link went silent may not have come: so much more is asked for.
_OVERLAP_S = 3.0

# Keys come from the bus: the missing times of at most as many are kept.
_MOST_MISSING = 10_000


class _Expected:
    """The past of one stream while it may come: the count of open questions for it, and `end`,
    which ends the buffer's wait for it.
    """

    def __init__(self, end: Callable[[], None]) -> None:
        self.end = end
        self.questions = 0


class _Missing(Struct, frozen=False):
    """A part of the past that is not there: all since a time by the monotonic clock, None for as
    much as is wanted; from a place on that a page has named, if some has come before a cut.
    """

    since_s: float | None = None
    place: str = ""


def _since(silent_s: float) -> _Missing:
    """The part since a silence began."""
    return _Missing(scheduler.monotonic() - silent_s - _OVERLAP_S)


class AskedHistory:
    """Requests the last `history_s` seconds of streams, by pages; if that is 0 it does nothing.

    Of a stream that was lost and is back it requests the missing times: former answers stay, and so
    do messages that came by themselves until the link was silent.

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
        self._turns = PagesInTurn(executor)
        # By key; and the streams that the keys are of.
        self._asked: dict[str, AskPages | None] = {}
        self._missing: Bounded[str, list[_Missing]] = Bounded(_MOST_MISSING)
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
            self._executor.after(_EXPECTED_WITHIN_S, self._stop_expecting, stream, made)
        else:
            made.end()

    def keeps_nothing(self, stream: str) -> None:
        """The stream says that it keeps no history."""
        expected = self._expected.get(stream)
        if expected is not None and not expected.questions:
            self._stop_expecting(stream, expected)

    def leave(self, keys: Iterable[str], stream: str, silent_s: float | None = None) -> None:
        """Have the keys asked for again when the stream is back, or is read again: for all; or for
        the missing times, if the transforms stay and none came for the last `silent_s` seconds.
        """
        for key in keys:
            asking = self._asked.pop(key, None)
            if asking is not None:
                asking.close()
            if silent_s is None:
                self._missing.pop(key, None)
            elif key in self._missing:
                self._miss(key, silent_s)
        self._streams.discard(stream)

    def miss(self, key: str, stream: StreamReception, silent_s: float) -> None:
        """Messages are missing on a key from the last seconds, though the stream was never lost."""
        if key not in self._missing or key not in self._asked or self._closed:
            return
        if self._asked[key] is None:
            self._miss(key, silent_s)
            self._begin(key, stream)
        elif len(missing := self._missing[key]) == 1:
            # The question under way knows nothing of it; the next one has later gaps, too.
            missing.append(_since(silent_s))

    def _miss(self, key: str, silent_s: float) -> None:
        missing = self._missing[key]
        # Until all that was wanted at first has been asked for, it is still asked for.
        if all(each.place for each in missing):
            missing.append(_since(silent_s))

    def ask(self, key: str, stream: StreamReception) -> None:
        """Ask for the earlier messages of a key, unless that was done."""
        if not self._history_s or key in self._asked:
            return
        self._streams.add(stream.name)
        self._missing.setdefault(key, [_Missing()])
        self._begin(key, stream)

    def _begin(self, key: str, stream: StreamReception) -> None:
        """Ask for the first part that is missing on a key, and then for the next."""
        self.expect(stream.name)
        with self._lock:
            expected = self._expected.get(stream.name)
            if expected is not None:
                expected.questions += 1
        asking = self._asked[key] = _AskHistory(self, key, stream, expected)
        asking.start()

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


class _AskHistory(AskPages):
    """Asks for the first part that is missing on a key of a stream, until there is an answer; a
    stream that has sent nothing so far gives none.
    """

    def __init__(
        self, history: AskedHistory, key: str, stream: StreamReception, expected: _Expected | None
    ) -> None:
        missing = history._missing[key]
        first = missing[0]
        super().__init__(history._session, history._executor, history._turns, place=first.place)
        self._history = history
        self._key = key
        self._stream = stream
        self._expected = expected
        self._missing = missing
        self._first = first

    def selector(self) -> str:
        last_s, since_s = self._history._history_s, self._first.since_s
        if since_s is not None:
            last_s = min(last_s, scheduler.monotonic() - since_s)
        return kept_transforms_selector(self._key, last_s)

    def on_page(self, page: Page) -> None:
        self._first.place = page.next
        for message in page.messages:
            self._stream.receive_kept(message.payload)

    def on_message(self, answer: Answer) -> bool:
        self._stream.receive_kept(answer.payload)
        return True

    def on_over(self) -> None:
        history, key, missing = self._history, self._key, self._missing
        history._end_question(self._stream.name, self._expected)
        if history._asked.get(key) is not self:
            return
        # Also a time that no publisher answers for: it has sent nothing, or does not know.
        del missing[:1]
        history._asked[key] = None
        if missing and not history._closed:
            history._missing.setdefault(key, missing)  # it may have made room for other keys
            history._begin(key, self._stream)
