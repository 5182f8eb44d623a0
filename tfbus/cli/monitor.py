"""`tfbus monitor`: rates, jitter, delays, missed messages and clocks of transforms, live."""

import itertools
import shlex
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from typing import TypeVar

import click

from tfbus.base.wording import counted, cut_middle, duration, listed, stamp_text, wrapped
from tfbus.buffer.info import FrameInfo
from tfbus.bus.settings import NodeSettings
from tfbus.cli.bus import (
    frames_in_span,
    is_running,
    listening,
    span_lines,
    warn_of_unanswered,
)
from tfbus.cli.fleet import FleetPage
from tfbus.cli.output import (
    json_option,
    longest_line,
    paint,
    paint_state,
    print_json,
    print_lines,
    screen,
    table,
)
from tfbus.command.options import listening_options, period_option
from tfbus.command.recordings import BagChoice, bag_options
from tfbus.command.types import FrameName
from tfbus.frames.clocks import is_another_time, whose_clock
from tfbus.frames.moment import BusMoment, BusView, LiveView, faults, state
from tfbus.frames.report import (
    EDGES,
    STREAMS,
    Column,
    MeasuredEdge,
    Meter,
    Pair,
    PairWatch,
    Report,
    as_map,
    make_report,
)
from tfbus.streams.info import StreamInfo
from tfbus.wire.fleet import Fleet

T = TypeVar("T")

# How often a pair is looked up: its answer ages between two samples.
_LOOK_EVERY_S = 0.05
# Between two frames of a chain.
_TO = " -> "
# The most letters that stand beside a name in a line: `Held back by: `, and some.
_BESIDE_NAME = 20


@click.command(
    epilog="Examples: tfbus monitor; tfbus monitor world drone; tfbus monitor --once --json; "
    "tfbus monitor --bag run.mcap --from +10s --to +20s"
)
@click.argument("target", type=FrameName(), required=False)
@click.argument("source", type=FrameName(), required=False)
@period_option("Time between reports")
@click.option("--once", is_flag=True, help="Print one report and exit.")
@json_option("Print each report as one line of JSON.")
@bag_options("begin", "end")
@listening_options("_monitor")
def command(
    settings: NodeSettings,
    fleet: Fleet | None,
    bag: BagChoice | None,
    target: str | None,
    source: str | None,
    period_s: float,
    once: bool,
    as_json: bool,
) -> None:
    """Measure rate, delay and order of transforms: all, or those between two frames.

    With two frames, measure the edges on the path between TARGET and SOURCE. With --bag, print one
    report of a whole recording, or of a span of it.
    """
    if target is not None and source is None:
        given = shlex.quote(target)
        raise click.UsageError(f"give two frames, as in: tfbus monitor {given} FRAME; or none")
    if bag is not None:
        _measure_recorded(settings, fleet, bag, target, source, as_json)
        return
    pair = PairWatch(target, source) if target is not None and source is not None else None
    page = FleetPage(None if pair else fleet)
    from tfbus.frames.meter import TransformMeter  # slow, and `--help` does not need it

    with listening(settings, fleet, goes_on=not once) as heard:
        heard.watch_nodes()
        warn_of_unanswered(heard.moment().unanswered)
        _fitting(page, heard.moment())  # the rates of robots begin here
        reports = _reports(heard, TransformMeter(heard.node, fleet), pair, period_s)
        first = next(reports, None)
        if first is None:
            raise KeyboardInterrupt
        _check(heard, first, once)
        if once and not as_json:
            print_lines(_fitting(page, first.moment) or as_lines(first))
            return
        with suppress(KeyboardInterrupt), ExitStack() as stack:  # its usual end
            show = None if as_json else stack.enter_context(screen())
            for report in [first] if once else itertools.chain([first], reports):
                if show is None:
                    print_json(as_map(report))
                else:
                    hint = "" if report.edges() else heard.hint_while_empty()
                    show(_fitting(page, report.moment) or as_lines(report, hint))


def _measure_recorded(
    settings: NodeSettings,
    fleet: Fleet | None,
    bag: BagChoice,
    target: str | None,
    source: str | None,
    as_json: bool,
) -> None:
    from tfbus.frames.meter import MOST_LOOKS, measured

    pair = None
    if target is not None and source is not None:
        pair = PairWatch(target, source, MOST_LOOKS)
    with frames_in_span(bag, settings, fleet) as (heard, from_ns, to_ns):
        report = measured(heard, from_ns, to_ns, pair)
        of_bag = [word for path in bag.paths for word in ("--bag", str(path))]
        if bag.end is not None:
            of_bag += ["--at", stamp_text(to_ns)]
        _check(heard, report, once=True, of_bag=of_bag)
        if as_json:
            print_json(as_map(report))
        else:
            print_lines(span_lines(bag, heard, from_ns, to_ns))
            print_lines(_fitting(FleetPage(fleet), report.moment) or as_lines(report))


def _fitting(page: FleetPage, moment: BusMoment) -> list[str] | None:
    return page.lines(moment, "--json measures each, TARGET SOURCE a path")


