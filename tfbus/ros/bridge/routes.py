"""Rows of transforms on their way to the other side: which go, under which names, and how often."""

import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from tfbus.base import lazy_numpy as np
from tfbus.base import scheduler
from tfbus.base.clock import Timer
from tfbus.base.executor import Executor
from tfbus.geometry import packed
from tfbus.geometry.columns import Columns, rows_of
from tfbus.geometry.kernel import QUATERNION_TOLERANCE
from tfbus.geometry.packed import EDGE_SIZE, ONE_EDGE, POSE_SIZE, STAMP_SIZE

# Frames come from the network: routes of at most this many tables of frames are kept.
_MOST_TABLES = 1000


@dataclass(frozen=True, slots=True)
class Route:
    """The names that frames get, and which rows go, None for all. The frames of `contested` rows
    go both ways: each row of theirs is looked at. `children` are the frames that go, by their
    names on the bus.
    """

    frames: tuple[str, ...]
    rows: Sequence[int] | None
    children: Sequence[str]
    contested: bool = False

    def renamed(self, rows: Columns) -> Columns:
        """The rows that go, with their names there."""
        if self.rows is not None:
            rows = chosen(rows, self.rows)
        return rows if rows.frames is self.frames else rows.with_frames(self.frames)


class Routes:
    """The routes of messages by their frames and edges; `make(rows)` finds a new one. Used by one
    thread at a time, but for `forget`.
    """

    def __init__(self, make: Callable[[Columns], Route]) -> None:
        self._make = make
        self._routes: dict[tuple[tuple[str, ...], bytes], Route] = {}

    def of(self, rows: Columns) -> Route:
        """The route of these rows."""
        table = rows.frames, rows.edges_bytes()
        routes = self._routes
        route = routes.get(table)
        if route is None:
            route = self._make(rows)
            if len(routes) >= _MOST_TABLES:
                routes.clear()
            routes[table] = route
        return route

    def of_one(self, frames: tuple[str, ...]) -> Route | None:
        """The route of one row alone, from the first of two frames to the second, if it is known
        already.
        """
        return self._routes.get((frames, ONE_EDGE))

    def forget(self) -> None:
        """Their conditions have changed."""
        # Another one: a route that is found at this moment is of the past.
        self._routes = {}


def chosen(rows: Columns, which: Sequence[int]) -> Columns:
    """Some of the rows."""
    return Columns.of_bytes(
        rows.frames,
        rows_of(rows.edges, rows.edges_at, EDGE_SIZE, which),
        rows_of(rows.stamps, rows.stamps_at, STAMP_SIZE, which),
        rows_of(rows.poses, rows.poses_at, POSE_SIZE, which),
    )


def route(rows: Columns, names: tuple[str, ...], kept: list[int]) -> Route:
    """The route if the frames get these names, and the rows at these indices go."""
    frames = rows.frames
    pairs = rows.pairs()
    return Route(
        frames if names == frames else names,
        None if len(kept) == len(pairs) else kept,
        [frames[pairs[at][1]] for at in kept],
    )


# Frames come from the network: at most this many are remembered.
_MOST_FRAMES = 100_000


class RateLimit:
    """Passes rows on to `send(rows)`, of each child frame one in `1 / rate_hz` seconds at most.

    A transform that comes too soon goes at the end of that time, unless a newer one has come. Safe
    from any thread; `send` is called by that of `pass_on` or the executor's.
    """

    def __init__(
        self,
        rate_hz: float,
        send: Callable[[Columns], object],
        executor: Executor,
    ) -> None:
        self._period_s = 1.0 / rate_hz
        self._send = send
        self._lock = threading.Lock()
        self._free_s: dict[str, float] = {}
        self._waiting: dict[str, tuple[Columns, int]] = {}
        self._executor = executor
        # While something waits.
        self._timer: Timer | None = None
        self._is_closed = False

    def pass_on(self, rows: Columns) -> None:
        """Pass on the rows that may go now."""
        now_s, frames = scheduler.monotonic(), rows.frames
        with self._lock:
            if len(self._free_s) > _MOST_FRAMES:
                self._free_s.clear()
            ready: dict[str, int] = {}
            for at, (_, child) in enumerate(rows.pairs()):
                if now_s < self._free_s.get(frames[child], now_s):
                    self._waiting[frames[child]] = rows, at
                else:
                    ready[frames[child]] = at
            self._record_passed(ready, now_s)
            if self._waiting and self._timer is None and not self._is_closed:
                # Often enough that one which waits goes soon after its time.
                self._timer = self._executor.every(self._period_s / 2, self.flush)
        if ready:
            self._send(chosen(rows, [*ready.values()]))

    def flush(self) -> None:
        """Pass on the rows that have waited long enough."""
        now_s = scheduler.monotonic()
        with self._lock:
            ready = {
                child: row
                for child, row in self._waiting.items()
                if now_s >= self._free_s.get(child, now_s)
            }
            self._record_passed(ready, now_s)
            if not self._waiting:
                self._stop()
        of: dict[int, tuple[Columns, list[int]]] = {}
        for rows, at in ready.values():
            of.setdefault(id(rows), (rows, []))[1].append(at)
        for rows, which in of.values():
            self._send(chosen(rows, which))

    def close(self) -> None:
        """Pass on nothing more. Twice is fine."""
        with self._lock:
            self._is_closed = True
            self._waiting.clear()
            self._stop()

    def _stop(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _record_passed(
        self, children: "dict[str, int] | dict[str, tuple[Columns, int]]", now_s: float
    ) -> None:
        for child in children:
            self._free_s[child] = now_s + self._period_s
            self._waiting.pop(child, None)


# Below this number of rows Python is faster than numpy.
_FEW = 4


def invalid_rows(rows: Columns) -> Sequence[int]:
    """The rows with a number that is not finite, or a quaternion whose norm is not 1."""
    if rows.count < _FEW:
        return [at for at in range(rows.count) if not is_pose(rows.poses, _place(rows, at))]
    poses = np.frombuffer(rows.poses, np.float64, 7 * rows.count, rows.poses_at).reshape(-1, 7)
    turned = poses[:, 3:]
    off = np.abs(np.einsum("ij,ij->i", turned, turned) - 1.0)
    # NaN is not below anything, and neither is a sum with one.
    if off.max() < QUATERNION_TOLERANCE and math.isfinite(poses.sum()):
        return ()
    is_valid = (off < QUATERNION_TOLERANCE) & np.isfinite(poses).all(axis=1)
    found: list[int] = np.flatnonzero(~is_valid).tolist()
    return found


def is_pose(data: bytes, at: int = 0) -> bool:
    """Whether a buffer would store the pose at this place, in the byte order of this machine."""
    x, y, z, qx, qy, qz, qw = packed.pose_at(data, at)
    off = abs(qx * qx + qy * qy + qz * qz + qw * qw - 1.0)
    return off < QUATERNION_TOLERANCE and math.isfinite(x + y + z)


def _place(rows: Columns, at: int) -> int:
    return rows.poses_at + POSE_SIZE * at
