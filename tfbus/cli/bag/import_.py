"""`tfbus bag import`: recordings of ROS and Foxglove as recordings of tfbus."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tfbus.cli.bag.new_file import (
    compression_option,
    edited,
    needing,
    output_option,
    write_recording,
)
from tfbus.cli.bag.selecting import names_of, names_option, regex_options, selected
from tfbus.cli.output import say, warn
from tfbus.errors import InvalidNameError, TfbusError
from tfbus.names import is_printable
from tfbus.recording.imported import Imported, imported
from tfbus.recording.items import Item
from tfbus.recording.selection import is_of_transforms
from tfbus.recording.writer import Compression
from tfbus.wording import counted, did_you_mean, listed, printable

if TYPE_CHECKING:
    from tfbus.recording.foreign_files import ForeignFiles

# Of the topics that were left out, as many are named, each with its reason.
_NAMED = 12


@click.command(
    epilog="Examples: tfbus bag import drive.bag -o drive.mcap; "
    "tfbus bag import rosbag2_2026_11_22/ --only-tf -o drive.mcap"
)
@click.argument(
    "files",
    nargs=-1,
    required=True,
    type=click.Path(exists=True, path_type=Path),
    metavar="FILE...",
)
@click.option("--only-tf", is_flag=True, help="Import transforms only.")
@names_option("--topics", text="Of topics import only these.")
@regex_options
@click.option(
    "--stream",
    default="",
    metavar="NAME",
    help="The stream of transforms whose publisher is not in the file (default ros or foxglove).",
)
@output_option
@compression_option
def command(
    files: tuple[Path, ...],
    only_tf: bool,
    topics: tuple[str, ...],
    regex: str,
    exclude: str,
    stream: str,
    output: Path,
    force: bool,
    compression: Compression,
) -> None:
    """Convert recordings of ROS or Foxglove: .bag, .db3, .mcap, or a folder of rosbag2.

    Several files become one recording. Transforms are those of TFMessage and FrameTransform; those
    on a topic tf_static are static. Other topics keep their messages as they are.
    """
    if stream and ("/" in stream or not is_printable(stream)):
        raise click.BadParameter("letters without '/' are allowed", param_hint="--stream")
    names = tuple(name.removeprefix("/") for name in names_of(topics))
    if only_tf and names:
        raise click.UsageError("--only-tf and --topics are mutually exclusive")
    selection = selected(regex=regex, exclude=exclude)
    counts = Imported()
    try:
        with needing("bags"):
            from tfbus.recording.foreign_files import opened

            with opened(*files) as sources:
                for source in sources.files:
                    if source.note:
                        warn(source.note)
                items = imported(
                    sources.messages(),
                    counts,
                    selection=selection,
                    topics=names,
                    only_transforms=only_tf,
                    default_stream=stream,
                )
                written = write_recording(
                    _some(items, counts, sources),
                    output,
                    force=force,
                    span=(sources.start_ns, sources.end_ns),
                    sources=files,
                    compression=compression,
                    about={"edited": edited(files, "import")},
                    refuse=counts.refuse,
                )
                for source in sources.files:
                    for lost in source.damage:
                        warn(f"{source.name} is damaged: {lost} cannot be read; the rest is")
    except InvalidNameError as error:
        raise TfbusError(str(error)) from error
    finally:
        _say_what_is_missing(counts, names)
    if not counts.transforms and not counts.static_transforms:
        say("There are no transforms in it: no message of TFMessage or FrameTransform")
    click.echo(f"Wrote {output}: {written}")


def _some(items: Iterator[Item], counts: Imported, sources: "ForeignFiles") -> Iterator[Item]:
    """The items. Raises TfbusError if none was written."""
    number = 0
    for item in items:
        number += 1
        yield item
    if number == counts.refused:
        names = listed([source.name for source in sources.files])
        if number:
            raise TfbusError(f"nothing was imported: no message of {names} can be written")
        raise TfbusError(f"nothing was imported: no message of {names} is one that was asked for")


def _say_what_is_missing(counts: Imported, names: tuple[str, ...]) -> None:
    for name in names:
        if counts.topics and name not in counts.topics and not is_of_transforms(name):
            warn(f"there is no topic '{printable(name, 60)}'{did_you_mean(name, counts.topics)}")
    by_reason: dict[str, list[str]] = {}
    for topic, reason in sorted(counts.left_out.items()):
        by_reason.setdefault(reason, []).append(printable(topic, 60))
    for reason, topics in by_reason.items():
        warn(f"left out {listed(topics, most=_NAMED)}: {reason}")
    for topic, count in sorted(counts.failed.items()):
        warn(
            f"left out {counted(count, 'message')} of {printable(topic, 60)}: "
            f"{counts.why_failed[topic]}"
        )
