"""`tfbus bag cut`, `filter`, `merge`, `recover` and `import`: recordings made from others."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tfbus.base.errors import DecodeError, InvalidNameError, TfbusError
from tfbus.base.wording import counted, did_you_mean, is_printable, listed, printable
from tfbus.cli.bag.files import (
    FRAMES,
    STREAMS,
    TOPICS,
    about_edited,
    check_recorded,
    compression_option,
    edited,
    lost_of,
    names_of,
    names_option,
    needing,
    output_option,
    recordings_argument,
    regex_options,
    selected,
    warn_of_unreadable,
    write_recording,
)
from tfbus.cli.output import first_lines, print_lines, say, warn
from tfbus.command.recordings import BagChoice, OpenBag, open_recording
from tfbus.command.types import Moment, MomentType
from tfbus.recording.edit import (
    Span,
    conflicting_epochs,
    cut,
    in_namespace,
    joined,
    repeated,
    without,
)
from tfbus.recording.items import Item, Selection, is_of_transforms
from tfbus.recording.reader import RecordingReader, files_of
from tfbus.recording.recover import Salvage, items_of_all
from tfbus.recording.writer import Compression
from tfbus.wire.fleet import has_name
from tfbus.wire.keys import check_namespace

if TYPE_CHECKING:
    from tfbus.recording.foreign_files import ForeignFiles
    from tfbus.recording.imported import Imported


@click.command(
    "cut",
    epilog="Examples: tfbus bag cut drive.mcap --from 60 --to 90 -o minute.mcap; "
    "tfbus bag cut drive.mcap --range 0 10 --range -10 -0 -o ends.mcap",
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
def cut_command(
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
        whole = Span(min(each.from_ns for each in spans), max(each.to_ns for each in spans))
        items = cut(bag.reader, spans)
        _write(items, [bag.reader], "cut", output, force, compression, span=whole)


def _span(bag: OpenBag, pair: tuple[Moment, Moment]) -> Span:
    begin, end = pair
    return Span(*OpenBag(bag.reader, BagChoice(bag.choice.paths, begin=begin, end=end)).span)


@click.command(
    "filter",
    epilog="Examples: tfbus bag filter drive.mcap --frames base_link,laser -o small.mcap; "
    "tfbus bag filter drive.mcap --drop camera/image -o small.mcap",
)
@recordings_argument
@names_option("--topics", text=TOPICS)
@names_option("--streams", text=STREAMS)
@names_option("--frames", text=FRAMES)
@regex_options
@names_option("--drop", "dropped", text="Drop these topics, streams, frames.")
@click.option(
    "--namespace", default="", metavar="NAME", help="Put streams, topics and nodes in a namespace."
)
@output_option
@compression_option
def filter_command(
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
        _write(items, [reader], "filter", output, force, compression)


def _check_names(reader: RecordingReader, selection: Selection, drop: frozenset[str]) -> None:
    """Raises TfbusError for a topic, stream or frame that is not in the recording."""
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
    check_recorded(asked)


@click.command("merge", epilog="Example: tfbus bag merge robot.mcap laptop.mcap -o both.mcap")
@recordings_argument
@output_option
@compression_option
def merge_command(
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
        _write(joined(readers), readers, "merge", output, force, compression)


def _write(
    items: Iterator[Item],
    readers: Sequence[RecordingReader],
    verb: str,
    output: Path,
    force: bool,
    compression: Compression,
    *,
    span: Span | None = None,
) -> None:
    """Write a recording of items of others, by default of all their time, and say so."""
    full = [reader for reader in readers if reader.end_ns] or readers
    if span is None:
        span = Span(min(each.start_ns for each in full), max(each.end_ns for each in full))
    written = write_recording(
        items,
        output,
        force=force,
        span=(span.from_ns, span.to_ns),
        sources=[part.path for reader in readers for part in reader.parts],
        compression=compression,
        about=about_edited(readers, verb),
        about_at_end=lambda: lost_of(readers),
    )
    click.echo(f"Wrote {output}: {written}")


@click.command(
    "recover",
    epilog="Examples: tfbus bag recover drive.mcap -o whole.mcap; "
    "tfbus bag recover day/ -o day.mcap",
)
@click.argument("recording", type=click.Path(exists=True, path_type=Path))
@output_option
@compression_option
def recover_command(recording: Path, output: Path, force: bool, compression: Compression) -> None:
    """Write what can be read of a recording that is cut short or damaged.

    Each chunk of messages has a checksum: whole ones are kept, with what others wrote too. The
    file itself stays as it is. All files of a folder are one recording.
    """
    files = files_of([recording])
    with ExitStack() as stack:
        salvages: dict[Path, Salvage] = {}
        for path in files:
            try:
                salvages[path] = stack.enter_context(closing(Salvage(path)))
            except OSError as error:
                name = printable(str(path))
                raise TfbusError(f"{name} cannot be read: {error.strerror}") from error
            except DecodeError as error:
                if len(files) == 1:
                    raise
                warn(f"left out: {error}")
        if not salvages:
            raise TfbusError(f"{printable(str(recording))} holds no recording that could be read")
        if left_out := {name for each in salvages.values() for name in each.topics_left_out}:
            warn(f"left out, as their messages cannot be read: {listed(sorted(left_out))}")
        all_ = salvages.values()
        written = write_recording(
            items_of_all(all_),
            output,
            force=force,
            span=(min(each.start_ns for each in all_), max(each.end_ns for each in all_)),
            sources=salvages,
            compression=compression,
            about={**next(iter(all_)).about, "edited": edited([recording], "recover")},
            about_at_end=lambda: _lost_of(all_),
        )
        losses = {path: salvage.loss for path, salvage in salvages.items()}
    click.echo(f"Wrote {output}: {written}")
    if not any(losses.values()):
        click.echo(f"{printable(str(recording))} was whole: nothing is lost")
    for path, loss in losses.items():
        name, lines = printable(str(path)), loss.lines()
        if len(lines) == 1:
            click.echo(f"Lost of {name}: {lines[0]}")
        elif lines:
            click.echo(f"Lost of {name}:")
            print_lines(f"  {line}" for line in first_lines(lines))


def _lost_of(salvages: Iterable[Salvage]) -> dict[str, str]:
    lost = ", ".join(str(each.loss) for each in salvages if each.loss)
    return {"lost": lost} if lost else {}


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
def import_command(
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
    from tfbus.recording.imported import Imported, imported  # 30 modules, for this verb only

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


def _some(items: Iterator[Item], counts: "Imported", sources: "ForeignFiles") -> Iterator[Item]:
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


def _say_what_is_missing(counts: "Imported", names: tuple[str, ...]) -> None:
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
