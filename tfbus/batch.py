"""Stamped transforms in columns: what one message carries, and a buffer takes in one call."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tfbus.errors import InvalidArgumentException
from tfbus.transform import Transform, TransformStamped


@dataclass(frozen=True, eq=False)
class TransformBatch:
    """N transforms; the columns are read-only.

    `frames` is a table of names; `edges` (N,2) uint32 are the indices in it of parent and
    child; `stamps_ns` (N,) int64 count nanoseconds since the Unix epoch; `poses` (N,7) float64
    are x y z qx qy qz qw and take points of the child into the parent.

    Raises InvalidArgumentException where a column has another shape or an index no name.
    Whether the numbers make a transform is judged where they are used.
    """

    frames: tuple[str, ...]
    edges: NDArray[np.uint32]
    stamps_ns: NDArray[np.int64]
    poses: NDArray[np.float64]

    def __post_init__(self) -> None:
        count = len(self.stamps_ns)
        _check_shape("edges", self.edges, (count, 2))
        _check_shape("stamps_ns", self.stamps_ns, (count,))
        _check_shape("poses", self.poses, (count, 7))
        if count and int(self.edges.max()) >= len(self.frames):
            raise InvalidArgumentException(
                f"an edge names frame {int(self.edges.max())} of a table of {len(self.frames)}"
            )
        for column in (self.edges, self.stamps_ns, self.poses):
            column.flags.writeable = False

    @classmethod
    def from_transforms(cls, transforms: Iterable[TransformStamped]) -> "TransformBatch":
        """The columns of these transforms, in their order."""
        items = list(transforms)
        index: dict[str, int] = {}
        edges = [
            (
                index.setdefault(ts.frame_id, len(index)),
                index.setdefault(ts.child_frame_id, len(index)),
            )
            for ts in items
        ]
        return cls(
            tuple(index),
            np.array(edges, np.uint32).reshape(-1, 2),
            np.array([ts.stamp_ns for ts in items], np.int64),
            np.array([ts.transform.as_pose() for ts in items], np.float64).reshape(-1, 7),
        )

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def __iter__(self) -> Iterator[TransformStamped]:
        """Each transform; raises InvalidArgumentException at one whose numbers make none."""
        rows = zip(self.edges.tolist(), self.stamps_ns.tolist(), self.poses.tolist(), strict=True)
        for (parent, child), stamp_ns, pose in rows:
            yield TransformStamped(
                stamp_ns, self.frames[parent], self.frames[child], Transform.from_pose(pose)
            )


def _check_shape(name: str, column: NDArray[Any], shape: tuple[int, ...]) -> None:
    if column.shape != shape:
        raise InvalidArgumentException(f"{name} has shape {column.shape}, {shape} is wanted")
