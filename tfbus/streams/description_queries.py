"""Queries for the descriptions of streams, one by one, of a whole fleet at once, or of the streams
that list a frame; and the queue in which descriptions wait to be read.
"""

from collections import deque
from collections.abc import Callable, Set
from contextlib import suppress
from functools import partial
from typing import NamedTuple

from tfbus.base import scheduler
from tfbus.base.errors import BusError
from tfbus.base.executor import Executor
from tfbus.base.structs import replace
from tfbus.bus.query import Answer, AskUntil, OnEnd, Pauses
from tfbus.bus.session import Session
from tfbus.streams.owners import MOST_ANSWERS, Owners
from tfbus.streams.queries import (
    ANSWER_WITHIN_S,
    PATIENT_FROM_TURN,
    description_question,
    descriptions_question,
    listing_question,
)
from tfbus.streams.stream_states import StreamStates
from tfbus.wire.descriptions import StreamDescription
from tfbus.wire.keys import ALL_STREAMS_EVERYWHERE, namespace_of

# As much may wait as a thousand large streams say of themselves.
_MOST_BYTES = 64 * 2**20
_OVERHEAD_BYTES = 500


class Received(NamedTuple):
    """A description: the key that it came at, its bytes, the session it is from, "" for one
    that does not say, and when it came by a clock that never goes back.
    """

    key: str
    payload: bytes
    sender: str
    came_s: float = 0.0


class FairQueue:
    """Descriptions that wait, at most `most_bytes` of them; safe from any thread.

    However many one sender writes, the others have their turn after each. If there is no room
    the oldest of the sender that has most of them is thrown away. No other is: a frame that is in
    one description and not in the next was removed.
    """

    def __init__(self, most_bytes: int = _MOST_BYTES) -> None:
        self._most_bytes = most_bytes
        self._lock = scheduler.Lock()
        self._waiting: dict[str, deque[Received]] = {}
        self._sums: dict[str, int] = {}
        self._bytes = 0
        self._is_read = False

    def enqueue(self, received: Received) -> bool:
        """Add a description; whether the reading has to begin.

        It goes on until `has_more` is False.
        """
        with self._lock:
            self._waiting.setdefault(received.sender, deque()).append(received)
            self._count(received.sender, _size(received))
            while self._bytes > self._most_bytes:
                self._dequeue_from(max(self._sums, key=self._sums.__getitem__))
            was_read, self._is_read = self._is_read, True
            return not was_read

    def has_more(self) -> bool:
        """Whether a description waits; if none does, the reading ends until the next."""
        with self._lock:
            self._is_read = bool(self._waiting)
            return self._is_read

    def dequeue(self) -> Received | None:
        """The next of the sender whose turn it is; None for none, which ends the reading."""
        with self._lock:
            sender = next(iter(self._waiting), None)
            if sender is None:
                self._is_read = False
                return None
            received = self._dequeue_from(sender)
            if sender in self._waiting:
                self._waiting[sender] = self._waiting.pop(sender)
            return received

    def _dequeue_from(self, sender: str) -> Received:
        received = self._waiting[sender].popleft()
        self._count(sender, -_size(received))
        if not self._waiting[sender]:
            del self._waiting[sender], self._sums[sender]
        return received

    def _count(self, sender: str, more: int) -> None:
        self._sums[sender] = self._sums.get(sender, 0) + more
        self._bytes += more


def _size(received: Received) -> int:
    return len(received.payload) + _OVERHEAD_BYTES


# A token may come before its publisher can answer, or has anything to describe.
_PAUSES = Pauses((0.1, 0.4, 1.0, 2.0, 4.0, 8.0), forever=True, lost_after_s=0.5)
# One that is back is taken for the same if this many questions end without a description, one after
# the other: about 1.5 s, or 12 s where each takes 2 s. Questions that overlap count as one.
_PATIENCE = 4

# The descriptions of at most this many tokens are asked for at a time. Where further ones wait, one
# that has been asked for five times gives way, and waits again.
_MOST_ASKED = 200
_TURNS = 5
# Tokens beyond this number of questions belong to a fleet: they are gathered for this
# time and asked about by one question for all streams, of which the answers so far are then taken.
_FEW_ASKED = 20
_GATHERED_FOR_S = 0.1
_TAKEN_AFTER_S = 0.5

# One that comes by itself and is not signed is taken; one that is may come for this many turns.
_TURNS_TO_SIGN = 2

_WHAT = "a stream"


