"""The streams on the bus, by their liveliness tokens and descriptions, without their data."""

import logging
import math
from collections import Counter
from collections.abc import Callable, Set
from contextlib import suppress

from tfbus.base import scheduler
from tfbus.base.bounded import Bounded
from tfbus.base.errors import BusError
from tfbus.base.executor import Executor
from tfbus.base.log import LogOnce
from tfbus.base.own_pauses import own_pauses
from tfbus.base.structs import replace
from tfbus.bus.query import Answer
from tfbus.bus.retained import declare_signed_subscriber
from tfbus.bus.session import ENDS_LATE_S, Session
from tfbus.streams.description_queries import (
    DescriptionQueries,
    FairQueue,
    Received,
    WantedStreams,
)
from tfbus.streams.frame_names import StreamRights
from tfbus.streams.info import StreamState
from tfbus.streams.owners import Owners
from tfbus.streams.stream_states import StreamStates
from tfbus.wire.keys import ALL_STREAMS, ALL_STREAMS_EVERYWHERE, namespace_of, stream_of

# News of a token may arrive in the wrong order, moments apart: times are kept of this many tokens.
_MOST_NEWS = 1000

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

    If several sessions describe themselves as its publisher, `Owners` says which of them is taken;
    descriptions by others at its key are `rejected`.

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
        self._session = session
        self._on_change = on_change
        self._on_unwanted = on_unwanted
        log = log or logging.getLogger(__name__)
        # No questions in a callback of Zenoh, which may hold locks.
        self._executor = executor or Executor("streams", log)
        self._pauses = own_pauses()
        self._pauses.watch(self._executor)
        key = ALL_STREAMS_EVERYWHERE if everywhere else ALL_STREAMS
        self._wanted = (
            WantedStreams(session, self._executor, self._look_whether_wanted)
            if only_wanted
            else None
        )
        rights = StreamRights.of_settings(session.settings)
        self._states = StreamStates(LogOnce(log), rights, self._report, self._forget_wanted)
        self._owners = Owners(session, self._executor, self._states)
        # The tokens that are there.
        self._living: set[str] = set()
        self._queries = DescriptionQueries(
            session,
            self._executor,
            self._states,
            self._owners,
            all_keys=key,
            living=self._living if only_wanted else None,
        )
        # When the latest news of a token came.
        self._news_s: Bounded[str, float] = Bounded(_MOST_NEWS)
        # The questions whether a token that was reported gone is still there, by its key.
        self._checks: dict[str, object] = {}
        self._received = FairQueue()
        self._descriptions = declare_signed_subscriber(
            session, key, self._on_description, only_new=only_wanted
        )
        self._tokens = session.watch_living(key, self._on_token)

    @property
    def rejected(self) -> Counter[str]:
        """How many descriptions were rejected, by their stream; "" for unknown streams."""
        return self._states.rejected

    def streams(self) -> dict[str, StreamState]:
        """All streams by their names, the last thousand gone ones among them."""
        return self._states.as_dict()

    def want(self, namespaces: Set[str], frames: Set[str]) -> None:
        """Watch the streams of these namespaces, and all that list one of these child frames, as
        the streams call them; others no longer. Call it on the executor's thread.
        """
        if self._wanted is None or self._states.is_closed:
            return
        new = self._wanted.want(namespaces, frames)
        for state in self._states.as_dict().values():
            if state.alive and namespace_of(state.key) in new:
                self._ask_about(state.key)
            elif state.description is not None and self._wanted.lets_go(
                state.key, state.description
            ):
                self._queries.end(state.key)
                self._states.returning.pop(state.name, None)
                left = StreamState(state.name, state.alive, None, state.key, silent=state.silent)
                self._states.store(left)
                self._on_unwanted(left)

    def _report(self, state: StreamState) -> None:
        if self._is_wanted(state.key):
            self._on_change(state)

    def _forget_wanted(self, state: StreamState) -> None:
        if self._wanted is not None:
            self._wanted.forget(state.key)

    def ask_again(self, key: str, epoch_ns: int) -> None:
        """Ask for the description of this epoch: another process publishes the stream now. Call it
        on the executor's thread.
        """
        self._queries.ask(key, epoch_ns)

    def ask_for_epoch(self, name: str, epoch_ns: int) -> None:
        """Ask whether a session publishes this epoch of a stream; from any thread, at once."""
        self._owners.ask_for_epoch(name, epoch_ns)

    def has_token(self, key: str) -> bool:
        """Whether this token is there now."""
        return key in self._living

    def is_asking(self, key: str) -> bool:
        """Whether a question about the stream of this token is open, or is to be asked."""
        return self._queries.is_asking(key) or self._owners.is_asking(key)

    def take_for_alive(self, key: str) -> None:
        """Take a stream that sends for alive, as if its token had come. Call it on the executor's
        thread.
        """
        if not self._states.is_closed:
            self._take_token(key, True, scheduler.monotonic())

    def take_for_gone(self, key: str) -> None:
        """Take a stream without a token for gone. Call it on the executor's thread."""
        if not self._states.is_closed and key not in self._living:
            self._take_token(key, False, scheduler.monotonic())

    def forget(self, key: str) -> None:
        """Forget the description of the stream of this token, until another comes. Call it on the
        executor's thread.
        """
        state = self._states.known(stream_of(key))
        if state is not None:
            self._states.store(replace(state, description=None, confirmed=False))
            self._queries.end(key)

    def close(self) -> None:
        """Stop watching. Twice is fine."""
        self._states.is_closed = True
        self._tokens.close()
        self._descriptions.close()
        self._executor.close()

    def _on_token(self, key: str, alive: bool) -> None:
        if self._states.is_name(key):
            came_s = scheduler.monotonic()
            self._executor.submit(_WHAT, self._note_token, key, alive, came_s)

    def _on_description(self, key: str, payload: bytes, sender: str = "") -> None:
        received = Received(key, payload, sender, scheduler.monotonic())
        if self._states.is_name(key) and self._received.enqueue(received):
            self._executor.submit(_WHAT, self._read_next)

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
            if description := self._states.read(received.key, received.payload):
                self._owners.take(received.key, description, received.sender)
        finally:
            if self._received.has_more():
                self._executor.submit(_WHAT, self._read_next)

    def _is_wanted(self, key: str) -> bool:
        return self._wanted is None or key in self._wanted

    def _look_whether_wanted(self, answer: Answer) -> None:
        """Look whether a stream of another namespace lists a frame that is wanted."""
        if self._states.is_closed or self._wanted is None or not self._wanted.frames:
            return
        description = self._states.read(answer.key, answer.payload)
        is_found = description is not None and self._wanted.finds(answer.key, description)
        if is_found and self._states.of(answer.key).alive:
            self._ask_about(answer.key)

    def _precedes_token(self, received: Received) -> bool:
        """Whether a description came before a token that is back, and so may be of the process of
        before: the answer that the token asks for is newer.
        """
        token_s = self._states.returning.get(stream_of(received.key))
        return token_s is not None and received.came_s < token_s

    def _note_token(self, key: str, alive: bool, came_s: float) -> None:
        # The end of a process and the begin of the next come on two threads of Zenoh, of which the
        # former may be the last to get here.
        latest_s = self._news_s.get(key, -math.inf)
        if came_s < latest_s:
            return
        self._news_s[key] = came_s
        has_time = self._gone_after_s or self._pauses.left_s()
        if not alive and has_time and self._states.of(key).alive:
            self._fall_silent(key, came_s)
            return
        self._change_token(key, alive, came_s)
        if not alive and came_s < latest_s + ENDS_LATE_S:
            self._check_end(key)

    def _fall_silent(self, key: str, came_s: float) -> None:
        """A token is lost, perhaps with a link: its stream is gone if it is not back in a while."""
        self._living.discard(key)
        self._queries.end(key)
        self._states.change(replace(self._states.of(key), silent=True))

        def end() -> None:
            # Any later news of the token, or messages that went on, have ended the silence.
            state = self._states.of(key)
            if self._news_s.get(key) == came_s and state.silent and not self._states.is_closed:
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
                if is_there and not self._states.is_closed:
                    self._change_token(key, True, scheduler.monotonic())

        def on_end(living: list[str]) -> None:
            self._executor.submit(_WHAT, take, key in living)

        with suppress(BusError):  # the session is closed
            self._session.living_later(key, on_end)

    def _change_token(self, key: str, alive: bool, came_s: float) -> None:
        self._checks.pop(key, None)
        (self._living.add if alive else self._living.discard)(key)
        self._take_token(key, alive, came_s)

    def _take_token(self, key: str, alive: bool, came_s: float) -> None:
        former = self._states.of(key)
        self._states.returning.pop(former.name, None)
        if not alive or former.alive or former.description is None:
            # Behind a token that is back after a silence there may be another process.
            confirmed = former.confirmed and not former.silent
            self._states.change(
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
            self._states.returning[former.name] = came_s
            # It may be another process, which need not be able to sign its description.
            self._states.store(replace(former, confirmed=False, displaced="", held=False))
        self._queries.end(key)
        if alive:
            self._ask_about(key)

    def _ask_about(self, key: str) -> None:
        if self._wanted is not None and key not in self._wanted:
            self._wanted.meet(key)
        else:
            self._queries.begin(key)
