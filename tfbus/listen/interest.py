"""Which streams a listener subscribes to; all by default.

With an interest it subscribes to those that the lookups of its buffer need, by what all streams say
of their frames. A thread of its own subscribes and unsubscribes: lookups, and Zenoh's threads, only
leave it a note.
"""

import logging
from collections.abc import Callable
from typing import Protocol

from tfbus.buffer.buffer import Buffer
from tfbus.buffer.explain import unknown_frame
from tfbus.bus.handles import Declaration
from tfbus.errors import BusError, ConnectivityException, LookupException, TransformException
from tfbus.listen.described_tree import DescribedTree, Pair, described_edges
from tfbus.listen.stream_state import StreamState
from tfbus.runtime import scheduler
from tfbus.runtime.log import library_log
from tfbus.runtime.log_once import LogOnce
from tfbus.runtime.structs import Struct
from tfbus.wire.fleet import FrameNames
from tfbus.wire.keys import (
    ALL_STATIC_TRANSFORMS,
    ALL_STATIC_TRANSFORMS_EVERYWHERE,
    ALL_TRANSFORMS,
    ALL_TRANSFORMS_EVERYWHERE,
    transforms_key_beside,
)

# A lookup that is not repeated within this time needs nothing; and a key that no lookup needs is
# read for as long again, since a path may lead there and back.
KEPT_S = 60.0
# How often in that time the buffer is asked which lookups are repeated.
_ROUNDS = 4
# A stream that is read for longer should have sent something.
_SOON_S = 1.0

_log = library_log(__name__)


# Subscribes to a key until the declaration is closed: stream, key, and whether it carries static
# transforms; the stream is "" where the key covers all.
Subscribe = Callable[[str, str, bool], Declaration]
# A key is no longer read, and its frames would only grow old: stream, key, frames.
Forget = Callable[[str, str, set[str]], object]


class Reading(Protocol):
    """Decides what a listener subscribes to."""

    def need(self, target: str, source: str) -> None:
        """Read what lookups of this pair need, from now until the end."""

    def update(self, state: StreamState, names: FrameNames | None) -> None:
        """Take the frames that a stream lists now; `names` is how they are called here."""

    def keys_of(self, stream_key: str) -> list[str]:
        """The keys of dynamic transforms that are read of the stream of this token."""

    def close(self) -> None:
        """Stop reading. Twice is fine."""


class Everything:
    """Reads all streams of a namespace; `everywhere` also those of the namespaces below it."""

    def __init__(self, subscribe: Subscribe, *, everywhere: bool = False) -> None:
        dynamic, static = (
            (ALL_TRANSFORMS_EVERYWHERE, ALL_STATIC_TRANSFORMS_EVERYWHERE)
            if everywhere
            else (ALL_TRANSFORMS, ALL_STATIC_TRANSFORMS)
        )
        self._declarations = [subscribe("", dynamic, False), subscribe("", static, True)]

    def need(self, target: str, source: str) -> None:
        """Nothing to do: it is read."""

    def update(self, state: StreamState, names: FrameNames | None) -> None:
        """Nothing to do: it is read."""

    def keys_of(self, stream_key: str) -> list[str]:
        """All keys of the stream, as one key expression."""
        return [f"{transforms_key_beside(stream_key)}/**"]

    def close(self) -> None:
        """Stop reading. Twice is fine."""
        for declaration in self._declarations:
            declaration.close()


class _Question(Struct, frozen=False):
    first_asked: float
    last_asked: float


class _Subscription(Struct, frozen=False):
    stream: str
    declaration: Declaration
    idle_since: float | None = None


