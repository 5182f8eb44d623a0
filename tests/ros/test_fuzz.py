"""Spoilt messages of ROS: whatever the bytes, a DecodeError or a message, and no large memory."""

import struct
import tracemalloc

import pytest

from tests.processes.fuzz_cdr import fuzz
from tfbus import DecodeError
from tfbus.messages import RobotDescription
from tfbus.ros import value_codec
from tfbus.ros.definitions import SEPARATOR, TF_MESSAGE, Definition
from tfbus.ros.schema import MessageCodec
from tfbus.ros.tf_message import TFMessageReader
from tfbus.wire.codec import as_map


def test_spoilt_messages_are_read_or_refused() -> None:
    """Of 2,000 spoilt messages each is read as what it is, or refused by a DecodeError."""
    report = fuzz(seed=1, payloads=2_000)
    assert report["read"] + report["refused"] == 2_000
    assert min(report["read"], report["refused"]) > 500
    assert report["definitions read"] > 15


def test_a_description_that_is_deep_is_taken_as_it_is() -> None:
    """What stands in its comment may be lists in lists without end."""
    description = RobotDescription("<robot/>\n<!-- tfbus: " + 5_000 * "[" + " -->", "", "")
    values = as_map(description)
    codec = MessageCodec.of_type(RobotDescription)
    assert codec.decode(b"\0\1\0\0" + _text(values["urdf"])) == values


def _text(text: str) -> bytes:
    return struct.pack("<I", len(text) + 1) + text.encode() + b"\0"


def doubled() -> Definition:
    """A definition that doubles a byte thirty times."""
    parts = [f"A{at + 1} a\nA{at + 1} b\n{SEPARATOR}\nMSG: a/A{at + 1}\n" for at in range(30)]
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
        Definition("a/msg/T", f"N[] x\n{SEPARATOR}\nMSG: a/N\n"),
        Definition("a/msg/T", f"N[999999999] x\n{SEPARATOR}\nMSG: a/N\n"),
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


@pytest.fixture
def most(monkeypatch: pytest.MonkeyPatch) -> int:
    """The most values of a message: a million, and fewer here."""
    assert value_codec.MOST_ITEMS == 1_000_000
    monkeypatch.setattr(value_codec, "MOST_ITEMS", 20_000)
    return 20_000


def test_a_message_of_more_than_a_million_values_is_refused(most: int) -> None:
    """Each takes up to a hundred bytes: maps, texts, and the values in MessagePack."""
    maps = Definition("a/msg/T", f"N[] x\n{SEPARATOR}\nMSG: a/N\n")
    texts = Definition("a/msg/T", "string[] x\n")
    packed = Definition("tfbus_msgs/msg/T", "Msgpack[] x\n")
    blob = b"\xdc" + struct.pack(">H", most - 10) + b"\x80" * (most - 10)
    blobs = (struct.pack("<I", len(blob)) + blob + bytes(-len(blob) % 4)) * 20
    for definition, count, items in [
        (maps, most + 1, bytes(most + 1)),
        (texts, most + 1, bytes(4) * (most + 1)),
        (packed, 20, blobs),
    ]:
        codec = MessageCodec.of_definition(definition)
        with pytest.raises(DecodeError, match=f"more than {most} values"):
            codec.decode(b"\0\1\0\0" + struct.pack("<I", count) + items)


def test_too_many_numbers_are_refused_before_they_are_made() -> None:
    """Each takes forty bytes; of one byte eight: maps of 100 million cells are read."""
    codec = MessageCodec.of_definition(Definition("a/msg/T", "int16[] x\n"))
    data = b"\0\1\0\0" + struct.pack("<I", 33_000_000) + bytes(66_000_000)
    tracemalloc.start()
    try:
        with pytest.raises(DecodeError, match="too many numbers, 33,000,000"):
            codec.decode(data)
        assert tracemalloc.get_traced_memory()[1] < 100_000
    finally:
        tracemalloc.stop()


def test_integers_of_one_byte_share_their_objects() -> None:
    """They are what they were, and a million of them takes 8 MB, whatever they are."""
    codec = MessageCodec.of_definition(Definition("a/msg/T", "int8[] x\n"))
    expected = [*range(-128, 128)] * 4096
    data = codec.encode({"x": expected})
    assert data is not None
    tracemalloc.start()
    try:
        found = codec.decode(data)["x"]
        assert tracemalloc.get_traced_memory()[0] < 10_000_000
    finally:
        tracemalloc.stop()
    assert found == expected


def test_numbers_beside_each_other_count_too(most: int) -> None:
    """A list of messages of a thousand numbers each has fewer of them."""
    fields = "".join(f"uint8 x{number}\n" for number in range(1000))
    nested = Definition("a/msg/T", f"N[] x\n{SEPARATOR}\nMSG: a/N\n{fields}")
    count = most // 25
    data = b"\0\1\0\0" + struct.pack("<I", count) + bytes(count * 1000)
    with pytest.raises(DecodeError, match=f"more than {most} values"):
        MessageCodec.of_definition(nested).decode(data)
