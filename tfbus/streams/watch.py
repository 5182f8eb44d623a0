"""The streams on the bus, by their liveliness tokens and descriptions, without their data."""

import logging
import math
from collections import Counter
from collections.abc import Callable, Set
from contextlib import suppress

from tfbus.base import scheduler
from tfbus.base.bounded import Bounded
from tfbus.base.errors import BusError, DecodeError
from tfbus.base.executor import Executor
from tfbus.base.log import LogOnce
from tfbus.base.names import is_printable
from tfbus.base.own_pauses import own_pauses
from tfbus.base.structs import replace
from tfbus.base.wording import printable, stamp_text
from tfbus.bus.query import Answer, AskUntil, Pauses
from tfbus.bus.retained import declare_signed_subscriber
from tfbus.bus.session import Session
from tfbus.streams.frame_names import StreamRights
from tfbus.streams.info import MOST_GONE, StreamState
from tfbus.streams.queries import (
    ANSWER_WITHIN_S,
    PATIENT_FROM_TURN,
    ask_for_description,
    ask_for_descriptions,
)
from tfbus.streams.stream_facts import is_from_future
from tfbus.streams.wanted import FairQueue, Received, WantedStreams
from tfbus.wire.descriptions import StreamDescription, read_description
from tfbus.wire.keys import ALL_STREAMS, ALL_STREAMS_EVERYWHERE, namespace_of, stream_of

# News of a token may arrive in the wrong order, moments apart: times are kept of this many tokens.
_MOST_NEWS = 1000
# News this soon after a token appeared that it is gone may be about the previous process's token.
_ENDS_LATE_S = 10.0

# A token may come before its publisher can answer, or has anything to describe.
_PAUSES = Pauses((0.1, 0.4, 1.0, 2.0, 4.0, 8.0), forever=True, lost_after_s=0.5)
# One that is back is taken for the same if this many questions end without a description, one after
# the other: about 1.5 s, or 12 s where each takes 2 s. Questions that overlap count as one.
_PATIENCE = 4

# An epoch that is disputed is confirmed soon, or never; and any peer can dispute.
_CLAIM_PAUSES = Pauses((0.1, 0.4, 1.0), lost_after_s=0.5)
_MOST_CLAIMS = 100
_CLAIMS_APART_S = 1.0
# If two sessions publish a stream and one ends, no token says so: the watch asks this often.
_OWNER_RECHECKS_APART_S = 4.0

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

# A question has one answer, or a few where several processes publish the stream.
_MOST_ANSWERS = 16

_WHAT = "a stream"


