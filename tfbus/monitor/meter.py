"""Measures how transforms come: the rate, delay and order of each edge, the load of each stream."""

import math
from collections import Counter
from collections.abc import Iterator, Sized
from itertools import pairwise

from tfbus.errors import DecodeError
from tfbus.listen.frame_names import StreamNames
from tfbus.monitor.flow import Edge, EdgeFlow, StreamFlow, Window, spread_of
from tfbus.node.node import Node
from tfbus.runtime import scheduler
from tfbus.runtime.clock import SYSTEM_CLOCK, Clock
from tfbus.wire.fleet import Fleet
from tfbus.wire.keys import ALL_TRANSFORMS, ALL_TRANSFORMS_EVERYWHERE, stream_of
from tfbus.wire.transforms import TransformMessage, decode_transforms

RECENT_S = 10.0
_MOST_SAMPLES = 5_000
# Names come from the bus: further edges and streams are not measured, while these are heard.
_MOST_EDGES = 20_000
_IDLE_S = 60.0
# Samples of all edges together, of 150 bytes each: then a new one takes the place of the oldest of
# its edge.
_MOST_IN_ALL = 1_000_000


class _EdgeMeter:
    def __init__(self) -> None:
        self.delays = Window(_MOST_SAMPLES)
        self.longest_gap_ns = self.out_of_order = self.at_zero = 0
        self._newest_ns: int | None = None

    def add(self, at_s: float, stamp_ns: int, now_ns: int, *, grow: bool) -> bool:
        """Add a sample; whether the window has grown."""
        has_grown = self.delays.add(at_s, (now_ns - stamp_ns) / 1e9, grow=grow)
        self.at_zero += stamp_ns == 0
        step_ns = 0 if self._newest_ns is None else stamp_ns - self._newest_ns
        if step_ns < 0:
            self.out_of_order += 1
        else:
            self._newest_ns = stamp_ns
            self.longest_gap_ns = max(self.longest_gap_ns, step_ns)
        return has_grown


class TransformMeter:
    """Measures the dynamic transforms of a fleet, or of the node's namespace.

    From when it is made until `close()`, or the end of the node. Rates and delays are of the last
    `recent_s` seconds, and of at most 5000 samples per edge. Arrivals are timed by `clock`, real
    time by default, since a simulated clock may stand still; delays are by the node's clock.
    """

    def __init__(
        self,
        node: Node,
        fleet: Fleet | None = None,
        *,
        recent_s: float = RECENT_S,
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        self.largest: Counter[str] = Counter()  # message of each stream, in bytes
        self._node = node
        self._clock = clock
        self._recent_s = recent_s
        self._since_s = self._elapsed_s()
        self._lock = scheduler.Lock()
        self._edges: dict[Edge, _EdgeMeter] = {}
        self._streams: dict[str, Window] = {}
        self._epochs: dict[str, tuple[int, int]] = {}  # the last of each stream, and how many
        self._samples = 0
        self._looked_s = -math.inf
        self._names = StreamNames(fleet)
        keys = ALL_TRANSFORMS if fleet is None else ALL_TRANSFORMS_EVERYWHERE
        self._subscription = node.session.subscriber(keys, self._take)

    def close(self) -> None:
        """Stop measuring. Twice is fine; closing the node does it too."""
        self._subscription.close()

    def edges(self) -> Iterator[EdgeFlow]:
        """How the samples of each edge came."""
        with self._lock:
            meters = list(self._edges.items())
        for edge, meter in meters:
            arrivals_s, delays_s = self._recent(meter.delays)
            between = spread_of([b - a for a, b in pairwise(arrivals_s)])
            yield EdgeFlow(
                *edge,
                rate_hz=None if between is None or not between.mean else 1.0 / between.mean,
                jitter_s=None if between is None else between.std_dev,
                delays_s=spread_of(delays_s),
                longest_gap_s=meter.longest_gap_ns / 1e9,
                out_of_order=meter.out_of_order,
                at_zero=meter.at_zero,
            )

    def stream(self, name: str) -> StreamFlow:
        """How the messages of a stream came."""
        with self._lock:
            window = self._streams.get(name)
            _, epochs = self._epochs.get(name, (0, 1))
        arrivals_s, sizes = self._recent(window) if window else ([], [])
        over_s = max(min(self._elapsed_s() - self._since_s, self._recent_s), 1e-3)
        return StreamFlow(len(arrivals_s) / over_s, sum(sizes) / over_s, epochs - 1)

    def _elapsed_s(self) -> float:
        return self._clock.elapsed_ns() / 1e9

    def _recent(self, window: Window) -> tuple[list[float], list[float]]:
        """The recent arrivals and numbers."""
        reading, from_s = window.read(), self._elapsed_s() - self._recent_s
        recent = [
            (at_s, number)
            for at_s, number in zip(reading.arrivals_s, reading.numbers, strict=True)
            if at_s >= from_s
        ]
        return [at_s for at_s, _ in recent], [number for _, number in recent]

    def _take(self, key: str, payload: bytes) -> None:
        at_s, now_ns = self._elapsed_s(), self._node.now_ns()
        try:
            message = decode_transforms(payload)
        except DecodeError:
            return  # the listener counts it, and logs it where it is not of ROS 2
        stream, frames = stream_of(key), self._names.of_message(key, message.rows.frames)
        with self._lock:
            self._take_rows(stream, frames, message, at_s, now_ns)
            if stream in self._streams or self._has_room(self._streams, at_s):
                window = self._streams.setdefault(stream, Window(_MOST_SAMPLES))
                grow = self._samples < _MOST_IN_ALL
                self._samples += window.add(at_s, len(payload), grow=grow)
                self.largest[stream] = max(self.largest[stream], len(payload))
                last_ns, epochs = self._epochs.get(stream, (-1, 0))
                if message.epoch_ns > last_ns:
                    self._epochs[stream] = message.epoch_ns, epochs + 1

    def _take_rows(
        self,
        stream: str,
        frames: tuple[str, ...],
        message: TransformMessage,
        at_s: float,
        now_ns: int,
    ) -> None:
        rows = zip(message.rows.pairs(), message.rows.stamps_as_ints(), strict=True)
        for (parent, child), stamp_ns in rows:
            edge = (stream, frames[parent], frames[child])
            meter = self._edges.get(edge)
            if meter is None and self._has_room(self._edges, at_s):
                meter = self._edges[edge] = _EdgeMeter()
            if meter is not None:
                grow = self._samples < _MOST_IN_ALL
                self._samples += meter.add(at_s, stamp_ns, now_ns, grow=grow)

    def _has_room(self, measured: Sized, at_s: float) -> bool:
        """Whether one more is measured; those that have been silent for long make room."""
        if len(measured) < _MOST_EDGES:
            return True
        if at_s >= self._looked_s + 1.0:
            self._looked_s = at_s
            self._forget_silent(at_s - _IDLE_S)
        return len(measured) < _MOST_EDGES

    def _forget_silent(self, since_s: float) -> None:
        for edge, meter in list(self._edges.items()):
            if meter.delays.last_s < since_s:
                self._samples -= len(meter.delays)
                del self._edges[edge]
        for stream, window in list(self._streams.items()):
            if window.last_s < since_s:
                self._samples -= len(window)
                del self._streams[stream], self.largest[stream], self._epochs[stream]
