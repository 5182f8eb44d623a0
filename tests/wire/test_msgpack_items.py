"""Payloads of very many values are refused before any of them is made."""

import struct

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tfbus.base.errors import DecodeError
from tfbus.wire.codec import decode_map, too_many_items, values_in

texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=300)
scalars = (
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**64 - 1)
    | st.floats()
    | texts
    | st.binary(max_size=300)
    | st.builds(msgpack.ExtType, st.integers(0, 127), st.binary(max_size=300))
)
values = st.recursive(
    scalars,
    lambda inner: st.lists(inner, max_size=20) | st.dictionaries(texts, inner, max_size=20),
    max_leaves=60,
)


def count(value: object) -> int:
    """How many values this is, with those in it, and the keys of maps."""
    if isinstance(value, list):
        return 1 + sum(map(count, value))
    if isinstance(value, dict):
        return 1 + sum(1 + count(inner) for inner in value.values())
    return 1


@given(values)
def test_every_value_of_a_payload_is_counted(value: object) -> None:
    """Each format of msgpack counts as what msgpack makes of it."""
    payload = msgpack.packb(value)
    assert values_in(payload, count(value)) == count(value)
    assert values_in(payload, count(value) - 1) > count(value) - 1


@pytest.mark.parametrize("single_float", [False, True])
def test_floats_of_both_sizes_are_counted(single_float: bool) -> None:
    """A list of numbers may have floats of four bytes."""
    payload = msgpack.packb([1.5] * 100, use_single_float=single_float)
    assert values_in(payload, 101) <= 101
    assert values_in(payload, 100) > 100


@pytest.mark.parametrize(
    "payload",
    [
        b"\x81\xa1a\xdd" + struct.pack(">I", 8_000_000) + b"\x80" * 8_000_000,
        b"\x81\xa1a\xdd" + struct.pack(">I", 8_000_000) + b"\x90" * 8_000_000,
        b"\x81\xa1a" + b"\x91" * 8_000_000,
        b"\x81\xa1a" + b"\xdd\x00\x0f\xff\xff" * 500 + b"\x80" * 100_000,
        b"\x81\xa1a\x9f" + (b"\xdc\xff\xff" + b"\xa2ab" * 65535) * 15 + b"\xc0" * 50_000,
    ],
    ids=["maps", "arrays", "nested", "announced", "texts"],
)
def test_a_message_of_too_many_values_is_refused(payload: bytes) -> None:
    """Several megabytes of empty maps would take a hundred times as much memory."""
    with pytest.raises(DecodeError):
        decode_map(payload)


def test_a_large_message_of_few_values_is_read() -> None:
    """An image, or half a million numbers, is no attack."""
    message = {"image": bytes(6_000_000), "ranges": [0.5] * 500_000}
    payload = msgpack.packb(message)
    assert too_many_items(payload) == ""
    assert decode_map(payload) == message


def _packed(head: int, size: int, width: int) -> bytes:
    """A value whose length is written in so many bytes, and then comes."""
    return bytes([head]) + size.to_bytes(width, "big") + _inside(size)


def _inside(size: int) -> bytes:
    """Each of these bytes would begin fifteen values."""
    return b"\x9f" * size


@pytest.mark.parametrize(
    "value",
    [
        *(bytes([0xA0 + size]) + _inside(size) for size in (0, 1, 31)),
        *(
            _packed(head, 300 % 256**width, width)
            for head, width in ((0xD9, 1), (0xDA, 2), (0xDB, 4))
        ),
        *(
            _packed(head, 300 % 256**width, width)
            for head, width in ((0xC4, 1), (0xC5, 2), (0xC6, 4))
        ),
        *(
            _packed(head, 7, width) + _inside(1)
            for head, width in ((0xC7, 1), (0xC8, 2), (0xC9, 4))
        ),
        *(bytes([0xD4 + at]) + _inside(1 + 2**at) for at in range(5)),
        *(
            bytes([0xCA + at]) + _inside(size)
            for at, size in enumerate((4, 8, 1, 2, 4, 8, 1, 2, 4, 8))
        ),
        *(bytes([head]) for head in (0x00, 0x7F, 0xC0, 0xC2, 0xC3, 0xE0, 0xFF)),
    ],
    ids=lambda value: f"{value[0]:02x}-{len(value)}",
)
def test_a_value_of_any_kind_is_one(value: bytes) -> None:
    """The next begins right behind it."""
    assert values_in(b"\x93" + value + b"\x92\x01\x02" + value, 1000) == 6
