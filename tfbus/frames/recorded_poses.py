"""Poses of one frame in another, from a recording: at a moment, or along a span.

`tfbus.Recording` has the answers; here are the questions of the tools: moments and spans of log
times, and errors that say where in the recording to look.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, TypeAlias

from tfbus.base import lazy_numpy as np
from tfbus.base.errors import (
    ExtrapolationException,
    FutureExtrapolationException,
    LookupException,
    PastExtrapolationException,
    TfbusError,
    TransformException,
)
from tfbus.base.lazy_numpy import NDArray
from tfbus.buffer.explain import LATER, LATEST
from tfbus.bus.settings import NodeSettings
from tfbus.command.recordings import BagChoice, OpenBag
from tfbus.frames.recorded import RecordedFrames
from tfbus.geometry.sampling import TF2, Sampling
from tfbus.geometry.trajectory import Trajectory, check_count, of_checked
from tfbus.geometry.transform import TransformStamped
from tfbus.geometry.transform_array import TransformArray
from tfbus.recording.items import Item, TransformItem
from tfbus.wire.fleet import Fleet

if TYPE_CHECKING:
    from tfbus.frames.recording import Recording
    from tfbus.recording.reader import RecordingReader

Ints: TypeAlias = "NDArray[np.int64]"

S = 1_000_000_000

# The poses of a span are looked up in parts: the first is short, so that it comes soon, and each
# further one is twice as long, up to this. Behind a part without poses it may be longer: stamps of
# a recording can be years apart, as of a host whose clock was not set yet.
_FIRST_PART_NS, _LONGEST_PART_NS = 2 * S, 512 * S

# For the last transforms before a moment, so much of the recording is read at first.
_LOOKED_BACK_NS = 2 * S


def frames_of_bag(
    bag: OpenBag, settings: NodeSettings, fleet: Fleet | None, *, cache_time_s: float = 10.0
) -> RecordedFrames:
    """The frames of an open recording, as a tool with these settings saw them."""
    return RecordedFrames(
        bag.reader,
        namespace=settings.namespace,
        fleet=fleet,
        cache_time_s=cache_time_s,
        sim_time=settings.sim_time or None,
        statics=bag.choice.statics,
    )


def recording_of(frames: RecordedFrames) -> Recording:
    """The recording of these frames, for lookups by stamps, with the same names."""
    from tfbus.frames.recording import Recording  # numpy

    return Recording.of_reader(frames.source, frames.statics, frames.viewpoint)


def recorded_transform(
    choice: BagChoice,
    settings: NodeSettings,
    fleet: Fleet | None,
    target: str,
    source: str,
    fixed_frame: str | None = None,
    sampling: Sampling = TF2,
) -> TransformStamped:
    """The pose at the moment of the choice. With a fixed frame: where the source was then, seen
    from where the target is at the end of the recording. Raises TfbusError if there is none.
    """
    with choice.opened() as bag:
        at_ns = bag.at_ns
        frames = frames_of_bag(bag, settings, fleet)
        stamp_ns = at_ns
        if frames.follows_clock:
            frames.seek(at_ns)
            stamp_ns = frames.now_ns()
        recording = recording_of(frames)
        with _explained(frames, at_ns):
            if fixed_frame is None:
                return recording.lookup_transform(target, source, stamp_ns, sampling=sampling)
            return recording.lookup_transform_full(
                target, None, source, stamp_ns, fixed_frame, sampling=sampling
            )


def transform_then(frames: RecordedFrames, target: str, source: str) -> TransformStamped:
    """The pose at the very moment of the frames, as `tfbus echo --at` has it. Raises TfbusError."""
    with _explained(frames, frames.at_ns):
        return recording_of(frames).lookup_transform(target, source, frames.now_ns())


class _explained:
    """Says of an unknown frame where in the recording it is to be found, and advises nothing that
    a recording does not have; `at_ns` is the moment that was asked for.
    """

    def __init__(self, frames: RecordedFrames, at_ns: int) -> None:
        self._frames, self._at_ns = frames, at_ns

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if not isinstance(error, TransformException):
            return
        frames = self._frames
        if frames.at_ns != self._at_ns or not frames.streams():
            frames.seek(self._at_ns)
        frame = ""
        if isinstance(error, LookupException):
            frame = error.frame
        elif isinstance(error, PastExtrapolationException):
            frame = error.child_frame_id
        if frame and (hint := frames.hint(frame)):
            raise TfbusError(f"no frame of that name at that time: {hint}") from error
        if isinstance(error, ExtrapolationException):
            gone = frames.said_gone(error.authority)
            is_after = gone and isinstance(error, FutureExtrapolationException)
            advice = {LATER: "give a later --at", LATEST: "give an earlier --at, or none"}
            if is_after:
                advice[LATEST] = f"{gone}; give an earlier --at"
            raise TfbusError(error.fact, advice=advice.get(error.advice, error.advice)) from error


def recorded_transforms(
    choice: BagChoice,
    settings: NodeSettings,
    fleet: Fleet | None,
    target: str,
    source: str,
    rate_hz: float | None = None,
    sampling: Sampling = TF2,
) -> Iterator[TransformStamped]:
    """The poses in the span of the choice: at the samples of the source, or of the first dynamic
    frame on the way from it to the target; or `rate_hz` of them a second. A static one comes once.

    Raises TfbusError if there is none.
    """
    for stamps_ns, poses in _parts(choice, settings, fleet, target, source, rate_hz, sampling):
        for stamp_ns, pose in zip(stamps_ns.tolist(), poses, strict=True):
            yield TransformStamped(stamp_ns, target, source, pose)


def recorded_track(
    choice: BagChoice,
    settings: NodeSettings,
    fleet: Fleet | None,
    target: str,
    source: str,
    rate_hz: float | None = None,
    sampling: Sampling = TF2,
) -> Trajectory:
    """The poses of `recorded_transforms` together."""
    parts = list(_parts(choice, settings, fleet, target, source, rate_hz, sampling))
    return of_checked(
        target,
        source,
        np.concatenate([stamps_ns for stamps_ns, _ in parts]),
        np.concatenate([poses.xyz for _, poses in parts]),
        np.concatenate([poses.quat_xyzw for _, poses in parts]),
    )


def _parts(
    choice: BagChoice,
    settings: NodeSettings,
    fleet: Fleet | None,
    target: str,
    source: str,
    rate_hz: float | None,
    sampling: Sampling,
) -> Iterator[tuple[Ints, TransformArray]]:
    """The poses of `recorded_transforms`, part by part: stamps (N,) and poses."""
    with choice.opened() as bag:
        from_ns, to_ns = bag.span
        frames = frames_of_bag(bag, settings, fleet)
        recording = recording_of(frames)
        span = stamps_of(bag)
        has_any = False
        with _explained(frames, to_ns):
            if is_static(recording, target, source):
                stamps = np.zeros(1, dtype=np.int64)
                at = stamps if span is None else stamps + span[0]
                yield stamps, recording.lookup_transforms(target, source, at)
                return
            for path in _paths(recording, target, source, span, rate_hz, sampling):
                has_any |= len(path) > 0
                yield path.stamps_ns, TransformArray(path.xyz, path.quat_xyzw)
        if not has_any:
            raise TfbusError(
                f"no pose of {source!r} in {target!r} in that span: "
                + _why_none(frames, from_ns, to_ns)
            )


def _why_none(frames: RecordedFrames, from_ns: int, to_ns: int) -> str:
    pauses = [each for each in frames.pauses if each.from_ns < to_ns and each.to_ns > from_ns]
    if pauses:
        return frames.said(pauses[0])
    return "nothing came of the frames between"


# Stamps


def is_static(recording: Recording, target: str, source: str) -> bool:
    """Whether all edges between two frames are static, at the end of the recording."""
    try:
        return recording.latest_common_time(target, source) is None
    except TransformException:
        return False


def stamps_of(bag: OpenBag) -> tuple[int, int] | None:
    """The first and last stamp of dynamic transforms received in the chosen span; the span itself
    if there are none, None if no span was chosen.
    """
    if bag.choice.begin is None and bag.choice.end is None:
        return None
    first_ns, last_ns = stamps_received(bag.reader, *bag.span)
    return bag.span if first_ns is None or last_ns is None else (first_ns, last_ns)


def stamps_received(
    reader: RecordingReader, from_ns: int, to_ns: int
) -> tuple[int | None, int | None]:
    """The first stamp of the dynamic transforms that were received from one log time to another,
    and the last; None if there are none.
    """
    first = next(_stamps(reader.items(from_ns, to_ns)), None)
    last = None
    window_ns = _LOOKED_BACK_NS
    while last is None and first is not None:
        begin_ns = max(from_ns, to_ns - window_ns)
        last = max(map(max, _stamps(reader.items(begin_ns, to_ns))), default=None)
        window_ns *= 4
    return (min(first) if first else None), last


def _stamps(items: Iterator[Item]) -> Iterator[list[int]]:
    for item in items:
        if isinstance(item, TransformItem) and not item.static and item.rows.count:
            yield item.rows.stamps_as_ints()


def stamps_at_rate(first_ns: int, last_ns: int, rate_hz: float) -> Ints:
    """Stamps from the first on, at most to the last, this many a second; each rounded. Raises
    TfbusError for more than 20 million.
    """
    count = int((last_ns - first_ns) * rate_hz / 1e9) + 1
    check_count(count)
    since: Ints = np.round(np.arange(count) * (1e9 / rate_hz)).astype(np.int64)
    return first_ns + since[since <= last_ns - first_ns]


# Paths


def _paths(
    recording: Recording,
    target: str,
    source: str,
    span: tuple[int, int] | None,
    rate_hz: float | None,
    sampling: Sampling,
) -> Iterator[Trajectory]:
    """The path from one stamp to another, part by part. Raises as `Recording.trajectory` if
    nothing of it is known.
    """
    if rate_hz is not None:
        yield path_at_rate(recording, target, source, span, rate_hz, sampling)
        return
    dynamic = [each for each in recording.frames() if not each.is_static]
    first_ns, last_ns = span or (
        min((each.first_ns for each in dynamic), default=0),
        max((each.last_ns for each in dynamic), default=0),
    )
    length_ns = _FIRST_PART_NS
    has_any, reason = False, None
    while first_ns <= last_ns:
        end_ns, path = min(first_ns + length_ns, last_ns), None
        try:
            path = recording.trajectory(target, source, first_ns, end_ns, sampling=sampling)
        except TransformException as error:
            reason = error
        if path is not None:
            has_any = True
            yield path
        first_ns, length_ns = end_ns + 1, 2 * length_ns
        if path:
            length_ns = min(length_ns, _LONGEST_PART_NS)
    if not has_any and reason is not None:
        raise reason


def path_at_rate(
    recording: Recording,
    target: str,
    source: str,
    span: tuple[int, int] | None,
    rate_hz: float,
    sampling: Sampling = TF2,
) -> Trajectory:
    """The path between the first and last stamp of the source in a span, by default anywhere, so
    many poses a second; of a static one from the beginning of the span to its end.
    """
    if is_static(recording, target, source):
        begin_ns, end_ns = span or (recording.start_ns, recording.end_ns)
    else:
        stamps = recording.trajectory(target, source, *(span or (None, None))).stamps_ns
        if not len(stamps):
            return poses_at(recording, target, source, stamps, sampling)
        begin_ns, end_ns = int(stamps[0]), int(stamps[-1])
    return poses_at(recording, target, source, stamps_at_rate(begin_ns, end_ns, rate_hz), sampling)


def poses_at(
    recording: Recording, target: str, source: str, stamps_ns: Ints, sampling: Sampling = TF2
) -> Trajectory:
    """The poses of the source, seen from the target, at the stamps at which they are known.

    Raises as `Recording.lookup_transform` if it is known at none.
    """
    poses, known = recording.lookup_known_transforms(target, source, stamps_ns, sampling=sampling)
    if len(stamps_ns) and not known.any():
        recording.lookup_transform(target, source, int(stamps_ns[-1]), sampling=sampling)
    return Trajectory(target, source, stamps_ns[known], poses.xyz[known], poses.quat_xyzw[known])
