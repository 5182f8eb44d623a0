"""`tfbus bag export`: a recording as a file of numbers."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tfbus.cli.bag.new_file import new_file, with_progress
from tfbus.cli.bag.selecting import RECORDING
from tfbus.cli.output import say
from tfbus.command.options import max_gap_option
from tfbus.command.recordings import BagChoice, OpenBag
from tfbus.command.types import POSITIVE, FrameName, Moment, MomentType
from tfbus.core.sampling import Sampling
from tfbus.recording.exported import (
    write_topic_csv,
    write_transforms_csv,
    write_transforms_npz,
)
from tfbus.recording.items import Item
from tfbus.recording.selection import ALL, Selection
from tfbus.recording.state import STATICS, Statics
from tfbus.trajectory import Trajectory
from tfbus.wire.limits import size_text
from tfbus.wording import counted, did_you_mean, duration

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from tfbus.frames.recording import Recording

    # Of a recording, from one stamp to another.
    StampsOf = Callable[[Recording, int | None, int | None], NDArray[np.int64]]


@dataclass(frozen=True)
class _Format:
    """How a file is written: the poses of a pair of frames, and all transforms; None if the format
    has none of these.
    """

    pair: Callable[[Trajectory, Path], None] | None = None
    all: Callable[[Iterable[Item], Path], int] | None = None


# By the ending of a file, without its dot.
_FORMATS = {
    "csv": _Format(Trajectory.write_csv, write_transforms_csv),
    "tum": _Format(Trajectory.write_tum),
    "kitti": _Format(Trajectory.write_kitti),
    "npz": _Format(all=write_transforms_npz),
}
_ENDINGS = [f".{form}" for form in _FORMATS]


@click.command(
    epilog="Examples: tfbus bag export drive.mcap map base_link -o drive.tum; "
    "tfbus bag export drive.mcap -o all.npz; "
    "tfbus bag export drive.mcap --topic turtle1/pose -o pose.csv"
)
@click.argument("recording", type=RECORDING)
@click.argument("target", type=FrameName(), required=False)
@click.argument("source", type=FrameName(), required=False)
@click.option(
    "-o",
    "--output",
    required=True,
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help=f"The file to write; its ending is the format: {', '.join(_ENDINGS)}.",
)
@click.option(
    "--format",
    "form",
    type=click.Choice(list(_FORMATS)),
    help="The format, where the ending is another, as .txt.",
)
@click.option("--topic", metavar="NAME", help="Write the messages of a topic (csv).")
@click.option(
    "--rate", "rate_hz", type=POSITIVE, metavar="HZ", help="Poses per second, interpolated."
)
@click.option(
    "--samples-of",
    type=FrameName(),
    metavar="FRAME",
    help="A pose at each sample of this frame (default: of SOURCE).",
)
@click.option(
    "--from",
    "begin",
    type=MomentType(),
    metavar="TIME",
    help="Begin here: 3 is 3 s after the beginning, -3 is 3 s before the end.",
)
@click.option(
    "--to", "end", type=MomentType(), metavar="TIME", help="End here, written as that of --from."
)
@click.option(
    "--statics",
    type=click.Choice(STATICS),
    default=STATICS[0],
    help="Static transforms hold always, as in tf2 (default), or from when they were received.",
)
@max_gap_option
@click.option("--force", is_flag=True, help="Replace the file if it exists.")
def command(
    recording: Path,
    target: str | None,
    source: str | None,
    output: Path,
    form: str | None,
    topic: str | None,
    rate_hz: float | None,
    samples_of: str | None,
    begin: Moment | None,
    end: Moment | None,
    statics: Statics,
    force: bool,
    sampling: Sampling,
) -> None:
    """Write where SOURCE was, seen from TARGET, or all transforms, or a topic.

    Of a pair there is a pose at each sample of SOURCE, in CSV as of tfbus echo, in TUM's or in
    KITTI's format, which has no times. Without a pair all transforms as they came are written, in
    CSV or npz.
    """
    form = form or output.suffix.removeprefix(".")
    if form not in _FORMATS:
        raise click.UsageError(
            f"{output}: the format is not clear: end the name with {', '.join(_ENDINGS)}, or "
            "give --format"
        )
    is_pair = target is not None and source is not None
    if (target is None) != (source is None):
        raise click.UsageError("name two frames, TARGET and SOURCE, or none")
    if (rate_hz is not None or samples_of is not None) and not is_pair:
        raise click.UsageError("--rate and --samples-of are for a pair of frames")
    if sampling.max_gap_s is not None and not is_pair:
        raise click.UsageError("--max-gap is for a pair of frames")
    if rate_hz is not None and samples_of is not None:
        raise click.UsageError("--rate and --samples-of are mutually exclusive")
    if topic is not None and (is_pair or form != "csv"):
        raise click.UsageError("--topic writes the messages of one topic as .csv, without frames")
    if is_pair and _FORMATS[form].pair is None:
        raise click.UsageError(f"{form} has all transforms: omit the frames, or write .csv or .tum")
    if not is_pair and _FORMATS[form].all is None:
        raise click.UsageError(f"{form} has the poses of one frame: name TARGET and SOURCE")
    with BagChoice((recording,), begin=begin, end=end, statics=statics).opened() as bag:
        if target is not None and source is not None:
            what = _pair(
                bag,
                (target, source),
                output,
                form,
                force,
                rate_hz,
                samples_of,
                sampling,
            )
        elif topic is not None:
            what = _topic(bag, topic.removeprefix("/"), output, force)
        else:
            what = _all(bag, output, form, force)
    click.echo(f"Wrote {output}: {size_text(output.stat().st_size)}, {what}")


def _pair(
    bag: OpenBag,
    pair: tuple[str, str],
    output: Path,
    form: str,
    force: bool,
    rate_hz: float | None,
    samples_of: str | None,
    sampling: Sampling,
) -> str:
    from tfbus.frames.recorded_poses import is_static, path_at_rate, poses_at, stamps_of
    from tfbus.frames.recording import Recording

    recording = Recording.of_reader(bag.reader, bag.choice.statics)
    recording.latest_common_time(*pair)  # raises for frames that are not joined
    span = stamps_of(bag)
    if rate_hz is not None:
        poses = path_at_rate(recording, *pair, span, rate_hz, sampling)
    elif samples_of is not None:
        stamps = recording.samples(samples_of, *(span or ())).stamps_ns
        poses = poses_at(recording, *pair, stamps, sampling)
    elif is_static(recording, *pair):
        raise click.UsageError(
            f"'{pair[1]}' is static in '{pair[0]}', without samples: give --rate HZ, or "
            "--samples-of FRAME for poses at those of another frame"
        )
    else:
        poses = recording.trajectory(*pair, *(span or ()), sampling=sampling)
    if span is not None and not len(poses):
        target, source = pair
        raise click.UsageError(f"'{source}' has no pose in '{target}' in that span{_paused(bag)}")
    write = _FORMATS[form].pair
    assert write is not None
    with new_file(output, force=force, sources=_sources(bag)) as beside:
        write(poses, beside)
    if form == "kitti":
        say("KITTI's format has no times: .csv and .tum have them")
    return f"{counted(len(poses), 'pose')} of '{pair[1]}' in '{pair[0]}' over " + duration(
        poses.span_s
    )


def _paused(bag: OpenBag) -> str:
    """The end of a sentence that says that the recorder was paused in the span."""
    from_ns, to_ns = bag.span
    pauses = (each for each in bag.reader.pauses if each.from_ns < to_ns and each.to_ns > from_ns)
    return next((f": {each.said(bag.reader.start_ns)}" for each in pauses), "")


def _sources(bag: OpenBag) -> list[Path]:
    return [part.path for part in bag.reader.parts]


def _all(bag: OpenBag, output: Path, form: str, force: bool) -> str:
    write = _FORMATS[form].all
    assert write is not None
    items = with_progress(bag.reader.items(*bag.span, _no_topics(bag)), bag.span, output.name)
    with new_file(output, force=force, sources=_sources(bag)) as beside:
        count = write(items, beside)
    return f"{count:,} transform{'' if count == 1 else 's'}"


def _no_topics(bag: OpenBag) -> Selection:
    streams = tuple({each.stream.name for each in bag.reader.streams})
    return Selection(streams=streams) if streams else ALL


def _topic(bag: OpenBag, topic: str, output: Path, force: bool) -> str:
    known = {each.name for each in bag.reader.topics}
    if topic not in known:
        raise click.UsageError(
            f"there is no topic {topic!r} in the recording"
            + did_you_mean(topic, known, none=", which has no topics")
        )

    def messages() -> Iterator[Item]:
        return bag.reader.items(*bag.span, Selection(topics=(topic,)))

    with new_file(output, force=force, sources=_sources(bag)) as beside:
        count = write_topic_csv(messages, beside)
    return counted(count, "message")
