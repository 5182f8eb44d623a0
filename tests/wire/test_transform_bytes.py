"""Scanning a message of transforms: it reads the same as decoding, or leaves it to decoding."""

import struct
from typing import Any

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.builders import EPOCH_NS, SAMPLE, at, messages, poses, rows_of
from tfbus import Buffer, DecodeError, Transform, TransformBatch, TransformStamped
from tfbus.geometry.columns import Columns
from tfbus.wire.transform_bytes import NameTables, scan_message
from tfbus.wire.transforms import (
    TransformMessage,
    TransformReader,
    decode_transforms,
    encode_transforms,
)

Contents = tuple[int, int | None, tuple[str, ...], bytes, bytes, bytes]


frames_of_edges = st.sampled_from([("world", "turtle1"), ("turtle1", "drone"), ("a", "world")])


def decoded(payload: bytes) -> Contents | None:
    """What `decode_transforms` reads in a payload; None where it refuses it."""
    try:
        message = decode_transforms(payload)
    except DecodeError:
        return None
    return contents(message)


def contents(message: TransformMessage) -> Contents:
    """All that a message says, to the last bit."""
    batch = message.batch
    columns = (batch.edges.tobytes(), batch.stamps_ns.tobytes(), batch.poses.tobytes())
    return message.epoch_ns, message.seq, batch.frames, *columns


def packed(**changed: Any) -> bytes:
    """The sample of docs/reference/wire.md with some columns changed, or left out where None."""
    columns = msgpack.unpackb(SAMPLE) | changed
    return bytes(msgpack.packb({key: value for key, value in columns.items() if value is not None}))


@given(messages())
def test_what_tfbus_writes_is_found(message: TransformMessage) -> None:
    """Every message that tfbus writes is read the fast way, to the same bits."""
    payload = encode_transforms(message)
    found = scan_message(payload, NameTables())
    assert found is not None
    assert contents(found) == decoded(payload)
    assert rows_of(found.batch) == rows_of(message.batch)


@given(messages(), st.data())
def test_what_is_found_in_spoilt_bytes_is_what_they_say(
    message: TransformMessage, data: st.DataObject
) -> None:
    """Whatever bytes change, are lost or come twice: what the fast way finds, the other way reads;
    and what the other way refuses, the fast way never finds.
    """
    spoilt = bytearray(encode_transforms(message))
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(spoilt) - 1))
        length = data.draw(st.integers(0, 12))
        spoilt[at : at + length] = (
            data.draw(st.binary(max_size=12) | st.just(bytes(spoilt[at : at + length]) * 2))
            or b"\x00"
        )
    found = scan_message(bytes(spoilt), NameTables())
    if found is not None:
        assert contents(found) == decoded(bytes(spoilt))


@given(st.binary(max_size=200))
def test_random_bytes_are_found_nothing_in(payload: bytes) -> None:
    """Random bytes are no message by the fast way, unless the other way reads it too."""
    message = scan_message(payload, NameTables())
    assert message is None or contents(message) == decoded(payload)


def test_a_message_that_was_cut_off_is_left_to_the_other_way() -> None:
    """A message that ends too early is not found, wherever it ends."""
    assert not any(scan_message(SAMPLE[:length], NameTables()) for length in range(len(SAMPLE)))


