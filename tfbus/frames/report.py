"""The report of `tfbus monitor` and `tfbus top` at one moment: the numbers of edges, of streams and
of a pair of frames, and the columns that show them.

A function and an entry in `EDGES` or `STREAMS` make a new column, in both tools.
"""

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from typing import Any, Generic, Literal, Protocol, TypeAlias, TypeVar

from tfbus.base import lazy_numpy as np
from tfbus.base.errors import TransformException
from tfbus.base.lazy_numpy import NDArray
from tfbus.base.wording import duration, natural_order, offset
from tfbus.buffer.info import FrameInfo
from tfbus.frames.moment import BusMoment, BusView
from tfbus.frames.snapshot import FrameTree
from tfbus.frames.windows import MessageWindow, Spread, spread_of
from tfbus.recording.items import Pause
from tfbus.streams.info import StreamInfo
from tfbus.wire.descriptions import FLOAT64

Edge = tuple[str, str, str]  # stream, parent, child
Ints: TypeAlias = "NDArray[np.int64]"


@dataclass(frozen=True)
class EdgeSamples:
    """The samples of an edge in the order in which they came: their log times, the clock's time
    then (it differs under simulated time), and their stamps, each (N,) in ns.
    """

    log_ns: "Ints"
    now_ns: "Ints"
    stamps_ns: "Ints"


@dataclass(frozen=True)
class EdgeFlow:
    """How the samples of one edge came.

    Of the recent ones: `rate_hz` by their arrivals, `jitter_s` the standard deviation of the times
    between them and `period_s` their median, `delays_s` their ages at arrival, by their stamps and
    our clock, below zero for stamps in the future. Since the meter was made: `longest_gap_s`
    between two stamps, `out_of_order` counts samples older than one before, `at_zero` samples with
    the stamp 0. In a span of a recording all are of the whole span, and times between samples are
    of their arrivals. There, `gaps` counts the pauses, which rate and jitter leave out, and the
    longest begins at the log time `gap_from_ns`, None without one.
    """

    stream: str
    parent: str
    child: str
    rate_hz: float | None = None
    jitter_s: float | None = None
    period_s: float | None = None
    delays_s: Spread | None = None
    longest_gap_s: float = 0.0
    out_of_order: int = 0
    at_zero: int = 0
    gaps: int = 0
    gap_from_ns: int | None = None

    @property
    def least_delay_s(self) -> float | None:
        """The age at arrival of the sample that came soonest."""
        return self.delays_s.min if self.delays_s else None


@dataclass(frozen=True)
class StreamFlow:
    """The load of a stream in the last seconds, or a span: messages and bytes per second, and how
    often it began a new epoch meanwhile; since the meter was made, the size of its largest message.
    In a span, bytes are not known: None.
    """

    messages_hz: float
    bytes_per_s: float | None
    restarts: int = 0
    largest_bytes: int | None = None


class Meter(Protocol):
    """Measures how transforms come: on a bus, or in a span of a recording."""

    def edges(self) -> Iterator[EdgeFlow]:
        """How the samples of each edge came."""

    def stream(self, name: str) -> StreamFlow:
        """How the messages of a stream came."""

    def streams(self) -> dict[str, StreamFlow]:
        """How the messages of each stream came, by its name."""


_MOST_SAMPLES = 1_000


@dataclass(frozen=True)
class Pair:
    """A lookup of `source` in `target`: the frames on its path, and its delay.

    `net_delay_s` is the age of the newest answer at each look. `held_back_by` is the child of the
    edge whose newest sample is the oldest, None if all edges are static. `failure` is why there is
    no answer, or "".
    """

    target: str
    source: str
    chain: tuple[str, ...] = ()
    net_delay_s: Spread | None = None
    held_back_by: str | None = None
    failure: str = ""


