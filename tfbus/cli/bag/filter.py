"""`tfbus bag filter`: a recording with less in it."""

from collections.abc import Iterator
from pathlib import Path

import click

from tfbus.cli.bag.new_file import (
    about_edited,
    compression_option,
    lost_of,
    output_option,
    write_recording,
)
from tfbus.cli.bag.selecting import (
    Regex,
    SeveralNames,
    names_of,
    recordings_argument,
    selected,
    warn_of_unreadable,
)
from tfbus.command.recordings import open_recording
from tfbus.errors import InvalidNameError
from tfbus.recording.edit import in_namespace, without
from tfbus.recording.items import Item
from tfbus.recording.reader import RecordingReader
from tfbus.recording.selection import Selection, is_of_transforms
from tfbus.recording.writer import Compression
from tfbus.wire.fleet import has_name
from tfbus.wire.keys import check_namespace
from tfbus.wording import did_you_mean, printable


@click.command(
    epilog="Examples: tfbus bag filter drive.mcap --frames base_link,laser -o small.mcap; "
    "tfbus bag filter drive.mcap --drop camera/image -o small.mcap"
)
@recordings_argument
@click.option(
    "--topics",
    cls=SeveralNames,
    multiple=True,
    metavar="NAME...",
    help="Only these topics; tf stands for dynamic transforms, tf_static for static ones.",
)
@click.option(
    "--streams",
    cls=SeveralNames,
    multiple=True,
    metavar="NAME...",
    help="Only transforms of these streams.",
)
@click.option(
    "--frames",
    cls=SeveralNames,
    multiple=True,
    metavar="NAME...",
    help="Only transforms of these child frames.",
)
@click.option(
    "-e",
    "--regex",
    type=Regex(),
    default="",
    metavar="REGEX",
    help="Only topics and streams in whose names this is found.",
)
@click.option(
    "-x",
    "--exclude",
    "--exclude-regex",
    type=Regex(),
    default="",
    metavar="REGEX",
    help="Omit topics and streams in whose names this is found.",
)
@click.option(
    "--drop",
    "dropped",
    cls=SeveralNames,
    multiple=True,
    metavar="NAME...",
    help="Drop these topics, streams, frames.",
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

    Names follow an option one by one, or with commas. Among the topics, tf stands for dynamic
    transforms, tf_static for static ones: with --topics without them no transforms are kept, with
    --streams or --frames no topics.
    """
    selection = selected(names_of(topics), names_of(streams), names_of(frames), regex, exclude)
    drop = frozenset(name.removeprefix("/") for name in names_of(dropped))
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
            sources=[part.path for part in reader.parts],
            compression=compression,
            about=about_edited([reader], "filter"),
            about_at_end=lambda: lost_of([reader]),
        )
    click.echo(f"Wrote {output}: {written}")


def _check_names(reader: RecordingReader, selection: Selection, drop: frozenset[str]) -> None:
    """Raises click.UsageError for a topic, stream or frame that is not in the recording."""
    topics = {topic.name for topic in reader.topics}
    streams = {each.stream.name for each in reader.streams}
    asked = [
        *(("topic", name, topics) for name in selection.topics if not is_of_transforms(name)),
        *(("stream", name, streams) for name in selection.streams),
    ]
    if selection.frames or drop:  # reads the index, which takes a moment of a long recording
        frames = reader.child_frames()
        spaces = {each.stream.namespace for each in reader.streams}
        asked += [
            ("child frame", name, frames)
            for name in selection.frames
            if not any(has_name(each, space, name) for each in frames for space in spaces)
        ]
        every = topics | streams | frames
        asked += [("topic, stream or child frame", name, every) for name in sorted(drop)]
    for kind, name, known in asked:
        if name not in known:
            raise click.UsageError(
                f"there is no {kind} '{printable(name, 60)}' in the recording"
                + did_you_mean(name, known, none=f", which has no {kind}s")
            )
