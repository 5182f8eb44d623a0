"""The buffer: the last seconds of every frame, and the transform between any two at any time."""

import asyncio
import threading
import time
from bisect import bisect_left, bisect_right
from collections import Counter
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tfbus.batch import TransformBatch
from tfbus.errors import (
    ConnectivityException,
    ExtrapolationException,
    FutureExtrapolationException,
    InvalidArgumentException,
    LookupException,
    LoopException,
    NoDataException,
    PastExtrapolationException,
    SingleSampleException,
    TimeoutException,
    TransformException,
)
from tfbus.frame import FrameInfo as FrameInfo
from tfbus.transform import Transform, TransformStamped, check_frame_id, check_stamp

NS_PER_S = 1_000_000_000


class _Edge:
    """The samples of one child frame, sorted by stamp."""

    def __init__(self, parent: str, *, static: bool) -> None:
        self.parent = parent
        self.static = static
        self.authority = ""
        self.conflicts = 0
        self.stamps: list[int] = []
        self.poses: list[Transform] = []
        self.parents: list[str] = []

    def insert(self, ts: TransformStamped, cache_ns: int) -> bool:
        stamp = ts.stamp_ns
        if self.static:
            self.stamps, self.poses, self.parents = [stamp], [ts.transform], [ts.frame_id]
            self.parent = ts.frame_id
            return True
        if self.stamps and stamp < self.stamps[-1] - cache_ns:
            return False
        at = bisect_left(self.stamps, stamp)
        if at < len(self.stamps) and self.stamps[at] == stamp:
            if self.poses[at] != ts.transform or self.parents[at] != ts.frame_id:
                self.conflicts += 1
            self.poses[at], self.parents[at] = ts.transform, ts.frame_id
        else:
            self.stamps.insert(at, stamp)
            self.poses.insert(at, ts.transform)
            self.parents.insert(at, ts.frame_id)
        self.parent = self.parents[-1]
        expired = bisect_left(self.stamps, self.stamps[-1] - cache_ns)
        del self.stamps[:expired], self.poses[:expired], self.parents[:expired]
        return True


