"""`tfbus monitor`: rates, jitter, delays, missed messages and clocks of transforms, live."""

import itertools
import shlex
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, suppress
from typing import TYPE_CHECKING

import click

from tfbus.bus.settings import NodeSettings
from tfbus.cli.bus import is_running, warn_of_unanswered
from tfbus.cli.monitor_report import as_lines
from tfbus.cli.output import json_option, print_json, print_lines, screen
from tfbus.command.options import listening_options
from tfbus.command.recordings import BagChoice, bag_options
from tfbus.command.types import FrameName, Number, own_name
from tfbus.frames.moment import BusView
from tfbus.monitor.report import PairWatch, Report, as_map, make_report
from tfbus.runtime.clock import SYSTEM_CLOCK
from tfbus.wire.fleet import Fleet
from tfbus.wording import stamp_text

if TYPE_CHECKING:
    from tfbus.frames.command_listener import Listening

# How often a pair is looked up: its answer ages between two samples.
_LOOK_EVERY_S = 0.05


@click.command(
    epilog="Examples: tfbus monitor; tfbus monitor world drone; tfbus monitor --once --json; "
    "tfbus monitor --bag run.mcap --from +10s --to +20s"
)
@click.argument("target", type=FrameName(), required=False)
@click.argument("source", type=FrameName(), required=False)
@click.option(
    "-p",
    "--period",
    "period_s",
    type=Number(least=0.1, most=3600.0),
    default=1.0,
    metavar="SECONDS",
    show_default=True,
    help="Time between reports, at least 0.1.",
)
@click.option("--once", is_flag=True, help="Print one report and exit.")
@json_option("Print each report as one line of JSON.")
@bag_options("begin", "end")
@listening_options(lambda: own_name("_monitor"))
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
    from tfbus.frames.command_listener import listening  # Zenoh, which a recording does not need

    pair = PairWatch(target, source) if target is not None and source is not None else None
    with listening(settings, fleet, goes_on=not once) as heard:
        heard.ask_nodes()
        warn_of_unanswered(heard.moment().unanswered)
        reports = _reports(heard, pair, period_s)
        first = next(reports, None)
        if first is None:
            raise KeyboardInterrupt
        _check(heard, first, once)
        if once and not as_json:
            print_lines(as_lines(first))
            return
        with suppress(KeyboardInterrupt), ExitStack() as stack:  # its usual end
            show = None if as_json else stack.enter_context(screen())
            for report in [first] if once else itertools.chain([first], reports):
                if show is None:
                    print_json(as_map(report))
                else:
                    show(as_lines(report, "" if report.edges() else heard.hint_while_empty()))


def _measure_recorded(
    settings: NodeSettings,
    fleet: Fleet | None,
    bag: BagChoice,
    target: str | None,
    source: str | None,
    as_json: bool,
) -> None:
    from tfbus.cli.recorded import span_lines
    from tfbus.frames.recorded_poses import frames_of
    from tfbus.monitor.meter import MOST_LOOKS, measured

    pair = None
    if target is not None and source is not None:
        pair = PairWatch(target, source, MOST_LOOKS)
    with bag.opened() as recording:
        from_ns, to_ns = recording.span
        heard = frames_of(recording, settings, fleet)
        report = measured(heard, from_ns, to_ns, pair)
        of_bag = [word for path in bag.paths for word in ("--bag", str(path))]
        if bag.end is not None:
            of_bag += ["--at", stamp_text(to_ns)]
        _check(heard, report, once=True, of_bag=of_bag)
        if as_json:
            print_json(as_map(report))
        else:
            print_lines(span_lines(bag, heard, from_ns, to_ns))
            print_lines(as_lines(report))


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


def _reports(heard: "Listening", pair: PairWatch | None, period_s: float) -> Iterator[Report]:
    """A report after each period, until the node is shut down."""
    from tfbus.monitor.meter import TransformMeter

    meter = TransformMeter(heard.node, heard.fleet)
    while _measure(heard, pair, period_s):
        tree = heard.tree()
        if any(map(tree.is_ahead, tree.frames.values())):
            heard.ask_about_clocks()
        yield make_report(heard, meter, pair)


def _measure(heard: "Listening", pair: PairWatch | None, period_s: float) -> bool:
    """Wait for one period; False if the node is shut down."""
    end_s = time.monotonic() + period_s
    while (left_s := end_s - time.monotonic()) > 0:
        if not heard.node.wait(min(left_s, _LOOK_EVERY_S), clock=SYSTEM_CLOCK):
            return False
        if pair is not None:
            pair.look(heard, time.monotonic())
    return True
