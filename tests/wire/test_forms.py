"""Messages of the form of the one before, which are made and read without a look at each field."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import msgpack
import numpy as np
import pytest

from tfbus.base.errors import BusError, DecodeError
from tfbus.messages import (
    Image,
    LaserScan,
    PointCloud,
)
from tfbus.wire.codec import decode_message, encode_message
from tfbus.wire.forms import Decoder, Encoder

STAMP_NS = 1_790_000_000_123_456_789


def cloud(stamp_ns: int = STAMP_NS, seed: int = 1, count: int = 3, frame: str = "lidar") -> Any:
    """A cloud of random points."""
    xyz = np.random.default_rng(seed).random((count, 3), np.float32)
    return PointCloud.from_xyz(stamp_ns, frame, xyz)


def image(stamp_ns: int = STAMP_NS, seed: int = 1, frame: str = "camera") -> Any:
    """An image of random pixels."""
    pixels = np.random.default_rng(seed).integers(0, 255, (2, 3, 3), np.uint8)
    return Image.from_pixels(stamp_ns, frame, pixels)


LATER_NS = STAMP_NS + 7_654_321_987


def outcome(decode: Callable[[bytes], Any], data: bytes) -> Any:
    """The message, or why there is none."""
    try:
        return decode(data)
    except DecodeError as error:
        return str(error)


@pytest.mark.parametrize(
    "messages",
    [
        [cloud(), cloud(LATER_NS, 2), cloud(LATER_NS, 3, 5), cloud(LATER_NS, 4, 5), cloud(0)],
        [cloud(frame="\u00a4data"), cloud(LATER_NS, 2, frame="\u00a4data")],
        [cloud(), replace(cloud(LATER_NS, 2), is_dense=1), replace(cloud(), height=1.0)],
        [cloud(count=0), cloud(LATER_NS, count=0), cloud(count=2000), cloud(LATER_NS, 2, 2000)],
        [cloud(), cloud(1_790_000_000_000_000_001), cloud(2**62 + 5), cloud(LATER_NS, 2)],
        [image(), image(LATER_NS, 2), image(LATER_NS, 3, "other"), image(STAMP_NS, 4, "other")],
        [LaserScan(STAMP_NS, "laser", ranges=np.ones(4)), LaserScan(LATER_NS, "laser")],
    ],
)
def test_bytes_and_messages_are_those_of_a_message_alone(messages: list[Any]) -> None:
    """Whatever came before."""
    encoder, decoder = Encoder(type(messages[0])), Decoder(type(messages[0]))
    for message in messages * 2:
        data = encoder.encode(message)
        assert data == encode_message(message)
        read = outcome(decoder.decode, data)
        alone = outcome(partial(decode_message, type(message)), data)
        assert read == alone
        for name in ("data", "ranges"):
            if (array := getattr(read, name, None)) is not None:
                assert array.dtype == getattr(alone, name).dtype
                assert not array.flags.writeable


@pytest.mark.parametrize("message", [cloud(), image()])
def test_each_changed_byte_is_read_as_without_a_message_before(message: Any) -> None:
    """A hostile payload gains nothing by being like the last one."""
    data, alone = encode_message(message), partial(decode_message, type(message))
    decoder = Decoder(type(message))
    decoder.decode(data)
    for at in range(len(data)):
        for value in (0x00, 0x7F, 0xCF, 0xFF, data[at] ^ 1):
            changed = data[:at] + bytes((value,)) + data[at + 1 :]
            assert outcome(decoder.decode, changed) == outcome(alone, changed), (at, value)
            decoder = Decoder(type(message))
            decoder.decode(data)


@pytest.mark.parametrize("order", ["header last", "two of one", "frame first"])
def test_maps_in_another_order_are_read_as_ever(order: str) -> None:
    """Programs in other languages write them as they like."""
    decoder = Decoder(PointCloud)
    for message in (cloud(), cloud(LATER_NS, 2), cloud(STAMP_NS, 3)):
        values = msgpack.unpackb(encode_message(message))
        if order == "header last":
            values["header"] = values.pop("header")
        if order == "frame first":
            header = values["header"]
            values["header"] = {"frame_id": header["frame_id"], "stamp": header["stamp"]}
        data = msgpack.packb(values)
        if order == "two of one":
            again = msgpack.packb({"data": values["data"][::-1]})[1:]
            data = bytes((data[0] + 1,)) + data[1:] + again
        assert decoder.decode(data) == decode_message(PointCloud, data)


@dataclass(frozen=True, slots=True, eq=False)
class Tinted(PointCloud):
    """A cloud with one more field."""

    tint: int = 0


def test_a_message_of_a_subclass_keeps_its_fields() -> None:
    """On a publisher of the class above, too."""
    one = cloud()
    given = {name: getattr(one, name) for name in PointCloud.__dataclass_fields__ if name[0] != "_"}
    encoder = Encoder(PointCloud)
    encoder.encode(one)
    tinted = Tinted(**{k: v for k, v in given.items() if not k.isupper()}, tint=5)
    assert encoder.encode(tinted) == encode_message(tinted)
    assert Decoder(Tinted).decode(encode_message(tinted)).tint == 5


def test_a_stamp_that_is_no_integer_is_refused_as_ever() -> None:
    """It is not sent as one."""
    encoder = Encoder(PointCloud)
    encoder.encode(cloud())
    wrong: Any = np.int64(LATER_NS)
    for _ in range(2):
        with pytest.raises((BusError, TypeError)) as expected:
            encode_message(cloud(wrong))
        with pytest.raises(type(expected.value)):
            encoder.encode(cloud(wrong))
