"""How transforms come: of each edge and each stream how often, how late, and in which order."""

import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

from tfbus.errors import DecodeError
from tfbus.listen.names import StreamNames
from tfbus.monitor.window import Spread, Window, spread_of
from tfbus.node.node import Node
from tfbus.wire.fleet import Fleet
from tfbus.wire.keys import ALL_TRANSFORMS, ALL_TRANSFORMS_EVERYWHERE, stream_of
from tfbus.wire.transforms import TransformMessage, decode_transforms

# What is older than this tells of a past that is over.
_LAST_S = 10.0
_MOST_SAMPLES = 2_000
# Names come from the bus: of more edges than these nothing is measured.
_MOST_EDGES = 20_000

Edge = tuple[str, str, str]  # stream, parent, child


@dataclass(frozen=True)
class EdgeFlow:
    """How the samples of one edge came in the last ten seconds.

    `jitter_s` is the standard deviation of the times between them, `delays_s` how old they were
    when they came, by their stamps and our clock. `out_of_order` counts, since the beginning,
    those with an older stamp than the one before.
    """

    stream: str
    parent: str
    child: str
    rate_hz: float | None
    jitter_s: float | None
    delays_s: Spread | None
    out_of_order: int


@dataclass(frozen=True)
class StreamFlow:
    """How many messages of a stream came in the last ten seconds, and how many bytes."""

    messages_hz: float
    bytes_per_s: float


class _EdgeMeter:
    def __init__(self) -> None:
        self.window = Window(_MOST_SAMPLES)
        self.newest_ns = 0
        self.out_of_order = 0

    def add(self, at_s: float, stamp_ns: int, now_ns: int) -> None:
        self.window.add(at_s, (now_ns - stamp_ns) / 1e9)
        if stamp_ns < self.newest_ns:
            self.out_of_order += 1
        else:
            self.newest_ns = stamp_ns


class TransformMeter:
    """Measures the dynamic transforms that come, of a fleet or of the node's namespace, from when
    it is made until the node is closed.
    """

    def __init__(self, node: Node, fleet: Fleet | None = None):
        self._node = node
        self._since_s = time.monotonic()
        self._lock = threading.Lock()
        self._edges: dict[Edge, _EdgeMeter] = {}
        self._streams: dict[str, Window] = {}
        self._names = StreamNames(fleet)
        keys = ALL_TRANSFORMS if fleet is None else ALL_TRANSFORMS_EVERYWHERE
        node.session.subscriber(keys, self._take)

    def edges(self) -> Iterator[EdgeFlow]:
        """How the samples of each edge came."""
        with self._lock:
            meters = list(self._edges.items())
        for (stream, parent, child), meter in meters:
            arrivals_s, delays_s = _recent(meter.window)
            between = spread_of([b - a for a, b in pairwise(arrivals_s)])
            yield EdgeFlow(
                stream,
                parent,
                child,
                None if between is None or not between.mean else 1.0 / between.mean,
                None if between is None else between.std_dev,
                spread_of(delays_s),
                meter.out_of_order,
            )

    def stream(self, name: str) -> StreamFlow:
        """How the messages of a stream came."""
        with self._lock:
            window = self._streams.get(name)
        arrivals_s, sizes = _recent(window) if window else ([], [])
        over_s = max(min(time.monotonic() - self._since_s, _LAST_S), 1e-3)
        return StreamFlow(len(arrivals_s) / over_s, sum(sizes) / over_s)

    def _take(self, key: str, payload: bytes) -> None:
        at_s, now_ns = time.monotonic(), self._node.now_ns()
        try:
            message = decode_transforms(payload)
        except DecodeError:
            return  # the listener counts it, and says so
        stream, frames = stream_of(key), self._names.of_message(key, message.batch.frames)
        with self._lock:
            self._take_rows(stream, frames, message, at_s, now_ns)
            if stream in self._streams or len(self._streams) < _MOST_EDGES:
                self._streams.setdefault(stream, Window(_MOST_SAMPLES)).add(at_s, len(payload))

    def _take_rows(
        self,
        stream: str,
        frames: tuple[str, ...],
        message: TransformMessage,
        at_s: float,
        now_ns: int,
    ) -> None:
        batch = message.batch
        rows = zip(batch.edges.tolist(), batch.stamps_ns.tolist(), strict=True)
        for (parent, child), stamp_ns in rows:
            edge = (stream, frames[parent], frames[child])
            meter = self._edges.get(edge)
            if meter is None and len(self._edges) < _MOST_EDGES:
                meter = self._edges[edge] = _EdgeMeter()
            if meter is not None:
                meter.add(at_s, stamp_ns, now_ns)


def _recent(window: Window) -> tuple[list[float], list[float]]:
    """The arrivals and numbers of the last ten seconds."""
    reading, from_s = window.read(), time.monotonic() - _LAST_S
    recent = [
        (at_s, number)
        for at_s, number in zip(reading.arrivals_s, reading.numbers, strict=True)
        if at_s >= from_s
    ]
    return [at_s for at_s, _ in recent], [number for _, number in recent]
