"""Measures how transforms come, on a bus or in a span of a recording: the rate, delay and order of
each edge, the load of each stream.
"""

import math
from array import array
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence, Sized
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING

from tfbus.base import lazy_numpy as np
from tfbus.base import scheduler
from tfbus.base.clock import SYSTEM_CLOCK, Clock
from tfbus.base.errors import DecodeError
from tfbus.base.lazy_numpy import NDArray
from tfbus.base.wording import mistake_in
from tfbus.frames.recorded import RecordedFrames, Tick
from tfbus.frames.report import (
    Edge,
    EdgeFlow,
    EdgeSamples,
    PairWatch,
    Report,
    StreamFlow,
    make_report,
)
from tfbus.frames.track import gaps_in
from tfbus.frames.windows import MessageWindow, Spread, spread_of
from tfbus.geometry.columns import Columns
from tfbus.recording.items import EventItem, Pause, TransformItem, recorded_ns, waits_between
from tfbus.streams.frame_names import StreamNames
from tfbus.wire.fleet import Fleet
from tfbus.wire.keys import ALL_TRANSFORMS, ALL_TRANSFORMS_EVERYWHERE, stream_of
from tfbus.wire.transforms import TransformMessage

if TYPE_CHECKING:
    from tfbus.node.node import Node  # Zenoh, which a recording does not need

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
        self.delays = MessageWindow(_MOST_SAMPLES)
        self.longest_gap_ns = self.out_of_order = self.at_zero = 0
        self._newest_ns: int | None = None
        # The latest epoch, and the clock's time at the last sample.
        self._epoch_ns = self._now_ns = 0

    def add(self, at_s: float, stamp_ns: int, epoch_ns: int, now_ns: int, *, grow: bool) -> bool:
        """Add a sample; whether the window has grown."""
        # A publisher or a clock that begins again is not out of order.
        if epoch_ns > self._epoch_ns or now_ns < self._now_ns:
            self._newest_ns = None
        self._epoch_ns, self._now_ns = max(epoch_ns, self._epoch_ns), now_ns
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
        node: "Node",
        fleet: Fleet | None = None,
        *,
        recent_s: float = RECENT_S,
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        self._node = node
        self._clock = clock
        self._recent_s = recent_s
        self._since_s = self._elapsed_s()
        self._lock = scheduler.Lock()
        self._edges: dict[Edge, _EdgeMeter] = {}
        self._streams: dict[str, MessageWindow] = {}
        self._largest: Counter[str] = Counter()  # message of each stream, in bytes
        self._epochs: dict[str, tuple[int, int]] = {}  # the last of each stream, and how many
        self.samples = 0
        self._looked_s = -math.inf
        self._names = StreamNames(fleet)
        # Here: a meter of a recording imports no bus.
        from tfbus.frames.named import NamedMessages

        self._named = NamedMessages(node, self._measure, everywhere=fleet is not None)
        keys = ALL_TRANSFORMS if fleet is None else ALL_TRANSFORMS_EVERYWHERE
        self._subscription = node.session.subscriber(keys, self.receive)

    def close(self) -> None:
        """Stop measuring. Twice is fine; closing the node does it too."""
        self._subscription.close()
        self._named.close()

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
                period_s=None if between is None else between.p50,
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
            largest = self._largest[name]
        arrivals_s, sizes = self._recent(window) if window else ([], [])
        over_s = max(min(self._elapsed_s() - self._since_s, self._recent_s), 1e-3)
        return StreamFlow(len(arrivals_s) / over_s, sum(sizes) / over_s, epochs - 1, largest)

    def streams(self) -> dict[str, StreamFlow]:
        """How the messages of each stream came, by its name."""
        with self._lock:
            names = list(self._streams)
        return {name: self.stream(name) for name in names}

    def _elapsed_s(self) -> float:
        return self._clock.elapsed_ns() / 1e9

    def _recent(self, window: MessageWindow) -> tuple[list[float], list[float]]:
        """The recent arrivals and numbers."""
        reading, from_s = window.read(), self._elapsed_s() - self._recent_s
        recent = [
            (at_s, number)
            for at_s, number in zip(reading.arrivals_s, reading.numbers, strict=True)
            if at_s >= from_s
        ]
        return [at_s for at_s, _ in recent], [number for _, number in recent]

    def receive(self, key: str, payload: bytes) -> None:
        """Measure a message of transforms that has come at this key."""
        # The listener counts unreadable messages, and logs them if they are not of ROS 2.
        with suppress(DecodeError):
            self._named.decode(key, payload)

    def _measure(self, key: str, message: TransformMessage, size: int) -> None:
        at_s, now_ns = self._elapsed_s(), self._node.now_ns()
        stream, frames = stream_of(key), self._names.of_message(key, message.rows.frames)
        with self._lock:
            self._take_rows(stream, frames, message, at_s, now_ns)
            if stream in self._streams or self._has_room(self._streams, at_s):
                window = self._streams.setdefault(stream, MessageWindow(_MOST_SAMPLES))
                grow = self.samples < _MOST_IN_ALL
                self.samples += window.add(at_s, size, grow=grow)
                self._largest[stream] = max(self._largest[stream], size)
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
                grow = self.samples < _MOST_IN_ALL
                self.samples += meter.add(at_s, stamp_ns, message.epoch_ns, now_ns, grow=grow)

    def _has_room(self, measured: Sized, at_s: float) -> bool:
        """Whether one more is measured; edges that have been silent for long make room."""
        if len(measured) < _MOST_EDGES:
            return True
        if at_s >= self._looked_s + 1.0:
            self._looked_s = at_s
            self._forget_silent(at_s - _IDLE_S)
        return len(measured) < _MOST_EDGES

    def _forget_silent(self, since_s: float) -> None:
        for edge, meter in list(self._edges.items()):
            if meter.delays.last_s < since_s:
                self.samples -= len(meter.delays)
                del self._edges[edge]
        for stream, window in list(self._streams.items()):
            if window.last_s < since_s:
                self.samples -= len(window)
                del self._streams[stream], self._largest[stream], self._epochs[stream]


