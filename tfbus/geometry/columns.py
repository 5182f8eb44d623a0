"""Many transforms as columns of bytes, as a message carries them and the buffer stores them.

Compiled if there is a C compiler (`columns.pxd` has the C types).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from contextlib import suppress
from struct import iter_unpack, unpack_from
from typing import Any

from tfbus.base import lazy_numpy as np
from tfbus.base.errors import InvalidArgumentException
from tfbus.base.lazy_numpy import NDArray
from tfbus.geometry import packed
from tfbus.geometry.batch import TransformBatch, batch_of_checked
from tfbus.geometry.packed import EDGE_SIZE, POSE_SIZE, STAMP_SIZE
from tfbus.geometry.transform import (
    Transform,
    TransformStamped,
    check_frame_id,
    child_name,
    stamped_list,
)


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
    def of_bytes(frames: tuple[str, ...], edges: bytes, stamps: bytes, poses: bytes) -> Columns:
        """Columns of these bytes, from their beginning; as many rows as there are stamps."""
        columns = Columns(frames, len(stamps) // STAMP_SIZE)
        columns.edges, columns.stamps, columns.poses = edges, stamps, poses
        return columns

    @staticmethod
    def of_transforms(transforms: Iterable[TransformStamped]) -> "Columns":
        """The transforms in the same order, each frame named once."""
        return _of_list(stamped_list(transforms))

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

    def edges_bytes(self) -> bytes:
        """The edges of all rows, without the bytes around them."""
        return self.edges[self.edges_at : self.edges_at + EDGE_SIZE * self.count]

    def stamps_bytes(self) -> bytes:
        """The stamps of all rows."""
        return self.stamps[self.stamps_at : self.stamps_at + STAMP_SIZE * self.count]

    def poses_bytes(self) -> bytes:
        """The poses of all rows."""
        return self.poses[self.poses_at : self.poses_at + POSE_SIZE * self.count]

    def is_like(self, frames: tuple[str, ...], edges: bytes) -> bool:
        """Whether these are the names, and the edges of all rows."""
        size = EDGE_SIZE * self.count
        return (
            len(edges) == size
            and packed.is_at(self.edges, self.edges_at, edges, size)
            and packed.are_texts(frames, self.frames)
        )

    def pairs(self) -> list[tuple[int, int]]:
        """The edge of each row: the indices of parent and child in `frames`."""
        return list(iter_unpack("=2I", self.edges_bytes()))

    def stamps_as_ints(self) -> list[int]:
        """The stamp of each row, in nanoseconds since the Unix epoch."""
        return memoryview(self.stamps_bytes()).cast("q").tolist()

    def children(self) -> frozenset[str]:
        """The child frames of the rows."""
        return frozenset([self.frames[child] for _, child in self.pairs()])

    def only(self, children: Collection[str]) -> "Columns":
        """The rows whose child frame is one of these."""
        return self._chosen(children, True)

    def without(self, children: Collection[str]) -> "Columns":
        """The rows whose child frame is none of these."""
        return self._chosen(children, False)

    def __iter__(self) -> Iterator[TransformStamped]:
        """Row by row. Raises InvalidArgumentException for a row that is not a valid transform."""
        for row in range(self.count):
            yield self._transform(row)

    def valid(self) -> list[TransformStamped]:
        """The rows that are valid transforms."""
        found = []
        for row in range(self.count):
            with suppress(InvalidArgumentException):
                found.append(self._transform(row))
        return found

    def _transform(self, row: int) -> TransformStamped:
        parent, child = packed.edge_at(self.edges, self.edges_at + EDGE_SIZE * row)
        pose = unpack_from("=7d", self.poses, self.poses_at + POSE_SIZE * row)
        return TransformStamped(
            packed.stamp_at(self.stamps, self.stamps_at + STAMP_SIZE * row),
            check_frame_id(self.frames[parent]),
            check_frame_id(self.frames[child]),
            Transform(pose[:3], pose[3:]),
        )

    def _chosen(self, children: Collection[str], wanted: bool) -> "Columns":
        of = {at for at, frame in enumerate(self.frames) if frame in children}
        kept = [row for row, (_, child) in enumerate(self.pairs()) if (child in of) is wanted]
        columns = Columns(self.frames, len(kept))
        columns.edges = rows_of(self.edges, self.edges_at, EDGE_SIZE, kept)
        columns.stamps = rows_of(self.stamps, self.stamps_at, STAMP_SIZE, kept)
        columns.poses = rows_of(self.poses, self.poses_at, POSE_SIZE, kept)
        return columns

    def last_child(self) -> str:
        """The child frame of the last row, of which there has to be one."""
        edge = packed.edge_at(self.edges, self.edges_at + EDGE_SIZE * (self.count - 1))
        return self.frames[edge[1]]

    def last_stamp_ns(self) -> int | None:
        """The stamp of the last row; None without rows."""
        if self.count == 0:
            return None
        return packed.stamp_at(self.stamps, self.stamps_at + STAMP_SIZE * (self.count - 1))


class Kind:
    """Rows with the same names and edges, and the value found for them."""

    def __init__(self, frames: tuple[str, ...], edges: bytes, found: object) -> None:
        self.frames = frames
        self.edges = edges
        self.found = found


class FoundOfRows:
    """Findings about rows by their names and edges, for rows that are alike but for their
    stamps and poses; of at most `most` rows in all, then it begins again. Of several kinds with the
    same child in the last row it keeps the last.
    """

    def __init__(self, most: int) -> None:
        # How many rows it keeps.
        self.count = 0
        self._most = most
        self._kinds: dict[str, Kind] = {}

    def get(self, columns: Columns) -> Any:
        """The finding about such rows; None for none."""
        if columns.count == 0:
            return None
        kind = self._kinds.get(columns.last_child())
        if kind is None or not columns.is_like(kind.frames, kind.edges):
            return None
        return kind.found

    def put(self, columns: Columns, found: object) -> None:
        """Keep a finding about rows; not of rows beside names that are of none of them, of which a
        message may have a million.
        """
        if columns.count == 0 or columns.count > self._most:
            return
        if len(columns.frames) > 2 * columns.count:
            return
        last_child = columns.last_child()
        former = self._kinds.pop(last_child, None)
        if former is not None:
            self.count -= len(former.edges) // EDGE_SIZE
        self.count += columns.count
        if self.count > self._most:
            self._kinds.clear()
            self.count = columns.count
        self._kinds[last_child] = Kind(columns.frames, columns.edges_bytes(), found)


def rows_of(column: bytes, start: int, size: int, rows: Iterable[int]) -> bytes:
    """These rows of a column that begins at `start`, each of `size` bytes."""
    return b"".join([column[start + size * row : start + size * (row + 1)] for row in rows])


def columns_of_batch(batch: TransformBatch) -> Columns:
    """The columns of a batch; no method of the class, since this is then a function of C."""
    stamps: bytes = batch.stamps_ns.tobytes()
    columns = Columns.__new__(Columns)
    columns.frames = batch.frames
    columns.count = len(stamps) // STAMP_SIZE
    columns.edges = batch.edges.tobytes()
    columns.stamps = stamps
    columns.poses = batch.poses.tobytes()
    columns.edges_at = columns.stamps_at = columns.poses_at = 0
    return columns


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
        child = index_of.setdefault(child_name(one), len(index_of))
        edges.append(packed.edge_bytes(parent, child))
        stamps.append(packed.stamp_bytes(one._stamp_ns))
        poses.append(packed.pose_bytes(one._pose))
    columns = Columns(tuple(index_of), len(transforms))
    columns.edges = b"".join(edges)
    columns.stamps = b"".join(stamps)
    columns.poses = b"".join(poses)
    return columns
