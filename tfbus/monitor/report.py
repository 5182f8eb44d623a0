"""The report of `tfbus monitor` and `tfbus top` at one moment: edges, streams, a pair of frames."""

from dataclasses import asdict, dataclass
from typing import Any, Protocol

from tfbus.buffer.info import FrameInfo
from tfbus.errors import TransformException
from tfbus.frames.moment import BusMoment, BusView
from tfbus.frames.snapshot import FrameTree
from tfbus.monitor.flow import EdgeFlow, MessageWindow, Meter, Spread, spread_of
from tfbus.recording.pauses import Pause
from tfbus.wording import natural_order

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

    def look(self, heard: BusView, at_s: float) -> None:
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
    return min(newest, key=lambda name: newest[name], default=None)


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
        """The frames with a parent, by name; with a pair, those of its chain, in its order."""
        frames = self.tree.frames
        names = (
            self.pair.chain if self.pair and self.pair.chain else sorted(frames, key=natural_order)
        )
        return [frames[name] for name in names if name in frames and frames[name].parent]

    def rows(self) -> list[MeasuredEdge]:
        """The edges of `edges`, and those of further publishers, from which samples came too."""
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
