"""Many transforms as arrays, which a broadcaster sends and a buffer stores in one call."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from typing import Any

from tfbus.base import lazy_numpy as np
from tfbus.base.errors import InvalidArgumentException
from tfbus.base.lazy_numpy import NDArray
from tfbus.base.structs import Struct
from tfbus.geometry.transform import (
    Transform,
    TransformStamped,
    check_frame_id,
    plain,
    stamped_list,
)


class TransformBatch(Struct, eq=False):
    """Transforms as four columns; row i is one transform.

    `frames` are the names; `edges` (N, 2) uint32 are the indices of parent and child in `frames`;
    `stamps_ns` (N,) int64 are nanoseconds since the Unix epoch; `poses` (N, 7) float64 are
    x y z qx qy qz qw, taking points of the child into the parent.

    The arrays are read-only; an array of the right type is not copied, so do not change it
    afterwards. Raises InvalidArgumentException for wrong shapes, types and indices; the buffer
    judges the numbers and names themselves.
    """

    frames: tuple[str, ...]
    edges: NDArray[np.uint32]
    stamps_ns: NDArray[np.int64]
    poses: NDArray[np.float64]

    def __post_init__(self) -> None:
        if isinstance(self.frames, str):
            raise InvalidArgumentException("frames: expected several names, got a str")
        object.__setattr__(self, "frames", tuple([_name(frame) for frame in self.frames]))
        count = int(np.size(self.stamps_ns))
        self._set_column("edges", np.uint32, (count, 2))
        self._set_column("stamps_ns", np.int64, (count,))
        self._set_column("poses", np.float64, (count, 7))
        if count and int(self.edges.max()) >= len(self.frames):
            raise InvalidArgumentException(
                f"an edge names frame {int(self.edges.max())}, but there are only "
                f"{len(self.frames)} frames"
            )

    @staticmethod
    def from_transforms(transforms: Iterable[TransformStamped]) -> "TransformBatch":
        """The transforms in the same order, each frame named once."""
        index_of: dict[str, int] = {}
        edges, stamps, poses = [], [], []
        for ts in stamped_list(transforms):
            parent = index_of.setdefault(ts.frame_id, len(index_of))
            child = index_of.setdefault(ts.child_frame_id, len(index_of))
            edges.append((parent, child))
            stamps.append(ts.stamp_ns)
            poses.append(ts.transform.as_pose())
        columns = (
            np.array(edges, dtype=np.uint32).reshape(-1, 2),
            np.array(stamps, dtype=np.int64),
            np.array(poses, dtype=np.float64).reshape(-1, 7),
        )
        return batch_of_checked(tuple(index_of), *columns)

    def with_frames(self, frames: tuple[str, ...]) -> "TransformBatch":
        """The same rows with other names for their frames, in the same order.

        Raises InvalidArgumentException for another number of names.
        """
        if len(frames) != len(self.frames):
            raise InvalidArgumentException(
                f"{len(frames)} names for {len(self.frames)} frames; expected one for each"
            )
        return batch_of_checked(frames, self.edges, self.stamps_ns, self.poses)

    def only(self, children: Collection[str]) -> "TransformBatch":
        """The rows whose child frame is one of these."""
        return self._rows(self._is_of(children))

    def without(self, children: Collection[str]) -> "TransformBatch":
        """The rows whose child frame is none of these."""
        return self._rows(~self._is_of(children))

    def _is_of(self, children: Collection[str]) -> NDArray[np.bool_]:
        of = [at for at, frame in enumerate(self.frames) if frame in children]
        return np.isin(self.edges[:, 1], of)

    def _rows(self, kept: NDArray[np.bool_]) -> "TransformBatch":
        return batch_of_checked(
            self.frames, self.edges[kept], self.stamps_ns[kept], self.poses[kept]
        )

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def __iter__(self) -> Iterator[TransformStamped]:
        """Row by row. Raises InvalidArgumentException for a row that is not a valid transform."""
        rows = zip(self.edges.tolist(), self.stamps_ns.tolist(), self.poses, strict=True)
        for (parent, child), stamp_ns, pose in rows:
            yield TransformStamped(
                stamp_ns,
                check_frame_id(self.frames[parent]),
                check_frame_id(self.frames[child]),
                Transform(pose[:3], pose[3:]),
            )

    def _set_column(self, name: str, dtype: Any, shape: tuple[int, ...]) -> None:
        given = np.asarray(getattr(self, name))
        if given.shape != shape:
            raise InvalidArgumentException(
                f"{name}: expected shape {shape}, as there are {shape[0]} stamps, got {given.shape}"
            )
        if given.dtype.kind == "m" or (
            not np.can_cast(given.dtype, dtype, "same_kind") and given.size
        ):
            raise InvalidArgumentException(f"{name}: expected {np.dtype(dtype)}, got {given.dtype}")
        if np.ma.is_masked(getattr(self, name)):
            raise InvalidArgumentException(f"{name}: some numbers are masked; omit their rows")
        column = np.ascontiguousarray(given, dtype=dtype).view()
        if given.dtype.kind in "iu" and given.dtype != column.dtype and (column != given).any():
            raise InvalidArgumentException(f"{name}: some numbers do not fit {column.dtype}")
        column.flags.writeable = False
        object.__setattr__(self, name, column)


def _name(frame: object) -> str:
    if not isinstance(frame, str):
        raise InvalidArgumentException(f"frames: expected names, got a {type(frame).__name__}")
    return plain(frame)


def batch_of_checked(
    frames: tuple[str, ...],
    edges: NDArray[np.uint32],
    stamps_ns: NDArray[np.int64],
    poses: NDArray[np.float64],
) -> TransformBatch:
    """The batch of columns that were checked before: checking takes longer than all else."""
    for column in (edges, stamps_ns, poses):
        column.flags.writeable = False
    batch = object.__new__(TransformBatch)
    vars(batch).update(frames=frames, edges=edges, stamps_ns=stamps_ns, poses=poses)
    return batch
