"""Poses of one frame in another, from a recording: at a moment, or along a span."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from typing import TYPE_CHECKING

from tfbus.buffer.explain import after_waiting_with
from tfbus.bus.settings import NodeSettings
from tfbus.command.recordings import BagChoice, OpenBag
from tfbus.core.sampling import TF2, Sampling
from tfbus.errors import (
    ExtrapolationException,
    FutureExtrapolationException,
    LookupException,
    PastExtrapolationException,
    TfbusError,
    TransformException,
)
from tfbus.frames.recorded import RecordedFrames
from tfbus.frames.track import Track
from tfbus.geometry.transform import TransformStamped
from tfbus.geometry.transform_array import TransformArray
from tfbus.trajectory.trajectory import check_count
from tfbus.wire.fleet import Fleet

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Ints = NDArray[np.int64]
else:
    from tfbus.core import lazy_numpy as np

S = 1_000_000_000

# The poses of a span are looked up in parts of this length. What a slow frame of the path lags
# behind the others, and the pauses that are interpolated, are at most as long as the cache.
_PART_NS = 2 * S
_CACHE_S = 60.0

# A lookup at a stamp needs a later sample of each frame on the path, which comes within this.
_LATER_S = (1, 5, 55)


def frames_of(
    bag: OpenBag,
    settings: NodeSettings,
    fleet: Fleet | None,
    *,
    cache_time_s: float = 10.0,
    sampling: Sampling = TF2,
) -> RecordedFrames:
    """The frames of an open recording, as a tool with these settings saw them."""
    return RecordedFrames(
        bag.reader,
        namespace=settings.namespace,
        fleet=fleet,
        cache_time_s=cache_time_s,
        sim_time=settings.sim_time or None,
        statics=bag.choice.statics,
        sampling=sampling,
    )


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
    from where the target is at the end of the recording. Raises TfbusError where there is none.
    """
    with choice.opened() as bag:
        at_ns = bag.at_ns
        if fixed_frame is not None:
            cache_s = (bag.reader.end_ns - at_ns) / S + 10.0
            frames = frames_of(bag, settings, fleet, cache_time_s=cache_s, sampling=sampling)
            stamp_ns = _stamp_at(frames, at_ns)
            frames.seek(bag.reader.end_ns)
            with _explained(frames):
                return frames.buffer.lookup_transform_full(
                    target, None, source, stamp_ns, fixed_frame
                )
        frames = frames_of(bag, settings, fleet, cache_time_s=_CACHE_S, sampling=sampling)
        stamp_ns = _stamp_at(frames, at_ns)
        with _explained(frames):
            return _at(frames, target, source, stamp_ns)


def _stamp_at(frames: RecordedFrames, at_ns: int) -> int:
    """The stamp of a log time: the same, but under simulated time."""
    frames.seek(at_ns)
    return frames.now_ns()


def why_no_pose(frames: RecordedFrames, target: str, source: str) -> str:
    """Why there is no pose at the very moment of the frames, as `tfbus echo --at` says it; "" where
    there is one.
    """
    at_ns = frames.at_ns
    try:
        with _explained(frames):
            _at(frames, target, source, frames.now_ns())
    except TfbusError as error:
        return str(error)
    finally:
        if frames.at_ns != at_ns:
            frames.seek(at_ns)
    return ""


def _at(frames: RecordedFrames, target: str, source: str, stamp_ns: int) -> TransformStamped:
    first: FutureExtrapolationException | None = None
    # What is known of the moment before a publisher begins again, or a frame is removed.
    found: list[TransformStamped] = []

    def look() -> None:
        with suppress(TransformException):
            found.append(frames.buffer.lookup_transform(target, source, stamp_ns))

    frames.before_loss = look
    for later_s in _LATER_S:
        if found:
            return found[0]
        try:
            return frames.buffer.lookup_transform(target, source, stamp_ns)
        except FutureExtrapolationException as error:
            first = first or error
            if frames.pause is not None:
                raise TfbusError(
                    f"no pose of {source!r} in {target!r} then: {frames.said(frames.pause)}"
                ) from error
            frames.advance(min(frames.at_ns + later_s * S, frames.end_ns))
        except PastExtrapolationException as error:
            # Its publisher began again meanwhile.
            raise first or error from None
    return found[0] if found else frames.buffer.lookup_transform(target, source, stamp_ns)


