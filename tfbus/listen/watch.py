"""Which streams there are, by their liveliness tokens and descriptions, without their data."""

import logging
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace

from tfbus.bus.ask_until import AskUntil, Pauses
from tfbus.bus.query import Answer
from tfbus.bus.retained import ask_retained_later, declare_retained_subscriber
from tfbus.bus.session import Session
from tfbus.errors import DecodeError
from tfbus.runtime.executor import Executor
from tfbus.runtime.log_once import LogOnce
from tfbus.wire.codec import decode_message
from tfbus.wire.descriptions import StreamDescription
from tfbus.wire.keys import ALL_STREAMS, ALL_STREAMS_EVERYWHERE, stream_of

# Streams come and go: at most this many of those that are gone are remembered.
MOST_GONE = 1000

# A token may come before its publisher can answer, or has anything to describe.
_ANSWER_WITHIN_S = 2.0
_PAUSES = Pauses((0.1, 0.4, 1.0, 2.0, 4.0, 8.0), forever=True, lost_after_s=0.5)
# One that is back is taken for the same if this many questions end without a description, one after
# the other: about 1.5 s, or 12 s where each takes 2 s. Questions that overlap count as one.
_PATIENCE = 4

_WHAT = "a stream"


@dataclass(frozen=True)
class StreamState:
    """A stream as it is now.

    `name` is as `stream_of` gives it: `sim`, or `robot7/sim` outside of the namespace. `alive`
    is whether its publisher is there. `description` is the last it has sent, None before the
    first. `key` is that of its token and its description.
    """

    name: str
    alive: bool = False
    description: StreamDescription | None = None
    key: str = ""


class StreamWatch:
    """Watches which streams there are; closed by `close()` or the session's end.

    `on_change(state)` is called after each change of one stream, one call at a time, on a thread
    of its own, or that of the `executor` given. With `everywhere` the streams of all namespaces
    below are watched. Descriptions that cannot be read are counted in `rejected` by their stream,
    and the first is logged.

    A token that comes back may be that of a new process, which the last description does not
    describe. So with each token the description is asked for, until one comes, readable or not; a
    stream that comes back is alive as soon as it has come.
    """

    def __init__(
        self,
        session: Session,
        on_change: Callable[[StreamState], None],
        *,
        everywhere: bool = False,
        log: logging.Logger | None = None,
        executor: Executor | None = None,
    ) -> None:
        self.rejected: Counter[str] = Counter()
        self._session = session
        self._on_change = on_change
        log = log or logging.getLogger(__name__)
        self._once = LogOnce(log)
        self._states: dict[str, StreamState] = {}
        self._gone: dict[str, None] = {}
        self._returning: set[str] = set()
        # The questions about the token that is there now, by its key.
        self._asking: dict[str, AskUntil] = {}
        self._closed = False
        # No questions in a callback of Zenoh, which may hold locks.
        self._executor = executor or Executor("streams", log)
        key = ALL_STREAMS_EVERYWHERE if everywhere else ALL_STREAMS
        self._descriptions = declare_retained_subscriber(session, key, self._on_description)
        self._tokens = session.watch_living(key, self._on_token)

    def streams(self) -> dict[str, StreamState]:
        """All streams by their names, the last thousand of those that are gone among them."""
        return dict(self._states)

    def ask_again(self, key: str, epoch_ns: int) -> None:
        """Ask for the description of this epoch: another process publishes the stream now. Call it
        on the executor's thread.
        """
        self._ask_for_description(key, epoch_ns)

    def close(self) -> None:
        """Stop watching. Twice is fine."""
        self._closed = True
        self._tokens.close()
        self._descriptions.close()
        self._executor.close()

    def _do(self, job: Callable[[], None]) -> None:
        self._executor.submit(_WHAT, job)

    def _on_token(self, key: str, alive: bool) -> None:
        self._do(lambda: self._take_token(key, alive))

    def _on_description(self, key: str, payload: bytes) -> None:
        if description := self._read(key, payload):
            self._do(lambda: self._take_description(key, description))

    def _read(self, key: str, payload: bytes) -> StreamDescription | None:
        try:
            return decode_message(StreamDescription, payload)
        except DecodeError as error:
            self._reject(stream_of(key), error)
            return None

    def _take_token(self, key: str, alive: bool) -> None:
        former = self._state(key)
        self._returning.discard(former.name)
        if not alive or former.alive or former.description is None:
            self._set(replace(former, alive=alive))
        else:
            self._returning.add(former.name)
        if alive:
            self._ask_for_description(key)
        else:
            self._end_questions(key)

    def _take_description(self, key: str, description: StreamDescription) -> None:
        former = self._state(key)
        alive = former.alive or former.name in self._returning
        self._returning.discard(former.name)
        self._set(replace(former, alive=alive, description=description))

    def _ask_for_description(self, key: str, epoch_ns: int | None = None) -> None:
        """Ask for the retained description: Zenoh requests it for later publishers too, but not
        at keys that begin with `@`. With an epoch, the description of that one among several
        publishers is reported even where it was known before.
        """
        known = self._state(key).description
        answers: list[StreamDescription | None] = []
        asked = ended = next_to_count = 0

        def ask(turn: int, on_end: Callable[[], None]) -> None:
            nonlocal asked
            asked = turn

            def end() -> None:
                on_end()
                # After the answers of this question have been looked at.
                self._do(lambda: count_end(turn))

            ask_retained_later(self._session, key, on_answer, end, timeout_s=_ANSWER_WITHIN_S)

        def count_end(turn: int) -> None:
            nonlocal ended, next_to_count
            if not asking.is_over and turn >= next_to_count:
                next_to_count = asked + 1
                ended += 1
                if ended >= _PATIENCE:
                    self._take_back(key)

        def on_answer(answer: Answer) -> None:
            if answer.refusal is None:
                answers.append(self._read(key, answer.payload))

        def is_settled() -> bool:
            if self._closed:
                return True
            if self._state(key).description is not known:
                # One that has come by itself in the meantime is at least as new.
                return True
            readable = [answer for answer in answers if answer]
            if epoch_ns is not None:
                readable = [answer for answer in readable if answer.epoch == epoch_ns]
            if readable:
                if epoch_ns is not None:
                    self._states[stream_of(key)] = replace(self._state(key), description=None)
                self._take_description(key, max(readable, key=lambda answer: answer.epoch))
            elif answers:
                self._take_back(key)
            return bool(answers if epoch_ns is None else readable)

        self._end_questions(key)
        asking = self._asking[key] = AskUntil(
            self._executor, _WHAT, _PAUSES, ask=ask, is_settled=is_settled
        )
        asking.start()

    def _end_questions(self, key: str) -> None:
        asking = self._asking.pop(key, None)
        if asking is not None:
            asking.close()

    def _take_back(self, key: str) -> None:
        """No description comes: the last one stands."""
        former = self._state(key)
        if former.name in self._returning:
            self._returning.discard(former.name)
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
            self._remember_as_gone(state.name)
        self._on_change(state)

    def _remember_as_gone(self, name: str) -> None:
        self._gone[name] = None
        if len(self._gone) > MOST_GONE:
            oldest = next(iter(self._gone))
            del self._gone[oldest], self._states[oldest]

    def _reject(self, stream: str, error: DecodeError) -> None:
        self.rejected[stream if stream in self._states else ""] += 1
        self._once.warning("rejected", "Dropped the description of stream %r: %s", stream, error)
