"""Many transforms as columns of bytes, as a message carries them and the buffer stores them.

Compiled where there is a C compiler (`columns.pxd` has the C types).
"""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from tfbus.core import packed
from tfbus.core.packed import STAMP_SIZE
from tfbus.errors import InvalidArgumentException
from tfbus.geometry.batch import TransformBatch, batch_of_checked
from tfbus.geometry.transform import TransformStamped


class Columns:
    """Transforms as columns of bytes, in the byte order of this machine.

    `frames` are the names. Row i of `count` is an edge, two indices in `frames`; a stamp; and a
    pose. The rows begin at `edges_at`, `stamps_at` and `poses_at` of the bytes `edges`, `stamps`
    and `poses`, which may be one and the same, such as a payload.
    """

    def __init__(self, frames: tuple[str, ...], count: int) -> None:
        self.frames = frames
        self.count = count
        self.edges = self.stamps = self.poses = b""
        self.edges_at = self.stamps_at = self.poses_at = 0

    @staticmethod
    def of_batch(batch: TransformBatch) -> "Columns":
        """The columns of a batch."""
        stamps = batch.stamps_ns.tobytes()
        columns = Columns(batch.frames, len(stamps) // STAMP_SIZE)
        columns.edges = batch.edges.tobytes()
        columns.stamps = stamps
        columns.poses = batch.poses.tobytes()
        return columns

    @staticmethod
    def of_transforms(transforms: Iterable[TransformStamped]) -> "Columns":
        """The transforms in the same order, each frame named once."""
        return _of_list(list(transforms))

    def __len__(self) -> int:
        return self.count

    def as_batch(self) -> TransformBatch:
        """The same transforms as arrays, which are views of the bytes."""
        return batch_of_checked(
            self.frames,
            np.frombuffer(self.edges, np.uint32, 2 * self.count, self.edges_at).reshape(-1, 2),
            self.stamps_ns(),
            np.frombuffer(self.poses, np.float64, 7 * self.count, self.poses_at).reshape(-1, 7),
        )

    def stamps_ns(self) -> NDArray[np.int64]:
        """The stamps of all rows (N,)."""
        return np.frombuffer(self.stamps, np.int64, self.count, self.stamps_at)

    def with_frames(self, frames: tuple[str, ...]) -> "Columns":
        """The same rows with other names for their frames, in the same order.

        Raises InvalidArgumentException for another number of names.
        """
        if len(frames) != len(self.frames):
            raise InvalidArgumentException(
                f"{len(frames)} names for {len(self.frames)} frames; expected one for each"
            )
        columns = Columns(frames, self.count)
        columns.edges, columns.edges_at = self.edges, self.edges_at
        columns.stamps, columns.stamps_at = self.stamps, self.stamps_at
        columns.poses, columns.poses_at = self.poses, self.poses_at
        return columns

    def last_stamp_ns(self) -> int | None:
        """The stamp of the last row; None without rows."""
        if self.count == 0:
            return None
        return packed.stamp_at(self.stamps, self.stamps_at + STAMP_SIZE * (self.count - 1))


def _of_list(transforms: list[TransformStamped]) -> Columns:
    index_of: dict[str, int] = {}
    edges, stamps, poses = [], [], []
    for ts in transforms:
        if not isinstance(ts, TransformStamped):
            raise InvalidArgumentException(
                f"expected tfbus.TransformStamped, got a {type(ts).__name__}"
            )
        one: TransformStamped = ts
        parent = index_of.setdefault(one._frame_id, len(index_of))
        child = index_of.setdefault(one._child_frame_id, len(index_of))
        edges.append(packed.edge_bytes(parent, child))
        stamps.append(packed.stamp_bytes(one._stamp_ns))
        poses.append(packed.pose_bytes(one._pose))
    columns = Columns(tuple(index_of), len(transforms))
    columns.edges = b"".join(edges)
    columns.stamps = b"".join(stamps)
    columns.poses = b"".join(poses)
    return columns
