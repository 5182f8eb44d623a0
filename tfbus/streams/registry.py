"""The streams that a listener knows: the receivers of their keys, their memory, and checks by
messages of tokens and lists.

The sizes are estimates, from measured bytes of the parts of a stream.
"""

from collections.abc import Callable, Container, Iterable

from tfbus.base import scheduler
from tfbus.base.executor import Executor
from tfbus.base.own_pauses import own_pauses
from tfbus.base.structs import Struct, field
from tfbus.streams.info import MOST_GONE, StreamState
from tfbus.streams.reception import DynamicReception, StaticReception, StreamReception
from tfbus.streams.watch import StreamWatch
from tfbus.wire.keys import STATIC_TRANSFORMS, stream_of, transforms_key_beside

# The most bytes of all streams of one process's session, and of all streams. Streams that do not
# say whose they are count as one process's.
MOST_BYTES_A_PEER = 256 * 2**20
MOST_BYTES = 1024 * 2**20

# A stream, each of its keys, each row of a message that is remembered, each frame in the buffer
# without its dynamic samples, and each row of its description.
STREAM_BYTES = 4000
KEY_BYTES = 300
JUDGED_BYTES = 150
FRAME_BYTES = 1000
ROW_BYTES = 700


class Budget:
    """The sizes of streams, by the peer that publishes each; safe from any thread."""

    def __init__(
        self, most_bytes: int = MOST_BYTES, most_bytes_a_peer: int = MOST_BYTES_A_PEER
    ) -> None:
        self._most_bytes = most_bytes
        self._most_bytes_a_peer = most_bytes_a_peer
        self._lock = scheduler.Lock()
        # The sizes of each peer's streams, the oldest first, and their sums.
        self._sizes: dict[str, dict[str, int]] = {}
        self._sums: dict[str, int] = {}
        self._peers: dict[str, str] = {}
        self._bytes = 0

    @property
    def bytes(self) -> int:
        """How much all streams take."""
        return self._bytes

    def resize(self, stream: str, peer: str, size: int) -> list[str]:
        """Set how much a stream of this peer takes now; returns the streams that have to go.

        They are the oldest of this peer if it takes more than its part; then, if all together
        take too much, the oldest of the one that takes most. They count no longer.
        """
        with self._lock:
            former = self._peers.get(stream)
            if former is not None and former != peer:
                self._remove(stream)
            sizes = self._sizes.setdefault(peer, {})
            more = size - sizes.get(stream, 0)
            sizes[stream] = size
            self._peers[stream] = peer
            self._sums[peer] = self._sums.get(peer, 0) + more
            self._bytes += more
            gone = []
            while self._sums.get(peer, 0) > self._most_bytes_a_peer:
                gone.append(self._remove(next(iter(self._sizes[peer]))))
            while self._bytes > self._most_bytes:
                gone.append(self._remove(next(iter(self._sizes[self._largest()]))))
            return gone

    def forget(self, stream: str) -> None:
        """The stream is forgotten; unknown ones are fine."""
        with self._lock:
            if stream in self._peers:
                self._remove(stream)

    def oldest_of_the_largest(self) -> str | None:
        """The oldest stream of the peer that takes most; None for no streams."""
        with self._lock:
            return next(iter(self._sizes[self._largest()])) if self._sums else None

    def peer_of(self, stream: str) -> str | None:
        """The peer of a stream; None if it is not known."""
        return self._peers.get(stream)

    def _largest(self) -> str:
        return max(self._sums, key=self._sums.__getitem__)

    def _remove(self, stream: str) -> str:
        peer = self._peers.pop(stream)
        size = self._sizes[peer].pop(stream)
        self._sums[peer] -= size
        self._bytes -= size
        if not self._sizes[peer]:
            del self._sizes[peer], self._sums[peer]
        return stream


# Keys come from the bus: dynamic transforms are taken on at most this many.
MOST_KEYS = 200_000


# A stream without a token may be forgotten after this silence.
_SILENT_NS = 60 * 10**9


