"""Trajectories into a buffer and out of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tfbus.core.held import Held
from tfbus.errors import InvalidArgumentException
from tfbus.geometry.batch import TransformBatch
from tfbus.trajectory.trajectory import Trajectory, of_checked
from tfbus.wording import duration

if TYPE_CHECKING:
    import numpy as np
else:
    from tfbus.core import lazy_numpy as np


def samples_of(frame: str, held: Held, parent: str | None) -> Trajectory:
    """The samples that a frame has in one parent, by default the one above it now."""
    above = held.parent if parent is None else parent
    if above is None:
        raise InvalidArgumentException(f"frame {frame!r} is a root: it has no samples")
    if held.is_static and above == held.parent:
        stamps_ns = np.array([held.static_stamp_ns], dtype=np.int64)
        poses = np.array([held.static_pose])
    else:
        kept = np.array([each == above for each in held.parents or ()], dtype=bool)
        if held.parents is None:
            kept = np.full(len(held.stamps_ns), above == held.parent)
        stamps_ns, poses = held.stamps_ns[kept], held.poses[kept]
    return of_checked(above, frame, stamps_ns, poses[:, :3].copy(), poses[:, 3:].copy())


def as_batch(trajectory: Trajectory) -> TransformBatch:
    """The poses as the rows of a batch."""
    return TransformBatch(
        (trajectory.frame_id, trajectory.child_frame_id),
        np.tile(np.array((0, 1), dtype=np.uint32), (len(trajectory), 1)),
        trajectory.stamps_ns,
        np.hstack((trajectory.xyz, trajectory.quat_xyzw)),
    )


def check_span(trajectory: Trajectory, cache_time_s: float, newest_ns: int | None) -> None:
    """Check that a buffer keeps the whole, which has a newest sample of that frame already.

    Raises InvalidArgumentException.
    """
    if not len(trajectory):
        return
    first, last = int(trajectory.stamps_ns[0]), int(trajectory.stamps_ns[-1])
    newest_ns = last if newest_ns is None else max(last, newest_ns)
    if (newest_ns - first) / 1e9 > cache_time_s:
        what = "lasts" if newest_ns == last else "and what the buffer holds of that frame last"
        raise InvalidArgumentException(
            f"the trajectory of {trajectory.child_frame_id!r} {what} "
            f"{duration((newest_ns - first) / 1e9)}, and this buffer keeps the last "
            f"{cache_time_s:g} s: make it with Buffer(cache_time_s=math.inf), which keeps all"
        )
