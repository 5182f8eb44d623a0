"""The poses of frames in the fixed frame, at one time."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tfbus.buffer.buffer import Buffer
from tfbus.errors import TransformException
from tfbus.geometry.transform import Transform
from tfbus.geometry.transform_array import TransformArray

Floats = NDArray[np.float64]

# Browsers draw with 32 bits: the squares of such distances are still numbers there.
_FARTHEST_M = 1e15
_TOO_FAR = "it is farther than 1e15 m away, which cannot be drawn"

# The most points of a trail per second.
TRAIL_RATE_HZ = 30.0


@dataclass(frozen=True, eq=False)
class Placed:
    """The poses of frames in the fixed frame: `xyz` (N, 3) in metres, `quat_wxyz` (N, 4).

    `missing` says of each frame without a pose why.
    """

    names: tuple[str, ...]
    xyz: Floats
    quat_wxyz: Floats
    missing: dict[str, str]

    @cached_property
    def index(self) -> dict[str, int]:
        """The row of each frame."""
        return {name: row for row, name in enumerate(self.names)}

    def without(self, names: Collection[str]) -> "Placed":
        """The same without these frames."""
        if not names:
            return self
        rows = [row for row, name in enumerate(self.names) if name not in names]
        kept = tuple(self.names[row] for row in rows)
        return Placed(kept, self.xyz[rows], self.quat_wxyz[rows], self.missing)

    def pose(self, row: int) -> Transform:
        """The pose of one frame in the fixed frame."""
        w, x, y, z = self.quat_wxyz[row].tolist()
        return Transform(self.xyz[row], (x, y, z, w))

    def extent_m(self) -> float:
        """The longest side of the box around all origins; 0 for fewer than two."""
        return float(np.ptp(self.xyz, axis=0).max()) if len(self.xyz) else 0.0


def place(buffer: Buffer, fixed_frame: str, names: Sequence[str], stamp_ns: int | None) -> Placed:
    """Place the frames at a time; None is the latest of each."""
    poses, missing = [], {}
    for name in names:
        try:
            # A buffer caches a limited number of paths to one target. Looked up the other way
            # round, each frame has its own: a third of the time for thousands of frames.
            poses.append(buffer.lookup_transform(name, fixed_frame, stamp_ns).transform.as_pose())
        except TransformException:
            missing[name] = _why(buffer, fixed_frame, name, stamp_ns)
    kept = tuple(name for name in names if name not in missing) if missing else tuple(names)
    seen_from = np.array(poses, np.float64).reshape(-1, 7)
    if not (near := _are_near(seen_from[:, :3])).all():
        missing |= dict.fromkeys(np.array(kept)[~near].tolist(), _TOO_FAR)
        kept, seen_from = tuple(np.array(kept)[near].tolist()), seen_from[near]
    placed = TransformArray(seen_from[:, :3], seen_from[:, 3:]).inverse()
    return Placed(kept, placed.xyz, placed.quat_wxyz, missing)


def _why(buffer: Buffer, fixed_frame: str, name: str, stamp_ns: int | None) -> str:
    try:
        buffer.lookup_transform(fixed_frame, name, stamp_ns)
    except TransformException as error:
        return str(error)
    return "it has only just arrived"


def arrow_rows(
    names: Sequence[str], parents: Mapping[str, str | None]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """The rows of the frames whose parents are among them, and the rows of these parents."""
    index = {name: row for row, name in enumerate(names)}
    pairs = [
        (row, index[parent])
        for row, name in enumerate(names)
        if (parent := parents.get(name)) is not None and parent in index
    ]
    children, above = np.array(pairs, np.intp).reshape(-1, 2).T
    return children, above


def arrow_points(
    xyz: Floats, children: NDArray[np.intp], parents: NDArray[np.intp]
) -> tuple[Floats, NDArray[np.bool_]]:
    """Arrows (N, 2, 3) from children to parents, and which of them to draw (N,).

    As in RViz, those of at most a millimetre are not drawn.
    """
    points = np.stack([xyz[children], xyz[parents]], axis=1)
    kept: NDArray[np.bool_] = np.linalg.norm(points[:, 0] - points[:, 1], axis=1) > 1e-3
    return points, kept


def trail(buffer: Buffer, fixed_frame: str, name: str, end_ns: int, length_s: float) -> Floats:
    """The positions of a frame in the `length_s` before `end_ns`: (N, 3) in metres, oldest first.

    Leaves out the times at which its pose is not known; empty for an unknown frame.
    """
    count = max(2, round(length_s * TRAIL_RATE_HZ) + 1)
    back_ns = np.linspace(length_s * 1e9, 0.0, count).astype(np.int64)
    try:
        found, known = buffer.lookup_known_transforms(fixed_frame, name, end_ns - back_ns)
    except TransformException:
        return np.zeros((0, 3))
    xyz = found.xyz[known]
    return xyz[_are_near(xyz)]


def _are_near(xyz: Floats) -> NDArray[np.bool_]:
    """Which of the points (N, 3) can be drawn. Two finite transforms may add up to infinity."""
    near: NDArray[np.bool_] = np.all(np.abs(xyz) <= _FARTHEST_M, axis=1)
    return near


def newest_common_ns(buffer: Buffer, fixed_frame: str, names: Iterable[str]) -> int | None:
    """The latest time at which all of these frames can be placed; None if all are static.

    Frames that cannot be placed at all do not count.
    """
    latest: list[int] = []
    for name in names:
        try:
            stamp_ns = buffer.latest_common_time(fixed_frame, name)
        except TransformException:
            continue
        if stamp_ns is not None:
            latest.append(stamp_ns)
    return min(latest, default=None)