class DescriptionQueries:
    """Asks for the description of each stream it is given, until one comes, readable or not.

    `all_keys` are the keys of all streams that are watched; `living` are the tokens that are there,
    None if all of them are wanted. All of it runs on the executor's thread.
    """

    def __init__(
        self,
        session: Session,
        executor: Executor,
        states: StreamStates,
        owners: Owners,
        *,
        all_keys: str,
        living: Set[str] | None,
    ) -> None:
        self._session = session
        self._executor = executor
        self._states = states
        self._owners = owners
        self._all_keys = all_keys
        self._living = living
        # The questions about the token that is there now, by its key.
        self._asking: dict[str, AskUntil] = {}
        # Tokens whose description is to be asked for, the oldest first.
        self._to_ask: dict[str, None] = {}
        # The keys that wait for the next question for all streams, and the keys of the open
        # question, with the descriptions of before; None for no question.
        self._gathered: dict[str, None] = {}
        self._asked_together: dict[str, StreamDescription | None] | None = None

    def is_asking(self, key: str) -> bool:
        """Whether a question for the description of this token is open, or is to be asked."""
        return key in self._asking or key in self._to_ask

    def begin(self, key: str) -> None:
        """Ask for the description of the stream of this token, one of many together."""
        if len(self._asking) < _FEW_ASKED:
            self.ask(key)
        else:
            self._gather(key)

    def end(self, key: str) -> None:
        """Ask no further for the description of the stream of this token."""
        self._to_ask.pop(key, None)
        self._gathered.pop(key, None)
        if self._asked_together is not None:
            self._asked_together.pop(key, None)
        asking = self._asking.pop(key, None)
        if asking is not None:
            asking.close()

    def _gather(self, key: str) -> None:
        """Have the description asked for together with others."""
        self._gathered[key] = None
        if len(self._gathered) == 1 and self._asked_together is None:
            self._executor.after(_GATHERED_FOR_S, self._ask_together)

    def _ask_together(self) -> None:
        """Ask for the descriptions of all gathered tokens, then one by one for missing ones. An
        answer counts for a token that was there before the question.
        """
        states = self._states
        if states.is_closed or self._asked_together is not None or not self._gathered:
            return
        waiting = {key: states.of(key).description for key in self._gathered}
        self._gathered.clear()
        if self._living is not None and 2 * len(waiting) < len(self._living):
            # Most of the answers would be about others.
            for key in waiting:
                self.ask(key)
            return
        self._asked_together = waiting
        answers: dict[str, dict[str, Answer]] = {}

        def on_answer(answer: Answer) -> None:
            if answer.refusal is None and answer.key in waiting:
                by = answers.setdefault(answer.key, {})
                if len(by) < MOST_ANSWERS or answer.sender in by:
                    by[answer.sender] = answer

        def take() -> None:
            for key in [key for key in waiting if key in answers]:
                known = waiting.pop(key)
                state = states.of(key)
                # One that has come by itself in the meantime is at least as new.
                if not states.is_closed and (state.description is known or not state.confirmed):
                    self._take_best(key, [*answers[key].values()])

        def end() -> None:
            take()
            self._asked_together = None
            self._to_ask.update(dict.fromkeys(waiting))
            if self._gathered:
                self._executor.after(_GATHERED_FOR_S, self._ask_together)
            self._ask_next()

        with suppress(BusError):  # the session is closed
            question = descriptions_question(self._all_keys)
            question.ask(self._session, on_answer, partial(self._executor.submit, _WHAT, end))
            self._executor.after(_TAKEN_AFTER_S, take)

    def _take_best(self, key: str, answers: list[Answer]) -> None:
        """Take the best of all answers about a stream."""
        read = [(self._states.read(key, answer.payload), answer.sender) for answer in answers]
        readable = [(description, sender) for description, sender in read if description]
        if readable:
            self._owners.take_best(key, readable)
        else:
            self._states.take_back(key)

    def ask(self, key: str, epoch_ns: int | None = None) -> None:
        """Ask for the retained description: Zenoh requests it for later publishers too, but not
        at keys that begin with `@`. With an epoch, the description of that one among several
        publishers is reported even if it was known before.
        """
        if epoch_ns is None and key not in self._asking and len(self._asking) >= _MOST_ASKED:
            self._to_ask[key] = None
            return
        self.end(key)
        asking = self._asking[key] = _AskForDescription(self, key, epoch_ns)
        asking.start()

    def _ask_next(self) -> None:
        while self._to_ask and len(self._asking) < _MOST_ASKED and not self._states.is_closed:
            key = next(iter(self._to_ask))
            del self._to_ask[key]
            self.ask(key)