# A pair is looked up as often as by `tfbus monitor` on a bus, and at most this often.
_LOOK_EVERY_NS = 50_000_000
MOST_LOOKS = 100_000


@dataclass
class _Rows:
    """Messages of one layout: log times, times of the clock at arrival, and stamps, in ns."""

    log_ns: "array[int]" = field(default_factory=lambda: array("q"))
    now_ns: "array[int]" = field(default_factory=lambda: array("q"))
    stamps: bytearray = field(default_factory=bytearray)


@dataclass
class EpochSpan:
    """The log times of the first and last message of an epoch of a stream, in ns."""

    first_ns: int
    last_ns: int


class SpanMeter:
    """Measures the dynamic transforms of a span, but for the `pauses` of the recorder."""

    def __init__(self, from_ns: int, to_ns: int, pauses: Sequence[Pause] = ()) -> None:
        self.from_ns, self.to_ns = from_ns, to_ns
        self.pauses = [each for each in pauses if each.from_ns < to_ns and each.to_ns > from_ns]
        self.epochs: dict[str, dict[int, EpochSpan]] = {}
        self._rows: dict[tuple[str, tuple[str, ...], bytes], _Rows] = {}
        self._messages: dict[str, int] = defaultdict(int)

    def add(self, stream: str, epoch_ns: int, rows: Columns, log_ns: int, now_ns: int) -> None:
        """Add a message of dynamic transforms."""
        self._messages[stream] += 1
        epochs = self.epochs.setdefault(stream, {})
        epochs.setdefault(epoch_ns, EpochSpan(log_ns, log_ns)).last_ns = log_ns
        layout = (stream, rows.frames, rows.edges_bytes())
        seen = self._rows.get(layout)
        if seen is None:
            seen = self._rows[layout] = _Rows()
        seen.log_ns.append(log_ns)
        seen.now_ns.append(now_ns)
        seen.stamps += rows.stamps_bytes()

    def samples(self) -> dict[Edge, EdgeSamples]:
        """The samples of each edge."""
        parts: dict[Edge, list[EdgeSamples]] = defaultdict(list)
        for (stream, frames, edges), rows in self._rows.items():
            pairs = np.frombuffer(edges, np.uint32).reshape(-1, 2).tolist()
            log_ns = np.frombuffer(rows.log_ns, np.int64)
            now_ns = np.frombuffer(rows.now_ns, np.int64)
            stamps = np.frombuffer(bytes(rows.stamps), np.int64).reshape(len(log_ns), len(pairs))
            for at, (parent, child) in enumerate(pairs):
                edge = (stream, frames[parent], frames[child])
                if mistake_in(edge[1]) or mistake_in(edge[2]):
                    continue  # no buffer takes it
                parts[edge].append(EdgeSamples(log_ns, now_ns, stamps[:, at]))
        return {edge: _joined(found) for edge, found in parts.items()}

    def edges(self) -> Iterator[EdgeFlow]:
        """The flow of each edge. Rate and jitter leave out its gaps."""
        for edge, samples in self.samples().items():
            yield self._flow(edge, samples)

    def stream(self, name: str) -> StreamFlow:
        """How the messages of a stream came; bytes are not recorded."""
        over_s = max(recorded_ns(self.pauses, self.from_ns, self.to_ns) / 1e9, 1e-3)
        restarts = max(len(self.epochs.get(name, ())) - 1, 0)
        return StreamFlow(self._messages.get(name, 0) / over_s, None, restarts)

    def streams(self) -> dict[str, StreamFlow]:
        """How the messages of each stream came, by its name."""
        return {name: self.stream(name) for name in self._messages}

    def _flow(self, edge: Edge, samples: EdgeSamples) -> EdgeFlow:
        log_ns, stamps_ns = samples.log_ns, samples.stamps_ns
        waits = waits_between(log_ns, self.pauses)
        between = waits.length_ns
        begun = sorted(each.first_ns for each in self.epochs[edge[0]].values())
        begins = np.searchsorted(log_ns, begun[1:])
        late = [each[1:] < np.maximum.accumulate(each)[:-1] for each in np.split(stamps_ns, begins)]
        gaps = gaps_in(between)
        regular = between[~gaps & waits.is_whole]
        mean_s = float(regular.mean()) / 1e9 if len(regular) else 0.0
        longest = int(between.argmax()) if gaps.any() else None
        return EdgeFlow(
            *edge,
            rate_hz=1.0 / mean_s if mean_s > 0.0 else None,
            jitter_s=float(regular.std()) / 1e9 if len(regular) else None,
            period_s=waits.period_s() or None,
            delays_s=_spread((samples.now_ns - stamps_ns) / 1e9),
            longest_gap_s=float(between.max(initial=0)) / 1e9,
            out_of_order=sum(int(each.sum()) for each in late),
            at_zero=int((stamps_ns == 0).sum()),
            gaps=int(gaps.sum()),
            gap_from_ns=None if longest is None else int(waits.from_ns[longest]),
        )


