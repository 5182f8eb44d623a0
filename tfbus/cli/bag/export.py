"""`tfbus bag export`: a recording as files of numbers and images."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tfbus.base.errors import BusError, DecodeError, TfbusError, TransformException
from tfbus.base.wording import counted, duration
from tfbus.cli.bag.files import RECORDING, check_recorded, new_file, with_progress
from tfbus.cli.message import supplied_type
from tfbus.cli.output import say, warn
from tfbus.command.options import max_gap_option
from tfbus.command.recordings import BagChoice, OpenBag
from tfbus.command.types import POSITIVE, FrameName, Moment, MomentType
from tfbus.geometry.sampling import Sampling
from tfbus.geometry.trajectory import Trajectory
from tfbus.messages import CompressedImage, Image, LaserScan, PointCloud
from tfbus.recording.exported import (
    write_topic_csv,
    write_transforms_csv,
    write_transforms_npz,
)
from tfbus.recording.items import ALL, Item, Selection, TopicItem
from tfbus.recording.state import STATICS, Statics, last_item
from tfbus.sensor_files import (
    write_cloud_npz,
    write_jpeg,
    write_pcd,
    write_pixels_npy,
    write_ply,
    write_png,
)
from tfbus.wire.codec import from_map
from tfbus.wire.limits import size_text

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from tfbus.frames.recording import Recording

    # Of a recording, from one stamp to another.
    StampsOf = Callable[[Recording, int | None, int | None], NDArray[np.int64]]


@dataclass(frozen=True)
class _Format:
    """How a file is written: the poses of a pair of frames, all transforms, all messages of a
    topic, or one message of some types; None if the format has none of these.
    """

    pair: Callable[[Trajectory, Path], None] | None = None
    all: Callable[[Iterable[Item], Path], int] | None = None
    topic: Callable[[Callable[[], Iterable[Item]], Path], int] | None = None
    message: tuple[Callable[[Any, Path], None], tuple[type, ...]] | None = None


# The types that are written as clouds.
_POINTS = (PointCloud, LaserScan)

# By the ending of a file, without its dot.
_FORMATS = {
    "csv": _Format(Trajectory.write_csv, write_transforms_csv, write_topic_csv),
    "tum": _Format(Trajectory.write_tum),
    "kitti": _Format(Trajectory.write_kitti),
    "npz": _Format(all=write_transforms_npz, message=(write_cloud_npz, _POINTS)),
    "ply": _Format(message=(write_ply, _POINTS)),
    "pcd": _Format(message=(write_pcd, _POINTS)),
    "png": _Format(message=(write_png, (Image, CompressedImage))),
    "jpg": _Format(message=(write_jpeg, (CompressedImage,))),
    "npy": _Format(message=(write_pixels_npy, (Image,))),
}
_ENDINGS = [f".{form}" for form in _FORMATS]


@click.command(
    epilog="Examples: tfbus bag export drive.mcap map base_link -o drive.tum; "
    "tfbus bag export drive.mcap -o all.npz; "
    "tfbus bag export drive.mcap --topic turtle1/pose -o pose.csv; "
    "tfbus bag export drive.mcap --topic points --at 3 --in-frame map -o cloud.ply"
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
@click.option(
    "--topic",
    metavar="NAME",
    help="Write the messages of a topic: all (csv), or clouds, scans and images, a file for each.",
)
@click.option(
    "--in-frame",
    "frame",
    type=FrameName(),
    metavar="FRAME",
    help="Move the points of clouds and scans into this frame, by the transforms at their times.",
)
@click.option(
    "--at",
    "moment",
    type=MomentType(),
    metavar="TIME",
    help="Write only the message that was the newest at this time, written as of --from.",
)
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
    frame: str | None,
    moment: Moment | None,
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
    CSV or npz. Each cloud or scan of a topic is a PLY, PCD or npz, each image a PNG, JPEG or npy,
    named by its number and its stamp in nanoseconds: cloud_000000_1700000000000000000.ply.
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
    if topic is not None and is_pair:
        raise click.UsageError("--topic and frames are mutually exclusive")
    written = _FORMATS[form]
    if topic is not None and written.topic is None and written.message is None:
        raise click.UsageError(f"{form} has no messages: write a topic as .csv, a cloud as .ply")
    if moment is not None and (topic is None or written.message is None):
        raise click.UsageError("--at is for one cloud, scan or image of a --topic")
    if frame is not None and (
        topic is None or written.message is None or written.message[1] != _POINTS
    ):
        raise click.UsageError(
            "--in-frame is for the clouds or scans of a --topic: .ply, .pcd or .npz"
        )
    if moment is not None and (begin is not None or end is not None):
        raise click.UsageError("--at is one time: omit --from and --to")
    if is_pair and _FORMATS[form].pair is None:
        raise click.UsageError(f"{form} has all transforms: omit the frames, or write .csv or .tum")
    if not is_pair and topic is None and _FORMATS[form].all is None:
        if _FORMATS[form].message is not None:
            raise click.UsageError(f"{form} has the clouds or images of a topic: give --topic")
        raise click.UsageError(f"{form} has the poses of one frame: name TARGET and SOURCE")
    # The last message until the moment is the one that was the newest then.
    end = moment or end
    with BagChoice((recording,), begin=begin, end=end, statics=statics).opened() as bag:
        if moment is not None:
            bag.moment(moment)  # raises for one outside, which has no newest message
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
        elif topic is not None and written.message is not None:
            of_topic = _MessagesOf(bag, topic.removeprefix("/"), form, frame)
            click.echo(of_topic.write(output, force=force, is_one=moment is not None))
            return
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
        raise TfbusError(f"'{source}' has no pose in '{target}' in that span{_paused(bag)}")
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


def _items_of(bag: OpenBag, topic: str) -> Iterator[TopicItem]:
    known = {each.name for each in bag.reader.topics}
    check_recorded([("topic", topic, known)])
    items = bag.reader.items(*bag.span, Selection(topics=(topic,)))
    return (item for item in items if isinstance(item, TopicItem))


def _topic(bag: OpenBag, topic: str, output: Path, force: bool) -> str:
    _items_of(bag, topic)
    with new_file(output, force=force, sources=_sources(bag)) as beside:
        count = write_topic_csv(lambda: _items_of(bag, topic), beside)
    return counted(count, "message")


class _MessagesOf:
    """The messages of a topic that a format can hold, moved into a frame if there is one.

    Raises click.UsageError for a topic or frame that is not in the recording.
    """

    def __init__(self, bag: OpenBag, topic: str, form: str, frame: str | None) -> None:
        self._bag = bag
        self._topic = topic
        self._form = form
        written = _FORMATS[form].message
        assert written is not None
        self._write, self._types = written
        self._frame = frame
        self._items = _items_of(bag, topic)
        self._recording: Recording | None = None
        self._unread = self._unmoved = 0
        self._why_unmoved = ""
        if frame is not None:
            from tfbus.frames import recording

            self._recording = recording.Recording.of_reader(bag.reader, bag.choice.statics)
            edges = self._recording.frames()
            known = {name for edge in edges for name in (edge.name, edge.parent)}
            check_recorded([("frame", frame, known)])

    def write(self, output: Path, *, force: bool, is_one: bool) -> str:
        """Write the newest message into the file, or each into one beside it; a sentence that says
        so. Raises TfbusError if there is none.
        """
        if is_one:
            # Not by all before it, which may be hours of clouds.
            of_topic = Selection(topics=(self._topic,))
            newest = last_item(
                self._bag.reader,
                *self._bag.span,
                of_topic,
                lambda each: isinstance(each, TopicItem),
            )
            self._items = (each for each in (newest,) if isinstance(each, TopicItem))
        count = size = 0
        first = path = output
        for message in map(self._message, self._items):
            if message is None:
                continue
            if not is_one:
                number = f"{count:06d}_{message.stamp_ns}"
                path = output.with_name(f"{output.stem}_{number}{output.suffix}")
            with new_file(path, force=force, sources=_sources(self._bag)) as beside:
                self._write(message, beside)
            first = first if count else path
            count += 1
            size += path.stat().st_size
        unmoved = f"cannot be moved into {self._frame!r}: {self._why_unmoved}"
        if not count and self._unmoved:
            which = "the newest message" if is_one else "all messages"
            raise TfbusError(f"{which} of {self._topic!r} {unmoved}")
        for many, why in ((self._unread, "cannot be read"), (self._unmoved, unmoved)):
            if many:
                warn(f"skipped {counted(many, 'message')} of {self._topic!r}, which {why}")
        if not count:
            raise BusError(f"no message of {self._topic!r} in the recording, or in that span of it")
        if count == 1:
            return f"Wrote {path}: {size_text(size)}, a message of {self._topic!r}"
        return f"Wrote {first} to {path.name}: {size_text(size)}, {counted(count, 'message')}"

    def _message(self, item: TopicItem) -> Any:
        """The message as one of the format's types; None for one with wrong fields, or without a
        transform. Raises click.UsageError for another type.
        """
        found = supplied_type(item.type_name)
        if found is None or found not in self._types:
            names = " or ".join(each.__name__ for each in self._types)
            raise click.UsageError(
                f"{self._form} has messages of type {names}, and {item.topic!r} is of type "
                f"{item.type_name or 'unknown'}"
            )
        try:
            message: Any = from_map(found, item.values)
        except (DecodeError, TypeError, ValueError):
            self._unread += 1
            return None
        is_scan = isinstance(message, LaserScan)
        if self._recording is not None:
            # Without a stamp it is as of when it was recorded.
            message = replace(message, stamp_ns=message.stamp_ns or item.log_ns)
            try:
                message = self._recording.transform(message, self._frame or "")
            except TransformException as error:
                self._unmoved += 1
                self._why_unmoved = self._why_unmoved or str(error)
                return None
        elif is_scan:
            message = message.cloud()
        return _measured(message) if is_scan else message


def _measured(cloud: PointCloud) -> PointCloud:
    """A scan's cloud without the points that were not measured, which are NaN."""
    points = cloud.as_array()
    return PointCloud.from_array(cloud.stamp_ns, cloud.frame_id, points[points["x"] == points["x"]])
