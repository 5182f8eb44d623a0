"""Measures how transforms came in a span of a recording."""

from array import array
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING

from tfbus.frames.gaps import gaps_in
from tfbus.frames.recorded import RecordedFrames
from tfbus.frames.recorded_moments import Ticks
from tfbus.geometry.columns import Columns
from tfbus.monitor.flow import Edge, EdgeFlow, Spread, StreamFlow
from tfbus.monitor.report import PairWatch, Report, make_report
from tfbus.names import mistake_in
from tfbus.recording.items import EventItem, TransformItem
from tfbus.recording.pauses import Pause, recorded_ns, waits_between

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Ints = NDArray[np.int64]
else:
    from tfbus.core import lazy_numpy as np

# A pair is looked up as often as by `tfbus monitor` on a bus, and at most this often.
_LOOK_EVERY_NS = 50_000_000
MOST_LOOKS = 100_000


@dataclass
class _Rows:
    """Messages of one layout: when they came, what time it was then, and their stamps."""

    log_ns: "array[int]" = field(default_factory=lambda: array("q"))
    now_ns: "array[int]" = field(default_factory=lambda: array("q"))
    stamps: bytearray = field(default_factory=bytearray)


@dataclass(frozen=True)
class EdgeSamples:
    """The samples of an edge in the order in which they came: when they did, what time it was then
    (it differs under simulated time), and their stamps, each (N,) in ns.
    """

    log_ns: "Ints"
    now_ns: "Ints"
    stamps_ns: "Ints"


class SpanMeter:
    """Measures the dynamic transforms of a span, but for the `pauses` of the recorder."""

    def __init__(self, from_ns: int, to_ns: int, pauses: Sequence[Pause] = ()) -> None:
        self.from_ns, self.to_ns = from_ns, to_ns
        self.pauses = [each for each in pauses if each.from_ns < to_ns and each.to_ns > from_ns]
        self.epochs: dict[str, dict[int, int]] = {}
        self._rows: dict[tuple[str, tuple[str, ...], bytes], _Rows] = {}
        self._messages: dict[str, int] = defaultdict(int)

    def add(self, stream: str, epoch_ns: int, rows: Columns, log_ns: int, now_ns: int) -> None:
        """Add a message of dynamic transforms."""
        self._messages[stream] += 1
        self.epochs.setdefault(stream, {}).setdefault(epoch_ns, log_ns)
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
        """How the samples of each edge came. Rate and jitter are those between its gaps."""
        for edge, samples in self.samples().items():
            yield self._flow(edge, samples)

    def stream(self, name: str) -> StreamFlow:
        """How the messages of a stream came; bytes are not recorded."""
        over_s = max(recorded_ns(self.pauses, self.from_ns, self.to_ns) / 1e9, 1e-3)
        restarts = max(len(self.epochs.get(name, ())) - 1, 0)
        return StreamFlow(self._messages.get(name, 0) / over_s, None, restarts)

    def _flow(self, edge: Edge, samples: EdgeSamples) -> EdgeFlow:
        log_ns, stamps_ns = samples.log_ns, samples.stamps_ns
        waits = waits_between(log_ns, self.pauses)
        between = waits.length_ns
        newest = np.maximum.accumulate(stamps_ns)
        late = stamps_ns[1:] < newest[:-1]
        gaps = gaps_in(between)
        regular = between[~gaps & waits.is_whole]
        mean_s = float(regular.mean()) / 1e9 if len(regular) else 0.0
        longest = int(between.argmax()) if gaps.any() else None
        return EdgeFlow(
            *edge,
            rate_hz=1.0 / mean_s if mean_s > 0.0 else None,
            jitter_s=float(regular.std()) / 1e9 if len(regular) else None,
            delays_s=_spread((samples.now_ns - stamps_ns) / 1e9),
            longest_gap_s=float(between.max(initial=0)) / 1e9,
            out_of_order=int(late.sum()),
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
    frames: RecordedFrames,
    meter: SpanMeter,
    before: Callable[[int], object] = lambda log_ns: None,
) -> Iterator[EventItem]:
    """Measure the span of a meter: go through it with `frames`. Yields each event in it; calls
    `before` as `RecordedFrames.play`.
    """
    frames.seek(meter.from_ns)
    frames.count_from_now()
    for item in frames.play(meter.to_ns, before):
        if isinstance(item, TransformItem) and not item.static:
            epoch_ns = item.stream.epoch_ns
            meter.add(item.stream.name, epoch_ns, item.rows, item.log_ns, frames.now_ns())
        elif isinstance(item, EventItem):
            yield item


def measured(frames: RecordedFrames, from_ns: int, to_ns: int, pair: PairWatch | None) -> Report:
    """The report of a span, with the moment at its end."""
    meter = SpanMeter(from_ns, to_ns, frames.pauses)
    every_ns = max(_LOOK_EVERY_NS, (to_ns - from_ns) // MOST_LOOKS)
    look = (lambda log_ns: None) if pair is None else partial(_look, frames, pair)
    for _ in measure(frames, meter, Ticks(frames, from_ns, every_ns, look).before):
        pass
    return make_report(frames, meter, pair, meter)


def _look(frames: RecordedFrames, pair: PairWatch, log_ns: int) -> None:
    pair.look(frames, log_ns / 1e9)
