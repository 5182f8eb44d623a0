"""Which session publishes a stream, if several describe themselves as its publisher."""

from abc import abstractmethod

from tfbus.base.executor import Executor
from tfbus.base.wording import stamp_text
from tfbus.bus.query import Answer, AskUntil, OnEnd, Pauses
from tfbus.bus.session import Session
from tfbus.streams.info import StreamState
from tfbus.streams.queries import description_question
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
            self._executor.after(_OWNER_RECHECKS_APART_S, self._recheck, key)

    def _recheck(self, key: str) -> None:
        """Have another session take the stream over if it answers, and the owner does not."""
        if self._states.of(key).alive:
            _AskWhoIsLeft(self, key).start()
        else:
            self._rechecked.discard(key)

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
        has_room = len(self._challenges) < _MOST_CLAIMS and state.key not in self._challenges
        if has_room and not self._states.is_closed:
            asking = _AskOwner(self, state, description, challenger)
            self._challenges[state.key] = asking
            asking.start()

    def ask_for_epoch(self, name: str, epoch_ns: int) -> None:
        """Ask whether a session publishes this epoch of a stream; from any thread, at once."""
        self._executor.submit(
            "a disputed epoch", self._ask_for_epoch, name, epoch_ns, limit=_MOST_CLAIMS
        )

    def _ask_for_epoch(self, name: str, epoch_ns: int) -> None:
        disputed = self._states.known(name)
        if disputed is None or self._states.is_closed or disputed.key in self._claims:
            return
        if len(self._claims) < _MOST_CLAIMS:
            asking = self._claims[disputed.key] = _AskForEpoch(self, disputed, epoch_ns)
            asking.start()


class _AskOwners(AskUntil):
    """A few questions for the descriptions of all sessions that publish the stream of a token."""

    def __init__(self, owners: Owners, key: str) -> None:
        super().__init__(owners._executor, _WHAT, _CLAIM_PAUSES)
        self._owners = owners
        self._states = owners._states
        self._key = key

    def ask(self, turn: int, on_end: OnEnd) -> None:
        question = description_question(self._key, turn)
        question.ask(self._owners._session, self.receive, on_end)

    @abstractmethod
    def receive(self, answer: Answer) -> None:
        """An answer has come, or a refusal."""

    def is_settled(self) -> bool:
        return self._states.is_closed


class _AskWhoIsLeft(_AskOwners):
    """Asks which of the sessions that publish a stream are left."""

    def __init__(self, owners: Owners, key: str) -> None:
        super().__init__(owners, key)
        self._owner = self._states.of(key).owner
        self._answers: dict[str, Answer] = {}

    def receive(self, answer: Answer) -> None:
        if answer.refusal is None and len(self._answers) < MOST_ANSWERS:
            self._answers[answer.sender] = answer

    def is_settled(self) -> bool:
        return super().is_settled() or (self._owner in self._answers and len(self._answers) > 1)

    def on_over(self) -> None:
        owners, states, key = self._owners, self._states, self._key
        owners._rechecked.discard(key)
        answers = dict(self._answers)
        is_silent = answers.pop(self._owner, None) is None
        if is_silent and states.of(key).owner == self._owner and not states.is_closed:
            owners._take_one_of(key, list(answers.values()))
        if answers or is_silent:
            owners._recheck_later(key)


class _AskOwner(_AskOwners):
    """Asks whether the owner of a stream is still there, whom another session challenges."""

    def __init__(
        self, owners: Owners, state: StreamState, description: StreamDescription, challenger: str
    ) -> None:
        super().__init__(owners, state.key)
        self._stream, self._owner = state.name, state.owner
        self._description = description
        self._challenger = challenger
        self._answering: set[str] = set()

    def receive(self, answer: Answer) -> None:
        if answer.refusal is None and answer.sender in (self._owner, self._challenger):
            self._answering.add(answer.sender)

    def is_settled(self) -> bool:
        return super().is_settled() or self._owner in self._answering

    def on_over(self) -> None:
        owners, states, key = self._owners, self._states, self._key
        owners._executor.after(_CLAIMS_APART_S, owners._challenges.pop, key, None)
        if self._owner in self._answering:
            states.reject(self._stream, "the session that publishes the stream is there, too")
        elif self._challenger not in self._answering or states.is_closed:
            return
        elif states.of(key).owner == self._owner:
            owners.take(key, self._description, self._challenger, owner_is_silent=True)


class _AskForEpoch(_AskOwners):
    """Asks whether a session publishes an epoch of a stream."""

    def __init__(self, owners: Owners, disputed: StreamState, epoch_ns: int) -> None:
        super().__init__(owners, disputed.key)
        self._stream = disputed.name
        self._epoch_ns = epoch_ns
        self._known = disputed.description
        self._is_confirmed = False
        self._count = 0

    def ask(self, turn: int, on_end: OnEnd) -> None:
        self._known = self._states.of(self._key).description
        super().ask(turn, on_end)

    def receive(self, answer: Answer) -> None:
        self._count += answer.refusal is None
        if answer.refusal is None and self._count <= MOST_ANSWERS:
            self._owners._executor.submit(_WHAT, self._take, answer)

    def _take(self, answer: Answer) -> None:
        key, states = self._key, self._states
        description = states.read(key, answer.payload)
        if description is not None and answer.sender == description.session:
            self._is_confirmed |= description.epoch == self._epoch_ns
            state = states.of(key)
            is_same = state.owner == answer.sender and _epoch_of(state) == description.epoch
            # One that has come by itself since the question may be newer than the answer.
            if not is_same or state.description is self._known:
                self._owners.take(key, description, answer.sender, asked_epoch_ns=self._epoch_ns)

    def is_settled(self) -> bool:
        return super().is_settled() or self._is_confirmed

    def on_over(self) -> None:
        owners, states = self._owners, self._states
        owners._executor.after(_CLAIMS_APART_S, owners._claims.pop, self._key, None)
        if not self._is_confirmed and not states.is_closed:
            states.once.warning(
                ("epoch", self._stream),
                "Dropped messages of stream %r with the epoch %s: no process that publishes "
                "the stream confirms it. Another process sends on its key",
                self._stream,
                stamp_text(self._epoch_ns),
            )


def _rank(answer: tuple[StreamDescription, str]) -> tuple[bool, int]:
    """Of several answers: one from the session that it names, then the latest."""
    description, sender = answer
    return bool(sender) and sender == description.session, description.epoch


def _epoch_of(state: StreamState) -> int | None:
    return None if state.description is None else state.description.epoch
