"""Trajectories into a buffer and out of it, as arrays and as files."""

from __future__ import annotations

import os

from tfbus.base import lazy_numpy as np
from tfbus.base.errors import InvalidArgumentException
from tfbus.base.lazy_numpy import ArrayLike
from tfbus.base.wording import duration
from tfbus.buffer.buffer import Buffer
from tfbus.geometry.batch import TransformBatch
from tfbus.geometry.sampling import Sampling
from tfbus.geometry.trajectory import Trajectory, of_checked, read_tables
from tfbus.geometry.transform import check_text


def samples(buffer: Buffer, frame: str, *, parent: str | None = None) -> Trajectory:
    """The samples of a frame as they came, in the frame above it now, or in `parent`, one that
    it had before: stamps and poses as arrays.

    A static frame has one. Raises LookupException for an unknown frame.
    """
    frame = check_text(frame, "frame")
    if parent is not None:
        parent = check_text(parent, "parent")
    with buffer._store.lock:
        history = buffer._store.tree.frames.get(frame)
        held = None if history is None else history.held()
    if held is None:
        raise buffer._store.unknown_frame(frame)
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


def trajectory(
    buffer: Buffer,
    target_frame: str,
    source_frame: str,
    stamps_ns: ArrayLike | None = None,
    *,
    sampling: Sampling | None = None,
) -> Trajectory:
    """The poses of the source in the target, at rising stamps (N,).

    Without stamps they are the samples' of the source, or of the first dynamic frame on the way
    from it to the target, if all edges between have data. Raises as `lookup_transforms`.
    """
    if stamps_ns is not None:
        poses = buffer.lookup_transforms(target_frame, source_frame, stamps_ns, sampling=sampling)
        return Trajectory(target_frame, source_frame, stamps_ns, poses.xyz, poses.quat_xyzw)
    names = buffer.path(target_frame, source_frame)
    with buffer._store.lock:
        path = buffer._store.tree.path(target_frame, source_frame)
        edges = [] if path is None else [each for each in path.edges() if not each.static]
        held = edges[0].held() if edges else None
    if held is None:
        raise InvalidArgumentException(
            f"{' -> '.join(map(repr, reversed(names)))} is static: give the stamps_ns of the "
            "trajectory"
        )
    poses, known = buffer.lookup_known_transforms(
        target_frame, source_frame, held.stamps_ns, sampling=sampling
    )
    return Trajectory(
        target_frame,
        source_frame,
        held.stamps_ns[known],
        poses.xyz[known],
        poses.quat_xyzw[known],
    )


def insert(buffer: Buffer, trajectory: Trajectory, *, authority: str = "") -> None:
    """Store the poses of a trajectory, as `set_transforms` does.

    Raises InvalidArgumentException, and stores nothing, if it is longer than the buffer keeps;
    `Buffer(cache_time_s=math.inf)` keeps all. Raises LoopException.
    """
    if not isinstance(trajectory, Trajectory):
        raise InvalidArgumentException(
            f"trajectory: expected a tfbus.Trajectory, got a {type(trajectory).__name__}"
        )
    with buffer._store.lock:
        history = buffer._store.tree.frames.get(trajectory.child_frame_id)
        span = None if history is None or history.static else history.stamp_span()
    _check_span(trajectory, buffer.cache_time_s, None if span is None else span[1])
    for first in trajectory[:1]:
        buffer.set_transform(first, authority=authority)
    batch = TransformBatch(
        (trajectory.frame_id, trajectory.child_frame_id),
        np.tile(np.array((0, 1), dtype=np.uint32), (len(trajectory), 1)),
        trajectory.stamps_ns,
        np.hstack((trajectory.xyz, trajectory.quat_xyzw)),
    )
    stored = buffer.set_transforms(batch, authority=authority)
    if stored < len(trajectory):
        raise InvalidArgumentException(
            f"{trajectory!r} is not stored whole: {buffer.rejected.last}"
        )


def insert_tum(
    buffer: Buffer,
    path: str | os.PathLike[str],
    frame_id: str,
    child_frame_id: str,
    *,
    authority: str = "",
) -> Trajectory:
    """Store the trajectory of a file in TUM's format, of the child in the frame; returns it.

    Raises as `Trajectory.read_tum` and `insert`.
    """
    trajectory = Trajectory.read_tum(path, frame_id, child_frame_id)
    insert(buffer, trajectory, authority=authority)
    return trajectory


def insert_csv(
    buffer: Buffer, path: str | os.PathLike[str], *, authority: str = ""
) -> list[Trajectory]:
    """Store the trajectories of a CSV file, one for each pair of frames in it; returns them.

    The columns are as of `Trajectory.read_csv`. Raises as that and `insert`.
    """
    trajectories = read_tables(path)
    for trajectory in trajectories:
        insert(buffer, trajectory, authority=authority)
    return trajectories


def _check_span(trajectory: Trajectory, cache_time_s: float, newest_ns: int | None) -> None:
    """Check that a buffer keeps the whole, which has a newest sample of that frame already."""
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