@pytest.mark.parametrize(
    "payload",
    [
        SAMPLE + b"\0",
        b"\x87" + SAMPLE[1:] + b"\xa1v\x01",
        packed(more=1),
        packed(v=2),
        packed(v=True),
        packed(epoch=-1),
        packed(epoch=2**63),
        packed(seq="0"),
        packed(frames=None),
        packed(frames=["world", "turtle1"]),
        packed(frames=["world", "turtle1", b"drone"]),
        packed(frames="world"),
        packed(frames=[], edges=b""),
        packed(stamps=b"\0" * 8),
        packed(edges=b"\0" * 15),
        packed(poses=b"\0" * 56),
        packed(edges=b"\xff" * 16),
        SAMPLE.replace(b"world", b"worl\xff"),
        SAMPLE.replace(b"world", b"\xed\xa0\x80ld"),
        SAMPLE.replace(b"\x93\xa5", b"\xdd\xff\xff\xff\xff\xa5"),
        SAMPLE.replace(b"\xc4\x10", b"\xc6\xff\xff\xff\xff", 1),
        SAMPLE.replace(b"\x93\xa5", b"\x8f\xa5"),
        SAMPLE.replace(b"\x93\xa5", b"\xa3\xa5"),
    ],
    ids=range(23),
)
def test_what_is_unusual_is_left_to_the_other_way(payload: bytes) -> None:
    """A message with anything unusual in it is not found; the other way reads or refuses it."""
    assert scan_message(payload, NameTables()) is None


@pytest.mark.parametrize(
    "payload",
    [
        packed(frames=["world", "turtle1", "d" * 40]),
        packed(frames=["world", "turtle1", "d" * 300]),
        packed(frames=["world", "turtle1", "d" * 70_000]),
        packed(frames=["", "/turtle1", "dröne \N{SAILBOAT}", *map(str, range(70_000))]),
        packed(edges=b"", stamps=b"", poses=b"", frames=[]),
        packed(epoch=0, seq=2**63 - 1),
        packed(seq=200),
        packed(edges=bytes(8) * 40, stamps=bytes(8) * 40, poses=bytes(56) * 40),
        packed(edges=bytes(8) * 9000, stamps=bytes(8) * 9000, poses=bytes(56) * 9000),
    ],
    ids=range(9),
)
def test_lengths_of_every_size_are_read(payload: bytes) -> None:
    """Texts, lists and columns of any length are found."""
    message = scan_message(payload, NameTables())
    assert message is not None
    assert contents(message) == decoded(payload)


def test_the_order_of_keys_means_nothing() -> None:
    """A message with its keys in another order is found as well."""
    payload = msgpack.packb(dict(reversed(msgpack.unpackb(SAMPLE).items())))
    message = scan_message(payload, NameTables())
    assert message is not None
    assert contents(message) == decoded(SAMPLE)


def test_the_same_names_are_kept_within_bounds() -> None:
    """The names of frames are kept from one message to the next, up to a limit."""
    tables = NameTables()
    for number in range(5_000):
        message = scan_message(packed(frames=["world", f"turtle{number}", "drone"]), tables)
        assert message is not None
        assert message.rows.frames[1] == f"turtle{number}"
    assert len(tables.names) <= 1024
    again = scan_message(packed(frames=["world", "turtle4999", "drone"]), tables)
    assert again is not None
    assert again.rows.frames is message.rows.frames
    scan_message(packed(frames=["world", "turtle1", "d" * 70_000]), tables)
    assert max(map(len, tables.names)) < 20_000


@pytest.mark.parametrize(("table", "names"), [(b"", 1), (b"", 1_000), (b"x" * 16_000, 1)])
def test_the_oldest_names_go_first(table: bytes, names: int) -> None:
    """Whichever limit is reached: lists, names or bytes; a new list does not clear the others."""
    tables = NameTables()
    keys = [b"%4d" % number + table for number in range(2_000)]
    for key in keys:
        tables.keep(key, ("a",) * names)
    assert list(tables.names) == keys[-len(tables.names) :]
    assert len(tables.names) == {(0, 1): 1024, (0, 1_000): 100, (16_000, 1): 262}[len(table), names]


def test_names_that_are_no_text_are_not_kept() -> None:
    """What is refused once is refused again."""
    tables = NameTables()
    spoilt = SAMPLE.replace(b"world", b"worl\xff")
    assert scan_message(spoilt, tables) is None
    assert scan_message(spoilt, tables) is None
    assert not tables.names


