"""Transforms as ROS 2 sends them: tf2_msgs/msg/TFMessage in CDR, to and from columns.

A message with the frames of one before is written by joining the bytes between its numbers with
them, and read by copying them from their places; both are kept. That takes less than a microsecond
a transform; libraries that read any message take ten to twenty.
"""

import struct
import sys
from array import array
from collections.abc import Collection, Iterator, Sequence
from functools import lru_cache

from tfbus.base import lazy_numpy as np
from tfbus.base.errors import DecodeError, InvalidArgumentException
from tfbus.base.lazy_numpy import NDArray
from tfbus.base.wording import printable, stamp_text
from tfbus.geometry import packed
from tfbus.geometry.columns import Columns
from tfbus.geometry.packed import EDGE_SIZE, ONE_EDGE, POSE_SIZE, STAMP_SIZE
from tfbus.ros.cdr import HEADER, HEADER_SIZE, CdrReader, CdrWriter

_SECOND_NS = 1_000_000_000

# Whether this machine has the byte order of messages.
_AS_HERE = sys.byteorder == "little"

# The stamps that fit: seconds are signed integers of 32 bits, until 2038.
EARLIEST_STAMP_NS = -(2**31) * _SECOND_NS
LATEST_STAMP_NS = 2**31 * _SECOND_NS - 1

# Of one transform: its stamp, two names with their lengths, at least one byte each, and its pose.
_LEAST_SIZE = 8 + 2 * (4 + 4) + POSE_SIZE

# Below this number of stamps Python is faster than numpy.
_FEW = 8

# Layouts that are kept: at most this number, of this number of transforms in all, which take 20 MB.
_MOST_LAYOUTS = 1024
_MOST_ROWS = 100_000
_LONGEST_NAMES = 4096

# Layouts of the same size that are tried one after the other.
_MOST_ALIKE = 8

_WORD, _WORD_SIZE = "<u4", 4
_STAMP = struct.Struct("<iI")
# The head of a message of one transform: that header, and their count.
_HEAD_OF_ONE = HEADER + b"\x01\x00\x00\x00"
_OWN_EDGE = packed.edge_bytes(0, 0)
_STAMP_AT = HEADER_SIZE + 4
_NAMES_AT = _STAMP_AT + STAMP_SIZE


def only_stamp(rows: Columns) -> int | None:
    """The stamp that all rows have; None if there is no row, or another stamp."""
    stamps = rows.stamps_bytes()
    first = stamps[:STAMP_SIZE]
    return packed.stamp_at(first, 0) if first and stamps == first * rows.count else None


class TFMessageWriter:
    """Writes messages; keeps the places of the numbers by frames and edges. Not thread-safe."""

    def __init__(self) -> None:
        self._layouts: dict[tuple[tuple[str, ...], bytes], _Layout] = {}
        self._rows = 0

    def write(self, rows: Columns) -> bytes:
        """The message with these transforms, bit by bit.

        Raises InvalidArgumentException for a stamp that is not in the years 1901 to 2038, and for
        a name that is not valid Unicode.
        """
        edges = rows.edges_bytes()
        layout = self._layouts.get((rows.frames, edges))
        if layout is None:
            layout = _layout_of(rows)
            self._keep((rows.frames, edges), layout, rows.count)
        return layout.joined(rows)

    def _keep(self, key: tuple[tuple[str, ...], bytes], layout: "_Layout", rows: int) -> None:
        if len(self._layouts) >= _MOST_LAYOUTS or self._rows + rows > _MOST_ROWS:
            self._layouts.clear()
            self._rows = 0
        if rows <= _MOST_ROWS:
            self._layouts[key] = layout
            self._rows += rows


