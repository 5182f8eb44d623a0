"""The report of `tfbus monitor` as tables in a terminal."""

import itertools
import textwrap
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from tfbus.cli.output import longest_line, paint, paint_state, table
from tfbus.frames.other_clocks import is_another_time, whose_clock
from tfbus.frames.state import faults, state
from tfbus.monitor.report import Pair, Report
from tfbus.wording import counted, cut_middle, duration, listed

if TYPE_CHECKING:
    from tfbus.monitor.recorded import SpanReport

# Between two frames of a chain.
_TO = " -> "
# The most letters that stand beside a name in a line: `Held back by: `, and some.
_BESIDE_NAME = 20


def as_lines(report: Report, hint: str = "") -> list[str]:
    """The report as tables; `hint` is where to look if there is no transform."""
    lines = _pair_lines(report.pair) if report.pair else []
    if report.pair and report.pair.failure:
        return lines
    if not report.edges():
        return [f"No transform yet: {hint}" if hint else "No transform yet"]
    tables = [*_edge_table(report), "", *_stream_table(report)]
    return [*lines, *tables, *_dropped_lines(report), *_clock_lines(report), *_ahead_lines(report)]


def span_as_lines(report: "SpanReport", start_ns: int) -> list[str]:
    """The report of a span of a recording that begins at `start_ns`, as tables."""
    lines = _pair_lines(report.pair) if report.pair else []
    flows = report.shown()
    disorder = _disorder(flow.out_of_order for flow in flows)
    headings = ("frame", "by", "Hz", "jitter", "delay p50", "p99", *disorder, "longest gap")
    rows = []
    for flow in flows:
        delays, gap = flow.delays_s, ""
        if flow.gap_from_ns is not None:
            at_s = (flow.gap_from_ns - start_ns) / 1e9
            gap = f"{duration(flow.longest_gap_s)} at +{at_s:.1f}s"
        rows.append(
            [
                flow.child,
                flow.stream,
                "" if flow.rate_hz is None else f"{flow.rate_hz:.1f}",
                "" if flow.jitter_s is None else duration(flow.jitter_s),
                "" if delays is None else duration(delays.p50),
                "" if delays is None else duration(delays.p99),
                *(str(flow.out_of_order) for _ in disorder),
                paint(gap, "warning") if gap else "",
            ]
        )
    empty = [""] * (len(headings) - 3)
    rows += [[frame.name, frame.authority, "static", *empty] for frame in report.statics()]
    tables = [*_table(headings, sorted(rows), right=range(2, len(headings))), ""]
    of_stream = ("stream", "node", "host", "Hz", "missed", "restarts")
    rows = [
        [
            stream.name,
            stream.node if stream.alive else paint(f"{stream.node} GONE", "bad"),
            stream.host,
            f"{report.meter.stream(stream.name).messages_hz:.1f}",
            str(stream.missed),
            str(report.restarts(stream.name)),
        ]
        for stream in report.tree.streams.values()
    ]
    tables += _table(of_stream, rows, right=range(3, len(of_stream)))
    return [*lines, *tables, *_ahead_lines(report)]


def _pair_lines(pair: Pair) -> list[str]:
    both = (longest_line() - len(_TO)) // 2
    lines = [
        paint(f"{cut_middle(pair.target, both)}{_TO}{cut_middle(pair.source, both)}", "heading")
    ]
    if pair.failure:
        return [*lines, *(paint(line, "bad") for line in _wrapped(f"No transform: {pair.failure}"))]
    lines += _wrapped(f"Chain: {_TO.join(map(_cut, pair.chain))}")
    if pair.net_delay_s:
        delay = pair.net_delay_s
        lines.append(
            f"Net delay: p50 {duration(delay.p50)}, p95 {duration(delay.p95)}, "
            f"p99 {duration(delay.p99)}, max {duration(delay.max)}"
        )
    if pair.held_back_by is None:
        lines.append("Held back by: nothing, all edges are static")
    else:
        lines.append(f"Held back by: {_cut(pair.held_back_by)}")
    return [*lines, ""]


def _cut(name: str) -> str:
    """A name that fits into a line of its own, with some words beside it."""
    return cut_middle(name, max(longest_line() - _BESIDE_NAME, 1))


def _wrapped(line: str) -> list[str]:
    return textwrap.wrap(line, longest_line(), subsequent_indent="  ", break_on_hyphens=False)


def _table(headings: Sequence[str], rows: Iterable[Sequence[str]], *, right: range) -> list[str]:
    """A table whose first two columns are names."""
    return table(headings, rows, right=right, names=range(2))


def _disorder(counts: Iterable[int]) -> tuple[str, ...]:
    """The heading of that column; in 80 columns there is room for it if it is needed only."""
    return ("disordered",) if any(counts) else ()


def _clock_lines(report: Report) -> list[str]:
    """A line that names the frames with ages that are none."""
    odd = [each.name for each in report.edges() if is_another_time(report.tree.age_s(each))]
    if not odd:
        return []
    frames = listed([repr(_cut(name)) for name in odd])
    question = whose_clock(is_simulated=report.tree.is_simulated)
    said = _wrapped(f"The stamps of {frames} are of another clock: {question}")
    return ["", *(paint(line, "bad") for line in said)]


def _ahead_lines(report: Report) -> list[str]:
    """The remedy for frames whose stamps are in the future."""
    shown = {frame.name for frame in report.edges()}
    problems = [
        _wrapped(problem.text)
        for problem in report.tree.problems()
        if problem.kind == "ahead"
        and shown.intersection(problem.frames)
        and not any(
            is_another_time(report.tree.age_s(report.tree.frames[name])) for name in problem.frames
        )
    ]
    lines = list(itertools.chain.from_iterable(problems))
    return ["", *(paint(line, "bad") for line in lines)] if lines else []


def _edge_table(report: Report) -> list[str]:
    disorder = _disorder(report.flow(frame).out_of_order for frame in report.edges())
    headings = ("frame", "by", "Hz", "jitter", "delay p50", "p99", "age", *disorder)
    rows = []
    for frame in report.edges():
        flow, delays = report.flow(frame), report.flow(frame).delays_s
        its_state = state(report.tree, frame)
        if frame.static:
            cells = ["static", *[""] * (len(headings) - 3)]
        else:
            cells = [
                "" if flow.rate_hz is None else f"{flow.rate_hz:.1f}",
                "" if flow.jitter_s is None else duration(flow.jitter_s),
                "" if delays is None else duration(delays.p50),
                "" if delays is None else duration(delays.p99),
                duration(report.tree.age_s(frame)),
                *(str(flow.out_of_order) for _ in disorder),
            ]
        name = paint_state(frame.name, its_state)
        by = frame.authority
        if wrong := faults(report.tree, frame):
            by = paint_state(f"{by} {', '.join(wrong).upper()}", its_state)
        rows.append([name, by, *cells])
    return _table(headings, rows, right=range(2, len(headings)))


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
    return _table(headings, rows, right=range(3, len(headings)))


def _dropped_lines(report: Report) -> list[str]:
    if not report.dropped:
        return []
    text = f"Dropped {counted(report.dropped, 'message')}: transforms come on too many keys"
    return ["", paint(text, "bad")]