class Buffer:
    """Transforms of the last `cache_time_s` seconds, assembled into a tree of frames.

    Safe from any thread. A lookup with a timeout waits on a condition until data arrives.
    """

    def __init__(self, cache_time_s: float = 10.0) -> None:
        self.cache_time_s = cache_time_s
        self.rejected: Counter[str] = Counter()
        self._cache_ns = round(cache_time_s * NS_PER_S)
        self._edges: dict[str, _Edge] = {}
        self._names: dict[str, None] = {}
        self._changed = threading.Condition()
        self._watchers: set[Callable[[], None]] = set()

    # Filling it

    def set_transform(
        self, ts: TransformStamped, *, static: bool = False, authority: str = ""
    ) -> bool:
        """Store one transform; False where it is older than the cache and was not kept.

        Raises InvalidArgumentException where both frames are one, LoopException where the edge
        would close a loop.
        """
        with self._changed:
            kept = self._insert(ts, static, authority)
            self._tell()
        return kept

    def set_transforms(
        self, batch: TransformBatch, *, static: bool = False, authority: str = ""
    ) -> int:
        """Store the rows of a batch; the number that were kept.

        A row that cannot be right costs only itself: it is counted in `rejected`, by its reason.
        """
        kept = 0
        with self._changed:
            for row in range(len(batch)):
                try:
                    kept += self._insert(_row(batch, row), static, authority)
                except InvalidArgumentException as error:
                    self.rejected[str(error)] += 1
            self._tell()
        return kept

    def clear(self) -> None:
        """Forget all dynamic transforms; static ones stay."""
        with self._changed:
            self._edges = {child: edge for child, edge in self._edges.items() if edge.static}
            self._names = {}
            for child, edge in self._edges.items():
                self._names |= {edge.parent: None, child: None}

    def remove(self, frame: str) -> None:
        """Forget a frame with its history, and its place as a parent.

        Raises LookupException where it is not known.
        """
        with self._changed:
            self._check_known(frame)
            self._edges.pop(frame, None)
            for child in [c for c, edge in self._edges.items() if edge.parent == frame]:
                del self._edges[child]
            del self._names[frame]

    def _insert(self, ts: TransformStamped, static: bool, authority: str) -> bool:
        parent, child = ts.frame_id, ts.child_frame_id
        if parent == child:
            raise InvalidArgumentException(
                f"frame {child!r} cannot be its own parent; frame_id and child_frame_id differ"
            )
        edge = self._edges.get(child)
        if edge is None or edge.parent != parent:
            self._refuse_loop(parent, child, authority)
        if edge is None:
            edge = self._edges[child] = _Edge(parent, static=static)
            self._names |= {parent: None, child: None}
        edge.static = static
        self._names.setdefault(parent)
        kept = edge.insert(ts, self._cache_ns)
        if kept:
            edge.authority = authority
        return kept

    def _refuse_loop(self, parent: str, child: str, authority: str) -> None:
        chain = self._ancestors(parent)
        if child in chain:
            path = tuple(chain[: chain.index(child) + 1])
            other = self._edges[parent].authority
            raise LoopException(
                f"{parent!r} -> {child!r}, sent by {authority!r}, would close a loop: "
                f"{' -> '.join(reversed(path))} is known already, sent by {other!r}; "
                "one of the two is to stop",
                path=path,
                authority=authority,
                other_authority=other,
            )

    # Asking it

    def lookup_transform(
        self,
        target_frame: str,
        source_frame: str,
        stamp_ns: int | None = None,
        *,
        timeout_s: float = 0.0,
    ) -> TransformStamped:
        """The transform that takes data of `source_frame` into `target_frame`.

        So: the pose of the source seen from the target. `stamp_ns` None is the latest time at
        which the whole path is known. With a timeout it waits that long for data to come.
        Raises LookupException, ConnectivityException, ExtrapolationException, or
        TimeoutException after waiting.
        """
        return self._wait(lambda: self._lookup(target_frame, source_frame, stamp_ns), timeout_s)

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
        """The source as it was at one time, seen from the target at another.

        `fixed_frame` does not move between the two times. The answer has the target's stamp.
        """

        def travel() -> TransformStamped:
            back = self._lookup(fixed_frame, source_frame, source_stamp_ns)
            there = self._lookup(target_frame, fixed_frame, target_stamp_ns)
            return TransformStamped(
                there.stamp_ns, target_frame, source_frame, there.transform @ back.transform
            )

        return self._wait(travel, timeout_s)

    def lookup_transforms(
        self, target_frame: str, source_frame: str, stamps_ns: ArrayLike
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The transform at each of N stamps: translations (N, 3), quaternions (N, 4)."""
        stamps = np.asarray(stamps_ns, dtype=np.int64)
        with self._changed:
            found = [
                self._lookup(target_frame, source_frame, stamp).transform
                for stamp in stamps.tolist()
            ]
        xyz = np.array([t.xyz for t in found]).reshape(-1, 3)
        return xyz, np.array([t.quat_xyzw for t in found]).reshape(-1, 4)

    def can_transform(
        self,
        target_frame: str,
        source_frame: str,
        stamp_ns: int | None = None,
        *,
        timeout_s: float = 0.0,
    ) -> bool:
        """Whether `lookup_transform` with the same arguments would answer."""
        try:
            self.lookup_transform(target_frame, source_frame, stamp_ns, timeout_s=timeout_s)
        except InvalidArgumentException:
            raise
        except TransformException:
            return False
        return True

    async def wait_for_transform(
        self,
        target_frame: str,
        source_frame: str,
        stamp_ns: int | None = None,
        *,
        timeout_s: float | None = None,
    ) -> TransformStamped:
        """`lookup_transform` for asyncio: await until the answer is there.

        Raises TimeoutException after `timeout_s`; None waits for ever. It can be cancelled.
        """
        loop = asyncio.get_running_loop()
        changed = asyncio.Event()

        def tell() -> None:
            loop.call_soon_threadsafe(changed.set)

        deadline = None if timeout_s is None else loop.time() + timeout_s
        self._watchers.add(tell)
        try:
            while True:
                changed.clear()
                try:
                    with self._changed:
                        return self._lookup(target_frame, source_frame, stamp_ns)
                except (PastExtrapolationException, InvalidArgumentException):
                    raise
                except TransformException as error:
                    reason = error
                left = None if deadline is None else deadline - loop.time()
                try:
                    await asyncio.wait_for(changed.wait(), left)
                except TimeoutError:
                    raise _timed_out(timeout_s or 0.0, reason) from reason
        finally:
            self._watchers.discard(tell)

    def latest_common_time(self, target_frame: str, source_frame: str) -> int | None:
        """The newest stamp at which the whole path is known; None where all of it is static."""
        with self._changed:
            up, down = self._path(target_frame, source_frame)
            return self._latest(up + down)

    def _lookup(self, target: str, source: str, stamp_ns: int | None) -> TransformStamped:
        up, down = self._path(target, source)
        if stamp_ns is None:
            stamp_ns = self._latest(up + down) or 0
        stamp_ns = check_stamp(stamp_ns)
        return TransformStamped(
            stamp_ns,
            target,
            source,
            self._compose(down, stamp_ns).inverse() @ self._compose(up, stamp_ns),
        )

    def _path(self, target: str, source: str) -> tuple[list[str], list[str]]:
        """The frames below the common ancestor: up from the source, up from the target."""
        for what, frame in (("target_frame", target), ("source_frame", source)):
            check_frame_id(frame, what)
            self._check_known(frame)
        above_source, above_target = self._ancestors(source), self._ancestors(target)
        below = set(above_target)
        common = next((frame for frame in above_source if frame in below), None)
        if common is None:
            raise ConnectivityException(
                f"{target!r} and {source!r} are not connected: the one is in the tree of "
                f"{above_target[-1]!r}, the other in that of {above_source[-1]!r}",
                target_frame=target,
                source_frame=source,
                target_root=above_target[-1],
                source_root=above_source[-1],
            )
        return (
            above_source[: above_source.index(common)],
            above_target[: above_target.index(common)],
        )

    def _ancestors(self, frame: str) -> list[str]:
        chain = [frame]
        while chain[-1] in self._edges:
            chain.append(self._edges[chain[-1]].parent)
        return chain

    def _latest(self, frames: list[str]) -> int | None:
        newest = [self._edges[f].stamps[-1] for f in frames if not self._edges[f].static]
        return min(newest, default=None)

    def _compose(self, chain: list[str], stamp_ns: int) -> Transform:
        whole = Transform.identity()
        for child in chain:
            whole = self._sample(child, stamp_ns) @ whole
        return whole

    def _sample(self, child: str, stamp_ns: int) -> Transform:
        edge = self._edges[child]
        stamps, poses = edge.stamps, edge.poses
        if edge.static:
            return poses[-1]
        after = bisect_right(stamps, stamp_ns)
        if after and stamps[after - 1] == stamp_ns:
            return poses[after - 1]
        if after == 0 or after == len(stamps):
            raise self._no_data(child, edge, stamp_ns)
        before = after - 1
        if edge.parents[before] != edge.parents[after]:
            return poses[before]
        ratio = (stamp_ns - stamps[before]) / (stamps[after] - stamps[before])
        return poses[before].interpolate(poses[after], ratio)

    def _no_data(self, child: str, edge: _Edge, stamp_ns: int) -> ExtrapolationException:
        oldest, newest = edge.stamps[0], edge.stamps[-1]
        kind: type[ExtrapolationException]
        if not edge.stamps:
            kind, what = NoDataException, "there is no sample of it"
        elif len(edge.stamps) == 1:
            kind, what = SingleSampleException, f"its only sample is of {newest} ns"
        elif stamp_ns < oldest:
            kind = PastExtrapolationException
            what = f"its oldest sample is {(oldest - stamp_ns) / 1e9:g} s later"
        else:
            kind = FutureExtrapolationException
            what = f"its newest sample is {(stamp_ns - newest) / 1e9:g} s earlier"
        return kind(
            f"no data of {edge.parent!r} -> {child!r} (sent by {edge.authority!r}) at "
            f"{stamp_ns} ns: {what}",
            frame_id=edge.parent,
            child_frame_id=child,
            requested_ns=stamp_ns,
            oldest_ns=oldest,
            newest_ns=newest,
            authority=edge.authority,
        )

    # What it holds

    def frames(self) -> list[str]:
        """The names of all frames, sorted."""
        with self._changed:
            return sorted(self._names)

    def frame(self, name: str) -> FrameInfo:
        """What is known about one frame. Raises LookupException where it is unknown."""
        with self._changed:
            self._check_known(name)
            children = tuple(c for c, e in self._edges.items() if e.parent == name)
            edge = self._edges.get(name)
            if edge is None:
                return FrameInfo(name, children=children)
            oldest, newest = edge.stamps[0], edge.stamps[-1]
            moving = not edge.static and newest > oldest
            return FrameInfo(
                name,
                edge.parent,
                children,
                edge.static,
                len(edge.stamps),
                (len(edge.stamps) - 1) * 1e9 / (newest - oldest) if moving else None,
                oldest,
                newest,
                edge.authority,
                edge.conflicts,
            )

    def _check_known(self, frame: str) -> None:
        if frame not in self._names:
            raise LookupException(f"there is no frame {frame!r}", frame=frame)

    # Waiting

    def _wait(self, attempt: Callable[[], TransformStamped], timeout_s: float) -> TransformStamped:
        deadline = time.monotonic() + timeout_s
        with self._changed:
            while True:
                try:
                    return attempt()
                except (PastExtrapolationException, InvalidArgumentException):
                    raise
                except TransformException as error:
                    if timeout_s <= 0.0:
                        raise
                    if not self._changed.wait(max(0.0, deadline - time.monotonic())):
                        raise _timed_out(timeout_s, error) from error

    def _tell(self) -> None:
        self._changed.notify_all()
        for tell in tuple(self._watchers):
            tell()


def _timed_out(timeout_s: float, reason: TransformException) -> TimeoutException:
    return TimeoutException(f"waited {timeout_s:g} s: {reason}", reason=reason)


def _row(batch: TransformBatch, row: int) -> TransformStamped:
    parent, child = batch.edges[row].tolist()
    return TransformStamped(
        int(batch.stamps_ns[row]),
        batch.frames[parent],
        batch.frames[child],
        Transform(batch.poses[row, :3], batch.poses[row, 3:]),
    )
