"""A recording to look into: lookups at any stamp, buffers of a span, trajectories, messages."""

import math
import os
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self, TypeVar, overload

from tfbus.base import lazy_numpy as np
from tfbus.base import scheduler
from tfbus.base.bounded import Bounded
from tfbus.base.errors import (
    ConnectivityException,
    ExtrapolationException,
    InvalidArgumentException,
    LookupException,
    NoDataException,
    TransformException,
)
from tfbus.base.lazy_numpy import ArrayLike, NDArray
from tfbus.base.stamps import other_clock
from tfbus.base.wording import did_you_mean, near_names, printable
from tfbus.buffer import trajectories
from tfbus.buffer.buffer import Buffer
from tfbus.frames.recorded import RecordedFrames
from tfbus.frames.runs import FIRST_NS, LAST_NS
from tfbus.frames.samples import RecordedSamples, SampledSpan, only, poses_of
from tfbus.geometry.sampling import Sampling
from tfbus.geometry.trajectory import Trajectory
from tfbus.geometry.transform import TransformStamped, check_frame_id, check_stamp, make_stamped
from tfbus.geometry.transform_array import TransformArray, are_valid
from tfbus.recording.items import (
    ALL,
    EventItem,
    Item,
    Pause,
    Selection,
    TransformItem,
    Viewpoint,
    check_span,
    is_of_transforms,
)
from tfbus.recording.reader import RecordingReader, StreamSummary, TopicSummary
from tfbus.recording.state import STATICS, Statics
from tfbus.wire.codec import from_map

M = TypeVar("M")

# A lookup reads the samples of the stamps around it: this span of time, which the next ones use.
_CELL_NS = 2_000_000_000
_KEPT_SPANS = 16
_LONGEST_RUN_NS = 300 * _CELL_NS


@dataclass(frozen=True)
class RecordedFrame:
    """A frame in a recording: the last frame above it, the streams that sent it, how many samples
    there are, and the first and last of their stamps, in nanoseconds since the Unix epoch. Of a
    static frame the samples include repeated ones.
    """

    name: str
    parent: str
    is_static: bool
    streams: tuple[str, ...]
    samples: int
    first_ns: int
    last_ns: int


