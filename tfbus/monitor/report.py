"""The report of `tfbus monitor` and `tfbus top` show at one moment: edges, streams, and a pair of
frames.
"""

from dataclasses import asdict, dataclass
from typing import Any

from tfbus.buffer.info import FrameInfo
from tfbus.errors import TransformException
from tfbus.frames.heard import Heard
from tfbus.frames.snapshot import FrameTree
from tfbus.monitor.flow import EdgeFlow, Meter
from tfbus.monitor.window import Spread, Window, spread_of

_MOST_SAMPLES = 1_000
_NO_FLOW = EdgeFlow("", "", "")
# What `as_map` has of an edge, besides its frame.
_MEASURED = (
    "rate_hz",
    "jitter_s",
    "delays_s",
    "out_of_order",
    "longest_gap_s",
    "gaps",
    "gap_from_ns",
)


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
        self._delays = Window(most)

    def look(self, heard: Heard, at_s: float) -> None:
        """Measure the age of the newest answer now."""
        try:
            stamp_ns = heard.buffer.latest_common_time(self._target, self._source)
        except TransformException:
            return
        if stamp_ns is not None:
            self._delays.add(at_s, (heard.now_ns() - stamp_ns) / 1e9)

    def report(self, heard: Heard) -> Pair:
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


def _held_back_by(heard: Heard, chain: list[str]) -> str | None:
    """The child of the edge on the path whose newest sample is the oldest."""
    infos = {name: heard.buffer.frame(name) for name in chain}
    newest = {
        info.name: info.newest_ns
        for info in infos.values()
        if info.parent in infos and not info.static and info.newest_ns is not None
    }
    return min(newest, key=lambda name: newest[name], default=None)


@dataclass(frozen=True)
class Report:
    """The report of the monitor at one moment.

    `dropped` counts the messages that the listener dropped because transforms came on too many
    keys.
    """

    tree: FrameTree
    flows: dict[tuple[str, str], EdgeFlow]
    meter: Meter
    pair: Pair | None
    dropped: int = 0

    def flow(self, frame: FrameInfo) -> EdgeFlow:
        """How the samples of a frame's edge came."""
        return self.flows.get((frame.authority, frame.name), _NO_FLOW)

    def edges(self) -> list[FrameInfo]:
        """The frames with a parent, by name; with a pair, those of its chain, in its order."""
        frames = self.tree.frames
        names = self.pair.chain if self.pair and self.pair.chain else sorted(frames)
        return [frames[name] for name in names if name in frames and frames[name].parent]


def make_report(heard: Heard, meter: Meter, pair: PairWatch | None) -> Report:
    """The measurements of now."""
    flows = {(flow.stream, flow.child): flow for flow in meter.edges()}
    watched = pair.report(heard) if pair else None
    return Report(heard.tree(), flows, meter, watched, heard.dropped)


def as_map(report: Report) -> dict[str, Any]:
    """The report for programs; units are in the names."""
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