class TFMessageReader:
    """Reads messages; keeps the places of the numbers by the bytes around. Not thread-safe.

    Messages with the same frames get the same tuple of frames.
    """

    def __init__(self) -> None:
        # Of one transform: frames by the bytes of the names.
        self._names: dict[bytes, tuple[str, ...]] = {}
        # Of several: by the size of the message, the last found first.
        self._layouts: dict[int, list[_Layout]] = {}
        self._rows = 0
        # Hashes of the frames and edges that came once.
        self._once: set[int] = set()

    def read(self, data: bytes) -> Columns:
        """The transforms in a message, in the same order, bit by bit.

        Raises DecodeError if the bytes are no such message, a name is not UTF-8, or a stamp has
        a second or more of nanoseconds. The names are not judged otherwise, nor the numbers.
        """
        if (one := self.read_one(data)) is not None:
            frames, stamp_ns, pose = one
            edge = ONE_EDGE if len(frames) == 2 else _OWN_EDGE
            return Columns.of_bytes(frames, edge, packed.stamp_bytes(stamp_ns), pose)
        if data[:_STAMP_AT] == _HEAD_OF_ONE:
            return self._read_first(data, data[_NAMES_AT:-POSE_SIZE])
        alike = self._layouts.get(len(data))
        if alike is not None:
            for at, layout in enumerate(alike):
                if (found := layout.gathered(data)) is not None:
                    if at:
                        alike.insert(0, alike.pop(at))
                    return found
        return self._read_new(data)

    def read_one(self, data: bytes) -> tuple[tuple[str, ...], int, bytes] | None:
        """The frames of a message of one transform, its stamp, and its pose as columns have it:
        if `read` has met one with these names, and the stamp is one. None for any other.

        The frames are the parent and the child; or one that is both.
        """
        if data[:_STAMP_AT] != _HEAD_OF_ONE:
            return None
        frames = self._names.get(data[_NAMES_AT:-POSE_SIZE])
        if frames is None:
            return None
        seconds, nanoseconds = _STAMP.unpack_from(data, _STAMP_AT)
        if nanoseconds >= _SECOND_NS:
            return None
        pose = data[-POSE_SIZE:] if _AS_HERE else _swapped(data[-POSE_SIZE:], "d")
        return frames, seconds * _SECOND_NS + nanoseconds, pose

    def _read_first(self, data: bytes, names: bytes) -> Columns:
        rows, left = _read_slowly(data)
        # Only where the pose ends the message, as the fast way wants it.
        if not left and len(names) <= _LONGEST_NAMES:
            if len(self._names) >= _MOST_LAYOUTS:
                self._names.clear()
            self._names[names] = rows.frames
        return rows

    def _read_new(self, data: bytes) -> Columns:
        rows, left = _read_slowly(data)
        if not left and 2 <= rows.count <= _MOST_ROWS and data[:HEADER_SIZE] == HEADER:
            shape = hash((rows.frames, rows.edges_bytes()))
            if shape in self._once:
                self._keep(data, rows)
            elif len(self._once) >= _MOST_LAYOUTS:
                self._once.clear()
            self._once.add(shape)
        return rows

    def _keep(self, data: bytes, rows: Columns) -> None:
        """Keep the layout of a message that came twice: making it takes as long as reading one."""
        layout = _layout_of(rows)
        # Some writers leave anything between the fields: their messages are never alike.
        if layout.size != len(data) or layout.gathered(data) is None:
            return
        if self._rows + rows.count > _MOST_ROWS:
            self._layouts.clear()
            self._rows = 0
        alike = self._layouts.setdefault(len(data), [])
        alike.insert(0, layout)
        del alike[_MOST_ALIKE:]
        self._rows += rows.count


