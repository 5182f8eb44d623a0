"""Messages of transforms as bytes: read where they stand in their payload, and written one
transform at a time, which is the most frequent.

Compiled if there is a C compiler (`transform_bytes.pxd` has the C types).
"""

import sys
from collections.abc import Callable

from tfbus.base import scheduler
from tfbus.geometry import packed
from tfbus.geometry.batch import TransformBatch
from tfbus.geometry.columns import Columns, columns_of_batch
from tfbus.geometry.packed import EDGE_SIZE, POSE_SIZE, STAMP_SIZE
from tfbus.geometry.transform import TransformStamped, child_name
from tfbus.wire.numbered import FrameNumbers, pack_poses

try:
    import cython
except ImportError:
    from tfbus.base import cython_stub as cython

# Whether scanning is fast, a fraction of a microsecond: interpreted, msgpack and numpy are faster.
# Numbers are read as they stand, so it takes a little-endian machine.
FAST: bool = cython.compiled and sys.byteorder == "little"

VERSION = 1
# Of messages whose frames have numbers.
NUMBERED = 2

# A publisher mostly sends the same frames again: at most 1024 lists of names are kept, each of at
# most 16 KiB, of at most 100,000 names and 4 MiB in all, which take 15 MB. The oldest go first.
_MOST_TABLES = 1024
_LARGEST_TABLE = 16 * 1024
_MOST_NAMES = 100_000
_MOST_BYTES = 4 * 2**20

# A message of more names is left to `transforms.decode_transforms`, which counts all of its values.
_MOST_NAMES_OF_A_MESSAGE = 500_000

_VERSION = VERSION
_NUMBERED = NUMBERED
_LARGEST = 2**63 - 1

# The keys of a message, as they have been seen.
_V, _EPOCH, _SEQ, _STAMPS, _POSES = 1, 2, 4, 8, 16
_FRAMES, _EDGES, _RUNS, _FORMS = 32, 64, 128, 256
# The keys that it needs, and the ones that it may have; if its frames have numbers, too.
_NEEDED, _ALLOWED = 123, 127
_NEEDED_NUMBERED, _ALLOWED_NUMBERED = 411, 415


class TransformMessage:
    """A message of a stream: `rows` of transforms, and where it belongs.

    `epoch_ns` is when its publisher started, in nanoseconds since the Unix epoch: a larger one
    than before means that the publisher was restarted, or that its clock went back. `seq` counts
    the messages of its key in this epoch from 0; None if the publisher does not count. `unnamed`
    more rows have numbers for which no names are known so far.
    """

    def __init__(
        self,
        rows: Columns | TransformBatch,
        epoch_ns: int,
        seq: int | None = None,
        unnamed: int = 0,
    ) -> None:
        self.rows = rows if isinstance(rows, Columns) else columns_of_batch(rows)
        self.epoch_ns = epoch_ns
        self.seq = seq
        self.unnamed = unnamed

    @property
    def batch(self) -> TransformBatch:
        """The rows as arrays, views made for each call."""
        return self.rows.as_batch()

    def with_frames(self, frames: tuple[str, ...]) -> "TransformMessage":
        """The same message with other names for its frames. Raises as `Columns.with_frames`."""
        rows = self.rows.with_frames(frames)
        return TransformMessage(rows, self.epoch_ns, self.seq, self.unnamed)


class NameTables:
    """Lists of names by the bytes that they were read from; safe from any thread.

    Only `keep` changes `names`.
    """

    def __init__(self) -> None:
        self.names: dict[bytes, tuple[str, ...]] = {}
        self._count = 0
        self._bytes = 0
        self._lock = scheduler.Lock()

    def keep(self, table: bytes, names: tuple[str, ...]) -> None:
        """Keep a list of names; if there are too many, the oldest lists are forgotten."""
        with self._lock:
            if len(table) > _LARGEST_TABLE or table in self.names:
                return
            self.names[table] = names
            self._bytes += len(table)
            self._count += len(names)
            while (
                len(self.names) > _MOST_TABLES
                or self._bytes > _MOST_BYTES
                or self._count > _MOST_NAMES
            ):
                oldest = next(iter(self.names))
                self._bytes -= len(oldest)
                self._count -= len(self.names.pop(oldest))


class _Cursor:
    """A place in a payload that moves on; `failed` once the payload is not as tfbus writes it."""

    def __init__(self, payload: bytes) -> None:
        self.payload = payload
        self.data = payload
        self.at = 0
        self.end = len(payload)
        self.failed = False

    def skip(self, size: int) -> int:
        """Pass `size` bytes; returns where they begin."""
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
        """The integer that follows; it fails below zero and beyond 63 bits."""
        head = self.head()
        if head <= 0x7F:
            return head
        number = self.number(1 << (head - 0xCC)) if 0xCC <= head <= 0xCF else self.fail()
        return number if number <= _LARGEST else self.fail()

    def fail(self) -> int:
        """Note that the payload is not as tfbus writes it."""
        self.failed = True
        return 0


