"""The buffer: assembles the tree of frames in time, and answers where one is seen from another."""

import asyncio
import difflib
import math
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from tfbus.batch import TransformBatch
from tfbus.errors import (
    ConnectivityException,
    ExtrapolationException,
    FutureExtrapolationException,
    InvalidArgumentException,
    LookupException,
    NoDataException,
    SingleSampleException,
    TimeoutException,
    TransformException,
)
from tfbus.history import History, Sample
from tfbus.pose import Pose, compose, invert, unit_quaternion
from tfbus.transform import Transform, TransformStamped

T = TypeVar("T")

_IDENTITY: Pose = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True)
class FrameInfo:
    """What a buffer knows of one frame.

    `parent` is None for a root; `rate_hz` is None where there are fewer than two samples;
    the stamps are None where there are none.
    """

    name: str
    parent: str | None
    static: bool
    authority: str
    samples: int
    oldest_ns: int | None
    newest_ns: int | None
    rate_hz: float | None


class Buffer:
    """The transforms of the last `cache_time_s` seconds, by their own stamps; safe from any thread.

    What is set becomes an edge from parent to child; a lookup follows the edges between two
    frames, at one time. Semantics are tf2's; docs/porting.md lists the differences.
    """

    def __init__(self, cache_time_s: float = 10.0):
        self.cache_time_s = cache_time_s
        self.rejected: Counter[str] = Counter()
        self._cache_time_ns = round(cache_time_s * 1e9)
        self._histories: dict[str, History] = {}
        self._roots: dict[str, None] = {}
        self._changed = threading.Condition()
        self._waiters: set[tuple[asyncio.AbstractEventLoop, asyncio.Event]] = set()

    # Setting

    def set_transform(
        self, transform: TransformStamped, *, static: bool = False, authority: str = ""
    ) -> bool:
        """Take one transform; a static one holds at all times.

        False where it is older than the newest of its child frame by more than the cache time.
        Raises InvalidArgumentException for a frame name that cannot be, a parent that is its own
        child, or an edge that would close a loop; then nothing has changed.
        """
        with self._changed:
            taken = self._insert(
                transform.stamp_ns,
                transform.frame_id,
                transform.child_frame_id,
                transform.transform.as_pose(),
                static,
                authority,
            )
            self._wake()
            return taken

    def set_transforms(
        self, batch: TransformBatch, *, static: bool = False, authority: str = ""
    ) -> int:
        """Take a batch in one call; the number that was taken.

        One that cannot be taken harms none of the others: it is counted in `rejected`, by its
        reason.
        """
        taken = 0
        rows = zip(
            batch.edges.tolist(), batch.stamps_ns.tolist(), batch.poses.tolist(), strict=True
        )
        with self._changed:
            for (parent, child), stamp_ns, pose in rows:
                try:
                    taken += self._insert(
                        stamp_ns,
                        batch.frames[parent],
                        batch.frames[child],
                        _checked_pose(pose),
                        static,
                        authority,
                    )
                except InvalidArgumentException as error:
                    self.rejected[str(error)] += 1
            self._wake()
        return taken

    def clear(self) -> None:
        """Forget what holds only at a time; static transforms stay."""
        with self._changed:
            for history in self._histories.values():
                history.forget_samples()
            self._wake()

    def remove(self, frame: str) -> None:
        """Forget all about a frame's place in its parent, static or not."""
        with self._changed:
            self._histories.pop(frame, None)
            self._roots.pop(frame, None)
            self._wake()

    # Looking up

    def lookup_transform(
        self,
        target_frame: str,
        source_frame: str,
        stamp_ns: int | None = None,
        *,
        timeout_s: float = 0.0,
    ) -> TransformStamped:
        """The transform that takes data in `source_frame` into `target_frame`, which is the pose
        of the source seen from the target, at the stamp; None is the latest time at which every
        edge between the two is known.

        It waits for at most `timeout_s` seconds for what may still come. Raises
        InvalidArgumentException for a name that cannot be, LookupException for one that is not
        known, ConnectivityException where no path joins them, and a kind of
        ExtrapolationException where the time is outside of what is known.
        """
        return self._wait_for(lambda: self._lookup(target_frame, source_frame, stamp_ns), timeout_s)

    def lookup_transform_full(
        self,
        target_frame: str,
        target_stamp_ns: int | None,
        source_frame: str,
        source_stamp_ns: int | None,
        fixed_frame: str,
        *,
        timeout_s: float = 0.0,
    ) -> TransformStamped:
        """The transform that takes data in `source_frame` at the source's stamp into
        `target_frame` at the target's, both seen from a frame that is fixed in between.

        Waits and raises as `lookup_transform`.
        """

        def lookup() -> TransformStamped:
            early = self._lookup(fixed_frame, source_frame, source_stamp_ns)
            late = self._lookup(target_frame, fixed_frame, target_stamp_ns)
            return TransformStamped(
                late.stamp_ns, target_frame, source_frame, late.transform @ early.transform
            )

        return self._wait_for(lookup, timeout_s)

    def lookup_transforms(
        self, target_frame: str, source_frame: str, stamps_ns: Sequence[int] | NDArray[np.int64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The transforms at N stamps: xyz (N,3) in metres and quat_xyzw (N,4).

        Raises as `lookup_transform`, where any of the stamps cannot be answered.
        """
        with self._changed:
            poses = [
                self._lookup(target_frame, source_frame, int(stamp)).transform.as_pose()
                for stamp in stamps_ns
            ]
        columns = np.array(poses, np.float64).reshape(-1, 7)
        return columns[:, :3], columns[:, 3:]

    def can_transform(
        self,
        target_frame: str,
        source_frame: str,
        stamp_ns: int | None = None,
        *,
        timeout_s: float = 0.0,
    ) -> bool:
        """Whether `lookup_transform` with the same arguments answers."""
        try:
            self.lookup_transform(target_frame, source_frame, stamp_ns, timeout_s=timeout_s)
        except TransformException:
            return False
        return True

    def latest_common_time(self, target_frame: str, source_frame: str) -> int | None:
        """The latest stamp at which every edge between the two frames is known; None where all
        of them are static. Raises as `lookup_transform`.
        """
        with self._changed:
            self._check_known(target_frame, source_frame)
            return self._latest_common_time(target_frame, source_frame)

    async def wait_for_transform(
        self,
        target_frame: str,
        source_frame: str,
        stamp_ns: int | None = None,
        *,
        timeout_s: float | None = None,
    ) -> TransformStamped:
        """The answer of `lookup_transform` as soon as there is one.

        Raises TimeoutException after `timeout_s` (None: never), with the last reason as its
        cause, and at once what waiting cannot mend.
        """
        loop, event = asyncio.get_running_loop(), asyncio.Event()
        waiter = (loop, event)
        with self._changed:
            self._waiters.add(waiter)
        try:
            async with asyncio.timeout(timeout_s):
                while True:
                    event.clear()
                    try:
                        with self._changed:
                            return self._lookup(target_frame, source_frame, stamp_ns)
                    except TransformException as error:
                        if not may_come(error):
                            raise
                        reason = error
                    await event.wait()
        except TimeoutError:
            raise TimeoutException(
                f"not there within {timeout_s:g} s: {reason}", reason=reason
            ) from reason
        finally:
            with self._changed:
                self._waiters.discard(waiter)

    # Looking around

    def frames(self) -> list[str]:
        """The names of all known frames, sorted."""
        with self._changed:
            return sorted({*self._histories, *self._roots})

    def frame(self, name: str) -> FrameInfo:
        """What is known of one frame. Raises LookupException where it is not known."""
        with self._changed:
            self._check_known(name)
            history = self._histories.get(name) or History(name)
            stamps = history.stamps
            span_s = (stamps[-1] - stamps[0]) / 1e9 if stamps else 0.0
            return FrameInfo(
                name=name,
                parent=history.parent(),
                static=history.is_static,
                authority=history.authority,
                samples=len(stamps),
                oldest_ns=stamps[0] if stamps else None,
                newest_ns=stamps[-1] if stamps else None,
                rate_hz=(len(stamps) - 1) / span_s if span_s else None,
            )

    # The rest is called with the lock held

    def _insert(
        self, stamp_ns: int, parent: str, child: str, pose: Pose, static: bool, authority: str
    ) -> bool:
        _check_name(parent, "frame_id")
        _check_name(child, "child_frame_id")
        if parent == child:
            raise InvalidArgumentException(f"frame {child!r} cannot be its own parent")
        self._refuse_loop(parent, child, authority)
        history = self._histories.get(child)
        if history is None:
            history = self._histories[child] = History(child)
        history.authority = authority
        self._roots.setdefault(parent)
        sample = Sample(parent, pose)
        if static:
            history.set_static(sample)
            return True
        return history.insert(stamp_ns, sample, self._cache_time_ns)

    def _refuse_loop(self, parent: str, child: str, authority: str) -> None:
        known = self._histories.get(child)
        if known is not None and known.parent() == parent:
            return
        for ancestor, history in self._ancestors(parent):
            if ancestor == child:
                other = history.authority if history else ""
                raise InvalidArgumentException(
                    f"{parent!r} -> {child!r} from {authority or 'here'} would close a loop: "
                    f"{parent!r} hangs below {child!r} already (published by {other or 'here'})"
                )

    def _ancestors(self, frame: str) -> Iterator[tuple[str, History | None]]:
        """The frame and those above it, each with the history of the one just below it."""
        below: History | None = None
        at: str | None = frame
        while at is not None:
            yield at, below
            below = self._histories.get(at)
            at = below.parent() if below else None

    def _lookup(self, target: str, source: str, stamp_ns: int | None) -> TransformStamped:
        self._check_known(target, source)
        if stamp_ns is None:
            stamp_ns = self._latest_common_time(target, source) or 0
        pose = self._compose(target, source, stamp_ns)
        return TransformStamped(stamp_ns, target, source, Transform._trusted(pose))

    def _compose(self, target: str, source: str, stamp_ns: int) -> Pose:
        """Walk up from both frames until the walks meet, at the lowest common ancestor."""
        source_poses = dict(self._walk(source, stamp_ns))
        for frame, pose in self._walk(target, stamp_ns):
            if frame in source_poses:
                return compose(invert(pose), source_poses[frame])
        raise self._why_not(target, source, stamp_ns)

    def _walk(self, frame: str, stamp_ns: int) -> Iterator[tuple[str, Pose]]:
        """The frame and those above it at that time, each with the pose of the first in it; it
        ends early at an edge that is not known then.
        """
        pose = _IDENTITY
        while True:
            yield frame, pose
            history = self._histories.get(frame)
            if history is None:
                return
            try:
                sample = history.at(stamp_ns)
            except ExtrapolationException:
                return
            pose = compose(sample.pose, pose)
            frame = sample.parent

    def _why_not(self, target: str, source: str, stamp_ns: int) -> TransformException:
        for history in self._path(target, source):
            try:
                history.at(stamp_ns)
            except ExtrapolationException as error:
                return error
        return self._unconnected(target, source)

    def _path(self, target: str, source: str) -> list[History]:
        """The edges between the frames as the tree is now. Raises ConnectivityException."""
        sources = [frame for frame, _ in self._ancestors(source)]
        targets = [frame for frame, _ in self._ancestors(target)]
        common = set(sources) & set(targets)
        if not common:
            raise self._unconnected(target, source)
        below = [
            frame
            for walk in (sources, targets)
            for frame in walk[: next(i for i, f in enumerate(walk) if f in common)]
        ]
        return [self._histories[frame] for frame in below]

    def _latest_common_time(self, target: str, source: str) -> int | None:
        path = self._path(target, source)
        latest = [history.latest() for history in path if not history.is_static]
        return min((entry[0] for entry in latest if entry), default=None)

    def _unconnected(self, target: str, source: str) -> ConnectivityException:
        target_root = [frame for frame, _ in self._ancestors(target)][-1]
        source_root = [frame for frame, _ in self._ancestors(source)][-1]
        return ConnectivityException(
            f"{target!r} and {source!r} are not part of the same tree: "
            f"one hangs below {target_root!r}, the other below {source_root!r}",
            target_root=target_root,
            source_root=source_root,
        )

    def _check_known(self, *frames: str) -> None:
        for frame in frames:
            _check_name(frame, "frame")
            if frame not in self._histories and frame not in self._roots:
                raise self._unknown(frame)

    def _unknown(self, frame: str) -> LookupException:
        known = sorted({*self._histories, *self._roots})
        nearest = tuple(difflib.get_close_matches(frame, known, n=3))
        if nearest:
            hint = f"; the nearest names are {', '.join(nearest)}"
        elif known:
            shown = ", ".join(known[:10]) + (" ..." if len(known) > 10 else "")
            hint = f"; there are {shown}"
        else:
            hint = "; no frame is known so far"
        return LookupException(
            f"frame {frame!r} does not exist{hint}", frame=frame, nearest=nearest
        )

    def _wait_for(self, lookup: Callable[[], T], timeout_s: float) -> T:
        deadline = time.monotonic() + timeout_s
        with self._changed:
            while True:
                try:
                    return lookup()
                except TransformException as error:
                    remaining_s = deadline - time.monotonic()
                    if remaining_s <= 0 or not may_come(error):
                        raise
                self._changed.wait(remaining_s)

    def _wake(self) -> None:
        self._changed.notify_all()
        for loop, event in self._waiters:
            loop.call_soon_threadsafe(event.set)


def may_come(error: TransformException) -> bool:
    """Whether what is missing may still arrive: a frame, a link or the future, not the past."""
    return isinstance(
        error,
        LookupException
        | ConnectivityException
        | FutureExtrapolationException
        | SingleSampleException
        | NoDataException,
    )


def _checked_pose(pose: Sequence[float]) -> Pose:
    x, y, z, qx, qy, qz, qw = pose
    if not all(map(math.isfinite, pose)):
        raise InvalidArgumentException("a number of the transform is not finite")
    return (x, y, z, *unit_quaternion(qx, qy, qz, qw))


def _check_name(name: Any, what: str) -> None:
    if not isinstance(name, str) or not name:
        raise InvalidArgumentException(f"{what} is a name, not {name!r}")
    if name.startswith("/"):
        raise InvalidArgumentException(
            f"{what} {name!r} begins with '/': frame names have no leading slash, "
            f"write {name.lstrip('/')!r}"
        )
