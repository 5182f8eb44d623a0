"""The report of `tfbus monitor` as tables in a terminal."""

from typing import TYPE_CHECKING

from tfbus.cli.output import paint, paint_state, table
from tfbus.frames.state import faults, is_another_time, state, whose_clock
from tfbus.monitor.report import Pair, Report
from tfbus.wording import counted, duration, listed

if TYPE_CHECKING:
    from tfbus.monitor.recorded import SpanReport


def as_lines(report: Report, hint: str = "") -> list[str]:
    """The report as tables; `hint` is where to look if there is no transform."""
    lines = _pair_lines(report.pair) if report.pair else []
    if report.pair and report.pair.failure:
        return lines
    if not report.edges():
        return [f"No transform yet: {hint}" if hint else "No transform yet"]
    tables = [*_edge_table(report), "", *_stream_table(report)]
    return [*lines, *tables, *_dropped_lines(report), *_clock_lines(report)]


def span_as_lines(report: "SpanReport", start_ns: int) -> list[str]:
    """The report of a span of a recording that begins at `start_ns`, as tables."""
    lines = _pair_lines(report.pair) if report.pair else []
    flows = report.shown()
    # In 80 columns there is room for it where it is needed only.
    disorder = ("disordered",) if any(flow.out_of_order for flow in flows) else ()
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
    tables = [*table(headings, sorted(rows), right=range(2, len(headings))), ""]
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
    return [*lines, *tables, *table(of_stream, rows, right=range(3, len(of_stream)))]


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
        lines.append("Held back by: nothing, all edges are static")
    else:
        lines.append(f"Held back by: {pair.held_back_by}")
    return [*lines, ""]


def _clock_lines(report: Report) -> list[str]:
    """A line that names the frames with ages that are none."""
    odd = [each.name for each in report.edges() if is_another_time(report.tree.age_s(each))]
    if not odd:
        return []
    frames = listed(list(map(repr, odd)))
    question = whose_clock(is_simulated=report.tree.is_simulated)
    return ["", paint(f"The stamps of {frames} are of another clock: {question}", "bad")]


def _edge_table(report: Report) -> list[str]:
    headings = ("frame", "by", "Hz", "jitter", "delay p50", "p99", "age", "disordered")
    rows = []
    for frame in report.edges():
        flow, delays = report.flow(frame), report.flow(frame).delays_s
        its_state = state(report.tree, frame)
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
        name = paint_state(frame.name, its_state)
        by = frame.authority
        if wrong := faults(report.tree, frame):
            by = paint_state(f"{by} {', '.join(wrong).upper()}", its_state)
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
    text = f"Dropped {counted(report.dropped, 'message')}: transforms come on too many keys"
    return ["", paint(text, "bad")]
