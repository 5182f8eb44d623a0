"""Interest: a listener reads what the lookups of its buffer need, and nothing else.

Which streams they need follows from what all streams say of their frames. A thread subscribes and
unsubscribes: whoever asks the buffer, and Zenoh's threads, only leave a note for it.
"""

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from tfbus.buffer.buffer import Buffer
from tfbus.buffer.explain import unknown_frame
from tfbus.bus.handles import Declaration
from tfbus.errors import BusError, ConnectivityException, LookupException, TransformException
from tfbus.listen.described_tree import DescribedTree, Pair, described_edges
from tfbus.listen.reading import Forget, Subscribe
from tfbus.listen.watch import StreamState
from tfbus.wire.fleet import FrameNames
from tfbus.wire.keys import transforms_key_beside

# A lookup that is not repeated for so long needs nothing any more; and what nothing needs is
# read for as long again, as a path may lead there and back.
KEPT_S = 60.0
# How often it is asked which lookups are repeated.
_ROUNDS = 4
# Streams that were asked for longer ago should have sent something.
_SOON_S = 1.0

_log = logging.getLogger(__name__)


@dataclass
class _Question:
    first_asked: float
    last_asked: float


@dataclass
class _Reading:
    stream: str
    declaration: Declaration
    idle_since: float | None = None


class Interest:
    """Reads what a buffer is asked for; what it is not asked for any more is left after `kept_s`
    seconds of the clock. `subscribe` and `forget` are called in a thread of its own.
    """

    def __init__(
        self,
        buffer: Buffer,
        subscribe: Subscribe,
        forget: Forget,
        *,
        kept_s: float = KEPT_S,
        clock: Callable[[], float] = time.monotonic,
        log: logging.Logger = _log,
    ) -> None:
        self._buffer = buffer
        self._subscribe = subscribe
        self._forget = forget
        self._kept_s = kept_s
        self._clock = clock
        self._log = log
        # Holds together the questions and the tree; never held while something else is called,
        # but the buffer.
        self._lock = threading.Lock()
        self._tree = DescribedTree(self._parent_here)
        self._wanted: set[Pair] = set()
        self._asked: dict[Pair, _Question] = {}
        self._readings: dict[str, _Reading] = {}
        self._closed = False
        self._has_failed = False
        self._changed = threading.Event()
        self._end_watch = buffer.watch_questions(self._on_question, self._explain)
        self._thread = threading.Thread(target=self._run, name="interest", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Read nothing any more. Twice is fine."""
        self._end_watch()
        self._closed = True
        self._changed.set()
        # It may be in a callback of the buffer's, on whose end it would wait.
        if self._thread is not threading.current_thread():
            self._thread.join()
        for reading in self._readings.values():
            reading.declaration.close()

    def need(self, target: str, source: str) -> None:
        """Read what a lookup of this pair needs, from now on and for ever."""
        with self._lock:
            self._wanted.add((target, source))
        self._changed.set()

    def update(self, state: StreamState, names: FrameNames | None) -> None:
        """Take what a stream says of its frames now, and what they are called here."""
        description = state.description
        if description is not None:
            edges = described_edges(state.name, state.key, description, names)
            with self._lock:
                self._tree.update(state.name, edges, alive=state.alive)
            self._changed.set()

    def keys_of(self, stream_key: str) -> list[str]:
        """The keys of the dynamic transforms of the stream of a token that are read now."""
        whole = transforms_key_beside(stream_key)
        return [key for key in [*self._readings] if f"{key}/".startswith(f"{whole}/")]

    # In the thread of who asks

    def _on_question(self, target: str, source: str) -> None:
        now = self._clock()
        with self._lock:
            question = self._asked.setdefault((target, source), _Question(now, now))
            question.last_asked = now
            is_new = question.first_asked == now
        if is_new:
            self._changed.set()

    def _explain(self, target: str, source: str) -> TransformException | None:
        """Why a path is not there, where the streams' descriptions say more than the buffer."""
        with self._lock:
            nowhere = [frame for frame in (target, source) if not self._tree.describes(frame)]
            known = self._tree.frames() if nowhere else set()
            connected = self._tree.are_connected(target, source)
            roots = [" or ".join(self._tree.roots(frame)) for frame in (target, source)]
            streams = {edge.stream for edge in self._tree.edges_needed([(target, source)])}
            question = self._asked.get((target, source))
        missing = [frame for frame in (target, source) if not self._has(frame)]
        for frame in missing:
            if frame in nowhere:
                return unknown_frame(frame, known.union(self._buffer.frames()))
        if not connected:
            return ConnectivityException(
                f"{target!r} and {source!r} are not connected, by what streams say of their "
                f"frames: the root above the one is {roots[0]!r}, above the other {roots[1]!r}; "
                "a transform between the two trees is missing",
                target_frame=target,
                source_frame=source,
                target_root=roots[0],
                source_root=roots[1],
            )
        if not streams:
            return None
        named = ", ".join(map(repr, sorted(streams)))
        age_s = 0.0 if question is None else self._clock() - question.first_asked
        since = "from now on" if age_s < _SOON_S else f"for {age_s:.3g} s"
        return LookupException(
            f"{source!r} seen from {target!r} is not there yet: what it needs of stream {named} is "
            f"read {since}; wait for it (timeout_s), or ask again",
            frame=(missing or [source])[0],
        )

    def _has(self, frame: str) -> bool:
        try:
            self._buffer.frame(frame)
        except LookupException:
            return False
        return True

    # In any thread, with the lock held

    def _parent_here(self, frame: str) -> str | None:
        """The parent that a frame has in the buffer, which somebody may have put there."""
        try:
            return self._buffer.frame(frame).parent
        except LookupException:
            return None

    # In the thread of the interest

    def _run(self) -> None:
        next_round = self._clock()
        while not self._closed:
            now = self._clock()
            if now >= next_round:
                next_round = now + self._kept_s / _ROUNDS
                self._forget_questions(now)
            try:
                self._follow(now)
            except BusError:
                return  # the session is closed, and there is nothing to read
            except Exception:
                self._tell_failed()
            self._changed.wait(max(next_round - self._clock(), 0.0))
            self._changed.clear()

    def _tell_failed(self) -> None:
        if not self._has_failed:
            self._has_failed = True
            self._log.exception("What lookups need could not be followed; it is tried again")

    def _forget_questions(self, now: float) -> None:
        """Forget what has not been asked for of late, and ask what still is."""
        with self._lock:
            self._asked = {
                pair: question
                for pair, question in self._asked.items()
                if now - question.last_asked < self._kept_s
            }
        self._buffer.ask_again()

    def _follow(self, now: float) -> None:
        with self._lock:
            needed = {
                edge.key: edge for edge in self._tree.edges_needed([*self._wanted, *self._asked])
            }
        for key, edge in needed.items():
            reading = self._readings.get(key)
            if reading is None:
                declaration = self._subscribe(edge.stream, key, edge.static)
                self._readings[key] = _Reading(edge.stream, declaration)
            else:
                reading.idle_since = None
        for key, reading in [*self._readings.items()]:
            if key not in needed:
                self._leave_in_time(key, reading, now)

    def _leave_in_time(self, key: str, reading: _Reading, now: float) -> None:
        if reading.idle_since is None:
            reading.idle_since = now
        elif now - reading.idle_since >= self._kept_s:
            del self._readings[key]
            reading.declaration.close()
            with self._lock:
                frames = self._tree.children(key, reading.stream)
            self._forget(reading.stream, key, frames)