class StreamWatch:
    """Watches which streams there are; closed by `close()` or the session's end.

    `on_change(state)` is called after each change of one stream, one call at a time, on a thread
    of its own, or that of the `executor` given. With `everywhere` the streams of all namespaces
    below are watched. On a network on which links are lost for a while, and after a pause of this
    process itself, a stream whose token is lost is `silent` before it is gone; it is not gone as
    long as `is_heard(name, last_s)`, whether a message of it came in the last seconds. Descriptions
    that cannot be read are counted in `rejected` by their stream, and the first is logged.

    A token that comes back may be a new process's, which the last description does not
    describe. So with each token the description is asked for, until one comes, readable or not; a
    stream that comes back is alive as soon as it has come.

    Any peer can send a description at any key. Once the session that a description names has sent
    it, only that session changes it, or another session by a description of its own with a later
    epoch: a second process that publishes the stream. If the first shows then that it is there,
    by messages that go on and by its answer, no other session takes the stream over as long as it
    answers; neither does one with a later epoch in the future. Descriptions by others at the key
    are `rejected`. While both answer, the watch asks every few seconds which of them are left: no
    token shows that one of them has ended.

    With `only_wanted`, descriptions are asked for, and changes reported, only of the streams that
    `want` names. Of all others no more than the token is known: one that is wanted no longer is
    reported once more, without its description, by `on_unwanted(state)`.
    """

    def __init__(
        self,
        session: Session,
        on_change: Callable[[StreamState], None],
        *,
        everywhere: bool = False,
        only_wanted: bool = False,
        log: logging.Logger | None = None,
        executor: Executor | None = None,
        is_heard: Callable[[str, float], bool] = lambda name, last_s: False,
        on_unwanted: Callable[[StreamState], object] = lambda state: None,
    ) -> None:
        self._gone_after_s = session.network.gone_after_s
        self._is_heard = is_heard
        self.rejected: Counter[str] = Counter()
        self._rights = StreamRights.of_settings(session.settings)
        self._session = session
        self._on_change = on_change
        self._on_unwanted = on_unwanted
        log = log or logging.getLogger(__name__)
        self._once = LogOnce(log)
        self._states: dict[str, StreamState] = {}
        self._gone: Bounded[str, None] = Bounded(MOST_GONE, lambda name, _: self._evict(name))
        # When the tokens came that are back, and whose descriptions are not there so far.
        self._returning: dict[str, float] = {}
        # The tokens that are there.
        self._living: set[str] = set()
        # When the latest news of a token came.
        self._news_s: Bounded[str, float] = Bounded(_MOST_NEWS)
        # The questions whether a token that was reported gone is still there, by its key.
        self._checks: dict[str, object] = {}
        # The questions about the token that is there now, by its key.
        self._asking: dict[str, AskUntil] = {}
        # Tokens whose description is to be asked for, the oldest first.
        self._to_ask: dict[str, None] = {}
        # The keys that wait for the next question for all streams, and the keys of the open
        # question, with the descriptions of before; None for no question.
        self._gathered: dict[str, None] = {}
        self._asked_together: dict[str, StreamDescription | None] | None = None
        # The questions about disputed epochs, by their stream's key.
        self._claims: dict[str, AskUntil] = {}
        # The questions whether the owner of a stream still answers, likewise.
        self._challenges: dict[str, AskUntil] = {}
        # The streams of several sessions, whose owners will be asked again if they are there.
        self._rechecked: set[str] = set()
        self._received = FairQueue()
        self._closed = False
        # No questions in a callback of Zenoh, which may hold locks.
        self._executor = executor or Executor("streams", log)
        self._pauses = own_pauses()
        self._pauses.watch(self._executor)
        self._wanted = (
            WantedStreams(session, self._executor, self._look_whether_wanted)
            if only_wanted
            else None
        )
        self._keys = key = ALL_STREAMS_EVERYWHERE if everywhere else ALL_STREAMS
        self._descriptions = declare_signed_subscriber(
            session, key, self._on_description, only_new=only_wanted
        )
        self._tokens = session.watch_living(key, self._on_token)

    def streams(self) -> dict[str, StreamState]:
        """All streams by their names, the last thousand gone ones among them."""
        return dict(self._states)

    def want(self, namespaces: Set[str], frames: Set[str]) -> None:
        """Watch the streams of these namespaces, and all that list one of these child frames, as
        the streams call them; others no longer. Call it on the executor's thread.
        """
        if self._wanted is None or self._closed:
            return
        new = self._wanted.want(namespaces, frames)
        for state in [*self._states.values()]:
            if state.alive and namespace_of(state.key) in new:
                self._ask_about(state.key)
            elif state.description is not None and self._wanted.lets_go(
                state.key, state.description
            ):
                self._end_questions(state.key)
                self._returning.pop(state.name, None)
                left = StreamState(state.name, state.alive, None, state.key, silent=state.silent)
                self._states[state.name] = left
                self._on_unwanted(left)

    def _evict(self, name: str) -> None:
        """Forget a stream that is long gone."""
        state = self._states.pop(name)
        self.rejected.pop(name, None)
        if self._wanted is not None:
            self._wanted.forget(state.key)

    def ask_again(self, key: str, epoch_ns: int) -> None:
        """Ask for the description of this epoch: another process publishes the stream now. Call it
        on the executor's thread.
        """
        self._ask_for_description(key, epoch_ns)

    def ask_for_epoch(self, name: str, epoch_ns: int) -> None:
        """Ask whether a session publishes this epoch of a stream; from any thread, at once."""
        self._executor.submit(
            "a disputed epoch", lambda: self._ask_for_epoch(name, epoch_ns), limit=_MOST_CLAIMS
        )

    def has_token(self, key: str) -> bool:
        """Whether this token is there now."""
        return key in self._living

    def is_asking(self, key: str) -> bool:
        """Whether a question about the stream of this token is open, or is to be asked."""
        return any(key in q for q in (self._asking, self._to_ask, self._claims, self._challenges))

    def take_for_alive(self, key: str) -> None:
        """Take a stream that sends for alive, as if its token had come. Call it on the executor's
        thread.
        """
        if not self._closed:
            self._take_token(key, True, scheduler.monotonic())

    def take_for_gone(self, key: str) -> None:
        """Take a stream without a token for gone. Call it on the executor's thread."""
        if not self._closed and key not in self._living:
            self._take_token(key, False, scheduler.monotonic())

    def forget(self, key: str) -> None:
        """Forget the description of the stream of this token, until another comes. Call it on the
        executor's thread.
        """
        state = self._states.get(stream_of(key))
        if state is not None:
            self._states[state.name] = replace(state, description=None, confirmed=False)
            self._end_questions(key)

    def close(self) -> None:
        """Stop watching. Twice is fine."""
        self._closed = True
        self._tokens.close()
        self._descriptions.close()
        self._executor.close()

    def _do(self, job: Callable[[], None]) -> None:
        self._executor.submit(_WHAT, job)

    def _on_token(self, key: str, alive: bool) -> None:
        if self._is_name(key):
            came_s = scheduler.monotonic()
            self._do(lambda: self._note_token(key, alive, came_s))

    def _on_description(self, key: str, payload: bytes, sender: str = "") -> None:
        received = Received(key, payload, sender, scheduler.monotonic())
        if self._is_name(key) and self._received.enqueue(received):
            self._do(self._read_next)

    def _read_next(self) -> None:
        """Read one description: a token that comes meanwhile waits only for this one."""
        received = self._received.dequeue()
        if received is None:
            return
        try:
            if not self._is_wanted(received.key):
                self._look_whether_wanted(Answer(received.key, received.payload))
                return
            if self._precedes_token(received):
                return
            if description := self._read(received.key, received.payload):
                self._take_description(received.key, description, received.sender)
        finally:
            if self._received.has_more():
                self._do(self._read_next)

    def _is_wanted(self, key: str) -> bool:
        return self._wanted is None or key in self._wanted

    def _look_whether_wanted(self, answer: Answer) -> None:
        """Look whether a stream of another namespace lists a frame that is wanted."""
        if self._closed or self._wanted is None or not self._wanted.frames:
            return
        description = self._read(answer.key, answer.payload)
        is_found = description is not None and self._wanted.finds(answer.key, description)
        if is_found and self._state(answer.key).alive:
            self._ask_about(answer.key)

    def _precedes_token(self, received: Received) -> bool:
        """Whether a description came before a token that is back, and so may be of the process of
        before: the answer that the token asks for is newer.
        """
        token_s = self._returning.get(stream_of(received.key))
        return token_s is not None and received.came_s < token_s

    def _is_name(self, key: str) -> bool:
        name = stream_of(key)
        if is_printable(name):
            return True
        self._once.warning("name", "Ignored a stream: its name %r cannot be shown", name[:300])
        return False

    def _read(self, key: str, payload: bytes) -> StreamDescription | None:
        try:
            description, mistake = read_description(payload)
        except DecodeError as error:
            self._reject(stream_of(key), error)
            if state := self._states.get(stream_of(key)):
                self._states[state.name] = replace(state, unreadable=printable(str(error)))
            return None
        if mistake:
            self._once.warning(
                ("frame", stream_of(key)),
                "Ignored a frame of stream %r: it %s",
                stream_of(key),
                mistake,
            )
        return description if self._rights is None else self._allowed(key, description)

    def _allowed(self, key: str, description: StreamDescription) -> StreamDescription | None:
        assert self._rights is not None
        allowed, mistake = self._rights.checked(key, description)
        if mistake:
            self._once.warning(
                ("rights", stream_of(key)),
                "Refused what stream %r says of itself: it %s, by the rights of this bus",
                stream_of(key),
                mistake,
            )
        return allowed

    def _note_token(self, key: str, alive: bool, came_s: float) -> None:
        # The end of a process and the begin of the next come on two threads of Zenoh, of which the
        # former may be the last to get here.
        latest_s = self._news_s.get(key, -math.inf)
        if came_s < latest_s:
            return
        self._news_s[key] = came_s
        has_time = self._gone_after_s or self._pauses.left_s()
        if not alive and has_time and self._state(key).alive:
            self._fall_silent(key, came_s)
            return
        self._change_token(key, alive, came_s)
        if not alive and came_s < latest_s + _ENDS_LATE_S:
            self._check_end(key)

    def _fall_silent(self, key: str, came_s: float) -> None:
        """A token is lost, perhaps with a link: its stream is gone if it is not back in a while."""
        self._living.discard(key)
        self._end_questions(key)
        self._set(replace(self._state(key), silent=True))

        def end() -> None:
            # Any later news of the token, or messages that went on, have ended the silence.
            state = self._state(key)
            if self._news_s.get(key) == came_s and state.silent and not self._closed:
                if self._is_heard(state.name, self._gone_after_s):
                    self._pauses.after(self._executor, self._gone_after_s, end)
                else:
                    self._change_token(key, False, came_s)
                    self._check_end(key)

        self._pauses.after(self._executor, self._gone_after_s, end)

    def _check_end(self, key: str) -> None:
        """Ask whether a token that was reported gone is still there: the report may be about the
        previous process's token, and late because its thread had to wait for a processor.
        """
        check = self._checks[key] = object()

        def take(is_there: bool) -> None:
            # Any news of the token in the meantime is newer.
            if self._checks.get(key) is check:
                del self._checks[key]
                if is_there and not self._closed:
                    self._change_token(key, True, scheduler.monotonic())

        def on_end(living: list[str]) -> None:
            self._do(lambda: take(key in living))

        with suppress(BusError):  # the session is closed
            self._session.living_later(key, on_end)

    def _change_token(self, key: str, alive: bool, came_s: float) -> None:
        self._checks.pop(key, None)
        (self._living.add if alive else self._living.discard)(key)
        self._take_token(key, alive, came_s)

    def _take_token(self, key: str, alive: bool, came_s: float) -> None:
        former = self._state(key)
        self._returning.pop(former.name, None)
        if not alive or former.alive or former.description is None:
            # Behind a token that is back after a silence there may be another process.
            confirmed = former.confirmed and not former.silent
            self._set(
                replace(
                    former,
                    alive=alive,
                    confirmed=confirmed,
                    displaced="",
                    held=False,
                    silent=False,
                )
            )
        else:
            self._returning[former.name] = came_s
            # It may be another process, which need not be able to sign its description.
            self._states[former.name] = replace(former, confirmed=False, displaced="", held=False)
        self._end_questions(key)
        if alive:
            self._ask_about(key)

    def _ask_about(self, key: str) -> None:
        if self._wanted is not None and key not in self._wanted:
            self._wanted.meet(key)
        elif len(self._asking) < _FEW_ASKED:
            self._ask_for_description(key)
        else:
            self._gather(key)

    def _take_description(
        self,
        key: str,
        description: StreamDescription,
        sender: str = "",
        *,
        asked_epoch_ns: int | None = None,
        owner_is_silent: bool = False,
    ) -> None:
        """Take a description from a session; the one of the epoch that was asked for also if it
        is an earlier one.
        """
        former = self._state(key)
        is_own = bool(sender) and sender == description.session
        if former.owner and not is_own:
            self._reject(former.name, "it is not from the session that publishes the stream")
            # Unless it is: a session that cannot sign its messages signs its answers.
            self._ask_for_epoch(former.name, description.epoch)
            return
        held, displaced = former.held and sender == former.owner, former.displaced
        if former.owner and former.alive and sender != former.owner and former.description:
            is_later = description.epoch > former.description.epoch
            if not is_later and description.epoch != asked_epoch_ns:
                return
            # A new process on a host whose clock is wrong, unless the owner is still there.
            is_doubtful = former.held or is_from_future(description.epoch)
            if is_later and is_doubtful and not owner_is_silent:
                self._ask_owner(former, description, sender)
                return
            # An earlier epoch is asked for where its messages go on beside the later one.
            held = not is_later and sender == displaced
            displaced = (displaced or former.owner) if is_later else ""
        alive = former.alive or former.name in self._returning
        self._returning.pop(former.name, None)
        self._set(StreamState(former.name, alive, description, former.key, is_own, displaced, held))
        if former.owner and former.alive and sender != former.owner:
            self._recheck_owner_later(former.key)

    def _recheck_owner_later(self, key: str) -> None:
        """Ask in a while which of the sessions that publish a stream are left."""
        if key not in self._rechecked and len(self._rechecked) < _MOST_CLAIMS and not self._closed:
            self._rechecked.add(key)
            self._executor.after(_OWNER_RECHECKS_APART_S, lambda: self._recheck_owner(key))

    def _recheck_owner(self, key: str) -> None:
        """Have another session take the stream over if it answers, and the owner does not."""
        owner = self._state(key).owner
        answers: dict[str, Answer] = {}

        def ask(turn: int, on_end: Callable[[], None]) -> None:
            ask_for_description(self._session, key, turn, on_answer, on_end)

        def on_answer(answer: Answer) -> None:
            if answer.refusal is None and len(answers) < _MOST_ANSWERS:
                answers[answer.sender] = answer

        def on_over() -> None:
            self._rechecked.discard(key)
            others = [answer for sender, answer in list(answers.items()) if sender != owner]
            if owner not in answers and self._state(key).owner == owner and not self._closed:
                self._take_one_of(key, others)
            if others or owner not in answers:
                self._recheck_owner_later(key)

        if not self._state(key).alive:
            self._rechecked.discard(key)
            return
        AskUntil(
            self._executor,
            _WHAT,
            _CLAIM_PAUSES,
            ask=ask,
            is_settled=lambda: self._closed or (owner in answers and len(answers) > 1),
            on_over=on_over,
        ).start()

    def _take_one_of(self, key: str, answers: list[Answer]) -> None:
        """Take the latest of these descriptions, each from the session that it names."""
        read = [(self._read(key, answer.payload), answer.sender) for answer in answers]
        found = [(each, sender) for each, sender in read if each and each.session == sender]
        if found:
            description, sender = max(found, key=_rank)
            self._take_description(
                key, description, sender, asked_epoch_ns=description.epoch, owner_is_silent=True
            )

    def _ask_owner(
        self, state: StreamState, description: StreamDescription, challenger: str
    ) -> None:
        """Have another session take the stream over, if it answers and the owner does not.

        Its description may be of before it ended: it has waited while this process was stopped.
        """
        key, owner = state.key, state.owner
        answering: set[str] = set()
        if key in self._challenges or len(self._challenges) >= _MOST_CLAIMS or self._closed:
            return

        def ask(turn: int, on_end: Callable[[], None]) -> None:
            ask_for_description(self._session, key, turn, on_answer, on_end)

        def on_answer(answer: Answer) -> None:
            if answer.refusal is None and answer.sender in (owner, challenger):
                answering.add(answer.sender)

        def forget() -> None:
            self._challenges.pop(key, None)

        def on_over() -> None:
            self._executor.after(_CLAIMS_APART_S, forget)
            if owner in answering:
                self._reject(state.name, "the session that publishes the stream is there, too")
            elif challenger in answering and self._state(key).owner == owner and not self._closed:
                self._take_description(key, description, challenger, owner_is_silent=True)

        asking = self._challenges[key] = AskUntil(
            self._executor,
            _WHAT,
            _CLAIM_PAUSES,
            ask=ask,
            is_settled=lambda: self._closed or owner in answering,
            on_over=on_over,
        )
        asking.start()

    def _ask_for_epoch(self, name: str, epoch_ns: int) -> None:
        state = self._states.get(name)
        if state is None or self._closed or state.key in self._claims:
            return
        if len(self._claims) >= _MOST_CLAIMS:
            return
        key, known, is_confirmed, answers = state.key, state.description, False, 0

        def ask(turn: int, on_end: Callable[[], None]) -> None:
            nonlocal known
            known = self._state(key).description
            ask_for_description(self._session, key, turn, on_answer, on_end)

        def on_answer(answer: Answer) -> None:
            nonlocal answers
            answers += answer.refusal is None
            if answer.refusal is None and answers <= _MOST_ANSWERS:
                self._do(lambda: take(answer))

        def take(answer: Answer) -> None:
            nonlocal is_confirmed
            description = self._read(key, answer.payload)
            if description is not None and answer.sender == description.session:
                is_confirmed |= description.epoch == epoch_ns
                state = self._state(key)
                is_same = state.owner == answer.sender and _epoch_of(state) == description.epoch
                # One that has come by itself since the question may be newer than the answer.
                if not is_same or state.description is known:
                    self._take_description(key, description, answer.sender, asked_epoch_ns=epoch_ns)

        def forget() -> None:
            self._claims.pop(key, None)

        def on_over() -> None:
            self._executor.after(_CLAIMS_APART_S, forget)
            if not is_confirmed and not self._closed:
                self._once.warning(
                    ("epoch", name),
                    "Dropped messages of stream %r with the epoch %s: no process that publishes "
                    "the stream confirms it. Another process sends on its key",
                    name,
                    stamp_text(epoch_ns),
                )

        asking = self._claims[key] = AskUntil(
            self._executor,
            _WHAT,
            _CLAIM_PAUSES,
            ask=ask,
            is_settled=lambda: self._closed or is_confirmed,
            on_over=on_over,
        )
        asking.start()

    def _gather(self, key: str) -> None:
        """Have the description asked for together with others."""
        self._gathered[key] = None
        if len(self._gathered) == 1 and self._asked_together is None:
            self._executor.after(_GATHERED_FOR_S, self._ask_together)

    def _ask_together(self) -> None:
        """Ask for the descriptions of all gathered tokens, then one by one for missing ones. An
        answer counts for a token that was there before the question.
        """
        if self._closed or self._asked_together is not None or not self._gathered:
            return
        waiting = {key: self._state(key).description for key in self._gathered}
        self._gathered.clear()
        if self._wanted is not None and 2 * len(waiting) < len(self._living):
            # Most of the answers would be about others.
            for key in waiting:
                self._ask_for_description(key)
            return
        self._asked_together = waiting
        answers: dict[str, dict[str, Answer]] = {}

        def on_answer(answer: Answer) -> None:
            if answer.refusal is None and answer.key in waiting:
                by = answers.setdefault(answer.key, {})
                if len(by) < _MOST_ANSWERS or answer.sender in by:
                    by[answer.sender] = answer

        def take() -> None:
            for key in [key for key in waiting if key in answers]:
                known = waiting.pop(key)
                state = self._state(key)
                # One that has come by itself in the meantime is at least as new.
                if not self._closed and (state.description is known or not state.confirmed):
                    self._take_best(key, [*answers[key].values()])

        def end() -> None:
            take()
            self._asked_together = None
            self._to_ask.update(dict.fromkeys(waiting))
            if self._gathered:
                self._executor.after(_GATHERED_FOR_S, self._ask_together)
            self._ask_next()

        with suppress(BusError):  # the session is closed
            ask_for_descriptions(self._session, self._keys, on_answer, lambda: self._do(end))
            self._executor.after(_TAKEN_AFTER_S, take)

    def _take_best(self, key: str, answers: list[Answer]) -> None:
        """Take the best of all answers about a stream."""
        read = [(self._read(key, answer.payload), answer.sender) for answer in answers]
        readable = [(description, sender) for description, sender in read if description]
        if not readable:
            self._take_back(key)
            return
        self._take_description(key, *max(readable, key=_rank))
        if len(readable) > 1:
            self._recheck_owner_later(key)

    def _ask_for_description(self, key: str, epoch_ns: int | None = None) -> None:
        """Ask for the retained description: Zenoh requests it for later publishers too, but not
        at keys that begin with `@`. With an epoch, the description of that one among several
        publishers is reported even if it was known before.
        """
        if epoch_ns is None and key not in self._asking and len(self._asking) >= _MOST_ASKED:
            self._to_ask[key] = None
            return
        known = self._state(key).description
        answers: dict[str, StreamDescription | None] = {}
        asked = ended = next_to_count = 0

        def ask(turn: int, on_end: Callable[[], None]) -> None:
            nonlocal asked
            asked = turn
            if turn >= _TURNS and self._to_ask and epoch_ns is None:
                self._to_ask[key] = None
                asking.close()
                on_end()
                return

            def end() -> None:
                on_end()
                # After the answers of this question have been looked at.
                self._do(lambda: count_end(turn))

            ask_for_description(self._session, key, turn, on_answer, end)
            if turn >= PATIENT_FROM_TURN:
                self._executor.after(ANSWER_WITHIN_S, lambda: count_end(turn))

        def count_end(turn: int) -> None:
            nonlocal ended, next_to_count
            if not asking.is_over and turn >= next_to_count:
                next_to_count = asked + 1
                ended += 1
                if ended >= _PATIENCE:
                    self._take_back(key)

        def on_answer(answer: Answer) -> None:
            has_room = len(answers) < _MOST_ANSWERS or answer.sender in answers
            if answer.refusal is None and has_room:
                answers[answer.sender] = self._read(key, answer.payload)

        def is_settled() -> bool:
            if self._closed:
                return True
            state = self._state(key)
            if state.description is not known and (state.confirmed or asked >= _TURNS_TO_SIGN):
                # One that has come by itself in the meantime is at least as new.
                return True
            readable = [(answer, sender) for sender, answer in list(answers.items()) if answer]
            if epoch_ns is not None:
                readable = [each for each in readable if each[0].epoch == epoch_ns]
            if readable:
                if epoch_ns is not None:
                    self._states[stream_of(key)] = replace(self._state(key), description=None)
                self._take_description(key, *max(readable, key=_rank))
                if len(readable) > 1:
                    self._recheck_owner_later(key)
            elif answers:
                self._take_back(key)
            return bool(answers if epoch_ns is None else readable)

        self._end_questions(key)

        def on_over() -> None:
            if self._asking.get(key) is asking:
                del self._asking[key]
            self._ask_next()

        asking = self._asking[key] = AskUntil(
            self._executor, _WHAT, _PAUSES, ask=ask, is_settled=is_settled, on_over=on_over
        )
        asking.start()

    def _ask_next(self) -> None:
        while self._to_ask and len(self._asking) < _MOST_ASKED and not self._closed:
            key = next(iter(self._to_ask))
            del self._to_ask[key]
            self._ask_for_description(key)

    def _end_questions(self, key: str) -> None:
        self._to_ask.pop(key, None)
        self._gathered.pop(key, None)
        if self._asked_together is not None:
            self._asked_together.pop(key, None)
        asking = self._asking.pop(key, None)
        if asking is not None:
            asking.close()

    def _take_back(self, key: str) -> None:
        """No description comes: the last one stands."""
        former = self._state(key)
        if former.name in self._returning:
            del self._returning[former.name]
            self._set(replace(former, alive=True))

    def _state(self, key: str) -> StreamState:
        name = stream_of(key)
        return self._states.get(name) or StreamState(name, key=key)

    def _set(self, state: StreamState) -> None:
        if state == self._states.get(state.name):
            return
        self._states[state.name] = state
        self._gone.pop(state.name, None)
        if not state.alive:
            self._gone[state.name] = None
        if self._is_wanted(state.key):
            self._on_change(state)

    def _reject(self, stream: str, error: DecodeError | str) -> None:
        self.rejected[stream if stream in self._states else ""] += 1
        self._once.warning(
            ("rejected", stream), "Dropped the description of stream %r: %s", stream, error
        )


def _rank(answer: tuple[StreamDescription, str]) -> tuple[bool, int]:
    """Of several answers: one from the session that it names, then the latest."""
    description, sender = answer
    return bool(sender) and sender == description.session, description.epoch


def _epoch_of(state: StreamState) -> int | None:
    return None if state.description is None else state.description.epoch
