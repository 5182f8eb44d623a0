"""Spoilt messages of ROS: whatever the bytes, a DecodeError or a message, and no large memory."""

import random
import struct
import tracemalloc
from typing import Any

import pytest

from tests.builders import at
from tfbus import DecodeError
from tfbus.geometry.columns import Columns
from tfbus.ros.definitions import TF_MESSAGE, Definition
from tfbus.ros.schema import RAW, MessageCodec
from tfbus.ros.tf_message import TFMessageReader, TFMessageWriter

# What a wrong count or length is likely to be.
_COUNTS = (0, 1, 2, 3, 7, 255, 65_536, 10**9, 2**31 - 1, 2**31, 2**32 - 1)

_SEPARATOR = "=" * 80
_SOME_TYPES = Definition(
    "a/msg/T",
    f"B[] parts\nfloat32[3] three\nstring[] names\nbool[] flags\nuint8[] raw\nNone none\n"
    f"B[2] two\nNone[] nothing\n{_SEPARATOR}\nMSG: a/B\nfloat64 x\nint16[] y\n"
    f"{_SEPARATOR}\nMSG: a/None\n",
)


def transforms(count: int) -> list[bytes]:
    """The message with `count` transforms, and one of the same size with other names."""
    rows = [at(0.1 * row, f"joint{row}", 10**18 + row) for row in range(count)]
    others = [at(0.1 * row, f"wheel{row}", 10**18 + row) for row in range(count)]
    return [TFMessageWriter().write(Columns.of_transforms(each)) for each in (rows, others)]


def big_endian() -> bytes:
    """The message with one transform, in the other byte order."""
    names = b"\0\0\0\2a\0\0\0" + b"\0\0\0\2b\0" + bytes(6)
    return bytes(4) + struct.pack(">IiI", 1, 2, 3) + names + struct.pack(">7d", *range(7))


def spoilt(data: bytes, chance: random.Random) -> bytes:
    """The bytes with one to three mistakes."""
    changed = bytearray(data)
    for _ in range(chance.randint(1, 3)):
        place = chance.randrange(len(changed) + 1)
        how = chance.randrange(6)
        if how == 0:
            del changed[place:]
        elif how == 1:
            changed[place:place] = chance.randbytes(chance.randrange(9))
        elif how == 2:
            changed[place : place + 1] = chance.randbytes(1)
        elif how == 3:
            del changed[place : place + chance.randrange(9)]
        else:
            place -= place % 4
            changed[place : place + 4] = struct.pack("<I", chance.choice(_COUNTS))
    return bytes(changed)


def contents(rows: Columns) -> tuple[Any, ...]:
    """All that rows say, to the last bit."""
    columns = (rows.edges_bytes(), rows.stamps_bytes(), rows.poses_bytes())
    return rows.frames, rows.count, *columns


