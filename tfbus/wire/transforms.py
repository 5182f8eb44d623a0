"""Transforms as bytes: one msgpack map of columns a message, stated in docs/reference/wire.md.

A batch is written and read column by column, without a Python object for each transform.
"""

import struct
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import msgpack
import numpy as np
from numpy.typing import NDArray

from tfbus.errors import DecodeError, InvalidArgumentException
from tfbus.geometry.batch import TransformBatch
from tfbus.wire.codec import decode_map

VERSION = 1

# What MessagePack puts before an integer of eight bytes. Each `seq` is written so, since a packer
# made for it would take as long as its columns.
_UINT64 = b"\xcf"

# Of one transform: indices of parent and child in `frames`; the stamp; x y z qx qy qz qw.
_EDGE = np.dtype("<u4")
_STAMP = np.dtype("<i8")
_POSE = np.dtype("<f8")


@dataclass(frozen=True, eq=False)
class TransformMessage:
    """What one message of a stream says.

    `epoch_ns` is when its publisher started, in nanoseconds since the Unix epoch: a larger one
    than before means that the publisher was started again, or that its clock went back. `seq`
    counts the messages of its key in this epoch from 0; None where the publisher does not count.
    """

    batch: TransformBatch
    epoch_ns: int
    seq: int | None = None


def encode_transforms(message: TransformMessage) -> bytes:
    """The payload of one message."""
    batch = message.batch
    encoder = TransformEncoder(message.epoch_ns, batch.frames, batch.edges)
    return encoder.encode(message.seq, batch.stamps_ns.tobytes(), batch.poses.tobytes())


class TransformEncoder:
    """Writes messages that have their epoch, frames and edges in common: these are encoded once.

    `edges` are as a TransformBatch has them.
    """

    def __init__(self, epoch_ns: int, frames: Sequence[str], edges: NDArray[np.uint32]) -> None:
        pack = msgpack.Packer().pack
        common = [pack("v"), pack(VERSION), pack("epoch"), pack(epoch_ns)]
        common += [
            pack("frames"),
            pack(frames),
            pack("edges"),
            pack(edges.astype(_EDGE, copy=False).tobytes()),
        ]
        count = len(edges)
        self._uncounted = b"".join([b"\x86", *common])
        self._counted = b"".join([b"\x87", *common, pack("seq"), _UINT64])
        self._stamps = pack("stamps") + _bin_header(count * _STAMP.itemsize)
        self._poses = pack("poses") + _bin_header(count * 7 * _POSE.itemsize)

    @property
    def fixed(self) -> tuple[bytes, bytes, bytes]:
        """What all numbered messages have in common: up to their number, which takes eight bytes;
        from there to the stamps; and from there to the poses.
        """
        return self._counted, self._stamps, self._poses

    def encode(self, seq: int | None, stamps: bytes, poses: bytes) -> bytes:
        """The payload of one message: as many stamps and poses as there are edges, as the bytes
        of their columns on this machine.
        """
        if sys.byteorder == "big":
            stamps = np.frombuffer(stamps, np.int64).astype(_STAMP).tobytes()
            poses = np.frombuffer(poses, np.float64).astype(_POSE).tobytes()
        columns = (self._stamps, stamps, self._poses, poses)
        if seq is None:
            return b"".join((self._uncounted, *columns))
        return b"".join((self._counted, seq.to_bytes(8, "big"), *columns))


def decode_transforms(payload: bytes) -> TransformMessage:
    """The message in a payload; the columns are views of it, not copies.

    Raises DecodeError where the payload is not a message of a version that we read. Keys that
    we do not know are ignored. The numbers themselves are judged by the buffer.
    """
    columns = decode_map(payload)
    version = columns.get("v")
    if type(version) is not int or version != VERSION:
        raise DecodeError(
            f"a transform message of version {version!r:.40}; this tfbus reads version "
            f"{VERSION}: update the older of the two"
        )
    frames = columns.get("frames")
    if not isinstance(frames, list) or not all(isinstance(name, str) for name in frames):
        raise DecodeError("'frames' is not a list of texts")
    epoch_ns = columns.get("epoch")
    if type(epoch_ns) is not int:
        raise DecodeError("'epoch' is not an integer of nanoseconds")
    seq = columns.get("seq")
    if seq is not None and type(seq) is not int:
        raise DecodeError("'seq' is not an integer")
    try:
        batch = TransformBatch(
            tuple(frames),
            _column(columns, "edges", _EDGE, 2).astype(np.uint32, copy=False),
            _column(columns, "stamps", _STAMP, 1).reshape(-1).astype(np.int64, copy=False),
            _column(columns, "poses", _POSE, 7).astype(np.float64, copy=False),
        )
    except InvalidArgumentException as error:
        raise DecodeError(str(error)) from error
    return TransformMessage(batch, epoch_ns, seq)


def _bin_header(size: int) -> bytes:
    """What MessagePack puts before so many bytes of binary."""
    if size < 2**8:
        return struct.pack(">BB", 0xC4, size)
    return struct.pack(">BH", 0xC5, size) if size < 2**16 else struct.pack(">BI", 0xC6, size)


def _column(columns: dict[str, Any], name: str, dtype: np.dtype[Any], width: int) -> Any:
    data = columns.get(name)
    if not isinstance(data, bytes) or len(data) % (dtype.itemsize * width):
        raise DecodeError(f"{name!r} is not bytes in rows of {dtype.itemsize * width}")
    return np.frombuffer(data, dtype).reshape(-1, width)
