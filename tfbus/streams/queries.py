"""Queries to the publishers of streams: descriptions, static transforms, and kept transforms.

If many peers meet at once, the declaration of a queryable may be lost for good
(eclipse-zenoh/zenoh#2516): no query reaches it by that link, also none of Zenoh's own. So each
thing that a stream retains has two queryables, and queries alternate between them.

Zenoh sends retained messages to peers that join, and requests lost ones again. But if many peers
meet at once, its request may precede the route to the publisher, or the publisher's queryable may
be lost for good: then no answer comes, and nothing is sent again until something changes. A static
transform is sent once, so here the descriptions of streams are the check.
"""

import logging
import math
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
from tfbus.bus.retained import retained_selector
from tfbus.bus.session import Session
from tfbus.streams.reception import StreamReception
from tfbus.wire.codec import encode_message
from tfbus.wire.descriptions import FramesAsked
from tfbus.wire.keys import (
    description_selector,
    kept_transforms_selector,
    may_describe,
    page_selector,
    static_transforms_key_beside,
)
from tfbus.wire.pages import Page, decode_page, is_page

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


class PagesInTurn:
    """Has at most a few pages asked for at once: of many, the next once one has come, or has not
    come for a while.
    """

    def __init__(self, executor: Executor, most: int = 8, lost_after_s: float = 1.0) -> None:
        self._executor = executor
        self._most = most
        self._lost_after_s = lost_after_s
        self._lock = scheduler.Lock()
        self._waiting: deque[Callable[[Callable[[], None]], None]] = deque()
        self._open = 0

    def take(self, ask: Callable[[Callable[[], None]], None]) -> None:
        """Call `ask(on_end)` once it is its turn, which ends with `on_end()`."""
        with self._lock:
            if self._open >= self._most:
                self._waiting.append(ask)
                return
            self._open += 1
        self._begin(ask)

    def _begin(self, ask: Callable[[Callable[[], None]], None]) -> None:
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

    `selector()` asks for all of them, and is called for each page. `on_messages(page, sender_key)`
    is called for each page, on Zenoh's thread, and `on_message(payload)` for each answer that is
    none, as from earlier versions, which answer with all messages; without it only pages are
    answers. `on_over()` is called once;
    then `is_complete` says whether all have come, and `place` where to go on.
    """

    def __init__(
        self,
        session: Session,
        executor: Executor,
        selector: Callable[[], str],
        *,
        on_page: Callable[[Page, str], object],
        on_message: Callable[[Answer], object] | None,
        on_over: Callable[[], object],
        turns: PagesInTurn,
        place: str = "",
        payload: bytes | None = None,
    ) -> None:
        self._session = session
        self._executor = executor
        self._selector = selector
        self._on_page = on_page
        self._on_message = on_message
        self._on_over = on_over
        self._turns = turns
        self._payload = payload
        self._bytes = _FIRST_PAGE
        self._quickest_s = math.inf
        self.place = place
        self.is_complete = self.is_over = False
        self._page: _AskPage | None = None

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
            self._on_over()

    def _take(self, answer: Answer, took_s: float) -> bool:
        """Take an answer; whether it is one."""
        if not is_page(answer.payload):
            if self._on_message is None:
                return False
            # All messages come so, one by one.
            self.is_complete = True
            self._on_message(answer)
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
        self._on_page(page, answer.key)
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

    def _ask_now(self, on_end: OnEnd, end_turn: Callable[[], None]) -> None:
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
                page_selector(pages._selector(), pages._bytes, pages.place),
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
        if key in self._missing and self._asked.get(key, ...) is None and not self._closed:
            self._miss(key, silent_s)
            self._begin(key, stream)

    def _miss(self, key: str, silent_s: float) -> None:
        missing = self._missing[key]
        # Until all that was wanted at first has been asked for, it is still asked for.
        if all(each.place for each in missing):
            missing.append(_Missing(scheduler.monotonic() - silent_s - _OVERLAP_S))

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
        asking = self._asked[key] = self._asking(key, stream, expected)
        asking.start()

    def _asking(self, key: str, stream: StreamReception, expected: _Expected | None) -> AskPages:
        """Asks until there is an answer; a stream that has sent nothing so far gives none."""
        missing = self._missing[key]
        first = missing[0]

        def selector() -> str:
            last_s = self._history_s
            if first.since_s is not None:
                last_s = min(last_s, scheduler.monotonic() - first.since_s)
            return kept_transforms_selector(key, last_s)

        def take(page: Page, _: str) -> None:
            first.place = page.next
            for message in page.messages:
                stream.receive_kept(message.payload)

        def on_over() -> None:
            self._end_question(stream.name, expected)
            if self._asked.get(key) is not asking:
                return
            # Also a time that no publisher answers for: it has sent nothing, or does not know.
            del missing[:1]
            self._asked[key] = None
            if missing and not self._closed:
                self._missing.setdefault(key, missing)  # it may have made room for other keys
                self._begin(key, stream)

        asking = AskPages(
            self._session,
            self._executor,
            selector,
            on_page=take,
            on_message=lambda answer: stream.receive_kept(answer.payload),
            on_over=on_over,
            turns=self._turns,
            place=first.place,
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
