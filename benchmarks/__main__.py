"""Measure tfbus beside its peers, print the table, and write the page: `make bench`.

The page is docs/reference/performance.md; `make bench ARGS="--only bus"` writes its part about
the bus, and `--only recordings` that about recordings.
"""

import argparse
import sys
from pathlib import Path

from benchmarks import growth, machine, page, parts, report
from benchmarks.bus import page as bus_page
from benchmarks.bus import plot
from benchmarks.bus.measure import measure as measure_bus
from benchmarks.measure import Bench, measure
from benchmarks.measures import comparisons

DOCS = Path(__file__).parent.parent / "docs" / "reference"


def main() -> None:
    """All of it, or the rows with a word in them."""
    parser = argparse.ArgumentParser(prog="benchmarks", description=__doc__)
    parser.add_argument("--runs", type=int, default=9, help="of which the median counts (9)")
    parser.add_argument(
        "--only", default="", metavar="WORD", help="rows that have this in them; bus; recordings"
    )
    parser.add_argument(
        "--docs", type=Path, default=DOCS, help="folder for performance.md and its plot"
    )
    arguments = parser.parse_args()
    if arguments.only not in ("bus", "recordings"):
        _measure_buffer(arguments)
    if arguments.only in ("", "bus"):
        measured = measure_bus(min(arguments.runs, 5), _tell)
        plot.draw(measured.publishers, measured.frames, str(arguments.docs / "performance-bus.svg"))
        part = bus_page.part(measured, machine.describe())
        print(part)
        parts.put_in(arguments.docs / "performance.md", bus_page.MARK, part)
    if arguments.only in ("", "recordings"):
        _measure_recordings(arguments)


def _measure_recordings(arguments: argparse.Namespace) -> None:
    """tfbus and numpy are imported only where recordings are measured."""
    from benchmarks.recordings import page as recordings_page
    from benchmarks.recordings.measure import measure as measure_recordings

    place = machine.describe()
    measured = measure_recordings(min(arguments.runs, 5), _tell)
    part = recordings_page.part(measured, place)
    print(part)
    parts.put_in(arguments.docs / "performance.md", recordings_page.MARK, part)


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
        growth.plot(curves, str(arguments.docs / "performance.svg"))
        file = arguments.docs / "performance.md"
        kept = parts.former(file)
        file.write_text(page.performance(results, curves, place, versions) + kept)


def _tell(what: str) -> None:
    print(f"  {what}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
