"""The streams that a listener subscribes to; all by default.

With an interest it subscribes to the streams that the lookups of its buffer need, by the lists of
frames of all streams. A thread of its own subscribes and unsubscribes: lookups, and Zenoh's
threads, only leave it a note.
"""

import logging
from collections import Counter
from collections.abc import Callable, Iterable, Set
from typing import NamedTuple, Protocol

from tfbus.base import scheduler
from tfbus.base.bounded import Bounded
from tfbus.base.errors import BusError, ConnectivityException, LookupException, TransformException
from tfbus.base.log import LogOnce, library_log
from tfbus.base.structs import Struct
from tfbus.buffer.buffer import Buffer
from tfbus.buffer.explain import unknown_frame
from tfbus.bus.network_session import Declaration
from tfbus.streams.info import StreamState
from tfbus.wire.descriptions import StreamDescription
from tfbus.wire.fleet import Fleet, FrameNames
from tfbus.wire.keys import (
    ALL_STATIC_TRANSFORMS,
    ALL_STATIC_TRANSFORMS_EVERYWHERE,
    ALL_TRANSFORMS,
    ALL_TRANSFORMS_EVERYWHERE,
    static_transforms_key_beside,
    transforms_key_beside,
)

# Streams come and go: at most this many gone streams are remembered.
_MOST_GONE = 1000

# Target frame, source frame.
Pair = tuple[str, str]


class DescribedEdge(NamedTuple):
    """An edge from parent to child that a stream says it sends, and the key that carries it.

    An edge that only the buffer has has no stream and no key.
    """

    parent: str
    child: str
    static: bool
    stream: str
    key: str


def described_edges(
    stream: str, stream_key: str, description: StreamDescription, names: FrameNames | None = None
) -> list[DescribedEdge]:
    """The edges of a stream whose token is at `stream_key`; `names` is how its frames are called
    here, None for their own names.
    """
    whole = transforms_key_beside(stream_key)
    static_key = static_transforms_key_beside(stream_key)
    called = (lambda frame: frame) if names is None else names.outside
    edges = []
    for parent, child, static in description.frames:
        dynamic_key = transforms_key_beside(stream_key, child) if description.split else whole
        key = static_key if static else dynamic_key
        edges.append(DescribedEdge(called(parent), called(child), static, stream, key))
    return edges


