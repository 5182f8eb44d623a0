"""Where frames are, seen from the fixed frame, at one time."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tfbus import Buffer, TransformException

Floats = NDArray[np.float64]

# A trail has so many points a second, at most.
TRAIL_RATE_HZ = 30.0


@dataclass(frozen=True, eq=False)
class Placed:
    """The poses of frames in the fixed frame: `xyz` (N, 3) in metres, `quat_wxyz` (N, 4).

    `index` tells the row of each frame, `missing` why a frame has none.
    """

    names: tuple[str, ...]
    xyz: Floats
    quat_wxyz: Floats
    missing: dict[str, str]
    index: dict[str, int]

    def extent_m(self) -> float:
        """The longest side of the box around all origins; 0 below two of them."""
        return float(np.ptp(self.xyz, axis=0).max()) if len(self.xyz) else 0.0


def place(buffer: Buffer, fixed_frame: str, names: Iterable[str], stamp_ns: int | None) -> Placed:
    """The frames that can be placed at this time; None is the latest of each."""
    kept, poses, missing = [], [], {}
    for name in names:
        try:
            found = buffer.lookup_transform(fixed_frame, name, stamp_ns)
        except TransformException as error:
            missing[name] = str(error)
        else:
            kept.append(name)
            poses.append(found.transform.as_pose())
    rows = np.array(poses, np.float64).reshape(-1, 7)
    return Placed(
        tuple(kept),
        rows[:, :3],
        rows[:, [6, 3, 4, 5]],
        missing,
        {name: row for row, name in enumerate(kept)},
    )


def edges(placed: Placed, parents: dict[str, str | None]) -> tuple[list[str], Floats]:
    """The arrows from each placed frame to its parent, where that is placed too.

    The names of the children, and (N, 2, 3) points: child, then parent. Arrows no longer than a
    millimetre are left out, as in RViz.
    """
    pairs = [
        (child, row, placed.index[parent])
        for child, row in placed.index.items()
        if (parent := parents.get(child)) is not None and parent in placed.index
    ]
    if not pairs:
        return [], np.zeros((0, 2, 3))
    children = placed.xyz[[row for _, row, _ in pairs]]
    above = placed.xyz[[row for _, _, row in pairs]]
    long = np.linalg.norm(children - above, axis=1) > 1e-3
    names = [name for (name, _, _), kept in zip(pairs, long, strict=True) if kept]
    return names, np.stack([children, above], axis=1)[long]


def trail(buffer: Buffer, fixed_frame: str, name: str, end_ns: int, length_s: float) -> Floats:
    """Where a frame was in the last seconds before `end_ns`: (N, 3) in metres, oldest first.

    Times at which it is not known are left out; none are known of a frame that is not.
    """
    count = max(2, round(length_s * TRAIL_RATE_HZ) + 1)
    back_ns = np.linspace(length_s * 1e9, 0.0, count).astype(np.int64)
    try:
        found, known = buffer.lookup_known_transforms(fixed_frame, name, end_ns - back_ns)
    except TransformException:
        return np.zeros((0, 3))
    return found.xyz[known]


def newest_common_ns(buffer: Buffer, fixed_frame: str, names: Iterable[str]) -> int | None:
    """The latest time at which all of these frames can be placed; None: they never move.

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
