"""`tfbus bag merge`: several recordings as one."""

from contextlib import ExitStack
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
from tfbus.cli.output import warn
from tfbus.command.recordings import open_recording
from tfbus.recording.edit import conflicting_epochs, joined, repeated
from tfbus.recording.writer import Compression
from tfbus.wording import listed


@click.command(epilog="Example: tfbus bag merge robot.mcap laptop.mcap -o both.mcap")
@recordings_argument
@output_option
@compression_option
def command(
    recordings: tuple[Path, ...], output: Path, force: bool, compression: Compression
) -> None:
    """Write several recordings into one, in order of time.

    A stream or topic that several have is one in the result, and a message that several recorders
    of one bus received comes once. A folder is one recording.
    """
    with ExitStack() as stack:
        readers = [stack.enter_context(open_recording(path)) for path in recordings]
        for again, first in repeated(readers):
            readers.remove(again)
            name, other = again.parts[0].name, first.parts[0].name
            same = "is given twice" if name == other else f"is the same as {other}"
            warn(f"{name} {same}: it counts once")
        for reader in readers:
            warn_of_unreadable(reader)
        if names := conflicting_epochs(readers):
            warn(
                f"two publishers of one name at the same time: {listed(names)}; of such a stream "
                "only the newer counts: `tfbus bag filter --namespace` gives a recording's streams "
                "and topics a namespace"
            )
        full = [reader for reader in readers if reader.end_ns] or readers
        span = (min(each.start_ns for each in full), max(each.end_ns for each in full))
        written = write_recording(
            joined(readers),
            output,
            force=force,
            span=span,
            sources=[part.path for reader in readers for part in reader.parts],
            compression=compression,
            about=about_edited(readers, "merge"),
            about_at_end=lambda: lost_of(readers),
        )
    click.echo(f"Wrote {output}: {written}")