class PairWatch:
    """Looks up one frame in another, repeatedly; it keeps the last `most` delays."""

    def __init__(self, target: str, source: str, most: int = _MOST_SAMPLES):
        self._target, self._source = target, source
        self._delays = MessageWindow(most)

    def measure(self, heard: BusView, at_s: float) -> None:
        """Measure the age of the newest answer now."""
        try:
            stamp_ns = heard.buffer.latest_common_time(self._target, self._source)
        except TransformException:
            return
        if stamp_ns is not None:
            self._delays.add(at_s, (heard.now_ns() - stamp_ns) / 1e9)

    def report(self, heard: BusView) -> Pair:
        """The path and delay of the pair, or why there is no answer."""
        try:
            chain = heard.buffer.path(self._target, self._source)
            heard.buffer.lookup_transform(self._target, self._source)
        except TransformException as error:
            return Pair(self._target, self._source, failure=str(error))
        return Pair(
            self._target,
            self._source,
            tuple(reversed(chain)),
            spread_of(self._delays.read().numbers),
            _held_back_by(heard, chain),
        )


def _held_back_by(heard: BusView, chain: list[str]) -> str | None:
    """The child of the edge on the path whose newest sample is the oldest."""
    infos = {name: heard.buffer.frame(name) for name in chain}
    newest = {
        info.name: info.newest_ns
        for info in infos.values()
        if info.parent in infos and not info.static and info.newest_ns is not None
    }
    return min(newest, key=newest.__getitem__, default=None)


class MeasuredSpan(Protocol):
    """The measured part of a recording: its log times, and the pauses of the recorder."""

    from_ns: int
    to_ns: int
    pauses: "list[Pause]"


@dataclass(frozen=True)
class MeasuredEdge:
    """An edge of a frame by one of its publishers, and how its samples came from that."""

    frame: FrameInfo
    flow: EdgeFlow


@dataclass(frozen=True)
class Report:
    """The report of the monitor at one moment, or at the end of a `span` of a recording."""

    moment: BusMoment
    flows: dict[tuple[str, str], EdgeFlow]
    meter: Meter
    pair: Pair | None
    span: MeasuredSpan | None = None

    @property
    def tree(self) -> FrameTree:
        """The tree of frames at the moment."""
        return self.moment.tree

    def flow(self, frame: FrameInfo) -> EdgeFlow:
        """How the samples of a frame's edge came from the publisher of its last one."""
        return self.flows.get((frame.authority, frame.name)) or _no_flow(frame)

    def edges(self) -> list[FrameInfo]:
        """The frames with a parent, by name; with a pair, only its chain, in its order."""
        frames = self.tree.frames
        names = (
            self.pair.chain if self.pair and self.pair.chain else sorted(frames, key=natural_order)
        )
        return [frames[name] for name in names if name in frames and frames[name].parent]

    def rows(self) -> list[MeasuredEdge]:
        """The edges of `edges`, and edges of further publishers, from which samples came too."""
        found = [MeasuredEdge(frame, self.flow(frame)) for frame in self.edges()]
        shown = {(row.frame.authority, row.frame.name) for row in found}
        chain = self.pair.chain if self.pair else ()
        found += [
            MeasuredEdge(FrameInfo(flow.child, flow.parent, authority=flow.stream), flow)
            for key, flow in self.flows.items()
            if key not in shown and flow.delays_s is not None and (not chain or key[1] in chain)
        ]
        if chain:
            return sorted(found, key=lambda row: chain.index(row.frame.name))
        return sorted(found, key=lambda row: (natural_order(row.frame.name), row.frame.authority))


def _no_flow(frame: FrameInfo) -> EdgeFlow:
    return EdgeFlow(frame.authority, frame.parent or "", frame.name)


def make_report(
    view: BusView, meter: Meter, pair: PairWatch | None, span: MeasuredSpan | None = None
) -> Report:
    """The measurements of now, or at the end of a span."""
    flows = {(flow.stream, flow.child): flow for flow in meter.edges()}
    watched = pair.report(view) if pair else None
    return Report(view.moment(), flows, meter, watched, span)


def as_map(report: Report) -> dict[str, Any]:
    """The report for programs; units are in the names, times of a recording are log times."""
    span = report.span
    return {
        "recorded_ns": report.tree.recorded_ns,
        "from_ns": span and span.from_ns,
        "to_ns": span and span.to_ns,
        "pauses": [asdict(pause) for pause in span.pauses] if span else [],
        "dropped": report.moment.dropped,
        "unanswered": list(report.moment.unanswered),
        "pair": None if report.pair is None else asdict(report.pair),
        "edges": [
            asdict(row.frame) | {"age_s": report.tree.age_s(row.frame)} | asdict(row.flow)
            for row in report.rows()
        ],
        "statics": [frame.name for frame in report.edges() if frame.static],
        "streams": [
            asdict(stream) | asdict(report.meter.stream(stream.name))
            for stream in report.tree.streams.values()
        ],
    }