def scan_message(
    payload: bytes, tables: NameTables, numbers: FrameNumbers | None = None
) -> TransformMessage | None:
    """The message in a payload that is as tfbus writes it; its frames may have these numbers.

    None for any other, which `transforms.decode_transforms` reads, or refuses. `tables` keeps the
    names of frames from one call to the next.
    """
    # It begins with its version, `NUMBERED`.
    if len(payload) > 4 and packed.is_at(payload, 1, b"\xa1v\x02", 3):
        return None if numbers is None else _scan_numbered(payload, numbers)
    cursor = _Cursor(payload)
    columns = Columns((), 0)
    message = _message(columns)
    columns.edges = columns.stamps = columns.poses = payload
    edges_size = stamps_size = poses_size = seen = 0
    for _ in range(cursor.map_length()):
        key = _key(cursor)
        if not key & _ALLOWED or seen & key:
            return None
        seen |= key
        if key == _FRAMES:
            columns.frames = _names(cursor, tables)
        elif key == _EDGES:
            edges_size = cursor.binary_size()
            columns.edges_at = cursor.skip(edges_size)
        elif key == _STAMPS:
            stamps_size = cursor.binary_size()
            columns.stamps_at = cursor.skip(stamps_size)
        elif key == _POSES:
            poses_size = cursor.binary_size()
            columns.poses_at = cursor.skip(poses_size)
        elif key == _EPOCH:
            message.epoch_ns = cursor.integer()
        elif key == _SEQ:
            message.seq = cursor.integer()
        elif cursor.integer() != _VERSION:
            return None
        if cursor.failed:
            return None
    if cursor.failed or cursor.at != cursor.end or seen & _NEEDED != _NEEDED:
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
    return message


def _message(rows: Columns) -> TransformMessage:
    # Calling the class would take as long as a tenth of the rest.
    message = TransformMessage.__new__(TransformMessage)
    message.rows, message.epoch_ns, message.seq, message.unnamed = rows, 0, None, 0
    return message


def _scan_numbered(payload: bytes, numbers: FrameNumbers) -> TransformMessage | None:
    """As `scan_message`, of a message whose frames have these numbers."""
    cursor = _Cursor(payload)
    epoch_ns, seq, seen = 0, None, 0
    runs = stamps = forms = poses = b""
    for _ in range(cursor.map_length()):
        key = _key(cursor)
        if not key & _ALLOWED_NUMBERED or seen & key:
            return None
        seen |= key
        start = cursor.at
        if key == _RUNS:
            for _ in range(cursor.array_length()):
                cursor.integer()
                if cursor.failed:
                    return None
            runs = payload[start : cursor.at]
        elif key == _STAMPS:
            stamps = _stamps(cursor)
        elif key == _FORMS:
            forms = _binary(cursor)
        elif key == _POSES:
            poses = _binary(cursor)
        elif key == _EPOCH:
            epoch_ns = cursor.integer()
        elif key == _SEQ:
            seq = cursor.integer()
        elif cursor.integer() != _NUMBERED:
            return None
        if cursor.failed:
            return None
    if cursor.failed or cursor.at != cursor.end or seen & _NEEDED_NUMBERED != _NEEDED_NUMBERED:
        return None
    # Only if they were found before: the limits of a message are checked once.
    rows = numbers.get(runs) if epoch_ns == numbers.epoch_ns else None
    if rows is None:
        return None
    columns = rows.columns(stamps, forms, poses)
    if columns is None:
        return None
    message = _message(columns)
    message.epoch_ns, message.seq, message.unnamed = epoch_ns, seq, rows.unnamed
    return message


def _stamps(cursor: _Cursor) -> bytes:
    """The bytes that follow; an integer as its bytes."""
    if cursor.at < cursor.end and 0xC4 <= cursor.data[cursor.at] <= 0xC6:
        return _binary(cursor)
    return packed.stamp_bytes(cursor.integer())


def _binary(cursor: _Cursor) -> bytes:
    """The bytes that follow."""
    size = cursor.binary_size()
    start = cursor.skip(size)
    return b"" if cursor.failed else cursor.payload[start : start + size]


def _key(cursor: _Cursor) -> int:
    """The key that follows; 0 for an unknown one."""
    size = cursor.text_size()
    at = cursor.skip(size)
    if cursor.failed:
        return 0
    if size == 6:
        if packed.is_at(cursor.data, at, b"frames", 6):
            return _FRAMES
        return _STAMPS if packed.is_at(cursor.data, at, b"stamps", 6) else 0
    if size == 5:
        if packed.is_at(cursor.data, at, b"edges", 5):
            return _EDGES
        if packed.is_at(cursor.data, at, b"poses", 5):
            return _POSES
        if packed.is_at(cursor.data, at, b"epoch", 5):
            return _EPOCH
        return _FORMS if packed.is_at(cursor.data, at, b"forms", 5) else 0
    if size == 4:
        return _RUNS if packed.is_at(cursor.data, at, b"runs", 4) else 0
    if size == 3:
        return _SEQ if packed.is_at(cursor.data, at, b"seq", 3) else 0
    return _V if size == 1 and packed.is_at(cursor.data, at, b"v", 1) else 0


