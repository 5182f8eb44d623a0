"""Foxglove's FrameTransform and FrameTransforms as columns: of JSON, protobuf, or values by name.

https://docs.foxglove.dev/docs/sdk/schemas/frame-transform has the fields.
"""

import json
import math
import struct
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from tfbus.base.errors import DecodeError
from tfbus.geometry.columns import Columns
from tfbus.geometry.packed import edge_bytes, pose_bytes, stamp_bytes

_NS_PER_S = 1_000_000_000
_NO_TURN = (0.0, 0.0, 0.0, 1.0)

# The wire types of protobuf.
_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5
_FIXED_SIZES = {_FIXED64: 8, _FIXED32: 4}

# parent, child, stamp in ns, translation x y z, rotation x y z w
_Row = tuple[str, str, int, Sequence[float], Sequence[float]]


def json_map(data: bytes) -> dict[str, Any]:
    """A message in JSON. Raises DecodeError if it is none."""
    try:
        values = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise DecodeError(f"a message is not JSON: {error}") from error
    if not isinstance(values, dict):
        raise DecodeError(f"a message is a {type(values).__name__} in JSON, not a map")
    return values


def of_json(data: bytes) -> Columns:
    """The transforms of a message in JSON. Raises DecodeError if it is none."""
    return of_values(json_map(data))


def of_values(values: Any) -> Columns:
    """The transforms of a message by the names of its fields. Raises DecodeError if it is
    none.
    """
    try:
        rows = values.get("transforms", [values])
        return _columns([_row_of_values(row) for row in rows])
    except (AttributeError, KeyError, TypeError, ValueError, OverflowError, struct.error) as error:
        raise DecodeError(
            f"a message is no FrameTransform of Foxglove ({type(error).__name__}: {error})"
        ) from error


def of_protobuf(data: bytes, *, many: bool) -> Columns:
    """The transforms of a message in protobuf: of FrameTransforms with `many`, else of
    FrameTransform. Raises DecodeError if it is none.
    """
    try:
        if not many:
            return _columns([_row_of_protobuf(data)])
        return _columns([_row_of_protobuf(part) for field, part in _fields(data) if field == 1])
    except (AttributeError, TypeError, ValueError, struct.error) as error:
        raise DecodeError(f"a message is no FrameTransform in protobuf: {error}") from error


def _columns(rows: Sequence[_Row]) -> Columns:
    index_of: dict[str, int] = {}
    edges, stamps, poses = [], [], []
    for parent, child, stamp_ns, (x, y, z), (qx, qy, qz, qw) in rows:
        edges.append(
            edge_bytes(
                index_of.setdefault(parent, len(index_of)),
                index_of.setdefault(child, len(index_of)),
            )
        )
        stamps.append(stamp_bytes(stamp_ns))
        poses.append(pose_bytes((x, y, z, qx, qy, qz, qw)))
    return Columns.of_bytes(tuple(index_of), b"".join(edges), b"".join(stamps), b"".join(poses))


def _row_of_values(values: Mapping[str, Any]) -> _Row:
    translation, rotation = values.get("translation") or {}, values.get("rotation")
    return (
        _name(values["parent_frame_id"]),
        _name(values["child_frame_id"]),
        ns_of(values.get("timestamp") or {}),
        _numbers(translation, "xyz"),
        _NO_TURN if rotation is None else _numbers(rotation, "xyzw"),
    )


def ns_of(stamp: Mapping[str, Any]) -> int:
    """A stamp of Foxglove's, of ROS 1 or of ROS 2, in ns. Raises TypeError for no whole numbers."""
    nanoseconds = stamp.get("nsec", stamp.get("nanosec", 0))
    return _whole(stamp.get("sec", 0)) * _NS_PER_S + _whole(nanoseconds)


def _name(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError("the name of a frame is no text")
    value.encode()  # half of a letter cannot be written
    return value


def _whole(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise TypeError("a time is no whole number")
    return value


def _numbers(values: Mapping[str, Any], names: str) -> list[float]:
    # JSON has no NaN; Foxglove writes null.
    return [
        math.nan if values.get(name, 0.0) is None else float(values.get(name, 0.0))
        for name in names
    ]


def _row_of_protobuf(data: bytes) -> _Row:
    """Of a field that comes twice the last counts; one that is missing is zero."""
    fields = dict(_fields(data))
    stamp = dict(_fields(fields.get(1, b"")))
    seconds, nanoseconds = stamp.get(1, 0), stamp.get(2, 0)
    if isinstance(seconds, bytes) or isinstance(nanoseconds, bytes):
        raise ValueError("its timestamp is none")
    rotation = fields.get(5)
    return (
        fields.get(2, b"").decode(),
        fields.get(3, b"").decode(),
        _signed(seconds) * _NS_PER_S + _signed(nanoseconds),
        _doubles(fields.get(4, b""), 3),
        _NO_TURN if rotation is None else _doubles(rotation, 4),
    )


def _doubles(data: bytes, count: int) -> list[float]:
    numbers = [0.0] * count
    for field, value in _fields(data):
        if 1 <= field <= count:
            (numbers[field - 1],) = struct.unpack("<d", value)
    return numbers


def _signed(number: int) -> int:
    """The bytes that protobuf's int32 and int64 write for a negative number."""
    return number - 2**64 if number >= 2**63 else number


def _fields(data: bytes) -> Iterator[tuple[int, Any]]:
    """The fields of a message: number, and value: int of a varint, bytes of all others."""
    at = 0
    while at < len(data):
        key, at = _varint(data, at)
        kind = key & 7
        if kind == _VARINT:
            number, at = _varint(data, at)
            yield key >> 3, number
            continue
        if kind == _BYTES:
            size, at = _varint(data, at)
        elif kind in _FIXED_SIZES:
            size = _FIXED_SIZES[kind]
        else:
            raise ValueError(f"wire type {kind}")
        if size > len(data) - at:
            raise ValueError("a field is longer than the message")
        yield key >> 3, data[at : at + size]
        at += size


def _varint(data: bytes, at: int) -> tuple[int, int]:
    number = 0
    for shift in range(0, 70, 7):
        if at >= len(data):
            raise ValueError("a number is cut")
        byte = data[at]
        at += 1
        number |= (byte & 0x7F) << shift
        if byte < 0x80:
            return number & 0xFFFFFFFFFFFFFFFF, at
    raise ValueError("a number of more than 64 bits")