T = TypeVar("T")

# A number, a word in place of one, or nothing.
Value = float | str | None

# Forms of numbers that are seconds, besides the forms of `format`.
_DURATION, _OFFSET = "duration", "offset"


@dataclass(frozen=True)
class Column(Generic[T]):
    """A column: its heading, its value for a row of a report, and the form of numbers in it.

    80 columns have no room for all: the monitor shows a `rare` one only if a row has a value. `top`
    explains one with a `meaning`. `needs` is "now" for numbers that go stale with a span, "span"
    for times of a recording.
    """

    heading: str
    value: Callable[[Report, T], Value]
    form: str
    meaning: str = ""
    rare: bool = False
    needs: Literal["report", "now", "span"] = "report"

    def has_needs(self, report: Report) -> bool:
        """Whether the report has the numbers of this column."""
        return self.needs == "report" or (report.span is None) == (self.needs == "now")

    def text(self, value: Value) -> str:
        """The text of a value."""
        if value is None or isinstance(value, str):
            return value or ""
        if self.form == _DURATION:
            return duration(value)
        if self.form == _OFFSET:
            return offset(value)
        return format(value, self.form)


def _rate(report: Report, row: MeasuredEdge) -> Value:
    return "static" if row.frame.static else row.flow.rate_hz


def _jitter(report: Report, row: MeasuredEdge) -> Value:
    return row.flow.jitter_s


def _median_delay(report: Report, row: MeasuredEdge) -> Value:
    return None if row.flow.delays_s is None else row.flow.delays_s.p50


def _longest_delay(report: Report, row: MeasuredEdge) -> Value:
    return None if row.flow.delays_s is None else row.flow.delays_s.p99


def _age(report: Report, row: MeasuredEdge) -> Value:
    return report.tree.age_s(row.frame)


def _disordered(report: Report, row: MeasuredEdge) -> Value:
    return row.flow.out_of_order or None


def _longest_gap(report: Report, row: MeasuredEdge) -> Value:
    if row.flow.gap_from_ns is None:
        return None
    at_s = (row.flow.gap_from_ns - report.moment.start_ns) / 1e9
    return f"{duration(row.flow.longest_gap_s)} at +{at_s:.1f}s"


EDGES: tuple[Column[MeasuredEdge], ...] = (
    Column("Hz", _rate, ".1f", "messages or samples per second, mean of 10 s"),
    Column("jitter", _jitter, _DURATION, "how irregularly samples come"),
    Column(
        "delay p50", _median_delay, _DURATION, "how old a sample is when it comes, median of 10 s"
    ),
    Column("p99", _longest_delay, _DURATION),
    Column("age", _age, _DURATION, "how old the newest stamp of a frame is", needs="now"),
    Column("disordered", _disordered, "d", rare=True),
    Column("longest gap", _longest_gap, _DURATION, needs="span"),
)


def _messages(report: Report, stream: StreamInfo) -> Value:
    return report.meter.stream(stream.name).messages_hz


def _kilobytes(report: Report, stream: StreamInfo) -> Value:
    load = report.meter.stream(stream.name).bytes_per_s
    return None if load is None else load / 1e3


def _missed(report: Report, stream: StreamInfo) -> Value:
    return stream.missed


def _restarts(report: Report, stream: StreamInfo) -> Value:
    return report.meter.stream(stream.name).restarts or None


def _poses(report: Report, stream: StreamInfo) -> Value:
    return None if stream.poses == FLOAT64 else stream.poses


def _clock(report: Report, stream: StreamInfo) -> Value:
    return stream.clock_offset_s


STREAMS: tuple[Column[StreamInfo], ...] = (
    Column("Hz", _messages, ".1f"),
    Column("kB/s", _kilobytes, ".1f", rare=True),
    Column("missed", _missed, "d", "messages that were sent and never came"),
    Column("restarts", _restarts, "d", rare=True),
    Column("poses", _poses, "", "how precise its transforms are", rare=True),
    Column("clock", _clock, _OFFSET, "how far the publisher's clock is ahead of ours", rare=True),
)