def test_spoilt_transforms_are_read_or_refused(pytestconfig: pytest.Config) -> None:
    """A reader that has seen other messages reads what a new one reads, and refuses what it
    refuses.
    """
    chance = random.Random(1)
    samples = [each for count in (0, 1, 1, 2, 8, 30) for each in transforms(count)]
    samples.append(big_endian())
    reader = TFMessageReader()
    for each in samples * 2:
        reader.read(each)
    read = 0
    for _ in range(pytestconfig.getoption("--fuzz-messages") // 2):
        data = spoilt(chance.choice(samples), chance)
        try:
            expected = contents(TFMessageReader().read(data))
        except DecodeError:
            with pytest.raises(DecodeError):
                reader.read(data)
        else:
            assert contents(reader.read(data)) == expected
            read += 1
    assert read


def test_spoilt_messages_of_topics_are_read_or_refused(pytestconfig: pytest.Config) -> None:
    """Messages of any type are read as values that fit the type, or refused."""
    chance = random.Random(2)
    part = {"x": 0.5, "y": [1, 2, 3]}
    values: dict[str, Any] = {
        "parts": [part] * 3,
        "three": [0.0, 1.0, 2.0],
        "names": ["a", "bcd", ""],
        "flags": [True, False],
        "raw": b"12345",
        "none": {},
        "two": [part] * 2,
        "nothing": [{}] * 3,
    }
    codec = MessageCodec.of_definition(_SOME_TYPES)
    transforms_codec = MessageCodec.of_definition(TF_MESSAGE)
    own = MessageCodec.of_values("T", {**values, "empty": [], "any": None, "map": {"é": [[1]]}})
    samples = [(transforms_codec, each) for each in transforms(3)]
    for each, message in [
        (codec, values),
        (own, {**values, "empty": [], "any": None, "map": {"é": [[1]]}}),
        (RAW, values),
    ]:
        data = each.encode(message)
        assert data is not None
        samples.append((each, data))
    read = 0
    for _ in range(pytestconfig.getoption("--fuzz-messages") // 2):
        each, data = chance.choice(samples)
        try:
            found = each.decode(spoilt(data, chance))
        except DecodeError:
            continue
        assert isinstance(found, dict)
        read += 1
    assert read


def test_spoilt_definitions_are_read_or_refused(pytestconfig: pytest.Config) -> None:
    """The text of a definition may be anything too."""
    chance = random.Random(3)
    for _ in range(pytestconfig.getoption("--fuzz-messages") // 40):
        data = spoilt(chance.choice((_SOME_TYPES, TF_MESSAGE)).text.encode(), chance)
        try:
            codec = MessageCodec.of_definition(Definition("a/msg/T", data.decode(errors="replace")))
            codec.decode(b"\0\1\0\0" + chance.randbytes(200))
        except DecodeError:
            continue


def doubled() -> Definition:
    """A definition that doubles a byte thirty times."""
    parts = [f"A{at + 1} a\nA{at + 1} b\n{_SEPARATOR}\nMSG: a/A{at + 1}\n" for at in range(30)]
    return Definition("a/msg/A0", "".join(parts) + "uint8 x\n")


@pytest.mark.parametrize("count", [2**20, 2**31 - 1, 2**32 - 1])
@pytest.mark.parametrize(
    "definition",
    [
        TF_MESSAGE,
        Definition("a/msg/T", "float64[] x\n"),
        Definition("a/msg/T", "uint8[] x\n"),
        Definition("a/msg/T", "string x\n"),
        Definition("a/msg/T", "string[] x\n"),
        Definition("a/msg/T", "bool[] x\n"),
        Definition("a/msg/T", "float64[999999999] x\n"),
        Definition("a/msg/T", "string[999999999] x\n"),
        Definition("a/msg/T", f"N[] x\n{_SEPARATOR}\nMSG: a/N\n"),
        Definition("a/msg/T", f"N[999999999] x\n{_SEPARATOR}\nMSG: a/N\n"),
        doubled(),
    ],
    ids=range(11),
)
def test_a_large_count_takes_no_memory(definition: Definition, count: int) -> None:
    """A message that says it has more items than bytes is refused before they are made."""
    data = b"\0\1\0\0" + struct.pack("<I", count) + b"\0" * 64
    codec = MessageCodec.of_definition(definition)
    tracemalloc.start()
    try:
        with pytest.raises(DecodeError):
            codec.decode(data)
        if definition is TF_MESSAGE:
            with pytest.raises(DecodeError):
                TFMessageReader().read(data)
        assert tracemalloc.get_traced_memory()[1] < 100_000
    finally:
        tracemalloc.stop()


def test_a_message_of_more_than_a_million_values_is_refused() -> None:
    """Each takes up to a hundred bytes: maps, texts, and the values in MessagePack."""
    maps = Definition("a/msg/T", f"N[] x\n{_SEPARATOR}\nMSG: a/N\n")
    texts = Definition("a/msg/T", "string[] x\n")
    packed = Definition("tfbus_msgs/msg/T", "Msgpack[] x\n")
    blob = b"\xdc\xea\x60" + b"\x80" * 60_000
    blobs = (struct.pack("<I", len(blob)) + blob + bytes(-len(blob) % 4)) * 20
    for definition, count, items in [
        (maps, 1_000_001, bytes(1_000_001)),
        (texts, 1_000_001, bytes(4) * 1_000_001),
        (packed, 20, blobs),
    ]:
        codec = MessageCodec.of_definition(definition)
        with pytest.raises(DecodeError, match="more than 1000000 values"):
            codec.decode(b"\0\1\0\0" + struct.pack("<I", count) + items)