def _names(cursor: _Cursor, tables: NameTables) -> tuple[str, ...]:
    """The names that follow."""
    start = cursor.at
    count = cursor.array_length()
    if count > _MOST_NAMES_OF_A_MESSAGE:
        cursor.fail()
        return ()
    for _ in range(count):
        cursor.skip(cursor.text_size())
        if cursor.failed:
            return ()
    table = cursor.payload[start : cursor.at]
    names = tables.names.get(table)
    if names is None:
        names = _texts(cursor, start)
        if not cursor.failed:
            tables.keep(table, names)
    return names


def _texts(cursor: _Cursor, start: int) -> tuple[str, ...]:
    """The texts of an array that begins at `start`, passed once already."""
    cursor.at = start
    texts = []
    try:
        for _ in range(cursor.array_length()):
            size = cursor.text_size()
            texts.append(packed.text_at(cursor.data, cursor.skip(size), size))
    except UnicodeDecodeError:
        cursor.failed = True
    return tuple(texts)


def _are_edges(columns: Columns, count: int) -> bool:
    """Whether all edges are between frames of the message."""
    edges = columns.edges
    known = len(columns.frames)
    for i in range(count):
        parent, child = packed.edge_at(edges, columns.edges_at + EDGE_SIZE * i)
        if parent >= known or child >= known:
            return False
    return True


class OneMessage:
    """Writes messages that carry one transform, always between the same two frames.

    Three parts are `fixed` in a message: up to its number, from there to its stamp, and from there
    to its pose.
    """

    def __init__(
        self, frame_id: str, child_frame_id: str, fixed: tuple[bytes, bytes, bytes]
    ) -> None:
        self._frame_id = frame_id
        self._child_frame_id = child_frame_id
        self._head, self._stamps, self._poses = fixed

    def encode_bytes(
        self, seq: int, frames: tuple[str, ...], stamp_ns: int, pose: bytes
    ) -> bytes | None:
        """The message with this number, of a pose in the byte order of this machine. None for other
        frames.
        """
        if frames[1] != self._child_frame_id or frames[0] != self._frame_id:
            return None
        return b"".join(
            (
                self._head,
                seq.to_bytes(8, "big"),
                self._stamps,
                packed.stamp_bytes(stamp_ns),
                self._poses,
                pose,
            )
        )

    def encode(self, seq: int, transform: TransformStamped) -> bytes | None:
        """The message with this number, in the byte order of this machine. None for a transform
        between other frames.
        """
        if child_name(transform) != self._child_frame_id or transform._frame_id != self._frame_id:
            return None
        return b"".join(
            (
                self._head,
                seq.to_bytes(8, "big"),
                self._stamps,
                packed.stamp_bytes(transform._stamp_ns),
                self._poses,
                packed.pose_bytes(transform._pose),
            )
        )


class OneNumbered:
    """As OneMessage, of version 2: with a number for the frames, and a pose less its `origin`.

    Four parts are `fixed` in a message: up to its number, from there to its stamp, to its form, and
    to the size of its pose, which `is_short` or compact. `pack` writes an integer that is 0 or
    more.
    """

    def __init__(
        self,
        frame_id: str,
        child_frame_id: str,
        fixed: tuple[bytes, bytes, bytes, bytes],
        origin: bytes,
        is_short: bool,
        pack: Callable[[int], bytes],
    ) -> None:
        self._frame_id = frame_id
        self._child_frame_id = child_frame_id
        self._head, self._stamps, self._forms, self._poses = fixed
        self._origin = origin
        self._is_short = is_short
        self._pack = pack
        # By their forms, which say the size of a pose.
        self._between: dict[bytes, bytes] = {}

    def encode_bytes(
        self, seq: int, frames: tuple[str, ...], stamp_ns: int, pose: bytes
    ) -> bytes | None:
        """As `OneMessage.encode_bytes`; None for a stamp below zero, too."""
        if frames[1] != self._child_frame_id or frames[0] != self._frame_id:
            return None
        return self._message(seq, stamp_ns, pose)

    def encode(self, seq: int, transform: TransformStamped) -> bytes | None:
        """As `OneMessage.encode`; None for a stamp below zero, too."""
        if child_name(transform) != self._child_frame_id or transform._frame_id != self._frame_id:
            return None
        return self._message(seq, transform._stamp_ns, packed.pose_bytes(transform._pose))

    def _message(self, seq: int, stamp_ns: int, pose: bytes) -> bytes | None:
        if stamp_ns < 0:
            return None
        form, short = pack_poses(pose, 1, self._origin, self._is_short)
        between = self._between.get(form)
        if between is None:
            between = self._between[form] = self._forms + form + self._poses + bytes([len(short)])
        pack = self._pack
        return b"".join((self._head, pack(seq), self._stamps, pack(stamp_ns), between, short))
