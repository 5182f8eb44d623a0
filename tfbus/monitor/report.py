"""What `tfbus monitor` tells at one moment: of each edge, each publisher, and of a pair."""

from dataclasses import asdict, dataclass
from typing import Any

from tfbus.buffer.info import FrameInfo
from tfbus.cli.output import paint, table
from tfbus.errors import TransformException
from tfbus.frames.listening import Listening
from tfbus.frames.snapshot import FrameTree
from tfbus.frames.state import State, state
from tfbus.frames.text import conflicting
from tfbus.monitor.meter import EdgeFlow, TransformMeter
from tfbus.monitor.window import Spread, Window, spread_of
from tfbus.wording import counted, duration

_MOST_SAMPLES = 1_000
_ROLES: dict[State, str] = {
    "static": "faint",
    "stale": "warning",
    "gone": "bad",
    "conflict": "bad",
}

# What is said in words too, for those who see no colour.
_TOLD: tuple[State, ...] = ("stale", "gone", "conflict")

_NO_FLOW = EdgeFlow("", "", "", None, None, None, 0)


@dataclass(frozen=True)
class Pair:
    """Where one frame is seen from another: over which frames, how late, and who is the latest.

    `net_delay_s` is how old the newest answer was, each time one looked. `held_back_by` is the
    child of the edge whose newest sample is the oldest, None where all edges are static.
    `failure` is why there is no answer, "" where there is one.
    """

    target: str
    source: str
    chain: tuple[str, ...] = ()
    net_delay_s: Spread | None = None
    held_back_by: str | None = None
    failure: str = ""


class PairWatch:
    """Looks one frame up from another, again and again."""

    def __init__(self, target: str, source: str):
        self._target, self._source = target, source
        self._delays = Window(_MOST_SAMPLES)

    def look(self, heard: Listening, at_s: float) -> None:
        """Measure how old the newest answer is now."""
        try:
            stamp_ns = heard.buffer.latest_common_time(self._target, self._source)
        except TransformException:
            return
        if stamp_ns is not None:
            self._delays.add(at_s, (heard.node.now_ns() - stamp_ns) / 1e9)

    def report(self, heard: Listening) -> Pair:
        """What is known of the pair."""
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


def _held_back_by(heard: Listening, chain: list[str]) -> str | None:
    """The child of the edge on the path that was heard of the longest ago."""
    infos = {name: heard.buffer.frame(name) for name in chain}
    newest = {
        info.name: info.newest_ns
        for info in infos.values()
        if info.parent in infos and not info.static and info.newest_ns is not None
    }
    return min(newest, key=lambda name: newest[name], default=None)


@dataclass(frozen=True)
class Report:
    """All that the monitor knows at one moment; `dropped` are the messages that it could not take,
    since transforms came on too many keys.
    """

    tree: FrameTree
    flows: dict[tuple[str, str], EdgeFlow]
    meter: TransformMeter
    pair: Pair | None
    dropped: int = 0

    def flow(self, frame: FrameInfo) -> EdgeFlow:
        """How the samples of a frame's edge came."""
        return self.flows.get((frame.authority, frame.name), _NO_FLOW)

    def edges(self) -> list[FrameInfo]:
        """The frames that have a parent, by name; of a pair those of its chain, in its order."""
        frames = self.tree.frames
        names = self.pair.chain if self.pair and self.pair.chain else sorted(frames)
        return [frames[name] for name in names if name in frames and frames[name].parent]


def make_report(heard: Listening, meter: TransformMeter, pair: PairWatch | None) -> Report:
    """What is known now."""
    flows = {(flow.stream, flow.child): flow for flow in meter.edges()}
    told = pair.report(heard) if pair else None
    return Report(heard.tree(), flows, meter, told, heard.listener.dropped)


def as_lines(report: Report) -> list[str]:
    """The report as tables."""
    lines = _pair_lines(report.pair) if report.pair else []
    if report.pair and report.pair.failure:
        return lines
    if not report.edges():
        return ["No transform has come yet."]
    return [*lines, *_edge_table(report), "", *_stream_table(report), *_dropped_lines(report)]


def _pair_lines(pair: Pair) -> list[str]:
    lines = [paint(f"{pair.target} -> {pair.source}", "heading")]
    if pair.failure:
        return [*lines, paint(f"No transform: {pair.failure}", "bad")]
    lines.append(f"Chain: {' -> '.join(pair.chain)}")
    if pair.net_delay_s:
        delay = pair.net_delay_s
        lines.append(
            f"Net delay: p50 {duration(delay.p50)}, p95 {duration(delay.p95)}, "
            f"p99 {duration(delay.p99)}, max {duration(delay.max)}"
        )
    if pair.held_back_by is None:
        lines.append("Nothing holds it back: all of it is static")
    else:
        lines.append(f"Held back by: {pair.held_back_by}")
    return [*lines, ""]


def _edge_table(report: Report) -> list[str]:
    headings = ("frame", "by", "Hz", "jitter", "delay p50", "p99", "age", "disordered")
    conflicts = conflicting(report.tree)
    rows = []
    for frame in report.edges():
        flow, delays = report.flow(frame), report.flow(frame).delays_s
        told = state(report.tree, frame, conflicts)
        if frame.static:
            cells = ["static", "", "", "", "", ""]
        else:
            cells = [
                "" if flow.rate_hz is None else f"{flow.rate_hz:.1f}",
                "" if flow.jitter_s is None else duration(flow.jitter_s),
                "" if delays is None else duration(delays.p50),
                "" if delays is None else duration(delays.p99),
                duration(report.tree.age_s(frame)),
                str(flow.out_of_order),
            ]
        name = paint(frame.name, _ROLES[told]) if told in _ROLES else frame.name
        by = frame.authority
        if told in _TOLD:
            by = paint(f"{by} {told.upper()}", _ROLES[told])
        rows.append([name, by, *cells])
    return table(headings, rows, right=range(2, len(headings)))


def _stream_table(report: Report) -> list[str]:
    headings = ("stream", "node", "host", "Hz", "kB/s", "missed", "clock")
    rows = []
    for stream in report.tree.streams.values():
        flow = report.meter.stream(stream.name)
        offset_s = stream.clock_offset_s
        rows.append(
            [
                stream.name,
                stream.node if stream.alive else paint(f"{stream.node} GONE", "bad"),
                stream.host,
                f"{flow.messages_hz:.1f}",
                f"{flow.bytes_per_s / 1e3:.1f}",
                str(stream.missed),
                "" if offset_s is None else f"{'+' if offset_s >= 0 else ''}{duration(offset_s)}",
            ]
        )
    return table(headings, rows, right=range(3, len(headings)))


def _dropped_lines(report: Report) -> list[str]:
    if not report.dropped:
        return []
    told = f"Dropped {counted(report.dropped, 'message')}: transforms come on too many keys"
    return ["", paint(told, "bad")]


def as_map(report: Report) -> dict[str, Any]:
    """The report for programs: times in ns or s, as their names say."""
    return {
        "recorded_ns": report.tree.recorded_ns,
        "dropped": report.dropped,
        "pair": None if report.pair is None else asdict(report.pair),
        "edges": [
            asdict(frame)
            | {"age_s": report.tree.age_s(frame)}
            | {key: value for key, value in asdict(report.flow(frame)).items() if key in _MEASURED}
            for frame in report.edges()
        ],
        "streams": [
            asdict(stream) | asdict(report.meter.stream(stream.name))
            for stream in report.tree.streams.values()
        ],
    }


_MEASURED = ("rate_hz", "jitter_s", "delays_s", "out_of_order")