def test_a_reader_refuses_as_decoding_does() -> None:
    """A reader says the same of bytes that are no message, and counts nothing itself."""
    for payload in (b"", b"hello", packed(v=2), packed(poses=b"\0" * 55), SAMPLE + b"\0"):
        with pytest.raises(DecodeError) as refused:
            decode_transforms(payload)
        with pytest.raises(DecodeError) as read:
            TransformReader().read(payload)
        assert str(read.value) == str(refused.value)


def test_a_message_of_a_million_names_is_left_to_the_other_way() -> None:
    """That counts its values, and refuses them."""
    head, rest = SAMPLE.split(bytes.fromhex("93 a5776f726c64 a7747572746c6531 a564726f6e65"))
    names = b"\xa5world\xa7turtle1\xa5drone" + b"\xa1x" * 1_000_000
    many = head + b"\xdd" + (1_000_003).to_bytes(4, "big") + names + rest
    assert scan_message(many, NameTables()) is None
    with pytest.raises(DecodeError, match="more than 1000000 values"):
        TransformReader().read(many)


def test_a_reader_reads_what_a_later_version_adds_to() -> None:
    """A message with keys that we do not know is read without them."""
    message = TransformReader().read(packed(covariance=b"...", seq=5))
    assert message.seq == 5
    assert message.epoch_ns == EPOCH_NS
    assert contents(message) == decoded(packed(seq=5))


@given(st.lists(poses, min_size=1, max_size=5), st.booleans())
def test_a_buffer_takes_columns_as_it_takes_a_batch(
    given_poses: list[tuple[float, ...]], static: bool
) -> None:
    """The rows that a buffer takes, and why it refuses others, are the same either way."""
    count = len(given_poses)
    payload = packed(
        edges=struct.pack("<2I", 0, 1) * count,
        stamps=struct.pack(f"<{count}q", *range(0, 10**9 * count, 10**9)),
        poses=b"".join(struct.pack("<7d", *pose) for pose in given_poses),
    )
    one, other = Buffer(), Buffer()
    taken = one.set_transforms(decode_transforms(payload).batch, static=static, authority="sim")
    message = TransformReader().read(payload)
    assert other.set_transforms(message.rows, static=static, authority="sim") == taken
    assert other.rejected == one.rejected
    assert other.all_frames() == one.all_frames()


def test_the_last_stamp_is_that_of_the_last_row() -> None:
    """Columns tell the stamp of their last row, and None where they have none."""
    reader = TransformReader()
    assert reader.read(packed(stamps=struct.pack("<2q", -5, 7))).rows.last_stamp_ns() == 7
    assert reader.read(packed(edges=b"", stamps=b"", poses=b"")).rows.last_stamp_ns() is None


@given(st.lists(st.tuples(frames_of_edges, st.integers(-(10**18), 10**18)), max_size=6))
def test_transforms_become_the_same_columns_as_a_batch(
    given_rows: list[tuple[tuple[str, str], int]],
) -> None:
    """Columns made of transforms are those of the batch that is made of them."""
    transforms = [
        TransformStamped(stamp, parent, child, Transform((1, 2, 3), (0, 0, 0.6, 0.8)))
        for (parent, child), stamp in given_rows
    ]
    made = Columns.of_transforms(transforms)
    batch = TransformBatch.from_transforms(transforms)
    assert contents(TransformMessage(made, 0)) == contents(TransformMessage(batch, 0))
    assert made.stamps_ns().tolist() == batch.stamps_ns.tolist()


def test_columns_are_chosen_by_their_children() -> None:
    """`only` and `without` divide the rows, in order and also where they stand in a payload."""
    transforms = [at(float(row), name) for row, name in enumerate("abac")]
    whole = Columns.of_transforms(transforms)
    scanned = scan_message(encode_transforms(TransformMessage(whole, 7, 3)), NameTables())
    assert scanned is not None
    for rows in (whole, scanned.rows):
        assert list(rows.only({"a"})) == [transforms[0], transforms[2]]
        assert list(rows.without({"a"})) == [transforms[1], transforms[3]]
        assert rows.children() == {"a", "b", "c"}
        assert list(rows.only(())) == []
