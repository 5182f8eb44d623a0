"""`tfbus bag filter`: a recording with less in it."""

from collections.abc import Iterator
from pathlib import Path

import click

from tfbus.cli.bag.new_file import compression_option, output_option, write_recording
from tfbus.cli.bag.sources import recordings_argument, warn_of_unreadable
from tfbus.command.recordings import open_recording
from tfbus.errors import InvalidNameError
from tfbus.recording.edit import in_namespace, without
from tfbus.recording.items import Item
from tfbus.recording.reader import RecordingReader
from tfbus.recording.selection import Selection, is_of_transforms
from tfbus.recording.writer import Compression
from tfbus.wire.keys import check_namespace
from tfbus.wording import did_you_mean


@click.command(
    epilog="Examples: tfbus bag filter drive.mcap --frames base_link,laser -o small.mcap; "
    "tfbus bag filter drive.mcap --drop camera/image -o small.mcap"
)
@recordings_argument
@click.option("--topics", multiple=True, metavar="NAMES", help="Keep only these topics.")
@click.option("--streams", multiple=True, metavar="NAMES", help="Keep only these streams.")
@click.option("--frames", multiple=True, metavar="NAMES", help="Keep only these child frames.")
@click.option(
    "-e", "--regex", default="", metavar="REGEX", help="Keep topics and streams that match."
)
@click.option(
    "-x", "--exclude", default="", metavar="REGEX", help="Drop topics and streams that match."
)
@click.option(
    "--drop", "dropped", multiple=True, metavar="NAMES", help="Drop these topics, streams, frames."
)
@click.option(
    "--namespace", default="", metavar="NAME", help="Put streams, topics and nodes in a namespace."
)
@output_option
@compression_option
def command(
    recordings: tuple[Path, ...],
    topics: tuple[str, ...],
    streams: tuple[str, ...],
    frames: tuple[str, ...],
    regex: str,
    exclude: str,
    dropped: tuple[str, ...],
    namespace: str,
    output: Path,
    force: bool,
    compression: Compression,
) -> None:
    """Write a recording without some of its topics, streams and frames.

    NAMES are separated by commas, and the options repeatable. Among the topics, tf stands for
    dynamic transforms, tf_static for static ones: with --topics without them no transforms are
    kept, with --streams or --frames no topics.
    """
    selection = Selection(
        topics=tuple(name.removeprefix("/") for name in _names(topics)),
        streams=_names(streams),
        frames=_names(frames),
        regex=regex,
        exclude=exclude,
    )
    drop = frozenset(_names(dropped))
    if selection.is_all and not drop and not namespace:
        raise click.UsageError("say what to keep or drop: --topics, --frames, --drop, …")
    try:
        namespace = check_namespace(namespace)
    except InvalidNameError as error:
        raise click.BadParameter(str(error), param_hint="--namespace") from error
    with open_recording(*recordings) as reader:
        _check_names(reader, selection, drop)
        warn_of_unreadable(reader)
        items: Iterator[Item] = reader.items(selection=selection)
        if drop:
            items = without(items, drop)
        if namespace:
            items = in_namespace(items, namespace)
        written = write_recording(
            items,
            output,
            force=force,
            span=(reader.start_ns, reader.end_ns),
            compression=compression,
        )
    click.echo(f"Wrote {output}: {written}")


def _names(given: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(name.strip() for text in given for name in text.split(",") if name.strip())


def _check_names(reader: RecordingReader, selection: Selection, drop: frozenset[str]) -> None:
    """Raises click.UsageError for a topic or stream that is not in the recording."""
    topics = {topic.name for topic in reader.topics}
    streams = {each.stream.name for each in reader.streams}
    for names, known, kind in (
        (selection.topics, topics, "topic"),
        (selection.streams, streams, "stream"),
    ):
        for name in names:
            if name not in known and not (kind == "topic" and is_of_transforms(name)):
                raise click.UsageError(
                    f"there is no {kind} {name!r} in the recording"
                    + did_you_mean(name, known, none=f", which has no {kind}s")
                )
