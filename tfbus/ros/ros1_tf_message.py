"""TFMessage of ROS 1 as bytes: little-endian, without alignment, with a sequence number each."""

import struct
import sys
from array import array

from tfbus.core.packed import POSE_SIZE, edge_bytes, stamp_bytes
from tfbus.errors import DecodeError
from tfbus.geometry.columns import Columns
from tfbus.wording import printable

_NS_PER_S = 1_000_000_000

_U32 = struct.Struct("<I")
# Of a header: sequence number, seconds and nanoseconds, and the length of frame_id.
_HEAD = struct.Struct("<4I")
# What a transform takes with empty names.
_LEAST_SIZE = _HEAD.size + _U32.size + POSE_SIZE


def decode_ros1_tf_message(data: bytes) -> Columns:
    """The transforms of a tf2_msgs/TFMessage, or tf/tfMessage, as ROS 1 serializes it.

    Raises DecodeError where the bytes are no such message.
    """
    if len(data) < _U32.size:
        raise DecodeError(f"{len(data)} bytes are no TFMessage of ROS 1: it begins with a count")
    (count,) = _U32.unpack_from(data)
    if count * _LEAST_SIZE > len(data) - _U32.size:
        raise DecodeError(f"{count} transforms, and only {len(data) - _U32.size} bytes follow")
    index_of: dict[str, int] = {}
    edges, stamps, poses = [], [], []
    at = _U32.size
    try:
        for _ in range(count):
            _, seconds, nanoseconds, size = _HEAD.unpack_from(data, at)
            parent, at = _text(data, at + _HEAD.size, size)
            (size,) = _U32.unpack_from(data, at)
            child, at = _text(data, at + _U32.size, size)
            edges.append(
                edge_bytes(
                    index_of.setdefault(parent, len(index_of)),
                    index_of.setdefault(child, len(index_of)),
                )
            )
            stamps.append(stamp_bytes(seconds * _NS_PER_S + nanoseconds))
            poses.append(data[at : at + POSE_SIZE])
            at += POSE_SIZE
    except struct.error as error:
        raise DecodeError("the message ends within a transform") from error
    if at != len(data):
        what = "ends within a transform" if at > len(data) else "has more bytes than its type"
        raise DecodeError(f"the message {what}")
    return Columns.of_bytes(
        tuple(index_of), b"".join(edges), b"".join(stamps), _in_machine_order(b"".join(poses))
    )


def _text(data: bytes, at: int, size: int) -> tuple[str, int]:
    """A text, and where it ends."""
    end = at + size
    if end > len(data):
        raise DecodeError("the message ends within a name")
    try:
        return data[at:end].decode(), end
    except UnicodeDecodeError as error:
        shown = printable(data[at:end].decode(errors="backslashreplace"), 60)
        raise DecodeError(f"the name '{shown}' is not UTF-8") from error


def _in_machine_order(poses: bytes) -> bytes:
    if sys.byteorder == "little":
        return poses
    numbers = array("d", poses)
    numbers.byteswap()
    return numbers.tobytes()
