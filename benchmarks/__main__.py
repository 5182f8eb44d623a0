"""Measure tfbus beside its peers, print the tables, and write the pages: `make bench`.

The pages are docs/reference/performance.md and performance-tables.md, made from what is kept in
benchmarks/measured; `make bench ARGS="--only bus"` measures the part about the bus anew, and
`--only recordings` that about recordings.
"""

import argparse
import sys

from benchmarks import growth, machine, report
from benchmarks.bus import part as bus_part
from benchmarks.bus import plot
from benchmarks.bus.measure import measure as measure_bus
from benchmarks.measure import Bench, measure
from benchmarks.measures import comparisons
from benchmarks.pages import DOCS
from benchmarks.parts import Part, Table


def main() -> None:
    """All of it, or the rows with a word in them."""
    parser = argparse.ArgumentParser(prog="benchmarks", description=__doc__)
    parser.add_argument("--runs", type=int, default=9, help="of which the median counts (9)")
    parser.add_argument(
        "--only", default="", metavar="WORD", help="rows that have this in them; bus; recordings"
    )
    arguments = parser.parse_args()
    if arguments.only not in ("bus", "recordings"):
        _measure_buffer(arguments)
    if arguments.only in ("", "bus"):
        measured = measure_bus(min(arguments.runs, 5), _tell)
        plot.draw(measured.publishers, measured.frames, str(DOCS / "performance-bus.svg"))
        part = bus_part.part(measured, machine.describe())
        part.show()
        part.keep("bus")
    if arguments.only in ("", "recordings"):
        _measure_recordings(arguments)


def _measure_recordings(arguments: argparse.Namespace) -> None:
    """tfbus and numpy are imported only where recordings are measured."""
    from benchmarks.recordings import part as recordings_part
    from benchmarks.recordings.measure import measure as measure_recordings

    place = machine.describe()
    part = recordings_part.part(measure_recordings(min(arguments.runs, 5), _tell), place)
    part.show()
    part.keep("recordings")


def _measure_buffer(arguments: argparse.Namespace) -> None:
    chosen = [row for row in comparisons() if arguments.only in f"{row.what} {row.peer}"]
    place = machine.describe()
    with Bench() as bench:
        versions = bench.versions()
        results = measure(bench, chosen, arguments.runs, _tell)
        curves = [] if arguments.only else growth.grow(bench, 3, _tell)
    print(report.as_text(results))
    for line in report.left_out(results):
        print(f"left out: {line}")
    print(place, *(f"{peer}: {version}" for peer, version in versions.items()), sep="\n")
    if curves:
        growth.plot(curves, str(DOCS / "performance.svg"))
        tables = {"peers": Table(report.HEADINGS, report.rows(results), words=2)}
        tables |= {curve.axis.measure: growth.as_table(curve) for curve in curves}
        left_out = "; ".join(report.left_out(results))
        Part(place, tables, versions, {"left_out": left_out}).keep("buffer")


def _tell(what: str) -> None:
    print(f"  {what}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
