"""`tfbus bag recover`: a whole recording from one that is cut short or damaged."""

from pathlib import Path

import click

from tfbus.cli.bag.new_file import compression_option, edited, output_option, write_recording
from tfbus.cli.output import first_lines, print_lines, warn
from tfbus.errors import TfbusError
from tfbus.recording.recover import Salvage
from tfbus.recording.writer import Compression
from tfbus.wording import listed, printable


@click.command(epilog="Example: tfbus bag recover drive.mcap -o whole.mcap")
@click.argument("recording", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@output_option
@compression_option
def command(recording: Path, output: Path, force: bool, compression: Compression) -> None:
    """Write what can be read of a recording that is cut short or damaged.

    Each chunk of messages has a checksum: whole ones are kept, with what others wrote too. The
    file itself stays as it is.
    """
    name = printable(str(recording))
    try:
        salvage = Salvage(recording)
    except OSError as error:
        raise TfbusError(f"{name} cannot be read: {error.strerror}") from error
    try:
        if salvage.topics_left_out:
            warn(f"left out, as their messages cannot be read: {listed(salvage.topics_left_out)}")
        written = write_recording(
            salvage.items(),
            output,
            force=force,
            span=(salvage.start_ns, salvage.end_ns),
            sources=[recording],
            compression=compression,
            about={**salvage.about, "edited": edited([recording], "recover")},
            about_at_end=lambda: {"lost": str(salvage.loss)} if salvage.loss else {},
        )
        loss = salvage.loss
    finally:
        salvage.close()
    click.echo(f"Wrote {output}: {written}")
    lines = loss.lines()
    if not loss:
        click.echo(f"{name} was whole: nothing is lost")
    elif len(lines) == 1:
        click.echo(f"Lost of {name}: {lines[0]}")
    else:
        click.echo(f"Lost of {name}:")
        print_lines(f"  {line}" for line in first_lines(lines))