class Recording(AbstractContextManager["Recording"]):
    """The traffic of a bus, from the files that `tfbus bag record` wrote; opened by the path of a
    file, of several, or of a folder with the files of one recording.

        with tfbus.Recording("tfbus_2026_11_22-09_00_00.mcap") as recording:
            pose = recording.lookup_transform("map", "laser", stamp_ns)

    Lookups go by the stamps of the transforms, anywhere in the recording, and read only the chunks
    that they need. They answer as a listener would have that knew all that came: of a stream that
    restarted each epoch counts for its own stamps, and static transforms count as in force then. A
    static transform also holds before it was received, as in tf2; with `statics="then"` it does
    not. Nothing is interpolated across a pause of the recorder: lookups in it raise
    ExtrapolationException. The times `start_ns` and `end_ns`, and the times of items and messages,
    are log times: when the recorder received them. Both are nanoseconds since the Unix epoch.

    An unreadable part of a file is left out, and logged once.

    Needs the extra `bag`. Raises MissingFileError, which is a FileNotFoundError, for a file that
    is not there, FileError if one cannot be opened, and DecodeError for one that is no recording.
    Safe from any thread.
    """

    def __init__(self, *paths: str | os.PathLike[str], statics: Statics = "always") -> None:
        if not paths:
            raise InvalidArgumentException("name at least one file of the recording")
        for path in paths:
            if not isinstance(path, str | os.PathLike):
                raise InvalidArgumentException(
                    f"path: expected the name of a file, got a {type(path).__name__}; several "
                    "files are given one after the other: Recording(first, second)"
                )
        if statics not in STATICS:
            raise InvalidArgumentException(f"statics: {statics!r} is none of {', '.join(STATICS)}")
        self._begin(RecordingReader(*paths), statics, Viewpoint(None))

    @classmethod
    def of_reader(
        cls, reader: RecordingReader, statics: Statics = "always", view: Viewpoint | None = None
    ) -> Self:
        """The recording that an open reader reads, seen from a viewpoint; `close` closes the
        reader.
        """
        recording = cls.__new__(cls)
        recording._begin(reader, statics, view or Viewpoint(None))
        return recording

    def _begin(self, reader: RecordingReader, statics: Statics, view: Viewpoint) -> None:
        self._reader = reader
        self._statics: Statics = statics
        self._view = view
        self._lock = scheduler.RLock()
        self._is_closed = False
        self._known: RecordedSamples | None = None
        # By their last use.
        self._spans: Bounded[tuple[int, bool], SampledSpan] = Bounded(_KEPT_SPANS)
        self._last: Buffer | None = None

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the files. Lookups raise InvalidArgumentException from then on."""
        with self._lock:
            self._is_closed = True
            self._reader.close()

    def __repr__(self) -> str:
        return f"<Recording of {self.duration_s:.1f} s, {len(self.streams)} streams>"

    # Its contents

    @property
    def paths(self) -> tuple[Path, ...]:
        """The files."""
        return tuple(part.path for part in self._reader.parts)

    @property
    def start_ns(self) -> int:
        """The log time of the first item; 0 if there is none."""
        return self._reader.start_ns

    @property
    def end_ns(self) -> int:
        """The log time of the last item; 0 if there is none."""
        return self._reader.end_ns

    @property
    def duration_s(self) -> float:
        """Seconds from the first item to the last."""
        return (self.end_ns - self.start_ns) / 1e9

    @property
    def is_complete(self) -> bool:
        """Whether no file was cut short, as by a power failure; the rest is read."""
        return self._reader.is_complete

    @property
    def about(self) -> Mapping[str, str]:
        """The recorder's note on itself, as `version` and `host`."""
        return self._reader.about

    @property
    def streams(self) -> tuple[StreamSummary, ...]:
        """The streams, each epoch for itself, by name and epoch."""
        return self._reader.streams

    @property
    def topics(self) -> tuple[TopicSummary, ...]:
        """The topics by name."""
        return self._reader.topics

    @property
    def pauses(self) -> tuple[Pause, ...]:
        """When nothing was recorded though the bus may have gone on, in order of time."""
        return self._reader.pauses

    @property
    def events(self) -> tuple[EventItem, ...]:
        """Events on the bus, and of the recorder, in order of time."""
        return self._reader.events

    def frames(self) -> tuple[RecordedFrame, ...]:
        """The child frames of all transforms, by name."""
        found: dict[str, RecordedFrame] = {}
        for each in self._samples().facts():
            parent, child = each.edge
            former = found.get(child)
            if former is None:
                former = RecordedFrame(
                    child, parent, each.is_static, (), 0, each.first_ns, each.last_ns
                )
            found[child] = RecordedFrame(
                child,
                parent if each.last_ns >= former.last_ns else former.parent,
                each.is_static and former.is_static,
                tuple(sorted({*former.streams, each.key[0]})),
                former.samples + each.samples,
                min(former.first_ns, each.first_ns),
                max(former.last_ns, each.last_ns),
            )
        return tuple(found[name] for name in sorted(found))

    def items(
        self, from_ns: int | None = None, to_ns: int | None = None, selection: Selection = ALL
    ) -> Iterator[Item]:
        """All that was recorded from one log time to another, both included, in order of the log
        times; an item that only repeats one in force is left out.

        Raises InvalidArgumentException for a span that ends before it begins.
        """
        check_span(from_ns, to_ns)
        return self._reader.items(from_ns, to_ns, selection)

    @overload
    def messages(
        self, topic: str, *, from_ns: int | None = None, to_ns: int | None = None
    ) -> Iterator[tuple[int, Mapping[str, Any]]]: ...

    @overload
    def messages(
        self,
        topic: str,
        message_type: type[M],
        *,
        from_ns: int | None = None,
        to_ns: int | None = None,
    ) -> Iterator[tuple[int, M]]: ...

    def messages(
        self,
        topic: str,
        message_type: type[Any] | None = None,
        *,
        from_ns: int | None = None,
        to_ns: int | None = None,
    ) -> Iterator[tuple[int, Any]]:
        """The messages of a topic from one log time to another, both included: pairs of the log
        time and the message, of its type if one is given, else as a map of its fields.

        `topic` is its full name, with or without a slash before it. Raises LookupException for one
        that is not in the recording, InvalidArgumentException for `tf`, whose transforms `samples`,
        `trajectory` and `buffer` have, and for a span that ends before it begins, and DecodeError
        for a message of another type.
        """
        check_span(from_ns, to_ns)
        topic = topic.removeprefix("/")
        if is_of_transforms(topic):
            raise InvalidArgumentException(
                f"'{topic}' has transforms, which are no messages of a topic: samples(frame), "
                "trajectory(target, source) and buffer() give them, and items() as they came"
            )
        if topic not in {each.name for each in self.topics}:
            names = [each.name for each in self.topics]
            raise LookupException(
                f"topic '{topic}' is not in the recording{did_you_mean(topic, names)}"
            )
        return self._messages(topic, message_type, from_ns, to_ns)

    def _messages(
        self, topic: str, message_type: type[Any] | None, from_ns: int | None, to_ns: int | None
    ) -> Iterator[tuple[int, Any]]:
        for item in self.items(from_ns, to_ns, Selection(topics=(topic,))):
            if isinstance(item, (EventItem, TransformItem)):
                continue
            if message_type is None:
                yield item.log_ns, item.with_arrays
            else:
                yield item.log_ns, from_map(message_type, item.values)

    # Lookups, by stamps

    def lookup_transform(
        self,
        target_frame: str,
        source_frame: str,
        stamp_ns: int | None = None,
        *,
        sampling: Sampling | None = None,
    ) -> TransformStamped:
        """The transform that takes data in `source_frame` into `target_frame` at a stamp; None
        means the latest time for which every edge between the two has data.

        Raises as `Buffer.lookup_transform`.
        """
        if stamp_ns is None:
            return self._latest(target_frame, source_frame, sampling)
        stamp_ns = check_stamp(stamp_ns)
        span = self._around(stamp_ns)
        with self._telling_of_all(span):
            return span.buffer.lookup_transform(
                target_frame, source_frame, stamp_ns, sampling=sampling
            )

    def lookup_transform_full(
        self,
        target_frame: str,
        target_stamp_ns: int | None,
        source_frame: str,
        source_stamp_ns: int | None,
        fixed_frame: str,
        *,
        sampling: Sampling | None = None,
    ) -> TransformStamped:
        """The source as it was at one time, seen from the target at another.

        `fixed_frame` must not move between the two times. The answer has the target's stamp.
        Raises as `lookup_transform`.
        """
        back = self.lookup_transform(fixed_frame, source_frame, source_stamp_ns, sampling=sampling)
        there = self.lookup_transform(target_frame, fixed_frame, target_stamp_ns, sampling=sampling)
        return make_stamped(
            there.stamp_ns,
            target_frame,
            source_frame,
            (there.transform @ back.transform).as_pose(),
            max(back.extrapolated_ns, there.extrapolated_ns),
        )

    def can_transform(
        self,
        target_frame: str,
        source_frame: str,
        stamp_ns: int | None = None,
        *,
        sampling: Sampling | None = None,
    ) -> bool:
        """Whether `lookup_transform` with the same arguments would succeed.

        Raises InvalidArgumentException for arguments that no lookup takes.
        """
        try:
            self.lookup_transform(target_frame, source_frame, stamp_ns, sampling=sampling)
        except InvalidArgumentException:
            raise
        except TransformException:
            return False
        return True

    def latest_common_time(self, target_frame: str, source_frame: str) -> int | None:
        """The latest stamp for which every edge between the two frames has data.

        None if all of them are static. Raises as `lookup_transform`.
        """
        return self._end().latest_common_time(target_frame, source_frame)

    def lookup_transforms(
        self,
        target_frame: str,
        source_frame: str,
        stamps_ns: "ArrayLike",
        *,
        sampling: Sampling | None = None,
    ) -> TransformArray:
        """The transforms at N stamps (N,): a sequence of N, whose arrays are `xyz` (N, 3) in metres
        and `quat_xyzw` (N, 4).

        Raises as `lookup_transform` if one of the stamps cannot be answered.
        """
        stamps = _checked_stamps(stamps_ns)
        poses = np.empty((len(stamps), 7))
        for span, of_span in self._spans_of(target_frame, source_frame, stamps):
            with self._telling_of_all(span):
                found = span.buffer.lookup_transforms(
                    target_frame, source_frame, stamps[of_span], sampling=sampling
                )
            poses[of_span, :3], poses[of_span, 3:] = found.xyz, found.quat_xyzw
        return TransformArray(poses[:, :3], poses[:, 3:])

    def lookup_known_transforms(
        self,
        target_frame: str,
        source_frame: str,
        stamps_ns: "ArrayLike",
        *,
        sampling: Sampling | None = None,
    ) -> "tuple[TransformArray, NDArray[np.bool_]]":
        """The transforms at N stamps as far as they are known, and a mask of the known stamps.

        The mask (N,) is False, and the rows are NaN, if there is no answer. Raises
        LookupException for a frame that is not in the recording.
        """
        stamps = _checked_stamps(stamps_ns)
        poses, known = np.full((len(stamps), 7), np.nan), np.zeros(len(stamps), bool)
        for span, of_span in self._spans_of(target_frame, source_frame, stamps):
            try:
                found, are_known = span.buffer.lookup_known_transforms(
                    target_frame, source_frame, stamps[of_span], sampling=sampling
                )
            except (LookupException, ConnectivityException):
                continue  # one of the frames was not there
            poses[of_span, :3], poses[of_span, 3:] = found.xyz, found.quat_xyzw
            known[of_span] = are_known
        return TransformArray(poses[:, :3], poses[:, 3:]), known

    def transform(self, message: Any, target_frame: str, *, fixed_frame: str | None = None) -> Any:
        """A message of `tfbus.messages` in the target frame, by the recorded transform at its
        stamp, or at the time of each of its points: see `Buffer.transform`.
        """
        from tfbus.buffer.messages import Lookups, transformed

        lookups = Lookups(self.lookup_transform, self.lookup_transforms)
        return transformed(lookups, message, target_frame, fixed_frame)

    def trajectory(
        self,
        target_frame: str,
        source_frame: str,
        from_ns: int | None = None,
        to_ns: int | None = None,
        *,
        sampling: Sampling | None = None,
    ) -> Trajectory:
        """The poses of the source, seen from the target, from one stamp to another, both included.

        It is at the stamps of the samples of the source, or of the first dynamic frame on the way
        from it to the target, if all edges between have data. Raises as `Buffer.trajectory`,
        and InvalidArgumentException for a span that ends before it begins.
        """
        check_span(from_ns, to_ns)
        first_ns, last_ns = self._stamps_from(from_ns), self._stamps_to(to_ns)
        found: list[Trajectory] = []
        reason: TransformException | None = None
        for span in self._pieces(target_frame, source_frame, first_ns, last_ns):
            try:
                if span.buffer.latest_common_time(target_frame, source_frame) is None:
                    raise InvalidArgumentException(
                        f"{target_frame!r} -> {source_frame!r} is static, without samples: "
                        "lookup_transforms(target_frame, source_frame, stamps_ns) has it at stamps "
                        "of your choice"
                    )
                part = trajectories.trajectory(
                    span.buffer, target_frame, source_frame, sampling=sampling
                )
            except InvalidArgumentException:
                raise
            except TransformException as error:
                reason = error
                continue
            of_span = (part.stamps_ns >= span.first_ns) & (part.stamps_ns <= span.last_ns)
            found.append(part[of_span])
        if not found:
            raise reason or self._unknown(target_frame, source_frame)
        return _joined(found)

    def samples(
        self,
        frame: str,
        from_ns: int | None = None,
        to_ns: int | None = None,
        *,
        parent: str | None = None,
    ) -> Trajectory:
        """The samples of a frame, from one stamp to another, both included: in the last frame
        above it, or in `parent`. Of equal stamps the one that came last.

        Raises LookupException for a frame that is not in the recording, and
        InvalidArgumentException for a span that ends before it begins.
        """
        check_frame_id(frame, "frame")
        check_span(from_ns, to_ns)
        known = {each.name: each for each in self.frames()}
        if frame not in known:
            raise LookupException(
                f"frame '{frame}' is not in the recording{did_you_mean(frame, known)}",
                frame=frame,
                nearest=near_names(frame, known),
            )
        parent = parent or known[frame].parent
        first_ns, last_ns = self._stamps_from(from_ns), self._stamps_to(to_ns)
        with self._lock:
            samples = self._samples()
            groups = samples.groups(first_ns, last_ns, frozenset({frame}))
            rows = [only(group.rows, {frame}, parent) for group in groups]
            if known[frame].is_static:
                rows = [only(item.rows, {frame}, parent) for item in samples.last_statics()]
                first_ns, last_ns = FIRST_NS, LAST_NS
        stamps = np.concatenate([np.empty(0, np.int64), *(each.stamps_ns() for each in rows)])
        poses = np.concatenate([np.empty((0, 7)), *(poses_of(each) for each in rows)])
        taken = are_valid(poses)  # no buffer takes the others
        stamps, poses = stamps[taken], poses[taken]
        # The last of each stamp: the first of them in the reversed order.
        stamps, at = np.unique(stamps[::-1], return_index=True)
        poses = poses[::-1][at]
        wanted = (stamps >= first_ns) & (stamps <= last_ns)
        return Trajectory(parent, frame, stamps[wanted], poses[wanted, :3], poses[wanted, 3:])

    # Buffers

    def buffer(
        self,
        from_ns: int | None = None,
        to_ns: int | None = None,
        *,
        selection: Selection = ALL,
        **arguments: Any,
    ) -> Buffer:
        """A buffer as a listener has it that began at one log time, when static transforms were
        there already, and ended after another; by default of the whole recording. Errors of its
        lookups do not advise to wait. Raises InvalidArgumentException for a span that ends before
        it begins.

        It keeps all samples, unless `arguments`, as `Buffer` takes them, say otherwise.
        Its clock stands at the end of the span, so that ages (`max_age_s`) are as of then.
        Samples from before a restart of their stream are not in it, nor frames that were removed;
        frames whose publisher was gone at the end are marked so. In a pause of the recorder
        lookups raise ExtrapolationException.
        """
        check_span(from_ns, to_ns)
        buffer = Buffer(**{"cache_time_s": math.inf, **arguments})
        clock = buffer.clock
        frames = RecordedFrames(self._reader, view=self._view, sim_time=False, buffer=buffer)
        with self._lock:
            frames.hear(from_ns, to_ns, selection)
        buffer.expect_no_more()
        buffer.clock = clock
        if "clock" not in arguments:
            now_ns = self.end_ns if to_ns is None else min(to_ns, self.end_ns)
            stamps = [each.newest_ns for each in buffer.all_frames() if each.newest_ns is not None]
            if stamps and other_clock(now_ns, max(stamps)):
                now_ns = max(stamps)  # a simulated time
            buffer.clock = lambda: now_ns
        return buffer

    # How it finds them

    def _check_open(self) -> None:
        """Raise InvalidArgumentException if it is closed, also for contents held in memory."""
        if self._is_closed:
            name = printable(str(self.paths[0]))
            raise InvalidArgumentException(f"{name} is closed: read it within its `with`")

    def _samples(self) -> RecordedSamples:
        with self._lock:
            self._check_open()
            if self._known is None:
                self._known = RecordedSamples(self._reader, self._statics, self._view)
            return self._known

    def _stamps_from(self, from_ns: int | None) -> int:
        first_ns = self._samples().first_ns or 0
        return first_ns if from_ns is None else max(check_stamp(from_ns), first_ns)

    def _stamps_to(self, to_ns: int | None) -> int:
        last_ns = self._samples().last_ns or 0
        return last_ns if to_ns is None else min(check_stamp(to_ns), last_ns)

    def _around(self, stamp_ns: int, *, of_last_runs: bool = False) -> SampledSpan:
        """A span with a stamp in it."""
        with self._lock:
            samples = self._samples()
            cell_ns = stamp_ns - stamp_ns % _CELL_NS
            first_ns = samples.start_of(stamp_ns, cell_ns)
            key = first_ns, of_last_runs
            span = self._spans.get(key)
            if span is None:
                span = samples.span(first_ns, cell_ns + _CELL_NS - 1, of_last_runs=of_last_runs)
            self._spans[key] = span
            return span

    def _end(self) -> Buffer:
        """The last samples of all frames."""
        with self._lock:
            self._check_open()
            if self._last is None:
                self._last = self._samples().end()
            return self._last

    def _latest(
        self, target_frame: str, source_frame: str, sampling: Sampling | None
    ) -> TransformStamped:
        end = self._end()
        latest_ns = end.latest_common_time(target_frame, source_frame)
        if latest_ns is not None:
            end = self._around(latest_ns, of_last_runs=True).buffer
        return end.lookup_transform(target_frame, source_frame, latest_ns, sampling=sampling)

    @contextmanager
    def _telling_of_all(self, span: SampledSpan) -> Iterator[None]:
        """Inside the `with` an error of a span's buffer tells of all samples."""
        try:
            yield
        except ExtrapolationException as error:
            self._tell_of_other_clock(error)
            known = self._samples().range_of(error.child_frame_id, span.runs)
            if known is not None:
                error.oldest_ns, error.newest_ns = known
            raise

    def _tell_of_other_clock(self, error: ExtrapolationException) -> None:
        """Have the error for a stamp that is years away explain stamps of a recording, if no
        publisher can be given another clock.
        """
        if error.requested_ns is None or error.newest_ns is None:
            return
        mistake = other_clock(error.requested_ns, error.newest_ns)
        if mistake is not None and error.advice == mistake.advice:
            first_ns = self._samples().first_ns or 0
            better = f"stamps are nanoseconds since 1970, here from {first_ns} on"
            if not other_clock(self.start_ns, first_ns):
                better += "; recording.start_ns + 5 * 10**9 is 5 s after its beginning"
            error.advice = better

    def _pieces(
        self,
        target_frame: str,
        source_frame: str,
        first_ns: int,
        last_ns: int,
        stamps: "NDArray[np.int64] | None" = None,
    ) -> Iterator[SampledSpan]:
        """Spans from one stamp to another, of the frames that the two need; with `stamps` only
        spans in which one of them is.
        """
        children = self._samples().chain(target_frame, source_frame)
        if not self._samples().knows(target_frame, source_frame):
            raise self._unknown(target_frame, source_frame)
        while first_ns <= last_ns:
            end_ns = self._samples().end_of(first_ns, last_ns)
            if stamps is None or ((stamps >= first_ns) & (stamps <= end_ns)).any():
                with self._lock:
                    span = self._samples().span(first_ns, end_ns, children=children)
                yield span
            first_ns = end_ns + 1

    def _spans_of(
        self, target_frame: str, source_frame: str, stamps: "NDArray[np.int64]"
    ) -> "Iterator[tuple[SampledSpan, NDArray[np.bool_]]]":
        """Spans that have all of the stamps (N,), and which of these are in each (N,)."""
        for first_ns, last_ns in _runs(stamps):
            for span in self._pieces(target_frame, source_frame, first_ns, last_ns, stamps):
                yield span, (stamps >= span.first_ns) & (stamps <= span.last_ns)

    def _unknown(self, target_frame: str, source_frame: str) -> TransformException:
        """The error of a lookup that has no samples to go by."""
        try:
            self._end().lookup_transform(target_frame, source_frame)
        except TransformException as error:
            return error
        return NoDataException(
            f"no samples between '{target_frame}' and '{source_frame}' in that span"
        )


