# cython: boundscheck=False, wraparound=False
"""Frames by their numbers, and poses in fewer bytes, as messages of version 2 have them.

A stream gives each pair of parent and child a number, which nothing else has in its epoch, and says
it in its description, with an origin: the pose that the frame had first. A pose is sent as the
difference from its origin, so that the joint of a robot is a rotation alone, and a robot that is
far from where its map begins needs no more bytes than any other.

Compiled if there is a C compiler (`numbered.pxd` has the C types).
"""

import math
import sys
from array import array
from bisect import bisect_left
from collections.abc import MutableSequence, Sequence

from tfbus.base import scheduler
from tfbus.geometry import packed
from tfbus.geometry.columns import Columns, rows_of
from tfbus.geometry.packed import EDGE_SIZE, POSE_SIZE, STAMP_SIZE, Pose
from tfbus.wire.descriptions import StreamDescription

# How one pose is sent. Below 8 it is compact: the two lowest bits say how many bytes each axis of
# the translation takes, 0, 2, 3 or 4, and the next whether a rotation follows.
_HAS_ROTATION, _SHORT, _WHOLE = 4, 8, 9
_ROTATION_SIZE, _SHORT_SIZE = 6, 28

# A compact translation is in steps of this size; the number of them fits into 32 bits up to this
# distance. Beyond the next one a float of 64 bits is no longer precise enough to add to.
_STEP_M, _STEPS_A_METRE = 1e-4, 1e4
_FARTHEST_M, _LARGEST_M = 214_748.0, 1e9
_LARGEST_OF_2, _LARGEST_OF_3 = 32_767, 8_388_607

# A compact rotation is the three smaller components of the quaternion in 15 bits each, and which
# one is missing. They are between -1/sqrt(2) and 1/sqrt(2).
_MIDDLE = 16_383
_STEPS_A_UNIT = _MIDDLE * math.sqrt(2.0)

# A rotation is that of the origin if the cosine of half the angle between them is less than this
# from 1: 0.006 degrees.
_SAME_ROTATION = 1.25e-9

# A quaternion whose squared norm is farther from 1 is sent as it is, for listeners to refuse.
_LARGEST_NORM_ERROR = 0.01

# A float of 32 bits is not larger.
_LARGEST_SHORT = 3.4e38

_NAN = float("nan")

# A message that could have more rows would be too large.
MOST_ROWS = 300_000

# The rows of messages that are alike are kept as long as they take about as much as the numbers of
# their stream: their bytes in memory, beside the bytes of their runs, and the most that they take.
_BYTES_OF_KIND, _BYTES_OF_ROW = 500, 120
_MOST_BYTES, _MOST_BYTES_A_NUMBER = 64 * 1024, 1000

IDENTITY = packed.pose_bytes((0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))