class _Layout:
    """The offsets of the numbers of a message, by its frames and edges.

    `names` are the bytes between the stamp and the pose of each row.
    """

    def __init__(self, frames: tuple[str, ...], edges: bytes, names: list[bytes]) -> None:
        self.frames = frames
        self.edges = edges
        self.names = names
        self.count = len(names)
        self.size = _STAMP_AT + (STAMP_SIZE + POSE_SIZE) * len(names) + sum(map(len, names))
        self._head = HEADER + len(names).to_bytes(4, "little")
        self._poses = struct.Struct(f"{POSE_SIZE}s" * len(names))
        self._words: tuple[NDArray[np.intp], bytes] | None = None

    def joined(self, rows: Columns) -> bytes:
        """The message with the numbers of these rows."""
        poses = _little_endian(rows.poses_bytes(), "d")
        if self.count == 1:
            (stamp,) = _stamps_of(rows)
            return b"".join((self._head, stamp, self.names[0], poses))
        parts = [b""] * (3 * self.count)
        parts[0::3] = _stamps_of(rows)
        parts[1::3] = self.names
        parts[2::3] = self._poses.unpack(poses)
        return self._head + b"".join(parts)

    def gathered(self, data: bytes) -> Columns | None:
        """The rows of a message of this size; None if it has other names, or a stamp that is
        none.
        """
        places, fixed = self._words or self._by_words()
        words, count = np.frombuffer(data, _WORD).take(places), self.count
        if words[16 * count :].tobytes() != fixed:
            return None
        nanoseconds = words[count : 2 * count]
        if nanoseconds.max() >= _SECOND_NS:
            return None
        stamps = words[:count].astype(np.int32) * np.int64(_SECOND_NS) + nanoseconds
        poses = _little_endian(words[2 * count : 16 * count].tobytes(), "d")
        return Columns.of_bytes(self.frames, self.edges, stamps.tobytes(), poses)

    def _by_words(self) -> "tuple[NDArray[np.intp], bytes]":
        """The places of all seconds, all nanoseconds, all poses, and of the rest; and the bytes of
        the rest.
        """
        stamp_at, pose_at, at = [], [], _STAMP_AT
        for names in self.names:
            stamp_at.append(at)
            pose_at.append(at + STAMP_SIZE + len(names))
            at = pose_at[-1] + POSE_SIZE
        empty = bytes(STAMP_SIZE), bytes(POSE_SIZE)
        text = b"".join([part for names in self.names for part in (empty[0], names, empty[1])])
        words = np.frombuffer(self._head + text, _WORD)
        stamps = np.array(stamp_at) // _WORD_SIZE
        poses = np.array(pose_at)[:, None] // _WORD_SIZE + np.arange(POSE_SIZE // _WORD_SIZE)
        numbers = np.concatenate((stamps, stamps + 1, poses.ravel()))
        is_fixed = np.ones(len(words), bool)
        is_fixed[numbers] = False
        places = np.concatenate((numbers, np.flatnonzero(is_fixed)))
        self._words = places, words[is_fixed].tobytes()
        return self._words


