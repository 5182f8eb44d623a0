"""The frames as the page shows them: their states, and their poses in the fixed frame."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tfbus.base.errors import TransformException
from tfbus.buffer.buffer import Buffer
from tfbus.buffer.info import FrameInfo
from tfbus.frames.moment import BusMoment, Fault, State, stale_after_s
from tfbus.geometry.transform import Transform
from tfbus.geometry.transform_array import TransformArray

# A stale frame fades to this opacity, over twice the time after which it was stale.
FADED = 0.25

# The states that mean that something is wrong.
FAULTS: tuple[Fault, ...] = ("conflict", "gone", "stale", "ahead")


@dataclass(frozen=True)
class ViewFrame:
    """A frame as the page shows it.

    `silent_s` is for how long a stale frame has had no sample, `ahead_s` how far in the future the
    newest stamp is of one that is ahead, else 0; `opacity` is from FADED to
    1. `publishers` are the streams that send it, several in a conflict. `depth` is the number of
    frames above it. `unplaced` says why it cannot be drawn, "" if it can.
    """

    info: FrameInfo
    state: State
    silent_s: float
    opacity: float
    publishers: tuple[str, ...]
    root: str
    depth: int
    unplaced: str = ""
    ahead_s: float = 0.0

    @property
    def name(self) -> str:
        """The frame's name."""
        return self.info.name


class Frames:
    """The frames at one moment: whole trees, the largest first, parents before their children."""

    def __init__(self, frames: Iterable[ViewFrame] = ()) -> None:
        self.by_name = {frame.name: frame for frame in frames}
        self.roots = [frame.name for frame in self if frame.depth == 0]

    def __len__(self) -> int:
        return len(self.by_name)

    def __iter__(self) -> Iterator[ViewFrame]:
        return iter(self.by_name.values())

    def __contains__(self, name: str) -> bool:
        return name in self.by_name

    def __getitem__(self, name: str) -> ViewFrame:
        return self.by_name[name]

    def tree_of(self, name: str) -> list[str]:
        """The frames of the tree that a frame is in; [] for an unknown frame."""
        if name not in self.by_name:
            return []
        root = self.by_name[name].root
        return [frame.name for frame in self if frame.root == root]

    def natural_fixed_frame(self) -> str:
        """The fixed frame if none is chosen: world, or the largest tree's root; "" for no frame.

        A world that nothing is in, as after its only publisher has gone, is no fixed frame.
        """
        if len(self.tree_of("world")) > 1:
            return "world"
        return next(iter(self.roots), "")


def frames_of(moment: BusMoment, buffer: Buffer, fixed_frame: str) -> Frames:
    """The frames at a moment, to be seen from the fixed frame; the buffer is the moment's."""
    tree, frames = moment.tree, []
    for whole in tree.trees:
        root = whole[0][1].name
        unplaced = _why_apart(buffer, fixed_frame, root)
        for depth, info in whole:
            status = moment.frames[info.name]
            silence_s, opacity = 0.0, FADED if status.state == "gone" else 1.0
            if status.state == "stale":
                silence_s = status.silent_s or 0.0
                opacity = fading(silence_s, stale_after_s(info))
            ahead_s = -(status.age_s or 0.0) if status.state == "ahead" else 0.0
            frames.append(
                ViewFrame(
                    info,
                    status.state,
                    silence_s,
                    opacity,
                    status.publishers,
                    root,
                    depth,
                    unplaced,
                    ahead_s,
                )
            )
    return Frames(frames)


def fading(silence_s: float, stale_after_s: float) -> float:
    """The opacity of a stale frame, from 1 down to FADED: lower the longer it is stale."""
    faded = min((silence_s - stale_after_s) / (2.0 * stale_after_s), 1.0)
    return 1.0 - (1.0 - FADED) * faded


def _why_apart(buffer: Buffer, fixed_frame: str, root: str) -> str:
    """Why a whole tree cannot be placed, in the buffer's words; "" if it can."""
    if not fixed_frame:
        return ""
    try:
        buffer.path(fixed_frame, root)
    except TransformException as error:
        return str(error)
    return ""


Floats = NDArray[np.float64]

# Browsers draw with 32 bits: the squares of such distances are still numbers there.
_FARTHEST_M = 1e15
_TOO_FAR = "it is farther than 1e15 m away, which cannot be drawn"

# The most points of a trail per second.
TRAIL_RATE_HZ = 30.0


_HERE = Transform()


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

    def moved(self, fixed: Transform) -> "Placed":
        """The same places if the fixed frame has this pose."""
        if fixed == _HERE or not self.names:
            return self
        moved = fixed @ TransformArray(self.xyz, self.quat_wxyz[:, (1, 2, 3, 0)])
        return Placed(self.names, moved.xyz, moved.quat_wxyz, self.missing)

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

    As in RViz, arrows of at most a millimetre are not drawn.
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