class KnownStream(Struct, frozen=False):
    """The state of one stream.

    `state` is the last of its token and description, with frames as they are called here; None
    before the first. `lost_s` is when its publisher was gone, None while it is not. `split_keys`
    are the keys of the frames that a split stream lists. `read_keys` are subscribed to one by one;
    messages came on `keys`. `met_ns` is when it was met.
    """

    reception: StreamReception
    state: StreamState | None = None
    lost_s: float | None = None
    split_keys: set[str] = field(default_factory=set)
    read_keys: set[str] = field(default_factory=set)
    keys: set[str] = field(default_factory=set)
    met_ns: int = field(default_factory=lambda: scheduler.time_ns())


class Registry:
    """The streams and keys that a listener has met; safe from any thread.

    `make(name, key)` makes the reception of a stream. `on_crowded` is called for a new stream if
    it is time for `forget_unconfirmed`, which calls `on_forgotten(name)` for each.
    """

    def __init__(
        self,
        make: Callable[[str, str], StreamReception],
        on_crowded: Callable[[], object],
        on_forgotten: Callable[[str], object],
    ) -> None:
        self.most_keys = MOST_KEYS
        # By key.
        self.receptions: dict[str, DynamicReception | StaticReception] = {}
        self._make = make
        self._on_crowded = on_crowded
        self._on_forgotten = on_forgotten
        self._streams: dict[str, KnownStream] = {}
        self._crowded_from = 2 * MOST_GONE

    def streams(self) -> dict[str, KnownStream]:
        """All streams by their names."""
        return dict(self._streams)

    def get(self, name: str) -> KnownStream | None:
        """The stream of this name; None if it is not known."""
        return self._streams.get(name)

    def reception(self, name: str) -> StreamReception | None:
        """The reception of the stream of this name; None if it is not known."""
        stream = self._streams.get(name)
        return None if stream is None else stream.reception

    def stream(self, key: str) -> KnownStream:
        """The stream of a key, made if it is new."""
        name = stream_of(key)
        known = self._streams.get(name)
        if known is not None:
            return known
        if len(self._streams) >= self._crowded_from:
            self._on_crowded()
        return self._streams.setdefault(name, KnownStream(self._make(name, key)))

    @property
    def is_full(self) -> bool:
        """Whether further keys of dynamic transforms are refused."""
        return len(self.receptions) >= self.most_keys

    def meet(self, key: str) -> DynamicReception | StaticReception:
        """The receiver of the messages of a key, made if it is new."""
        stream = self.stream(key)
        stream.keys.add(key)
        reception = stream.reception
        made = reception.statics if is_static(key) else DynamicReception(reception)
        # Two threads may come here at once: both get the same one.
        return self.receptions.setdefault(key, made)

    def forget_key(self, key: str) -> None:
        """Make room: forget a key on which no messages are expected."""
        reception = self.receptions.pop(key, None)
        stream = None if reception is None else self._streams.get(reception.stream.name)
        if stream is not None:
            stream.keys.discard(key)

    def forget(self, name: str) -> KnownStream | None:
        """Forget a stream and its keys; its last state, None for an unknown stream."""
        stream = self._streams.pop(name, None)
        if stream is not None:
            for key in list(stream.keys):
                self.receptions.pop(key, None)
            stream.reception.statics.forget()
        return stream

    def forget_removed(self, described: StreamState) -> None:
        """Make room: forget the keys of frames that a split stream no longer lists."""
        description = described.description
        if description is not None and description.split:
            stream = self.stream(described.key)
            keys = {
                transforms_key_beside(described.key, child)
                for _, child, static in description.frames
                if not static
            }
            for key in stream.split_keys - keys:
                self.forget_key(key)
            stream.split_keys = keys

    def forget_unconfirmed(self, known: Container[str]) -> None:
        """Make room if there are many: forget streams that are not `known`, if they had a token,
        or are silent.
        """
        if len(self._streams) < 2 * MOST_GONE:
            return
        silent_since_ns = scheduler.time_ns() - _SILENT_NS
        for name, stream in list(self._streams.items()):
            heard_ns = stream.reception.counts.last_heard_ns or stream.met_ns
            is_silent = heard_ns < silent_since_ns
            is_unknown = name not in known and not stream.read_keys
            if is_unknown and (stream.state is not None or is_silent):
                self.forget(name)
                self._on_forgotten(name)
        self._crowded_from = len(self._streams) + MOST_GONE


