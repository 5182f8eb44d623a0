"""The descriptions that a watch reads: in a fleet of few robots, and the senders in turn."""

from collections import deque
from collections.abc import Callable, Set
from typing import NamedTuple

from tfbus.base import scheduler
from tfbus.base.executor import Executor
from tfbus.bus.query import Answer, AskUntil, Pauses
from tfbus.bus.session import Session
from tfbus.streams.queries import ask_who_lists
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


# Where no stream lists a frame nobody answers, as if the question were lost: it is repeated.
_PAUSES = Pauses((0.4, 2.0), lost_after_s=0.5)
# New tokens are gathered for this time; more of them than these are asked by one question for all.
_GATHERED_FOR_S = 0.1
_FEW = 20

_WHAT = "streams that list a frame"


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
        def ask(turn: int, on_end: Callable[[], None]) -> None:
            ask_who_lists(self._session, keys, frames, on_answer, on_end)

        def on_answer(answer: Answer) -> None:
            if answer.refusal is None:
                self._executor.submit(_WHAT, lambda: self._on_answer(answer))

        AskUntil(
            self._executor, _WHAT, _PAUSES, ask=ask, is_settled=lambda: keys in self._found
        ).start()
