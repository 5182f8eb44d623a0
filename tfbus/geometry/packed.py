"""Numbers and texts at a place of some bytes.

Numbers are in the byte order of the machine unless their name says more.

Each function is there twice: this file is for the interpreted kernel, and `packed.pxd` is the same
in C. Compiled modules inline functions of other modules from a .pxd only; so each becomes one load
of the processor; a call would pass a pose of 56 bytes for each row of a batch.
"""

import math
from array import array
from collections.abc import MutableSequence, Sequence
from struct import pack, unpack, unpack_from
from typing import TypeVar

Pose = tuple[float, float, float, float, float, float, float]
_Number = TypeVar("_Number", int, float)


# Of one transform, in bytes.
EDGE_SIZE = 8
STAMP_SIZE = 8
POSE_SIZE = 56

# Of one transform alone: frame 0 is the parent, frame 1 the child.
ONE_EDGE = pack("=2I", 0, 1)


def edge_at(data: bytes, at: int) -> tuple[int, int]:
    """Two unsigned integers of 32 bits: the indices of a parent and of a child."""
    parent, child = unpack_from("=2I", data, at)
    return parent, child


def stamp_at(data: bytes, at: int) -> int:
    """A signed integer of 64 bits."""
    stamp: int = unpack_from("=q", data, at)[0]
    return stamp


def pose_at(data: bytes, at: int) -> Pose:
    """Seven floats of 64 bits: x y z qx qy qz qw."""
    pose: Pose = unpack_from("=7d", data, at)
    return pose


def int64(number: int) -> int:
    """The number as a signed integer of 64 bits; the least of these if it is none."""
    return number if -(2**63) <= number < 2**63 else -(2**63)


def fetch_pose(poses: Sequence[float], at: int) -> None:
    """Prefetch a pose of seven numbers into the processor's caches; nothing here."""


def edge_bytes(parent: int, child: int) -> bytes:
    """The edge that `edge_at` reads."""
    return pack("=2I", parent, child)


def stamp_bytes(stamp_ns: int) -> bytes:
    """The stamp that `stamp_at` reads."""
    return pack("=q", stamp_ns)


def pose_bytes(pose: Pose) -> bytes:
    """The pose that `pose_at` reads."""
    return pack("=7d", *pose)


def big_endian_at(data: bytes, at: int, size: int) -> int:
    """An unsigned integer of `size` bytes, 8 at most, the greatest first."""
    return int.from_bytes(data[at : at + size], "big")


def put(data: MutableSequence[int], at: int, number: int, size: int) -> None:
    """Write the last `size` bytes of an integer, 8 at most, the least first."""
    data[at : at + size] = list((number & (1 << 8 * size) - 1).to_bytes(size, "little"))


def little_endian_at(data: bytes, at: int, size: int) -> int:
    """A signed integer of `size` bytes, 8 at most, the least first."""
    return int.from_bytes(data[at : at + size], "little", signed=True)


def bits_of(number: float) -> int:
    """The bits of a float of 64 bits, as a signed integer."""
    bits: int = unpack("=q", pack("=d", number))[0]
    return bits


def float_of(bits: int) -> float:
    """The float whose bits `bits_of` gives."""
    number: float = unpack("=d", pack("=q", bits))[0]
    return number


def short_bits_of(number: float) -> int:
    """The bits of the nearest float of 32 bits, as a signed integer; it has to be in its range."""
    bits: int = unpack("=i", pack("=f", number))[0]
    return bits


def short_float_of(bits: int) -> float:
    """The float whose bits `short_bits_of` gives."""
    number: float = unpack("=f", pack("=i", bits))[0]
    return number


def nearest(number: float) -> int:
    """The nearest integer of a float that is smaller than 2**62."""
    return math.floor(number + 0.5)


def unset(like: "array[_Number]", count: int) -> "array[_Number]":
    """An array of the type of another; in C with any numbers, so that memory which is not used yet
    is not touched.
    """
    return array(like.typecode, bytes(like.itemsize * count))


def room_for_poses(count: int) -> "array[float]":
    """Room for poses, which are set by `floats_of` and read by `bytes_of`; in C it is bytes, with
    any numbers.
    """
    return array("d", bytes(POSE_SIZE * count))


def floats_of(room: "array[float]") -> MutableSequence[float]:
    """The floats of such room."""
    return room


def bytes_of(room: "array[float]") -> bytes:
    """The bytes of such room, which is not set any more."""
    return room.tobytes()


def octets_of(room: bytearray) -> MutableSequence[int]:
    """The bytes, to be set; in C in their place, which takes no view."""
    return room


def is_at(data: bytes, at: int, text: bytes, size: int) -> bool:
    """Whether the `size` bytes from there are the text's."""
    return data[at : at + size] == text


def are_texts(some: tuple[str, ...], others: tuple[str, ...]) -> bool:
    """Whether two tuples have equal texts, which mostly are the same ones."""
    return some == others


def text_at(data: bytes, at: int, size: int) -> str:
    """A text in UTF-8. Raises UnicodeDecodeError if it is not."""
    return data[at : at + size].decode()
