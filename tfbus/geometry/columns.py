"""The columns of a message of transforms, where they stand in its payload.

One of the modules that are compiled where there is a C compiler (`columns.pxd` says the C types).
"""

import sys
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from tfbus.core import packed
from tfbus.core.packed import EDGE_SIZE, POSE_SIZE, STAMP_SIZE
from tfbus.errors import InvalidArgumentException
from tfbus.geometry.batch import TransformBatch
from tfbus.geometry.transform import TransformStamped

try:
    import cython
except ImportError:
    from tfbus.core import cython_stub as cython

# Whether messages are found here, where it takes a fraction of a microsecond, or are read by
# msgpack and numpy, which are faster than this file interpreted. Numbers are taken as they stand.
FAST: bool = cython.compiled and sys.byteorder == "little"

# A publisher mostly sends the same frames again: so many lists of names are kept, each no larger.
_MOST_TABLES = 1024
_LARGEST_TABLE = 16 * 1024

_VERSION = 1
_LARGEST = 2**63 - 1

# The keys of a message, as they have been seen; all but the last are needed.
_V, _EPOCH, _FRAMES, _EDGES, _STAMPS, _POSES, _SEQ = 1, 2, 4, 8, 16, 32, 64
_NEEDED = 63


class Columns:
    """Transforms as columns of bytes, in the byte order of this machine, and what their message
    says besides.

    `frames` are the names. Row i of `count` is an edge, two indices in `frames`; a stamp; and a
    pose. The rows begin at `edges_at`, `stamps_at` and `poses_at` of the bytes `edges`, `stamps`
    and `poses`, which may be one and the same. `epoch_ns` and `seq` are those of the message.
    """

    def __init__(self, frames: tuple[str, ...], count: int) -> None:
        self.frames = frames
        self.count = count
        self.edges = self.stamps = self.poses = b""
        self.edges_at = self.stamps_at = self.poses_at = 0
        self.epoch_ns = 0
        self.seq: int | None = None

    @staticmethod
    def of_batch(batch: TransformBatch, epoch_ns: int = 0, seq: int | None = None) -> "Columns":
        """The columns of a batch."""
        stamps = batch.stamps_ns.tobytes()
        columns = Columns(batch.frames, len(stamps) // STAMP_SIZE)
        columns.edges = batch.edges.tobytes()
        columns.stamps = stamps
        columns.poses = batch.poses.tobytes()
        columns.epoch_ns = epoch_ns
        columns.seq = seq
        return columns

    @staticmethod
    def of_transforms(transforms: Iterable[TransformStamped]) -> "Columns":
        """The transforms in the same order, each frame named once."""
        return _of_list(list(transforms))

    def __len__(self) -> int:
        return self.count

    def as_batch(self) -> TransformBatch:
        """The same transforms as arrays."""
        return TransformBatch(
            self.frames,
            np.frombuffer(self.edges, np.uint32, 2 * self.count, self.edges_at).reshape(-1, 2),
            self.stamps_ns(),
            np.frombuffer(self.poses, np.float64, 7 * self.count, self.poses_at).reshape(-1, 7),
        )

    def stamps_ns(self) -> NDArray[np.int64]:
        """The stamps of all rows (N,)."""
        return np.frombuffer(self.stamps, np.int64, self.count, self.stamps_at)

    def with_frames(self, frames: tuple[str, ...]) -> "Columns":
        """The same rows, between frames of other names: as many, in the same order.

        Raises InvalidArgumentException where they are not as many.
        """
        if len(frames) != len(self.frames):
            raise InvalidArgumentException(
                f"{len(frames)} names cannot stand for those of {len(self.frames)} frames"
            )
        columns = Columns(frames, self.count)
        columns.edges, columns.edges_at = self.edges, self.edges_at
        columns.stamps, columns.stamps_at = self.stamps, self.stamps_at
        columns.poses, columns.poses_at = self.poses, self.poses_at
        columns.epoch_ns, columns.seq = self.epoch_ns, self.seq
        return columns

    def last_stamp_ns(self) -> int | None:
        """The stamp of the last row; None where there is none."""
        if self.count == 0:
            return None
        return packed.stamp_at(self.stamps, self.stamps_at + STAMP_SIZE * (self.count - 1))


def _of_list(transforms: list[TransformStamped]) -> Columns:
    index_of: dict[str, int] = {}
    edges, stamps, poses = [], [], []
    for ts in transforms:
        parent = index_of.setdefault(ts._frame_id, len(index_of))
        child = index_of.setdefault(ts._child_frame_id, len(index_of))
        edges.append(packed.edge_bytes(parent, child))
        stamps.append(packed.stamp_bytes(ts._stamp_ns))
        poses.append(packed.pose_bytes(ts._pose))
    columns = Columns(tuple(index_of), len(transforms))
    columns.edges = b"".join(edges)
    columns.stamps = b"".join(stamps)
    columns.poses = b"".join(poses)
    return columns


class _Walk:
    """A place in a payload that moves on; `failed` once that is not as tfbus writes it."""

    def __init__(self, payload: bytes) -> None:
        self.payload = payload
        self.data = payload
        self.at = 0
        self.end = len(payload)
        self.failed = False

    def skip(self, size: int) -> int:
        """Pass `size` bytes: where they begin."""
        start = self.at
        if size > self.end - start:
            self.failed = True
        else:
            self.at = start + size
        return start

    def number(self, size: int) -> int:
        """The number in the next `size` bytes."""
        start = self.skip(size)
        return 0 if self.failed else packed.big_endian_at(self.data, start, size)

    def head(self) -> int:
        """The byte that begins the next value; 0xc1, which begins none, at the end."""
        start = self.skip(1)
        return 0xC1 if self.failed else self.data[start]

    def map_length(self) -> int:
        """How many pairs follow."""
        head = self.head()
        if 0x80 <= head <= 0x8F:
            return head - 0x80
        return self.fail()

    def array_length(self) -> int:
        """How many values follow."""
        head = self.head()
        if 0x90 <= head <= 0x9F:
            return head - 0x90
        return self.number(2 << (head - 0xDC)) if 0xDC <= head <= 0xDD else self.fail()

    def text_size(self) -> int:
        """How many bytes of text follow."""
        head = self.head()
        if 0xA0 <= head <= 0xBF:
            return head - 0xA0
        return self.number(1 << (head - 0xD9)) if 0xD9 <= head <= 0xDB else self.fail()

    def binary_size(self) -> int:
        """How many bytes follow."""
        head = self.head()
        return self.number(1 << (head - 0xC4)) if 0xC4 <= head <= 0xC6 else self.fail()

    def integer(self) -> int:
        """The integer that follows, which is none below zero or beyond 63 bits."""
        head = self.head()
        if head <= 0x7F:
            return head
        number = self.number(1 << (head - 0xCC)) if 0xCC <= head <= 0xCF else self.fail()
        return number if number <= _LARGEST else self.fail()

    def fail(self) -> int:
        """Note that this is not as tfbus writes it."""
        self.failed = True
        return 0


def find_columns(payload: bytes, tables: dict[bytes, tuple[str, ...]]) -> Columns | None:
    """The columns in a payload that is as tfbus writes it.

    None for any other, which may yet be a message, or be refused: `wire.decode_transforms`
    judges that. `tables` keeps the names of frames from one call to the next.
    """
    walk = _Walk(payload)
    columns = Columns((), 0)
    columns.edges = columns.stamps = columns.poses = payload
    edges_size = stamps_size = poses_size = seen = 0
    for _ in range(walk.map_length()):
        key = _key(walk)
        if key == 0 or seen & key:
            return None
        seen |= key
        if key == _FRAMES:
            columns.frames = _names(walk, tables)
        elif key == _EDGES:
            edges_size = walk.binary_size()
            columns.edges_at = walk.skip(edges_size)
        elif key == _STAMPS:
            stamps_size = walk.binary_size()
            columns.stamps_at = walk.skip(stamps_size)
        elif key == _POSES:
            poses_size = walk.binary_size()
            columns.poses_at = walk.skip(poses_size)
        elif key == _EPOCH:
            columns.epoch_ns = walk.integer()
        elif key == _SEQ:
            columns.seq = walk.integer()
        elif walk.integer() != _VERSION:
            return None
        if walk.failed:
            return None
    if walk.failed or walk.at != walk.end or seen & _NEEDED != _NEEDED:
        return None
    count = stamps_size // STAMP_SIZE
    if (
        stamps_size != count * STAMP_SIZE
        or edges_size != count * EDGE_SIZE
        or poses_size != count * POSE_SIZE
        or not _are_edges(columns, count)
    ):
        return None
    columns.count = count
    return columns


def _key(walk: _Walk) -> int:
    """The key that follows; 0 for any that is not known."""
    size = walk.text_size()
    at = walk.skip(size)
    if walk.failed:
        return 0
    if size == 6:
        if packed.is_at(walk.data, at, b"frames", 6):
            return _FRAMES
        return _STAMPS if packed.is_at(walk.data, at, b"stamps", 6) else 0
    if size == 5:
        if packed.is_at(walk.data, at, b"edges", 5):
            return _EDGES
        if packed.is_at(walk.data, at, b"poses", 5):
            return _POSES
        return _EPOCH if packed.is_at(walk.data, at, b"epoch", 5) else 0
    if size == 3:
        return _SEQ if packed.is_at(walk.data, at, b"seq", 3) else 0
    return _V if size == 1 and packed.is_at(walk.data, at, b"v", 1) else 0


def _names(walk: _Walk, tables: dict[bytes, tuple[str, ...]]) -> tuple[str, ...]:
    """The names that follow."""
    start = walk.at
    count = walk.array_length()
    for _ in range(count):
        walk.skip(walk.text_size())
        if walk.failed:
            return ()
    table = walk.payload[start : walk.at]
    names = tables.get(table)
    if names is None:
        names = _texts(walk, start)
        if len(table) <= _LARGEST_TABLE and not walk.failed:
            if len(tables) >= _MOST_TABLES:
                tables.clear()
            tables[table] = names
    return names


def _texts(walk: _Walk, start: int) -> tuple[str, ...]:
    """The texts of an array that begins at `start`, and has been passed once."""
    walk.at = start
    texts = []
    try:
        for _ in range(walk.array_length()):
            size = walk.text_size()
            texts.append(packed.text_at(walk.data, walk.skip(size), size))
    except UnicodeDecodeError:
        walk.failed = True
    return tuple(texts)


def _are_edges(columns: Columns, count: int) -> bool:
    """Whether all edges are between frames that there are."""
    edges = columns.edges
    known = len(columns.frames)
    for i in range(count):
        parent, child = packed.edge_at(edges, columns.edges_at + EDGE_SIZE * i)
        if parent >= known or child >= known:
            return False
    return True