class DescribedTree:
    """The edges that all streams describe. Not safe from several threads at once.

    `parent_elsewhere(frame)` gives the parent of a frame that no stream describes as a child: the
    application may have put such an edge into the buffer.
    """

    def __init__(self, parent_elsewhere: Callable[[str], str | None] = lambda frame: None) -> None:
        self._parent_elsewhere = parent_elsewhere
        self._streams: dict[str, list[DescribedEdge]] = {}
        self._gone: Bounded[str, None] = Bounded(_MOST_GONE, lambda stream, _: self._remove(stream))
        self._above: dict[str, dict[str, DescribedEdge]] = {}
        # How many edges begin at a frame.
        self._below: Counter[str] = Counter()

    def update(self, stream: str, edges: list[DescribedEdge], *, alive: bool) -> set[str]:
        """Take the edges of a stream in place of its former ones; returns the frames above which
        that may change something.
        """
        former, edges = {*self._streams.get(stream, ())}, [*{e.child: e for e in edges}.values()]
        is_same = stream in self._streams and alive == (stream not in self._gone)
        changed = former.symmetric_difference(edges) if is_same else former.union(edges)
        if not changed:
            return set()
        self._remove(stream)
        if edges:
            self._streams[stream] = edges
        for edge in edges:
            self._above.setdefault(edge.child, {})[stream] = edge
            self._below[edge.parent] += 1
        if not alive and edges:
            self._gone[stream] = None
        return {edge.child for edge in changed}

    def _remove(self, stream: str) -> None:
        self._gone.pop(stream, None)
        for edge in self._streams.pop(stream, ()):
            above = self._above[edge.child]
            del above[stream]
            if not above:
                del self._above[edge.child]
            self._below[edge.parent] -= 1
            if not self._below[edge.parent]:
                del self._below[edge.parent]

    def frames(self) -> set[str]:
        """All frames that a stream describes, as a child or as a parent."""
        return self._above.keys() | self._below.keys()

    def describes(self, frame: str) -> bool:
        """Whether a stream describes the frame, as a child or as a parent."""
        return frame in self._above or frame in self._below

    def children(self, key: str, stream: str) -> set[str]:
        """The child frames that a stream sends on one key."""
        return {edge.child for edge in self._streams.get(stream, ()) if edge.key == key}

    def edges_needed(self, pairs: Iterable[Pair]) -> list[DescribedEdge]:
        """The edges that lookups between the pairs of frames are made of, each once.

        They lie above the target and the source, up to the lowest frame that is above both,
        or to the roots if nothing joins them. If streams disagree about the parent of a
        frame, only their transforms show which one counts: then all ways up are needed.
        """
        needed = (
            edge
            for target, source in pairs
            for edges in self._between(target, source).values()
            for edge in edges
            if edge.stream
        )
        return list(dict.fromkeys(needed))

    def frames_needed(self, pairs: Iterable[Pair]) -> set[str]:
        """The frames whose parents such lookups need: the children of these edges, and all roots
        that nothing joins.
        """
        return {frame for target, source in pairs for frame in self._between(target, source)}

    def frames_above(self, frames: Iterable[str]) -> set[str]:
        """These frames, and all on the ways up from them."""
        return {above for frame in frames for above in self._ways_up(frame)}

    def are_connected(self, target: str, source: str) -> bool:
        """Whether a frame is above both."""
        return not self._ways_up(target).keys().isdisjoint(self._ways_up(source))

    def roots(self, frame: str) -> list[str]:
        """The topmost frames above a frame, sorted; one if streams agree."""
        return sorted(above for above, edges in self._ways_up(frame).items() if not edges)

    def _between(self, target: str, source: str) -> dict[str, list[DescribedEdge]]:
        """The frames between the two, each with the edges that lead further up."""
        from_target, from_source = self._ways_up(target), self._ways_up(source)
        ways = from_target | from_source
        if target != source and all(map(_agree, ways.values())):
            for frame in from_target.keys() & from_source.keys():
                del ways[frame]
        return ways

    def _ways_up(self, frame: str) -> dict[str, list[DescribedEdge]]:
        """The frame and all above it, each with the edges that lead further up."""
        ways: dict[str, list[DescribedEdge]] = {}
        ahead = [frame]
        while ahead:
            frame = ahead.pop()
            if frame not in ways:
                ways[frame] = self._edges_above(frame)
                ahead += [edge.parent for edge in ways[frame]]
        return ways

    def _edges_above(self, frame: str) -> list[DescribedEdge]:
        """The edges above a frame; edges of gone streams only if no other stream has it."""
        edges = list(self._above.get(frame, {}).values())
        if not edges:
            parent = self._parent_elsewhere(frame)
            return [] if parent is None else [DescribedEdge(parent, frame, True, "", "")]
        return [edge for edge in edges if edge.stream not in self._gone] or edges


def _agree(edges: list[DescribedEdge]) -> bool:
    return len({edge.parent for edge in edges}) <= 1


# A lookup that is not repeated within this time needs nothing; and a key that no lookup needs is
# read for as long again, since a path may lead there and back.
KEPT_S = 60.0
# How often in that time the buffer is asked which lookups are repeated.
_ROUNDS = 4
# A subscription that failed is tried again after this time.
_RETRIED_AFTER_S = 1.0
# A stream that is read for longer should have sent something.
_SOON_S = 1.0

# All robots of a fleet are asked whether they list a shared frame if that is needed for so long by
# a lookup of robots that have said their frames; or if those of one have not come for longer.
_SOUGHT_AFTER_S = 0.5
_SOUGHT_AT_LAST_S = 5.0

_log = library_log(__name__)


# Subscribes to a key until the declaration is closed: stream, key, and whether it carries static
# transforms; the stream is "" where the key covers all.
Subscribe = Callable[[str, str, bool], Declaration]
# A key is no longer read, and its frames would only grow old: stream, key, frames.
Forget = Callable[[str, str, set[str]], object]
# The streams in these namespaces, and the streams of any that list one of these frames, may be
# needed, and no others.
Want = Callable[[Set[str], Set[str]], object]


