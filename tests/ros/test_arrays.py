"""Long lists of numbers in messages of ROS as arrays: of a scan, a grid or a cloud."""

import struct
import tracemalloc
from array import array
from typing import Any

import numpy as np
import pytest

from tfbus import DecodeError
from tfbus.ros.counterparts import fitted
from tfbus.ros.definitions import Definition
from tfbus.ros.message_type import message_of
from tfbus.ros.schema import MessageCodec
from tfbus.ros.value_codec import UnfitError

TYPES = {
    "bool": "?",
    "int8": "b",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
COUNT = 300_000


def definition(type_name: str) -> Definition:
    """A message with a number before the list, so that it is not aligned by itself."""
    return Definition("a/msg/T", f"uint8 before\n{type_name}[] x\nuint8 after\n")


def codec(type_name: str) -> MessageCodec:
    return MessageCodec.of_definition(definition(type_name))


def message(x: Any) -> dict[str, Any]:
    return {"before": 1, "x": x, "after": 2}


def test_an_array_and_a_list_of_the_same_numbers_are_the_same_bytes() -> None:
    """Of each type of number, also if there is none; read they are an array with its type."""
    for name, code in TYPES.items():
        for numbers in (np.arange(5).astype(code), np.empty(0, code)):
            data = codec(name).encode(message(numbers))
            assert data is not None
            assert data == codec(name).encode(message(numbers.tolist())), name
            if code != "?":
                assert data == codec(name).encode(message(array(code, numbers.tobytes())))
            read = codec(name).decode(data, arrays=True)
            assert read["x"].dtype == numbers.dtype and read["x"].tolist() == numbers.tolist()
            assert (read["before"], read["after"]) == (1, 2)
            assert codec(name).decode(data)["x"] == numbers.tolist()


@pytest.mark.parametrize("count", [16_383, 16_384, 16_389, 40_001])
def test_numbers_behind_large_arrays_are_aligned(count: int) -> None:
    """Arrays that are joined with the rest at the end have the same bytes as lists, two as well."""
    fields = "uint8[] octets\nfloat64 x\nint16[] numbers\nstring text\nint8[] more\nint64 last\n"
    of_all = MessageCodec.of_definition(Definition("a/msg/Mixed", fields))
    octets = np.arange(count).astype(np.uint8)
    numbers = np.arange(count).astype(np.int16)
    more = octets.view(np.int8)
    rest = {"x": 0.5, "text": "abc", "last": -(2**60)}

    def encoded(octets: Any, numbers: Any, more: Any) -> bytes | None:
        arrays = {"octets": octets, "numbers": numbers, "more": more}
        order = ("octets", "x", "numbers", "text", "more", "last")
        return of_all.encode({name: (rest | arrays)[name] for name in order})

    data = encoded(octets, numbers, more)
    assert data is not None
    assert data == encoded(octets.tobytes(), numbers.tolist(), more.tolist())
    read = of_all.decode(data, arrays=True)
    assert {name: read[name] for name in rest} == rest
    assert bytes(read["octets"]) == octets.tobytes()
    assert (read["numbers"] == numbers).all() and (read["more"] == more).all()


def test_a_message_in_the_other_byte_order_has_the_same_array() -> None:
    """The array is in this machine's order."""
    data = b"\0\0\0\0" + struct.pack(">B3xI2fB", 1, 2, 0.5, 1.5, 2)
    read = codec("float32").decode(data, arrays=True)["x"]
    assert read.tolist() == [0.5, 1.5] and read.dtype == np.float32 and read.dtype.isnative


def test_arrays_share_the_memory_of_the_message() -> None:
    """Nothing is taken for each number, in either direction."""
    points = np.random.default_rng(1).random(COUNT)
    of_points = codec("float64")
    data = of_points.encode(message(points))
    assert data is not None
    tracemalloc.start()
    try:
        read = of_points.decode(data, arrays=True)["x"]
        assert tracemalloc.get_traced_memory()[1] < 100_000
        tracemalloc.clear_traces()
        written = of_points.encode(message(read))
        assert tracemalloc.get_traced_memory()[1] < 6 * len(data)
    finally:
        tracemalloc.stop()
    assert written == data
    assert (read == points).all() and not read.flags.writeable


@pytest.mark.parametrize("count", [2**20, 2**31, 2**32 - 1])
def test_a_count_without_its_numbers_takes_no_memory(count: int) -> None:
    """It is refused before an array is made."""
    data = b"\0\1\0\0" + struct.pack("<B3xI8x", 1, count)
    with pytest.raises(DecodeError):
        codec("float32").decode(data, arrays=True)


def test_an_array_of_other_numbers_is_not_of_the_type() -> None:
    """Nor one of two dimensions; a sliced one is."""
    numbers = np.arange(6.0)
    assert codec("float32").encode(message(numbers)) is None
    assert codec("float64").encode(message(numbers.reshape(2, 3))) is None
    assert codec("float64").encode(message(numbers[::2])) == codec("float64").encode(
        message([0.0, 2.0, 4.0])
    )
    assert codec("int32").encode(message(numbers)) is None


def test_arrays_of_a_program_are_made_to_fit() -> None:
    """Floats are rounded to 32 bits; a number that none of 32 bits is near is refused."""
    type_ = message_of(definition("float32"))
    rounded = fitted({"x": np.array([0.1, np.inf])}, type_)["x"]
    assert rounded.dtype == np.float32 and rounded[0] == np.float32(0.1)
    with pytest.raises(UnfitError, match="x has a number"):
        fitted({"x": np.array([1e300])}, type_)
    same = np.arange(3, dtype=np.float32)
    assert fitted({"x": same}, type_)["x"] is same