class _AskForDescription(AskUntil):
    """Asks for the description of the stream of a token; with an epoch, for that one's."""

    def __init__(self, queries: DescriptionQueries, key: str, epoch_ns: int | None) -> None:
        super().__init__(queries._executor, _WHAT, _PAUSES)
        self._queries = queries
        self._key = key
        self._epoch_ns = epoch_ns
        self._known = queries._states.of(key).description
        self._answers: dict[str, StreamDescription | None] = {}
        # The turn of the last question, how many questions have ended, and the first turn whose
        # end counts as another.
        self._asked = self._ended = self._next_to_count = 0

    def ask(self, turn: int, on_end: OnEnd) -> None:
        queries = self._queries
        self._asked = turn
        if turn >= _TURNS and queries._to_ask and self._epoch_ns is None:
            queries._to_ask[self._key] = None
            self.close()
            on_end()
            return

        def end() -> None:
            on_end()
            # After the answers of this question have been looked at.
            queries._executor.submit(_WHAT, self._count_end, turn)

        description_question(self._key, turn).ask(queries._session, self._receive, end)
        if turn >= PATIENT_FROM_TURN:
            queries._executor.after(ANSWER_WITHIN_S, self._count_end, turn)

    def _count_end(self, turn: int) -> None:
        if not self.is_over and turn >= self._next_to_count:
            self._next_to_count = self._asked + 1
            self._ended += 1
            if self._ended >= _PATIENCE:
                self._queries._states.take_back(self._key)

    def _receive(self, answer: Answer) -> None:
        has_room = len(self._answers) < MOST_ANSWERS or answer.sender in self._answers
        if answer.refusal is None and has_room:
            self._answers[answer.sender] = self._queries._states.read(self._key, answer.payload)

    def is_settled(self) -> bool:
        states, key, epoch_ns = self._queries._states, self._key, self._epoch_ns
        if states.is_closed:
            return True
        state = states.of(key)
        is_signed = state.confirmed or self._asked >= _TURNS_TO_SIGN
        if state.description is not self._known and is_signed:
            # One that has come by itself in the meantime is at least as new.
            return True
        readable = [(answer, sender) for sender, answer in list(self._answers.items()) if answer]
        if epoch_ns is not None:
            readable = [each for each in readable if each[0].epoch == epoch_ns]
        if readable:
            if epoch_ns is not None:
                states.store(replace(states.of(key), description=None))
            self._queries._owners.take_best(key, readable)
        elif self._answers:
            states.take_back(key)
        return bool(self._answers if epoch_ns is None else readable)

    def on_over(self) -> None:
        if self._queries._asking.get(self._key) is self:
            del self._queries._asking[self._key]
        self._queries._ask_next()


# If no stream lists a frame no answer comes, as if the question were lost: it is repeated.
_LIST_PAUSES = Pauses((0.4, 2.0), lost_after_s=0.5)
# More new tokens than these are asked by one question for all.
_FEW = 20

_WHICH = "streams that list a frame"


class WantedStreams:
    """The streams in some namespaces, and all streams that list one of some frames.

    Each stream that answers a question whether it lists them is given to `on_answer(answer)`, which
    may call `finds`. All that runs on the executor's thread. It remembers streams that `finds` has
    found until `lets_go`, or `forget`.
    """

    def __init__(
        self, session: Session, executor: Executor, on_answer: Callable[[Answer], None]
    ) -> None:
        self._session = session
        self._executor = executor
        self._on_answer = on_answer
        self._namespaces: frozenset[str] = frozenset()
        self.frames: frozenset[str] = frozenset()
        self._found: set[str] = set()
        # Tokens that are about to be asked whether they list one of the frames.
        self._met: dict[str, None] = {}

    def __contains__(self, key: str) -> bool:
        return key in self._found or namespace_of(key) in self._namespaces

    def want(self, namespaces: Set[str], frames: Set[str]) -> frozenset[str]:
        """Want these from now on, and no others; returns the namespaces that are new."""
        new, sought = frozenset(namespaces) - self._namespaces, frozenset(frames) - self.frames
        self._namespaces, self.frames = frozenset(namespaces), frozenset(frames)
        if sought:
            self._ask(ALL_STREAMS_EVERYWHERE, sought)
        return new

    def meet(self, key: str) -> None:
        """A token is there now that is not wanted so far."""
        if self.frames:
            self._met[key] = None
            if len(self._met) == 1:
                self._executor.after(_GATHERED_FOR_S, self._ask_met)

    def finds(self, key: str, description: StreamDescription) -> bool:
        """Whether a stream that was not wanted so far is, as it describes itself."""
        is_found = key not in self and any(row[1] in self.frames for row in description.frames)
        if is_found:
            self._found.add(key)
        return is_found

    def lets_go(self, key: str, description: StreamDescription) -> bool:
        """Whether a stream that describes itself so is wanted no longer."""
        self._found.discard(key)
        return key not in self and not self.finds(key, description)

    def forget(self, key: str) -> None:
        """A stream is long gone."""
        self._found.discard(key)

    def _ask_met(self) -> None:
        met = [*self._met]
        self._met.clear()
        for keys in met if len(met) <= _FEW else [ALL_STREAMS_EVERYWHERE]:
            self._ask(keys, self.frames)

    def _ask(self, keys: str, frames: frozenset[str]) -> None:
        _AskWhoLists(self, keys, frames).start()


class _AskWhoLists(AskUntil):
    """Asks the streams whose tokens lie within `keys` whether they list one of the frames."""

    def __init__(self, wanted: WantedStreams, keys: str, frames: frozenset[str]) -> None:
        super().__init__(wanted._executor, _WHICH, _LIST_PAUSES)
        self._wanted = wanted
        self._keys = keys
        self._frames = frames

    def ask(self, turn: int, on_end: OnEnd) -> None:
        question = listing_question(self._keys, self._frames)
        question.ask(self._wanted._session, self._receive, on_end)

    def _receive(self, answer: Answer) -> None:
        if answer.refusal is None:
            self._wanted._executor.submit(_WHICH, self._wanted._on_answer, answer)

    def is_settled(self) -> bool:
        return self._keys in self._wanted._found