def _stamps_of(rows: Columns) -> list[bytes]:
    """The stamp of each row in CDR."""
    stamp = rows.last_stamp_ns() if rows.count == 1 else only_stamp(rows)
    if stamp is not None and EARLIEST_STAMP_NS <= stamp <= LATEST_STAMP_NS:
        return [_STAMP.pack(stamp // _SECOND_NS, stamp % _SECOND_NS)] * rows.count
    stamps = rows.stamps_as_ints() if stamp is None else [stamp]
    if stamps and not EARLIEST_STAMP_NS <= min(stamps) <= max(stamps) <= LATEST_STAMP_NS:
        raise _beyond(rows)
    if rows.count < _FEW:
        return [_STAMP.pack(*divmod(each, _SECOND_NS)) for each in stamps]
    words = np.empty((rows.count, 2), _WORD)
    seconds, words[:, 1] = np.divmod(rows.stamps_ns(), _SECOND_NS)
    words[:, 0] = seconds  # a negative one wraps around to its two's complement
    data = words.tobytes()
    return [data[at : at + STAMP_SIZE] for at in range(0, len(data), STAMP_SIZE)]


def _layout_of(rows: Columns) -> _Layout:
    frames = rows.frames
    edges = rows.edges_bytes()
    names = []
    at = _STAMP_AT
    for parent, child in rows.pairs():
        writer = CdrWriter()
        # All that matters of the bytes before is where the names begin.
        writer.data += bytes((at + STAMP_SIZE - HEADER_SIZE) % 8)
        start = len(writer.data)
        for name in (frames[parent], frames[child]):
            try:
                writer.text(name)
            except UnicodeEncodeError as error:
                raise InvalidArgumentException(
                    f"the frame '{printable(name, 60)}' is not valid Unicode: ROS messages cannot "
                    "have it"
                ) from error
        writer.align(8)
        names.append(bytes(writer.data[start:]))
        at += STAMP_SIZE + len(names[-1]) + POSE_SIZE
    return _Layout(frames, edges, names)


def _read_slowly(data: bytes) -> tuple[Columns, int]:
    """The transforms of a message that is not like one before, and how many bytes are left."""
    reader = CdrReader(data)
    index_of: dict[str, int] = {}
    edges, stamps, poses = [], [], []
    for _ in range(reader.count(_LEAST_SIZE)):
        stamps.append(_stamp(reader))
        parent = index_of.setdefault(reader.text(), len(index_of))
        child = index_of.setdefault(reader.text(), len(index_of))
        edges.append(packed.edge_bytes(parent, child))
        start = reader.skip(POSE_SIZE, 8)
        poses.append(data[start : reader.at])
    reader.finish()
    column = b"".join(poses)
    if (reader.order == "<") != _AS_HERE:
        column = _swapped(column, "d")
    rows = Columns.of_bytes(tuple(index_of), b"".join(edges), b"".join(stamps), column)
    return rows, reader.left


def _stamp(reader: CdrReader) -> bytes:
    seconds, nanoseconds = struct.unpack_from(
        f"{reader.order}iI", reader.data, reader.skip(STAMP_SIZE, 4)
    )
    if nanoseconds >= _SECOND_NS:
        raise DecodeError(
            f"a stamp has {nanoseconds} nanoseconds beside its seconds: less than 10^9 are allowed"
        )
    return packed.stamp_bytes(seconds * _SECOND_NS + nanoseconds)


def _beyond(rows: Columns) -> InvalidArgumentException:
    row = next(
        at
        for at, each in enumerate(rows.stamps_as_ints())
        if not EARLIEST_STAMP_NS <= each <= LATEST_STAMP_NS
    )
    frame = rows.frames[rows.pairs()[row][1]]
    stamp = stamp_text(rows.stamps_as_ints()[row])
    return InvalidArgumentException(
        f"the stamp {stamp} of frame '{printable(frame, 60)}' does not fit a ROS message, whose "
        "seconds have 32 bits: it must be from 1901 to 2038"
    )


def _little_endian(column: bytes, numbers: str) -> bytes:
    """The numbers of a column from this machine's byte order to little-endian, or back."""
    return column if _AS_HERE else _swapped(column, numbers)


def _swapped(column: bytes, numbers: str) -> bytes:
    swapped = array(numbers, column)
    swapped.byteswap()
    return swapped.tobytes()


# Many messages at once, all with the same frames in one step

_ONE = HEADER + b"\x01\x00\x00\x00"

# Below this number of messages reading each for itself is faster.
_FEW_MESSAGES = 4


def read_many(
    reader: TFMessageReader,
    messages: Sequence[bytes],
    children: Collection[str] | None = None,
) -> list[tuple[list[int], Columns]]:
    """The transforms of these messages with all child frames or these, bit by bit: groups of
    messages with the same frames, as their indices and the rows of all of them, each message's
    after the other's.

    Raises as `TFMessageReader.read`.
    """
    alike: dict[object, list[int]] = {}
    for at, data in enumerate(messages):
        # Names of one transform are between its numbers; names of several are compared later.
        is_one = data[:_STAMP_AT] == _ONE
        alike.setdefault(data[_NAMES_AT:-POSE_SIZE] if is_one else len(data), []).append(at)
    groups = []
    for members in alike.values():
        groups += _groups(reader, messages, members, children)
    return groups


def equal_parts(rows: Columns, count: int) -> Iterator[Columns]:
    """The rows in this number of parts with the same edges, one message each."""
    size = rows.count // count
    edges = rows.edges_bytes()[: EDGE_SIZE * size]
    stamps, poses = rows.stamps_bytes(), rows.poses_bytes()
    for start in range(0, size * count, size) if size else [0] * count:
        end = start + size
        yield Columns.of_bytes(
            rows.frames,
            edges,
            stamps[STAMP_SIZE * start : STAMP_SIZE * end],
            poses[POSE_SIZE * start : POSE_SIZE * end],
        )


def _groups(
    reader: TFMessageReader,
    messages: Sequence[bytes],
    members: list[int],
    children: Collection[str] | None,
) -> list[tuple[list[int], Columns]]:
    """The same of messages that have one size."""
    groups: list[tuple[list[int], Columns]] = []
    while len(members) >= _FEW_MESSAGES and len(groups) < _FEW_MESSAGES:
        found = _like_first(reader, [messages[at] for at in members], children)
        if found is None:
            break
        rows, taken = found
        groups.append(([at for at, is_in in zip(members, taken, strict=True) if is_in], rows))
        members = [at for at, is_in in zip(members, taken, strict=True) if not is_in]
    for at in members:
        rows = reader.read(messages[at])
        groups.append(([at], rows if children is None else rows.only(children)))
    return groups


def _like_first(
    reader: TFMessageReader, messages: list[bytes], children: Collection[str] | None
) -> tuple[Columns, list[bool]] | None:
    """The rows of the messages with the frames of the first, and which these are; None if the
    first is not as others are written, or a stamp is none.
    """
    first = reader.read(messages[0])
    if not first.count:
        return None
    places = _places(first.frames, first.edges_bytes(), len(messages[0]))
    if places is None or messages[0][:HEADER_SIZE] != HEADER:
        return None
    stamp_at, pose_at = places
    words = np.frombuffer(b"".join(messages), "<u4").reshape(len(messages), -1)
    is_fixed = np.ones(words.shape[1], bool)
    is_fixed[stamp_at] = is_fixed[stamp_at + 1] = is_fixed[pose_at] = False
    same = (words[:, is_fixed] == words[0, is_fixed]).all(axis=1)
    if not same.all():
        words = words[same]
    if words[:, stamp_at + 1].max() >= _SECOND_NS:
        return None
    edges = first.edges_bytes()
    if children is not None:
        pairs = np.frombuffer(edges, np.uint32).reshape(-1, 2)
        kept = np.array([frame in children for frame in first.frames], bool)[pairs[:, 1]]
        edges, stamp_at = pairs[kept].tobytes(), stamp_at[kept]
        pose_at = pose_at.reshape(len(kept), -1)[kept].ravel()
    nanoseconds = words[:, stamp_at + 1]
    stamps = words[:, stamp_at].astype(np.int32) * np.int64(_SECOND_NS) + nanoseconds
    poses = words[:, pose_at]
    if sys.byteorder != "little":
        poses = poses.astype("<u4").view("<f8").astype(np.float64)
    rows = Columns.of_bytes(first.frames, edges * len(words), stamps.tobytes(), poses.tobytes())
    return rows, same.tolist()


@lru_cache(256)
def _places(
    frames: tuple[str, ...], edges: bytes, size: int
) -> "tuple[NDArray[np.intp], NDArray[np.intp]] | None":
    """The offsets of the stamps and of the numbers of the poses in a message, in words of four
    bytes; None if the message has another size.
    """
    lengths = [len(name.encode()) + 1 for name in frames]
    stamp_at, pose_at, at = [], [], _STAMP_AT
    for edge in struct.iter_unpack("=2I", edges):
        stamp_at.append(at)
        at += STAMP_SIZE
        for frame in edge:
            at += -at % 4 + 4 + lengths[frame]
        at += (HEADER_SIZE - at) % 8
        pose_at.append(at)
        at += POSE_SIZE
    if at != size:
        return None
    of_pose = np.array(pose_at)[:, None] // 4 + np.arange(POSE_SIZE // 4)
    return np.array(stamp_at) // 4, of_pose.ravel()
