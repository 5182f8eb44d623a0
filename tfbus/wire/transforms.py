"""Transforms as bytes: one msgpack map of columns a message, stated in docs/reference/wire.md.

Messages are written and read column by column, without a Python object for each transform.
"""

import struct
import sys
from array import array
from collections.abc import Sequence
from typing import Any

import msgpack

from tfbus.base.errors import DecodeError
from tfbus.base.wording import counted
from tfbus.geometry.columns import Columns
from tfbus.geometry.packed import EDGE_SIZE, POSE_SIZE, STAMP_SIZE
from tfbus.wire.codec import decode_map
from tfbus.wire.fleet import FrameNames
from tfbus.wire.numbered import MOST_ROWS, FrameNumbers, pack_poses
from tfbus.wire.transform_bytes import (
    FAST,
    NUMBERED,
    VERSION,
    NameTables,
    OneMessage,
    OneNumbered,
    scan_message,
)
from tfbus.wire.transform_bytes import TransformMessage as TransformMessage

# The bytes of MessagePack before an integer of eight bytes. Each `seq` is written so, since packing
# it by msgpack would take as long as the columns.
_UINT64 = b"\xcf"

# The types of the numbers in a column, as array has them; messages are little-endian.
_EDGES, _STAMPS, _POSES = "I", "q", "d"


def encode_transforms(message: TransformMessage) -> bytes:
    """The payload of one message."""
    rows = message.rows
    encoder = TransformEncoder(message.epoch_ns, rows.frames, rows.edges_bytes())
    return encoder.encode(message.seq, rows.stamps_bytes(), rows.poses_bytes())


class TransformEncoder:
    """Writes messages with the same epoch, frames and edges, which are encoded once.

    `edges` are bytes in the byte order of this machine, as in Columns.
    """

    def __init__(self, epoch_ns: int, frames: Sequence[str], edges: bytes) -> None:
        pack = msgpack.Packer().pack
        common = [pack("v"), pack(VERSION), pack("epoch"), pack(epoch_ns)]
        common += [
            pack("frames"),
            pack(frames),
            pack("edges"),
            pack(_little_endian(edges, _EDGES)),
        ]
        count = len(edges) // EDGE_SIZE
        self._uncounted = b"".join([b"\x86", *common])
        self._counted = b"".join([b"\x87", *common, pack("seq"), _UINT64])
        self._stamps = pack("stamps") + _bin_header(count * STAMP_SIZE)
        self._poses = pack("poses") + _bin_header(count * POSE_SIZE)

    def of_one(self, frame_id: str, child_frame_id: str) -> OneMessage:
        """Writes the same counted messages, of the one edge between these frames, in less time."""
        return OneMessage(frame_id, child_frame_id, (self._counted, self._stamps, self._poses))

    def encode(self, seq: int | None, stamps: bytes, poses: bytes) -> bytes:
        """The payload of one message: a stamp and a pose for each edge, as bytes in the byte order
        of this machine.
        """
        columns = (
            self._stamps,
            _little_endian(stamps, _STAMPS),
            self._poses,
            _little_endian(poses, _POSES),
        )
        if seq is None:
            return b"".join((self._uncounted, *columns))
        return b"".join((self._counted, seq.to_bytes(8, "big"), *columns))