class NumberedRows:
    """The rows of messages that have the same numbers in the same order, of `count` rows.

    `frames`, `edges` and `origins` belong to the rows that are known. `known` are the places of
    these rows, None for all of them, and `unnamed` is how many others have numbers that the
    description does not have so far.
    """

    def __init__(
        self,
        frames: tuple[str, ...],
        edges: bytes,
        origins: bytes,
        count: int,
        known: list[int] | None,
        unnamed: int,
    ) -> None:
        self.frames = frames
        self.edges = edges
        self.origins = origins
        self.count = count
        self.known = known
        self.unnamed = unnamed

    def columns(self, stamps: bytes, forms: bytes, poses: bytes) -> Columns | None:
        """The rows that are known, or None if the bytes are not as many as it takes. One stamp
        is that of all rows, and one form that of all poses.
        """
        count = self.count
        if len(stamps) not in (STAMP_SIZE, STAMP_SIZE * count) or len(forms) not in (1, count):
            return None
        unpacked = unpack_poses(forms, poses, self.origins, count, self.known)
        if unpacked is None:
            return None
        if len(stamps) == STAMP_SIZE:
            stamps *= len(self.edges) // EDGE_SIZE
        elif self.known is not None:
            stamps = rows_of(stamps, 0, STAMP_SIZE, self.known)
        columns = Columns(self.frames, len(self.edges) // EDGE_SIZE)
        columns.edges, columns.stamps, columns.poses = self.edges, stamps, unpacked
        return columns


class FrameNumbers:
    """The numbers of a stream's frames in one epoch, as its description says them: each of `named`
    is a number, a parent and a child, and `origins` has their poses. `next_number` is the first
    that has not been given.
    """

    def __init__(
        self,
        epoch_ns: int,
        next_number: int,
        named: Sequence[tuple[int, str, str]],
        origins: bytes,
    ) -> None:
        self.epoch_ns = epoch_ns
        self.next_number = next_number
        self._named = {
            number: (parent, child, origins[POSE_SIZE * at : POSE_SIZE * (at + 1)])
            for at, (number, parent, child) in enumerate(named)
        }
        self._ascending = sorted(self._named)
        self._kinds: dict[bytes, NumberedRows] = {}
        self._bytes = 0
        self._lock = scheduler.Lock()

    def get(self, runs: bytes) -> NumberedRows | None:
        """The rows that were found before for these runs, as they stand in a message."""
        return self._kinds.get(runs)

    def find(
        self, runs: bytes, numbers: Sequence[int], epoch_ns: int, size: int
    ) -> NumberedRows | None:
        """The rows of a message of an epoch, of `size` bytes; `numbers` has for each run the first,
        and how many there are. None if no message can have them.
        """
        if len(numbers) % 2 or min(numbers, default=0) < 0 or sum(numbers[1::2]) > MOST_ROWS:
            return None
        is_ours = epoch_ns == self.epoch_ns
        ascending, given = (self._ascending, self.next_number) if is_ours else ([], 0)
        # Neither the time nor the memory that it takes depends on rows that have no names.
        parts: list[tuple[int, int, int]] = []
        count = named = unnamed = 0
        for first, length in zip(numbers[::2], numbers[1::2], strict=True):
            if not length:
                continue
            end = first + length
            begin, until = bisect_left(ascending, first), bisect_left(ascending, end)
            if begin < until:
                parts.append((begin, until, count - first))
            named += until - begin
            news = max(first, given)
            unnamed += max(0, end - news) - max(0, until - bisect_left(ascending, news, begin))
            count += length
        # A frame that comes twice takes a byte at least.
        if named > len(ascending) + size:
            return None
        index_of: dict[str, int] = {}
        edges, origins, known = [], [], []
        for begin, until, offset in parts:
            for number in ascending[begin:until]:
                parent, child, origin = self._named[number]
                above = index_of.setdefault(parent, len(index_of))
                below = index_of.setdefault(child, len(index_of))
                known.append(offset + number)
                edges.append(packed.edge_bytes(above, below))
                origins.append(origin)
        rows = NumberedRows(
            tuple(index_of),
            b"".join(edges),
            b"".join(origins),
            count,
            None if named == count else known,
            unnamed,
        )
        if is_ours and named <= len(ascending) + len(runs):
            self._keep(runs, rows, _BYTES_OF_KIND + len(runs) + named * _BYTES_OF_ROW)
        return rows

    def _keep(self, runs: bytes, rows: NumberedRows, size: int) -> None:
        """Keep rows that take so many bytes; if it is too much, all others are forgotten."""
        most = _MOST_BYTES + _MOST_BYTES_A_NUMBER * len(self._ascending)
        with self._lock:
            if size > most or runs in self._kinds:
                return
            if self._bytes + size > most:
                self._kinds.clear()
                self._bytes = 0
            self._kinds[runs] = rows
            self._bytes += size


# Before a stream has described its numbers.
NO_NUMBERS = FrameNumbers(-1, 0, (), b"")


def numbers_of(description: StreamDescription) -> FrameNumbers:
    """The frames that have numbers, by the description of their stream."""
    origins = description.origins
    if sys.byteorder != "little":
        swapped = array("d", origins)
        swapped.byteswap()
        origins = swapped.tobytes()
    return FrameNumbers(description.epoch, description.next_number, description.numbered, origins)


def origin_of(pose: bytes) -> bytes:
    """The origin of a frame whose first pose this is: normalised, or none if it is no pose."""
    values = packed.pose_at(pose, 0)
    norm = values[3] ** 2 + values[4] ** 2 + values[5] ** 2 + values[6] ** 2
    xyz, quat = values[:3], values[3:]
    is_near = all(abs(axis) <= _LARGEST_M for axis in xyz)
    if not is_near or not abs(norm - 1.0) <= _LARGEST_NORM_ERROR:
        return IDENTITY
    if norm == 1.0:
        return pose
    x, y, z, w = (each / math.sqrt(norm) for each in quat)
    return packed.pose_bytes((*xyz, x, y, z, w))


def pack_poses(poses: bytes, count: int, origins: bytes, is_short: bool) -> tuple[bytes, bytes]:
    """The forms of poses, one a byte, and the poses in these forms: each `is_short`, seven floats
    of 32 bits, or compact; one whose numbers do not fit is sent as it is.
    """
    forms = bytearray(count)
    room = bytearray(POSE_SIZE * count)
    forms_at, room_at = packed.octets_of(forms), packed.octets_of(room)
    at = 0
    for i in range(count):
        pose = packed.pose_at(poses, POSE_SIZE * i)
        origin = packed.pose_at(origins, POSE_SIZE * i)
        if is_short:
            form = _pack_short(room_at, at, pose, origin)
        else:
            form = _pack_compact(room_at, at, pose, origin)
        forms_at[i] = form
        at += _size_of(form)
    return bytes(forms), bytes(room[:at])


def unpack_poses(
    forms: bytes, data: bytes, origins: bytes, count: int, known: list[int] | None = None
) -> bytes | None:
    """The poses that `pack_poses` has packed; None if the bytes are not as many as the forms
    say, or a form is unknown. Only the poses at the `known` places of `count`, if it is not None,
    each with its origin.

    Of fewer forms than poses the first one holds for all.
    """
    if count == 0 or not forms:
        return None if data or count else b""
    wanted = len(origins) // POSE_SIZE
    made = packed.room_for_poses(wanted)
    poses = packed.floats_of(made)
    end = len(data)
    size = _size_of(forms[0])
    at = 0
    if len(forms) < count:
        if size < 0 or size * count != end:
            return None
        for i in range(wanted):
            row = i
            if known is not None:
                row = known[i]
            origin = packed.pose_at(origins, POSE_SIZE * i)
            _unpack(poses, 7 * i, forms[0], data, size * row, origin)
        return packed.bytes_of(made)
    row = 0
    for i in range(count):
        size = _size_of(forms[i])
        if size < 0 or size > end - at:
            return None
        if known is None or (row < wanted and known[row] == i):
            origin = packed.pose_at(origins, POSE_SIZE * row)
            _unpack(poses, 7 * row, forms[i], data, at, origin)
            row += 1
        at += size
    return packed.bytes_of(made) if at == end else None


def _size_of(form: int) -> int:
    """How many bytes a pose takes in a form; -1 for an unknown one."""
    if form < _SHORT:
        axis = form & 3
        size = 3 * (axis + 1) if axis else 0
        return size + _ROTATION_SIZE if form & _HAS_ROTATION else size
    if form == _SHORT:
        return _SHORT_SIZE
    return POSE_SIZE if form == _WHOLE else -1


def _pack_whole(room: MutableSequence[int], at: int, pose: Pose) -> int:
    packed.put(room, at, packed.bits_of(pose[0]), 8)
    packed.put(room, at + 8, packed.bits_of(pose[1]), 8)
    packed.put(room, at + 16, packed.bits_of(pose[2]), 8)
    packed.put(room, at + 24, packed.bits_of(pose[3]), 8)
    packed.put(room, at + 32, packed.bits_of(pose[4]), 8)
    packed.put(room, at + 40, packed.bits_of(pose[5]), 8)
    packed.put(room, at + 48, packed.bits_of(pose[6]), 8)
    return _WHOLE


def _pack_short(room: MutableSequence[int], at: int, pose: Pose, origin: Pose) -> int:
    x, y, z = pose[0] - origin[0], pose[1] - origin[1], pose[2] - origin[2]
    # Also False for NaN.
    if not (
        abs(x) <= _LARGEST_SHORT
        and abs(y) <= _LARGEST_SHORT
        and abs(z) <= _LARGEST_SHORT
        and abs(_norm_error(pose)) <= _LARGEST_NORM_ERROR
    ):
        return _pack_whole(room, at, pose)
    packed.put(room, at, packed.short_bits_of(x), 4)
    packed.put(room, at + 4, packed.short_bits_of(y), 4)
    packed.put(room, at + 8, packed.short_bits_of(z), 4)
    packed.put(room, at + 12, packed.short_bits_of(pose[3]), 4)
    packed.put(room, at + 16, packed.short_bits_of(pose[4]), 4)
    packed.put(room, at + 20, packed.short_bits_of(pose[5]), 4)
    packed.put(room, at + 24, packed.short_bits_of(pose[6]), 4)
    return _SHORT


def _pack_compact(room: MutableSequence[int], at: int, pose: Pose, origin: Pose) -> int:
    x, y, z = pose[0] - origin[0], pose[1] - origin[1], pose[2] - origin[2]
    farthest = max(abs(x), abs(y), abs(z))
    error = _norm_error(pose)
    # Also False for NaN; of several numbers and NaN, max may give either.
    if not (
        farthest <= _FARTHEST_M
        and x == x
        and y == y
        and z == z
        and abs(pose[0]) <= _LARGEST_M
        and abs(pose[1]) <= _LARGEST_M
        and abs(pose[2]) <= _LARGEST_M
        and abs(error) <= _LARGEST_NORM_ERROR
    ):
        return _pack_whole(room, at, pose)
    first = packed.nearest(x * _STEPS_A_METRE)
    second = packed.nearest(y * _STEPS_A_METRE)
    third = packed.nearest(z * _STEPS_A_METRE)
    most = max(abs(first), abs(second), abs(third))
    size = 4
    if most == 0:
        size = 0
    elif most <= _LARGEST_OF_2:
        size = 2
    elif most <= _LARGEST_OF_3:
        size = 3
    form = size - 1 if size else 0
    if size:
        packed.put(room, at, first, size)
        packed.put(room, at + size, second, size)
        packed.put(room, at + 2 * size, third, size)
    scale = 1.0 / math.sqrt(1.0 + error)
    qx, qy, qz, qw = pose[3] * scale, pose[4] * scale, pose[5] * scale, pose[6] * scale
    cosine = abs(qx * origin[3] + qy * origin[4] + qz * origin[5] + qw * origin[6])
    if 1.0 - cosine <= _SAME_ROTATION:
        return form
    packed.put(room, at + 3 * size, _rotation_bits(qx, qy, qz, qw), _ROTATION_SIZE)
    return form | _HAS_ROTATION


def _norm_error(pose: Pose) -> float:
    """By how much the squared norm of the quaternion differs from 1."""
    qx, qy, qz, qw = pose[3], pose[4], pose[5], pose[6]
    return qx * qx + qy * qy + qz * qz + qw * qw - 1.0


def _rotation_bits(qx: float, qy: float, qz: float, qw: float) -> int:
    """Which component is the largest, in two bits, and the others in 15 bits each."""
    a, b, c, largest, place = qx, qy, qz, qw, 3
    if abs(qx) >= abs(qy) and abs(qx) >= abs(qz) and abs(qx) >= abs(qw):
        a, b, c, largest, place = qy, qz, qw, qx, 0
    elif abs(qy) >= abs(qz) and abs(qy) >= abs(qw):
        a, b, c, largest, place = qx, qz, qw, qy, 1
    elif abs(qz) >= abs(qw):
        a, b, c, largest, place = qx, qy, qw, qz, 2
    # The same rotation with the other sign: the one that is missing is never negative.
    unit = -_STEPS_A_UNIT if largest < 0.0 else _STEPS_A_UNIT
    first = packed.nearest(a * unit) + _MIDDLE
    second = packed.nearest(b * unit) + _MIDDLE
    third = packed.nearest(c * unit) + _MIDDLE
    return place | first << 2 | second << 17 | third << 32


def _unpack(
    poses: MutableSequence[float], row: int, form: int, data: bytes, at: int, origin: Pose
) -> None:
    if form == _WHOLE:
        for i in range(7):
            poses[row + i] = packed.float_of(packed.little_endian_at(data, at + 8 * i, 8))
        return
    if form == _SHORT:
        for i in range(7):
            poses[row + i] = packed.short_float_of(packed.little_endian_at(data, at + 4 * i, 4))
        poses[row] += origin[0]
        poses[row + 1] += origin[1]
        poses[row + 2] += origin[2]
        return
    poses[row], poses[row + 1], poses[row + 2] = origin[0], origin[1], origin[2]
    axis = form & 3
    size = axis + 1 if axis else 0
    if size:
        poses[row] += packed.little_endian_at(data, at, size) * _STEP_M
        poses[row + 1] += packed.little_endian_at(data, at + size, size) * _STEP_M
        poses[row + 2] += packed.little_endian_at(data, at + 2 * size, size) * _STEP_M
    if not form & _HAS_ROTATION:
        poses[row + 3], poses[row + 4] = origin[3], origin[4]
        poses[row + 5], poses[row + 6] = origin[5], origin[6]
        return
    bits = packed.little_endian_at(data, at + 3 * size, _ROTATION_SIZE)
    a = ((bits >> 2 & 32767) - _MIDDLE) / _STEPS_A_UNIT
    b = ((bits >> 17 & 32767) - _MIDDLE) / _STEPS_A_UNIT
    c = ((bits >> 32 & 32767) - _MIDDLE) / _STEPS_A_UNIT
    square = 1.0 - a * a - b * b - c * c
    # No rotation has such bits: the buffer refuses NaN.
    largest = math.sqrt(square) if square >= 0.0 else _NAN
    place = bits & 3
    at = 3
    for i in range(4):
        if i == place:
            poses[row + 3 + i] = largest
        else:
            poses[row + 3 + i] = a if at == 3 else b if at == 4 else c
            at += 1
