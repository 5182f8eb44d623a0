"""`tfbus bag cut`: a part of a recording, or several."""

from pathlib import Path

import click

from tfbus.cli.bag.new_file import (
    about_edited,
    compression_option,
    lost_of,
    output_option,
    write_recording,
)
from tfbus.cli.bag.selecting import recordings_argument, warn_of_unreadable
from tfbus.command.recordings import BagChoice, OpenBag
from tfbus.command.types import Moment, MomentType
from tfbus.recording.edit import Span, cut
from tfbus.recording.writer import Compression


@click.command(
    epilog="Examples: tfbus bag cut drive.mcap --from 60 --to 90 -o minute.mcap; "
    "tfbus bag cut drive.mcap --range 0 10 --range -10 -0 -o ends.mcap"
)
@recordings_argument
@click.option(
    "--from", "begin", type=MomentType(), metavar="TIME", help="Begin here (default: beginning)."
)
@click.option("--to", "end", type=MomentType(), metavar="TIME", help="End here (default: end).")
@click.option(
    "--range",
    "ranges",
    type=(MomentType(), MomentType()),
    multiple=True,
    metavar="FROM TO",
    help="A part to keep; repeatable.",
)
@output_option
@compression_option
def command(
    recordings: tuple[Path, ...],
    begin: Moment | None,
    end: Moment | None,
    ranges: tuple[tuple[Moment, Moment], ...],
    output: Path,
    force: bool,
    compression: Compression,
) -> None:
    """Write a part of a recording into a new one.

    Times are those at which messages were received: 3 is 3 s after the beginning, -3 is 3 s before
    the end; or a date and time, or seconds since 1970. The new recording begins with what is in
    force then: static transforms, streams and nodes.
    """
    if ranges and (begin is not None or end is not None):
        raise click.UsageError("--range and --from or --to are mutually exclusive")
    if not ranges and begin is None and end is None:
        raise click.UsageError("give --from, --to or --range")
    with BagChoice(recordings, begin=begin, end=end).opened() as bag:
        warn_of_unreadable(bag.reader)
        spans = [_span(bag, pair) for pair in ranges] or [Span(*bag.span)]
        written = write_recording(
            cut(bag.reader, spans),
            output,
            force=force,
            span=(min(each.from_ns for each in spans), max(each.to_ns for each in spans)),
            sources=[part.path for part in bag.reader.parts],
            compression=compression,
            about=about_edited([bag.reader], "cut"),
            about_at_end=lambda: lost_of([bag.reader]),
        )
    click.echo(f"Wrote {output}: {written}")


def _span(bag: OpenBag, pair: tuple[Moment, Moment]) -> Span:
    begin, end = pair
    return Span(*OpenBag(bag.reader, BagChoice(bag.choice.paths, begin=begin, end=end)).span)