class NumberedEncoder:
    """As TransformEncoder, of version 2: with the numbers of rows instead of names, and each pose
    less its origin, in floats of 32 bits if it `is_short`, or compact.
    """

    def __init__(
        self, epoch_ns: int, numbers: Sequence[int], origins: bytes, *, is_short: bool
    ) -> None:
        pack = self._pack = msgpack.Packer().pack
        common = [pack("v"), pack(NUMBERED), pack("epoch"), pack(epoch_ns)]
        common += [pack("runs"), pack(runs_of(numbers))]
        self._head = b"".join([b"\x87", *common, pack("seq")])
        self._stamps, self._forms, self._poses = pack("stamps"), pack("forms"), pack("poses")
        self._count = len(numbers)
        self._are_once = len(set(numbers)) == len(numbers)
        self._origins = origins
        self._is_short = is_short

    def of_one(self, frame_id: str, child_frame_id: str) -> OneNumbered:
        """Writes the same messages, of the one number of these frames, in less time."""
        forms = self._forms + _bin_header(1)
        # Before the size of a pose, which fits into one byte.
        poses = self._poses + _bin_header(0)[:1]
        fixed = self._head, self._stamps, forms, poses
        return OneNumbered(
            frame_id, child_frame_id, fixed, self._origins, self._is_short, self._pack
        )

    def encode(self, seq: int | None, stamps: bytes, poses: bytes) -> bytes:
        """The payload of one message: a stamp and a pose for each number, as bytes in the byte
        order of this machine.
        """
        count = self._count
        forms, poses = pack_poses(poses, count, self._origins, self._is_short)
        first = stamps[:STAMP_SIZE]
        if count and stamps == first * count and first[-1] < 0x80:
            column = self._pack(int.from_bytes(first, sys.byteorder))
        else:
            stamps = _little_endian(stamps, _STAMPS)
            column = _bin_header(len(stamps)) + stamps
        # A frame that comes more than once takes a byte at least: `FrameNumbers.find`.
        if forms == forms[:1] * count and (poses or self._are_once):
            forms = forms[:1]
        return b"".join(
            (
                self._head,
                self._pack(seq or 0),
                self._stamps,
                column,
                self._forms,
                _bin_header(len(forms)),
                forms,
                self._poses,
                _bin_header(len(poses)),
                poses,
            )
        )


_NUMBERED_HEAD: bytes = msgpack.packb("v") + msgpack.packb(NUMBERED)


def is_numbered(payload: bytes) -> bool:
    """Whether a message, as tfbus writes it, has numbers instead of names."""
    return payload[1 : 1 + len(_NUMBERED_HEAD)] == _NUMBERED_HEAD


def runs_of(numbers: Sequence[int]) -> list[int]:
    """The first of each run of numbers that follow each other, and how many there are in it."""
    runs: list[int] = []
    for number in numbers:
        if runs and number == runs[-2] + runs[-1]:
            runs[-1] += 1
        else:
            runs += [number, 1]
    return runs


def decode_transforms(payload: bytes, numbers: FrameNumbers | None = None) -> TransformMessage:
    """The message in a payload; of version 2 with the `numbers` of the stream's frames.

    Raises DecodeError if the payload is not a message of a version that this tfbus reads, or if its
    frames have numbers, and there are none of them. Unknown keys are ignored. The buffer judges the
    poses themselves.
    """
    columns = decode_map(payload)
    version = columns.get("v")
    if type(version) is not int or version not in (VERSION, NUMBERED):
        raise DecodeError(
            f"a transform message of version {version!r:.40}; this tfbus reads versions "
            f"{VERSION} and {NUMBERED}: update the older of the two"
        )
    if version == NUMBERED:
        return _decode_numbered(columns, numbers, len(payload))
    frames = columns.get("frames")
    if not isinstance(frames, list) or not all(isinstance(name, str) for name in frames):
        raise DecodeError("'frames' is not a list of texts")
    epoch_ns = columns.get("epoch")
    if type(epoch_ns) is not int:
        raise DecodeError("'epoch' is not an integer of nanoseconds")
    seq = _seq(columns)
    edges = _column(columns, "edges", EDGE_SIZE, _EDGES)
    stamps = _column(columns, "stamps", STAMP_SIZE, _STAMPS)
    poses = _column(columns, "poses", POSE_SIZE, _POSES)
    rows = Columns.of_bytes(tuple(frames), edges, stamps, poses)
    for name, column, size in (("edges", edges, EDGE_SIZE), ("poses", poses, POSE_SIZE)):
        if len(column) != size * rows.count:
            raise DecodeError(
                f"{name!r} has {counted(len(column) // size, 'row')}, 'stamps' {rows.count}: each "
                "transform has one in both"
            )
    highest = max(memoryview(edges).cast("I"), default=-1)
    if highest >= len(frames):
        raise DecodeError(f"an edge names frame {highest}, but there are only {len(frames)} frames")
    return TransformMessage(rows, epoch_ns, seq)


