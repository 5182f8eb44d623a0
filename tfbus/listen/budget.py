"""How much memory the streams of a listener take, and which of them has to go if it is too much.

The sizes are estimates: what the parts of a stream were measured to take.
"""

from tfbus.runtime import scheduler

# What the session of one process publishes may take as much, and all streams together. Streams that
# do not say whose they are count as those of one process.
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

    def note(self, stream: str, peer: str, size: int) -> list[str]:
        """Note how much a stream of this peer takes now; returns the streams that have to go.

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
                gone.append(self._remove(next(iter(self._sizes[self._greediest()]))))
            return gone

    def forget(self, stream: str) -> None:
        """The stream is forgotten; unknown ones are fine."""
        with self._lock:
            if stream in self._peers:
                self._remove(stream)

    def oldest_of_the_greediest(self) -> str | None:
        """The oldest stream of the peer that takes most; None for no streams."""
        with self._lock:
            return next(iter(self._sizes[self._greediest()])) if self._sums else None

    def peer_of(self, stream: str) -> str | None:
        """The peer of a stream; None if it is not known."""
        return self._peers.get(stream)

    def _greediest(self) -> str:
        return max(self._sums, key=self._sums.__getitem__)

    def _remove(self, stream: str) -> str:
        peer = self._peers.pop(stream)
        size = self._sizes[peer].pop(stream)
        self._sums[peer] -= size
        self._bytes -= size
        if not self._sizes[peer]:
            del self._sizes[peer], self._sums[peer]
        return stream