class Reading(Protocol):
    """Decides which streams a listener subscribes to."""

    def need(self, target: str, source: str) -> None:
        """Read the streams that lookups of this pair need, from now until the end."""

    def find(self, fleet: Fleet, want: Want) -> None:
        """Call `want` with the robots of a fleet that may have the needed frames, unless all are
        read.
        """

    def update(self, state: StreamState, names: FrameNames | None) -> None:
        """Take the frames that a stream lists now, none if it is not known; `names` is how they are
        called here.
        """

    def keys_of(self, stream_key: str) -> list[str]:
        """The keys of dynamic transforms that are read of the stream of this token."""

    def close(self) -> None:
        """Stop reading. Twice is fine."""


class Everything:
    """Reads all streams of a namespace; `everywhere` also of the namespaces below it."""

    def __init__(self, subscribe: Subscribe, *, everywhere: bool = False) -> None:
        dynamic, static = (
            (ALL_TRANSFORMS_EVERYWHERE, ALL_STATIC_TRANSFORMS_EVERYWHERE)
            if everywhere
            else (ALL_TRANSFORMS, ALL_STATIC_TRANSFORMS)
        )
        # On a link that is too narrow all streams that are asked for later come after dynamic ones.
        self._declarations = [subscribe("", static, True), subscribe("", dynamic, False)]

    def need(self, target: str, source: str) -> None:
        """Nothing to do: it is read."""

    def find(self, fleet: Fleet, want: Want) -> None:
        """Nothing to do: all are watched."""

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
    """Reads the streams that lookups of a buffer need, and leaves them when the lookups have not
    been repeated for `kept_s` seconds of the clock. `subscribe` and `forget` are called on a thread
    of its own.
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
        # The frames whose edges are decisive. Of a fleet most streams describe others.
        self._decisive: set[str] = set()
        self._subscriptions: dict[str, _Subscription] = {}
        self._fleet: Fleet | None = None
        self._want: Want = lambda namespaces, frames: None
        # The namespaces and frames that are wanted, with since when one is not needed; since when a
        # frame that any robot may have has been needed, and when all are to be asked for it.
        self._wanted: dict[str, float | None] = {}
        self._wanted_frames: dict[str, float | None] = {}
        self._needed_since: dict[str, float] = {}
        self._sought_at: dict[str, float] = {}
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
        """Read the streams that lookups of this pair need, from now until the end."""
        with self._lock:
            self._needed[target, source] = None
        self._changed.set()

    def find(self, fleet: Fleet, want: Want) -> None:
        """Call `want` with the robots of a fleet whose streams lookups may need, whenever these
        change.
        """
        self._fleet, self._want = fleet, want
        self._changed.set()

    def update(self, state: StreamState, names: FrameNames | None) -> None:
        """Take the frames that a stream lists now, none if it is not known; `names` is how they are
        called here.
        """
        description = state.description
        edges = []
        if description is not None:
            edges = described_edges(state.name, state.key, description, names)
        with self._lock:
            changed = self._tree.update(state.name, edges, alive=state.alive)
            is_decisive = not self._decisive.isdisjoint(changed)
        if is_decisive:
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
        missing = [frame for frame in (target, source) if self._buffer.known_frame(frame) is None]
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
            waiting="wait for it",
            waiting_by="timeout_s",
            advice="query again",
            frame=(missing or [source])[0],
        )

    # On any thread, with the lock held

    def _parent_here(self, frame: str) -> str | None:
        """The parent that a frame has in the buffer, if the application may have put it."""
        info = self._buffer.known_frame(frame)
        return None if info is None else info.parent

    # On the thread of the interest

    def _run(self) -> None:
        next_round = self._clock()
        while not self._closed:
            now = self._clock()
            if now >= next_round:
                next_round = now + self._kept_s / _ROUNDS
                self._forget_questions(now)
            times = [next_round]
            try:
                is_done = self._follow(now)
            except Exception:  # such as of leaving a stream
                is_done = False
                self._once.exception("round", "Could not follow what lookups need; retrying")
            if not is_done:
                times.append(now + min(self._kept_s / _ROUNDS, _RETRIED_AFTER_S))
            times += self._sought_at.values()
            self._changed.wait(max(min(times) - self._clock(), 0.0))
            self._changed.clear()

    def _forget_questions(self, now: float) -> None:
        """Forget lookups that were not repeated, and have the buffer report waiting ones."""
        with self._lock:
            self._asked = {
                pair: question
                for pair, question in self._asked.items()
                if now - question.last_asked < self._kept_s
            }
        self._buffer.ask_again()

    def _follow(self, now: float) -> bool:
        """Subscribe to the needed keys, and leave the others; whether all that succeeded."""
        with self._lock:
            pairs = [*self._needed, *self._asked]
            self._decisive = self._tree.frames_above({frame for pair in pairs for frame in pair})
            needed = {edge.key: edge for edge in self._tree.edges_needed(pairs)}
            frames = set() if self._fleet is None else self._tree.frames_needed(pairs)
            told = self._tree.frames_needed(filter(self._is_told, pairs)) if frames else frames
        failed = 0
        for key, edge in needed.items():
            subscription = self._subscriptions.get(key)
            if subscription is not None:
                subscription.idle_since = None
                continue
            # One that fails keeps no other from being read.
            try:
                declaration = self._subscribe(edge.stream, key, edge.static)
                self._subscriptions[key] = _Subscription(edge.stream, declaration)
            except Exception as error:
                failed += 1
                self._say_failed(key, error)
        for key, subscription in [*self._subscriptions.items()]:
            if key not in needed:
                self._leave_when_idle(key, subscription, now)
        if self._fleet is not None:
            # After the keys of streams that are not wanted any longer have been left.
            self._find(self._fleet, frames, told, now)
        return not failed

    def _is_told(self, pair: Pair) -> bool:
        """Whether the frames of robots are known that a lookup is between."""
        return all(
            self._fleet is None
            or not self._fleet.namespaces_of(frame)
            or self._tree.describes(frame)
            or self._parent_here(frame) is not None
            for frame in pair
        )

    def _say_failed(self, key: str, error: Exception) -> None:
        """Log once that a key could not be subscribed to, unless that is the end of the session."""
        if self._closed:
            return
        message = "Could not subscribe to %r, which lookups need; retrying"
        if isinstance(error, BusError):
            self._once.warning("failed", f"{message}: %s", key, error)
        else:
            self._once.exception("failed", message, key)

    def _find(self, fleet: Fleet, frames: set[str], told: set[str], now: float) -> None:
        """Want the streams that may send these frames: by the robot of a frame at once, by a list
        with a shared frame once that is still needed when the robots have said theirs, as they have
        for `told`. A stream that has not been needed for as long as a key is read is wanted no
        longer.
        """
        shared = (frames & fleet.shared_frames) - self._wanted_frames.keys()
        self._needed_since = {frame: self._needed_since.get(frame, now) for frame in shared}
        self._sought_at = {
            frame: since_s + (_SOUGHT_AFTER_S if frame in told else _SOUGHT_AT_LAST_S)
            for frame, since_s in self._needed_since.items()
        }
        sought = {frame for frame, at_s in self._sought_at.items() if now >= at_s}
        for frame in sought:
            del self._needed_since[frame], self._sought_at[frame]
        sought |= frames & self._wanted_frames.keys()
        namespaces = {above for frame in frames for above in fleet.namespaces_of(frame)}
        # Both, so without `or`.
        if self._keep(self._wanted, namespaces, now) | self._keep(self._wanted_frames, sought, now):
            self._want({*self._wanted}, {*self._wanted_frames})

    def _keep(self, kept: dict[str, float | None], needed: set[str], now: float) -> bool:
        """Keep these names, and others until they have been idle for long; whether any is new or
        left.
        """
        before = {*kept}
        for name in before - needed:
            idle_since = kept[name]
            if idle_since is None:
                kept[name] = now
            elif now - idle_since >= self._kept_s:
                del kept[name]
        kept.update(dict.fromkeys(needed))
        return kept.keys() != before

    def _leave_when_idle(self, key: str, subscription: _Subscription, now: float) -> None:
        if subscription.idle_since is None:
            subscription.idle_since = now
        elif now - subscription.idle_since >= self._kept_s:
            del self._subscriptions[key]
            subscription.declaration.close()
            with self._lock:
                frames = self._tree.children(key, subscription.stream)
            self._forget(subscription.stream, key, frames)