def is_static(key: str) -> bool:
    """Whether a key carries static transforms."""
    return STATIC_TRANSFORMS in key.split("/")


# Frames that a publisher has sent, does not list, and sends no more are dropped: it has removed
# them. A list that comes after a message of a frame, and does not have it, may be older than the
# message or newer than the end of the frame. Only time tells: a publisher lists a frame within a
# second of its first message.

# A frame that is neither listed nor sent for so long has been removed.
SILENT_S = 2.0


class UnlistedFrames:
    """Frames of streams that do not list them, and when each was last sent; safe from any thread.
    Silent ones are dropped, on the executor's thread.
    """

    def __init__(self, registry: Registry, executor: Executor) -> None:
        self._registry = registry
        self._executor = executor
        self._lock = scheduler.Lock()
        self._heard_s: dict[str, dict[str, float]] = {}

    def hear(self, stream: str, frames: Iterable[str]) -> None:
        """A stream that does not list these frames has sent them."""
        now_s = scheduler.monotonic()
        with self._lock:
            is_new = stream not in self._heard_s
            self._heard_s.setdefault(stream, {}).update(dict.fromkeys(frames, now_s))
        if is_new:
            self._drop_later(stream)

    def _drop_later(self, stream: str) -> None:
        own_pauses().after(self._executor, SILENT_S, self._drop_silent, stream)

    def _drop_silent(self, stream: str) -> None:
        since_s = scheduler.monotonic() - SILENT_S
        with self._lock:
            heard_s = self._heard_s.pop(stream)
            silent = frozenset(frame for frame, at_s in heard_s.items() if at_s <= since_s)
            for frame in silent:
                del heard_s[frame]
            if heard_s:
                self._heard_s[stream] = heard_s
        if heard_s:
            self._drop_later(stream)
        reception = self._registry.reception(stream)
        if reception is not None:
            reception.drop_unlisted(silent)


# A stream that sends for so long after its token was lost is not gone. Messages that are under way
# when a process is killed come before that.
_SENDS_FOR_S = 2.0

# A stream that was brought back so is looked at as often, and gone when nothing has come since.
_RECHECKED_EVERY_S = 5.0


class StillSending:
    """Brings back streams that count as gone and still send: a token may be lost with its link
    while messages come by another one (eclipse-zenoh/zenoh#2806).

    It checks the streams that it has brought back, while there are any.
    """

    def __init__(self, registry: Registry, watch: StreamWatch, executor: Executor) -> None:
        self._registry = registry
        self._watch = watch
        self._executor = executor
        # How many messages each had sent when it was last looked at. On the executor's thread.
        self._back: dict[str, int] = {}
        self._is_waiting = False

    def hear_message(self, name: str) -> None:
        """Bring a stream back of which a message has come though it is gone. From any thread."""
        stream = self._registry.get(name)
        lost_s = None if stream is None else stream.lost_s
        if lost_s is not None and scheduler.monotonic() - lost_s > _SENDS_FOR_S:
            self._executor.submit("a stream that sends", self._bring_back, name, limit=1)

    def _bring_back(self, name: str) -> None:
        stream = self._registry.get(name)
        if stream is not None and stream.state is not None and not stream.state.alive:
            self._back[name] = stream.reception.counts.messages
            self._watch.take_for_alive(stream.state.key)
            self._recheck_later()

    def _recheck_later(self) -> None:
        if not self._is_waiting and self._back:
            self._is_waiting = True
            own_pauses().after(self._executor, _RECHECKED_EVERY_S, self._recheck)

    def _recheck(self) -> None:
        self._is_waiting = False
        for name, former in list(self._back.items()):
            stream = self._registry.get(name)
            state = None if stream is None else stream.state
            if stream is None or state is None or self._watch.has_token(state.key):
                del self._back[name]
            elif (messages := stream.reception.counts.messages) == former:
                del self._back[name]
                self._watch.take_for_gone(state.key)
            else:
                self._back[name] = messages
        self._recheck_later()
