"""Transforms as bytes: one msgpack map of columns a message, stated in docs/wire.md.

A batch is written and read column by column, without a Python object for each transform.
"""

from dataclasses import dataclass
from typing import Any

import msgpack
import numpy as np

from tfbus.batch import TransformBatch
from tfbus.codec import decode_map
from tfbus.errors import DecodeError, InvalidArgumentException

VERSION = 1

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
    columns = {
        "v": VERSION,
        "epoch": message.epoch_ns,
        "frames": batch.frames,
        "edges": batch.edges.astype(_EDGE, copy=False).tobytes(),
        "stamps": batch.stamps_ns.astype(_STAMP, copy=False).tobytes(),
        "poses": batch.poses.astype(_POSE, copy=False).tobytes(),
    }
    if message.seq is not None:
        columns["seq"] = message.seq
    payload: bytes = msgpack.packb(columns)
    return payload


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


def _column(columns: dict[str, Any], name: str, dtype: np.dtype[Any], width: int) -> Any:
    data = columns.get(name)
    if not isinstance(data, bytes) or len(data) % (dtype.itemsize * width):
        raise DecodeError(f"{name!r} is not bytes in rows of {dtype.itemsize * width}")
    return np.frombuffer(data, dtype).reshape(-1, width)