def _check(heard: BusView, report: Report, once: bool, of_bag: Sequence[str] = ()) -> None:
    """Raises ClickException if there is nothing to measure and waiting does not help.

    `of_bag` are the words by which another command looks at the same moment of a recording.
    """
    pair = report.pair
    if pair and pair.failure:
        unknown = sorted({pair.target, pair.source}.difference(heard.buffer.frames()))
        hint = next(filter(None, map(heard.hint, unknown)), "")
        failure = f"{pair.failure}; {hint}" if hint else pair.failure
        why = shlex.join(["tfbus", "why", pair.target, pair.source, *of_bag])
        raise click.ClickException(f"{failure} (see: {why})")
    if once and not report.edges():
        hint = heard.hint() or is_running("broadcaster")
        raise click.ClickException(f"no transform yet: {hint}")


def _reports(
    heard: LiveView, meter: Meter, pair: PairWatch | None, period_s: float
) -> Iterator[Report]:
    """A report after each period, until the node is shut down."""
    while _measure(heard, pair, period_s):
        yield make_report(heard, meter, pair)


def _measure(heard: LiveView, pair: PairWatch | None, period_s: float) -> bool:
    """Wait for one period; False if the node is shut down."""
    end_s = time.monotonic() + period_s
    while (left_s := end_s - time.monotonic()) > 0:
        if not heard.wait(min(left_s, _LOOK_EVERY_S)):
            return False
        if pair is not None:
            pair.measure(heard, time.monotonic())
    return True


def as_lines(report: Report, hint: str = "") -> list[str]:
    """The report as tables; `hint` is where to look if there is no transform."""
    lines = _pair_lines(report.pair) if report.pair else []
    if report.pair and report.pair.failure:
        return lines
    rows = report.rows()
    if not rows:
        return [f"No transform yet: {hint}" if hint else "No transform yet"]
    streams = list(report.tree.streams.values())
    lines += _table(
        report,
        {
            "frame": [_frame(report, each) for each in rows],
            "by": [_publisher(report, each) for each in rows],
        },
        EDGES,
        rows,
    )
    lines.append("")
    lines += _table(
        report,
        {
            "stream": [each.name for each in streams],
            "node": [_node(each) for each in streams],
            "host": [each.host for each in streams],
        },
        STREAMS,
        streams,
    )
    return [*lines, *_dropped_lines(report), *_clock_lines(report), *_stamp_lines(report)]


def _table(
    report: Report,
    names: Mapping[str, Sequence[str]],
    columns: Sequence[Column[T]],
    rows: Sequence[T],
) -> list[str]:
    """A table of these columns of names, with their headings, and of columns of numbers."""
    told = {
        each: [each.text(each.value(report, row)) for row in rows]
        for each in columns
        if each.has_needs(report)
    }
    shown = {each: texts for each, texts in told.items() if not each.rare or any(texts)}
    cells = zip(*names.values(), *map(_painted, shown, shown.values()), strict=True)
    headings = [*names, *(each.heading for each in shown)]
    return table(headings, cells, right=range(len(names), len(headings)), names=range(2))


def _painted(column: Column[T], texts: list[str]) -> list[str]:
    """The times of gaps are warnings."""
    return [paint(each, "warning") for each in texts] if column.needs == "span" else texts


def _frame(report: Report, row: MeasuredEdge) -> str:
    return paint_state(row.frame.name, state(report.tree, _now(report, row)))


def _publisher(report: Report, row: MeasuredEdge) -> str:
    now = _now(report, row)
    wrong = faults(report.tree, now)
    by = row.frame.authority
    return paint_state(f"{by} {', '.join(wrong).upper()}", state(report.tree, now)) if wrong else by


def _now(report: Report, row: MeasuredEdge) -> FrameInfo:
    """The frame of an edge as it is in the tree: another publisher's sample may be the last."""
    return report.tree.frames.get(row.frame.name, row.frame)


def _node(stream: StreamInfo) -> str:
    return stream.node if stream.alive else paint(f"{stream.node} GONE", "bad")


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
    return wrapped(line, longest_line(), after="  ")


def _clock_lines(report: Report) -> list[str]:
    """A line that names the frames with ages that are none, by stamps that are."""
    tree = report.tree
    odd = [
        each.name
        for each in report.edges()
        if is_another_time(tree.age_s(each)) and not tree.no_stamps(each)
    ]
    if not odd:
        return []
    frames = listed([repr(_cut(name)) for name in odd])
    question = whose_clock(is_simulated=tree.is_simulated)
    said = _wrapped(f"The stamps of {frames} are of another clock: {question}")
    return ["", *(paint(line, "bad") for line in said)]


def _stamp_lines(report: Report) -> list[str]:
    """The remedy for frames whose stamps are in another unit, or in the future."""
    tree = report.tree
    shown = {frame.name for frame in report.edges()}
    lines: list[str] = []
    for problem in tree.problems():
        if not shown.intersection(problem.frames):
            continue
        if problem.kind == "unit":
            lines += _wrapped(f"{problem.text}: {problem.remedy}")
        elif problem.kind == "ahead" and not any(
            is_another_time(tree.age_s(tree.frames[name])) for name in problem.frames
        ):
            lines += _wrapped(problem.text)
    return ["", *(paint(line, "bad") for line in lines)] if lines else []


def _dropped_lines(report: Report) -> list[str]:
    if not report.moment.dropped:
        return []
    text = f"Dropped {counted(report.moment.dropped, 'message')}: transforms come on too many keys"
    return ["", paint(text, "bad")]
