"""Which session publishes a stream, if several describe themselves as its publisher."""

from collections.abc import Callable

from tfbus.base.executor import Executor
from tfbus.base.wording import stamp_text
from tfbus.bus.query import Answer, AskUntil, Pauses
from tfbus.bus.session import Session
from tfbus.streams.info import StreamState
from tfbus.streams.queries import ask_for_description
from tfbus.streams.stream_facts import is_from_future
from tfbus.streams.stream_states import StreamStates
from tfbus.wire.descriptions import StreamDescription

# An epoch that is disputed is confirmed soon, or never; and any peer can dispute.
_CLAIM_PAUSES = Pauses((0.1, 0.4, 1.0), lost_after_s=0.5)
_MOST_CLAIMS = 100
_CLAIMS_APART_S = 1.0
# If two sessions publish a stream and one ends, no token says so: the watch asks this often.
_OWNER_RECHECKS_APART_S = 4.0

# A question has one answer, or a few where several processes publish the stream.
MOST_ANSWERS = 16

_WHAT = "a stream"


class Owners:
    """Takes the descriptions of streams, and asks whose is to be taken if several sessions answer.

    Any peer can send a description at any key. Once the session that a description names has sent
    it, that session owns the stream: only it changes the description, or another session by a
    description of its own with a later epoch. If the owner shows then that it is there, no other
    session takes the stream over as long as it answers; neither does one with a later epoch in the
    future. While both answer, they are asked every few seconds which of them are left.

    All but `ask_for_epoch` runs on the executor's thread.
    """

    def __init__(self, session: Session, executor: Executor, states: StreamStates) -> None:
        self._session = session
        self._executor = executor
        self._states = states
        # The questions about disputed epochs, by their stream's key.
        self._claims: dict[str, AskUntil] = {}
        # The questions whether the owner of a stream still answers, likewise.
        self._challenges: dict[str, AskUntil] = {}
        # The streams of several sessions, whose owners will be asked again if they are there.
        self._rechecked: set[str] = set()

    def is_asking(self, key: str) -> bool:
        """Whether a question who publishes the stream of this token is open."""
        return key in self._claims or key in self._challenges

    def take_best(self, key: str, readable: list[tuple[StreamDescription, str]]) -> None:
        """Take the best of at least one description, each with the session that has sent it."""
        self.take(key, *max(readable, key=_rank))
        if len(readable) > 1:
            self._recheck_later(key)

    def take(
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
        states = self._states
        former = states.of(key)
        is_own = bool(sender) and sender == description.session
        if former.owner and not is_own:
            states.reject(former.name, "it is not from the session that publishes the stream")
            # Unless it is: a session that cannot sign its messages signs its answers.
            self.ask_for_epoch(former.name, description.epoch)
            return
        held, displaced = former.held and sender == former.owner, former.displaced
        if former.owner and former.alive and sender != former.owner and former.description:
            is_later = description.epoch > former.description.epoch
            if not is_later and description.epoch != asked_epoch_ns:
                return
            # A new process on a host whose clock is wrong, unless the owner is still there.
            is_doubtful = former.held or is_from_future(description.epoch)
            if is_later and is_doubtful and not owner_is_silent:
                self._challenge(former, description, sender)
                return
            # An earlier epoch is asked for where its messages go on beside the later one.
            held = not is_later and sender == displaced
            displaced = (displaced or former.owner) if is_later else ""
        alive = former.alive or former.name in states.returning
        states.returning.pop(former.name, None)
        # It does not end a silence: it may have waited while this process was stopped.
        states.change(
            StreamState(
                *(former.name, alive, description, former.key, is_own, displaced, held),
                silent=former.silent,
            )
        )
        if former.owner and former.alive and sender != former.owner:
            self._recheck_later(former.key)

    def _recheck_later(self, key: str) -> None:
        """Ask in a while which of the sessions that publish a stream are left."""
        has_room = len(self._rechecked) < _MOST_CLAIMS
        if key not in self._rechecked and has_room and not self._states.is_closed:
            self._rechecked.add(key)
            self._executor.after(_OWNER_RECHECKS_APART_S, lambda: self._recheck(key))

    def _recheck(self, key: str) -> None:
        """Have another session take the stream over if it answers, and the owner does not."""
        states = self._states
        owner = states.of(key).owner
        answers: dict[str, Answer] = {}

        def on_answer(answer: Answer) -> None:
            if answer.refusal is None and len(answers) < MOST_ANSWERS:
                answers[answer.sender] = answer

        def on_over() -> None:
            self._rechecked.discard(key)
            others = [answer for sender, answer in list(answers.items()) if sender != owner]
            if owner not in answers and states.of(key).owner == owner and not states.is_closed:
                self._take_one_of(key, others)
            if others or owner not in answers:
                self._recheck_later(key)

        if not states.of(key).alive:
            self._rechecked.discard(key)
            return
        self._asking(key, on_answer, lambda: owner in answers and len(answers) > 1, on_over).start()

    def _take_one_of(self, key: str, answers: list[Answer]) -> None:
        """Take the latest of these descriptions, each from the session that it names."""
        read = [(self._states.read(key, answer.payload), answer.sender) for answer in answers]
        found = [(each, sender) for each, sender in read if each and each.session == sender]
        if found:
            description, sender = max(found, key=_rank)
            self.take(
                key, description, sender, asked_epoch_ns=description.epoch, owner_is_silent=True
            )

    def _challenge(
        self, state: StreamState, description: StreamDescription, challenger: str
    ) -> None:
        """Have another session take the stream over, if it answers and the owner does not.

        Its description may be of before it ended: it has waited while this process was stopped.
        """
        states, key, owner = self._states, state.key, state.owner
        answering: set[str] = set()
        if key in self._challenges or len(self._challenges) >= _MOST_CLAIMS or states.is_closed:
            return

        def on_answer(answer: Answer) -> None:
            if answer.refusal is None and answer.sender in (owner, challenger):
                answering.add(answer.sender)

        def on_over() -> None:
            self._executor.after(_CLAIMS_APART_S, lambda: self._challenges.pop(key, None))
            if owner in answering:
                states.reject(state.name, "the session that publishes the stream is there, too")
            elif challenger not in answering or states.is_closed:
                return
            elif states.of(key).owner == owner:
                self.take(key, description, challenger, owner_is_silent=True)

        asking = self._asking(key, on_answer, lambda: owner in answering, on_over)
        self._challenges[key] = asking
        asking.start()

    def ask_for_epoch(self, name: str, epoch_ns: int) -> None:
        """Ask whether a session publishes this epoch of a stream; from any thread, at once."""
        self._executor.submit(
            "a disputed epoch", lambda: self._ask_for_epoch(name, epoch_ns), limit=_MOST_CLAIMS
        )

    def _ask_for_epoch(self, name: str, epoch_ns: int) -> None:
        states = self._states
        disputed = states.known(name)
        if disputed is None or states.is_closed or disputed.key in self._claims:
            return
        if len(self._claims) >= _MOST_CLAIMS:
            return
        key, known, is_confirmed, answers = disputed.key, disputed.description, False, 0

        def before_question() -> None:
            nonlocal known
            known = states.of(key).description

        def on_answer(answer: Answer) -> None:
            nonlocal answers
            answers += answer.refusal is None
            if answer.refusal is None and answers <= MOST_ANSWERS:
                self._executor.submit(_WHAT, lambda: take(answer))

        def take(answer: Answer) -> None:
            nonlocal is_confirmed
            description = states.read(key, answer.payload)
            if description is not None and answer.sender == description.session:
                is_confirmed |= description.epoch == epoch_ns
                state = states.of(key)
                is_same = state.owner == answer.sender and _epoch_of(state) == description.epoch
                # One that has come by itself since the question may be newer than the answer.
                if not is_same or state.description is known:
                    self.take(key, description, answer.sender, asked_epoch_ns=epoch_ns)

        def on_over() -> None:
            self._executor.after(_CLAIMS_APART_S, lambda: self._claims.pop(key, None))
            if not is_confirmed and not states.is_closed:
                states.once.warning(
                    ("epoch", name),
                    "Dropped messages of stream %r with the epoch %s: no process that publishes "
                    "the stream confirms it. Another process sends on its key",
                    name,
                    stamp_text(epoch_ns),
                )

        asking = self._asking(
            key, on_answer, lambda: is_confirmed, on_over, before_question=before_question
        )
        self._claims[key] = asking
        asking.start()

    def _asking(
        self,
        key: str,
        on_answer: Callable[[Answer], None],
        is_settled: Callable[[], bool],
        on_over: Callable[[], None],
        before_question: Callable[[], None] = lambda: None,
    ) -> AskUntil:
        """A few questions for the descriptions of all sessions that publish the stream."""

        def ask(turn: int, on_end: Callable[[], None]) -> None:
            before_question()
            ask_for_description(self._session, key, turn, on_answer, on_end)

        return AskUntil(
            self._executor,
            _WHAT,
            _CLAIM_PAUSES,
            ask=ask,
            is_settled=lambda: self._states.is_closed or is_settled(),
            on_over=on_over,
        )


def _rank(answer: tuple[StreamDescription, str]) -> tuple[bool, int]:
    """Of several answers: one from the session that it names, then the latest."""
    description, sender = answer
    return bool(sender) and sender == description.session, description.epoch


def _epoch_of(state: StreamState) -> int | None:
    return None if state.description is None else state.description.epoch