def _decode_numbered(
    columns: dict[str, Any], numbers: FrameNumbers | None, size: int
) -> TransformMessage:
    if numbers is None:
        raise DecodeError("its frames have numbers, and static transforms have names")
    epoch_ns, runs = columns.get("epoch"), columns.get("runs")
    if type(epoch_ns) is not int:
        raise DecodeError("'epoch' is not an integer of nanoseconds")
    seq = _seq(columns)
    if not isinstance(runs, list) or not all(type(each) is int for each in runs):
        raise DecodeError("'runs' is not a list of integers")
    stamps = _stamps(columns)
    forms, poses = columns.get("forms"), columns.get("poses")
    if not isinstance(forms, bytes) or not isinstance(poses, bytes):
        raise DecodeError("'forms' or 'poses' is not bytes")
    rows = numbers.find(msgpack.packb(runs), runs, epoch_ns, size)
    if rows is None:
        raise DecodeError(
            "'runs' must be pairs of a number and how many follow, 0 or more each, and of at most "
            f"{MOST_ROWS:,} rows, of which those with names are no more than the stream has "
            "numbers and the message bytes"
        )
    stamps = _little_endian(stamps, _STAMPS) if len(stamps) % STAMP_SIZE == 0 else stamps
    found = rows.columns(stamps, forms, poses)
    if found is None:
        raise DecodeError(
            f"'stamps', 'forms' and 'poses' do not have the bytes of {counted(rows.count, 'row')}"
        )
    return TransformMessage(found, epoch_ns, seq, rows.unnamed)


def _stamps(columns: dict[str, Any]) -> bytes:
    stamps = columns.get("stamps")
    if type(stamps) is int and -(2**63) <= stamps < 2**63:
        stamps = stamps.to_bytes(STAMP_SIZE, "little", signed=True)
    if not isinstance(stamps, bytes):
        raise DecodeError("'stamps' is neither an integer of 64 bits with a sign nor bytes")
    return stamps


def _seq(columns: dict[str, Any]) -> int | None:
    seq = columns.get("seq")
    if type(seq) is not int and "seq" in columns:
        raise DecodeError("'seq' is not an integer")
    return seq


def newest_stamp(payload: bytes) -> int | None:
    """The newest stamp in a message, None without rows, whatever the names of its frames are.
    Raises DecodeError as `decode_transforms`.
    """
    if not is_numbered(payload):
        return max(decode_transforms(payload).rows.stamps_as_ints(), default=None)
    stamps = _column({"stamps": _stamps(decode_map(payload))}, "stamps", STAMP_SIZE, _STAMPS)
    return max(memoryview(stamps).cast("q"), default=None)


class TransformReader:
    """Reads messages of transforms; safe from any thread.

    It answers as `decode_transforms`, but thirty times as fast if tfbus is compiled: a message
    of one transform takes 0.4 us instead of 12 us, one of fifty 0.6 us instead of 16 us.

    Frames get the names that `names` gives them; None leaves them as they are. Readers may share
    the `tables` of names that they keep.
    """

    def __init__(
        self,
        names: FrameNames | None = None,
        tables: NameTables | None = None,
    ) -> None:
        self._names = names if names is not None and names.namespace else None
        self._tables = NameTables() if tables is None else tables

    def read(self, payload: bytes, numbers: FrameNumbers | None = None) -> TransformMessage:
        """The message in a payload. Raises DecodeError as `decode_transforms`."""
        message = scan_message(payload, self._tables, numbers) if FAST else None
        if message is None:
            message = decode_transforms(payload, numbers)
        if self._names is not None:
            message = message.with_frames(self._names.all_outside(message.rows.frames))
        return message


def in_order_of_messages(poses: bytes) -> bytes:
    """Poses in the byte order of messages."""
    return _little_endian(poses, _POSES)


def _bin_header(size: int) -> bytes:
    """The bytes of MessagePack before `size` bytes of binary."""
    if size < 2**8:
        return struct.pack(">BB", 0xC4, size)
    return struct.pack(">BH", 0xC5, size) if size < 2**16 else struct.pack(">BI", 0xC6, size)


def _column(columns: dict[str, Any], name: str, size: int, numbers: str) -> bytes:
    data = columns.get(name)
    if not isinstance(data, bytes) or len(data) % size:
        raise DecodeError(f"{name!r} is not bytes in rows of {size}")
    return _little_endian(data, numbers)


def _little_endian(column: bytes, numbers: str) -> bytes:
    """The numbers of a column from this machine's byte order into messages' order, or back."""
    if sys.byteorder == "little":
        return column
    swapped = array(numbers, column)
    swapped.byteswap()
    return swapped.tobytes()