class Interest:
    """Reads what lookups of a buffer need, and leaves it when they have not been repeated for
    `kept_s` seconds of the clock. `subscribe` and `forget` are called on a thread of its own.
    """

    def __init__(
        self,
        buffer: Buffer,
        subscribe: Subscribe,
        forget: Forget,
        *,
        kept_s: float = KEPT_S,
        clock: Callable[[], float] = lambda: scheduler.monotonic(),
        log: logging.Logger = _log,
    ) -> None:
        self._buffer = buffer
        self._subscribe = subscribe
        self._forget = forget
        self._kept_s = kept_s
        self._clock = clock
        self._once = LogOnce(log)
        # Guards the questions and the tree; only the buffer is called while it is held.
        self._lock = scheduler.Lock()
        self._tree = DescribedTree(self._parent_here)
        self._needed: dict[Pair, None] = {}
        self._asked: dict[Pair, _Question] = {}
        self._subscriptions: dict[str, _Subscription] = {}
        self._closed = False
        self._changed = scheduler.Event()
        self._end_watch = buffer.watch_questions(self._on_question, self._explain)
        self._thread = scheduler.Thread(target=self._run, name="interest", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop reading. Twice is fine."""
        self._end_watch()
        self._closed = True
        self._changed.set()
        # The thread itself may close the listener, in a callback of the buffer.
        if self._thread is not scheduler.current_thread():
            self._thread.join()
        for subscription in self._subscriptions.values():
            subscription.declaration.close()

    def need(self, target: str, source: str) -> None:
        """Read what lookups of this pair need, from now until the end."""
        with self._lock:
            self._needed[target, source] = None
        self._changed.set()

    def update(self, state: StreamState, names: FrameNames | None) -> None:
        """Take the frames that a stream lists now; `names` is how they are called here."""
        description = state.description
        if description is not None:
            edges = described_edges(state.name, state.key, description, names)
            with self._lock:
                self._tree.update(state.name, edges, alive=state.alive)
            self._changed.set()

    def keys_of(self, stream_key: str) -> list[str]:
        """The keys of dynamic transforms that are read of the stream of this token."""
        whole = transforms_key_beside(stream_key)
        return [key for key in [*self._subscriptions] if f"{key}/".startswith(f"{whole}/")]

    # On the thread of a lookup

    def _on_question(self, target: str, source: str) -> None:
        now = self._clock()
        with self._lock:
            question = self._asked.setdefault((target, source), _Question(now, now))
            question.last_asked = now
            is_new = question.first_asked == now
        if is_new:
            self._changed.set()

    def _explain(self, target: str, source: str) -> TransformException | None:
        """Why there is no path, if the streams' descriptions say more than the buffer."""
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
                f"{target!r} and {source!r} are not connected, by the frames that streams list: "
                f"their roots are {roots[0]!r} and {roots[1]!r}",
                advice="a transform between the two trees is missing",
                target_frame=target,
                source_frame=source,
                target_root=roots[0],
                source_root=roots[1],
            )
        if not streams:
            return None
        named = f"stream{'s' * (len(streams) > 1)} {', '.join(map(repr, sorted(streams)))}"
        age_s = 0.0 if question is None else self._clock() - question.first_asked
        since = "from now on" if age_s < _SOON_S else f"for {age_s:.3g} s"
        return LookupException(
            f"no transform from {source!r} to {target!r} yet: reading {named} {since}",
            waiting="wait for it (timeout_s)",
            advice="query again",
            frame=(missing or [source])[0],
        )

    def _has(self, frame: str) -> bool:
        try:
            self._buffer.frame(frame)
        except LookupException:
            return False
        return True

    # On any thread, with the lock held

    def _parent_here(self, frame: str) -> str | None:
        """The parent that a frame has in the buffer, if the application may have put it."""
        try:
            return self._buffer.frame(frame).parent
        except LookupException:
            return None

    # On the thread of the interest

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
                return  # the session is closed
            except Exception:
                self._once.exception("failed", "Could not subscribe to what lookups need; retrying")
            self._changed.wait(max(next_round - self._clock(), 0.0))
            self._changed.clear()

    def _forget_questions(self, now: float) -> None:
        """Forget lookups that were not repeated, and have the buffer report those that wait."""
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
                edge.key: edge for edge in self._tree.edges_needed([*self._needed, *self._asked])
            }
        for key, edge in needed.items():
            subscription = self._subscriptions.get(key)
            if subscription is None:
                declaration = self._subscribe(edge.stream, key, edge.static)
                self._subscriptions[key] = _Subscription(edge.stream, declaration)
            else:
                subscription.idle_since = None
        for key, subscription in [*self._subscriptions.items()]:
            if key not in needed:
                self._leave_when_idle(key, subscription, now)

    def _leave_when_idle(self, key: str, subscription: _Subscription, now: float) -> None:
        if subscription.idle_since is None:
            subscription.idle_since = now
        elif now - subscription.idle_since >= self._kept_s:
            del self._subscriptions[key]
            subscription.declaration.close()
            with self._lock:
                frames = self._tree.children(key, subscription.stream)
            self._forget(subscription.stream, key, frames)