class _explained:
    """Says of an unknown frame where in the recording it is to be found, and advises nothing that
    a recording does not have.
    """

    def __init__(self, frames: RecordedFrames) -> None:
        self._frames = frames

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, LookupException) and (hint := self._frames.hint(error.frame)):
            raise TfbusError(f"no frame of that name at that time: {hint}") from error
        if isinstance(error, ExtrapolationException):
            gone = self._frames.said_gone(error.authority)
            is_after = gone and isinstance(error, FutureExtrapolationException)
            raise TfbusError(
                after_waiting_with(
                    error,
                    later="give a later --at",
                    latest=f"{gone}; give an earlier --at"
                    if is_after
                    else "give an earlier --at, or none",
                )
            ) from error


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

    Raises TfbusError where there is none.
    """
    with choice.opened() as bag:
        from_ns, to_ns = bag.span
        frames = frames_of(bag, settings, fleet, cache_time_s=_CACHE_S, sampling=sampling)
        for stamps_ns, poses in poses_in(frames, target, source, from_ns, to_ns, rate_hz):
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
) -> Track:
    """The poses of `recorded_transforms` together."""
    with choice.opened() as bag:
        from_ns, to_ns = bag.span
        frames = frames_of(bag, settings, fleet, cache_time_s=_CACHE_S, sampling=sampling)
        parts = list(poses_in(frames, target, source, from_ns, to_ns, rate_hz))
    return Track(
        target,
        source,
        np.concatenate([stamps_ns for stamps_ns, _ in parts]),
        TransformArray(
            np.concatenate([poses.xyz for _, poses in parts]),
            np.concatenate([poses.quat_xyzw for _, poses in parts]),
        ),
    )


def poses_in(
    frames: RecordedFrames,
    target: str,
    source: str,
    from_ns: int,
    to_ns: int,
    rate_hz: float | None = None,
) -> Iterator[tuple[Ints, TransformArray]]:
    """The poses that could be looked up from one log time to another, part by part: stamps (N,) and
    poses. Raises TfbusError where there is none.
    """
    poses = _Poses(frames, target, source, rate_hz)
    frames.seek(from_ns)
    if from_ns > frames.start_ns:
        poses.skip()
    due_ns = from_ns + _PART_NS
    has_any = False
    found: list[tuple[Ints, TransformArray]] = []
    frames.before_loss = lambda: found.extend(poses.new())
    for item in frames.play(to_ns):
        if item.log_ns >= due_ns:
            due_ns = item.log_ns + _PART_NS
            found += poses.new()
        has_any |= bool(found)
        yield from found
        found.clear()
    for part in poses.new():
        has_any = True
        yield part
    if not has_any:
        with _explained(frames):
            frames.buffer.lookup_transform(target, source)
        raise TfbusError(
            f"no pose of {source!r} in {target!r} in that span: {_why_none(frames, from_ns, to_ns)}"
        )


def _why_none(frames: RecordedFrames, from_ns: int, to_ns: int) -> str:
    pauses = [each for each in frames.pauses if each.from_ns < to_ns and each.to_ns > from_ns]
    if pauses:
        return frames.said(pauses[0])
    return "nothing came of the frames between"


class _Poses:
    """The poses of a pair that are new since the last look."""

    def __init__(
        self, frames: RecordedFrames, target: str, source: str, rate_hz: float | None
    ) -> None:
        self._frames, self._target, self._source = frames, target, source
        self._step_ns = None if rate_hz is None else max(round(S / rate_hz), 1)
        self._last_ns: int | None = None
        self._jumps = 0
        self._is_static = False

    def skip(self) -> None:
        """What is there now is not new; a rate begins now."""
        if self._step_ns is not None:
            self._last_ns = self._frames.now_ns() - self._step_ns
            return
        try:
            self._last_ns = self._frames.buffer.latest_common_time(self._target, self._source)
        except TransformException:
            self._last_ns = self._frames.now_ns()

    def new(self) -> Iterator[tuple[Ints, TransformArray]]:
        """The new ones, none or some."""
        buffer = self._frames.buffer
        if self._frames.jumps > self._jumps:
            # A simulated clock was set back: what follows comes from then on.
            self._jumps = self._frames.jumps
            self._last_ns = self._frames.jumped_to_ns
        try:
            newest_ns = buffer.latest_common_time(self._target, self._source)
            if newest_ns is None:
                yield from self._static()
                return
            stamps = self._stamps(newest_ns)
            poses, known = buffer.lookup_known_transforms(self._target, self._source, stamps)
        except TransformException:
            return
        stamps = stamps[known]
        if len(stamps):
            self._last_ns = int(stamps[-1])
            yield stamps, poses[known]

    def _static(self) -> Iterator[tuple[Ints, TransformArray]]:
        """A path without a dynamic edge: one pose."""
        if not self._is_static:
            self._is_static = True
            stamps = np.zeros(1, dtype=np.int64)
            yield stamps, self._frames.buffer.lookup_transforms(self._target, self._source, stamps)

    def _stamps(self, newest_ns: int) -> Ints:
        buffer, last_ns = self._frames.buffer, self._last_ns
        path = buffer.path(self._target, self._source)
        infos = map(buffer.frame, path)
        dynamic = next(info.name for info in infos if info.parent in path and not info.static)
        stamps = buffer.samples(dynamic).stamps_ns
        if self._step_ns is not None and len(stamps):
            first_ns = int(stamps[0]) if last_ns is None else last_ns + self._step_ns
            check_count((newest_ns - first_ns) // self._step_ns)
            return np.arange(first_ns, newest_ns + 1, self._step_ns, dtype=np.int64)
        # The buffer answers none beyond the newest common time.
        return stamps if last_ns is None else stamps[stamps > last_ns]