def _checked_stamps(stamps_ns: "ArrayLike") -> "NDArray[np.int64]":
    stamps = np.asarray(stamps_ns)
    if stamps.ndim != 1 or (stamps.size and stamps.dtype.kind not in "iu"):
        raise InvalidArgumentException(
            "stamps_ns: expected integers of shape (N,), nanoseconds since the Unix epoch, got "
            f"{stamps.dtype} of shape {stamps.shape}; tfbus.stamp_ns(...) converts seconds"
        )
    for stamp in (stamps.min(), stamps.max()) if stamps.size else ():
        check_stamp(stamp)
    return stamps.astype(np.int64)


def _runs(stamps: "NDArray[np.int64]") -> Iterator[tuple[int, int]]:
    """Spans that hold all stamps: each from a first to a last one, of at most `_LONGEST_RUN_NS`,
    and without a gap of more than that of two lookups that share their samples.
    """
    ordered = np.unique(stamps)
    at = 0
    while at < len(ordered):
        most = int(np.searchsorted(ordered, int(ordered[at]) + _LONGEST_RUN_NS))
        gaps = np.flatnonzero(np.diff(ordered[at:most]) > _CELL_NS)
        end = at + int(gaps[0]) + 1 if len(gaps) else most
        yield int(ordered[at]), int(ordered[end - 1])
        at = end


def _joined(parts: list[Trajectory]) -> Trajectory:
    if len(parts) == 1:
        return parts[0]
    stamps = np.concatenate([part.stamps_ns for part in parts])
    xyz = np.concatenate([part.xyz for part in parts])
    quat_xyzw = np.concatenate([part.quat_xyzw for part in parts])
    return Trajectory(parts[0].frame_id, parts[0].child_frame_id, stamps, xyz, quat_xyzw)