def _spread(numbers: "NDArray[np.float64]") -> Spread | None:
    """The same as `spread_of`, of arrays."""
    count = len(numbers)
    if not count:
        return None
    at = [int(np.ceil(count * part)) - 1 for part in (0.5, 0.95, 0.99)]
    ordered = np.sort(numbers)
    middle, most, nearly_all = (float(ordered[each]) for each in at)
    return Spread(
        count,
        float(numbers.mean()),
        float(ordered[0]),
        float(ordered[-1]),
        float(numbers.std()),
        middle,
        most,
        nearly_all,
    )


def _joined(parts: Sequence[EdgeSamples]) -> EdgeSamples:
    if len(parts) == 1:
        return parts[0]
    log_ns = np.concatenate([each.log_ns for each in parts])
    order = np.argsort(log_ns, kind="stable")
    now_ns = np.concatenate([each.now_ns for each in parts])
    stamps_ns = np.concatenate([each.stamps_ns for each in parts])
    return EdgeSamples(log_ns[order], now_ns[order], stamps_ns[order])


def measure(
    frames: RecordedFrames, meter: SpanMeter, every_ns: int | None = None
) -> Iterator[EventItem | Tick]:
    """Measure the span of a meter, both ends included: go through it with `frames`, which are right
    before it. Yields each event in it, and with `every_ns` Ticks, as `RecordedFrames.play`.
    """
    frames.count_from_now()
    for item in frames.play(meter.to_ns, every_ns):
        if isinstance(item, TransformItem) and not item.static:
            epoch_ns = item.stream.epoch_ns
            meter.add(item.stream.name, epoch_ns, item.rows, item.log_ns, frames.now_ns())
        elif isinstance(item, EventItem | Tick):
            yield item


def measured(frames: RecordedFrames, from_ns: int, to_ns: int, pair: PairWatch | None) -> Report:
    """The report of a span, with the moment at its end."""
    meter = SpanMeter(from_ns, to_ns, frames.pauses)
    every_ns = max(_LOOK_EVERY_NS, (to_ns - from_ns) // MOST_LOOKS)
    frames.seek(from_ns - 1)
    for each in measure(frames, meter, every_ns if pair else None):
        if pair is not None and isinstance(each, Tick):
            pair.measure(frames, each.log_ns / 1e9)
    return make_report(frames, meter, pair, meter)
