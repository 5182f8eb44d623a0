"""Transforms as bytes: written, read back, and refused."""

from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.builders import EPOCH_NS, SAMPLE, STAMP_NS, messages, names, rows_of
from tfbus import DecodeError, Transform, TransformBatch, TransformStamped
from tfbus.wire.transforms import TransformMessage, decode_transforms, encode_transforms

TRANSFORMS = [
    TransformStamped(STAMP_NS, "world", "turtle1", Transform((1.5, -2, 0), (0, 0, 0.6, 0.8))),
    TransformStamped(STAMP_NS, "turtle1", "drone", Transform((-0.5, 0, 1), (0, 0, 0, 1))),
]


def sample_columns() -> dict[str, Any]:
    """The sample as msgpack reads it, to be spoilt by a test."""
    columns: dict[str, Any] = msgpack.unpackb(SAMPLE)
    return columns


def refusal(payload: bytes) -> str:
    """Why the payload is refused."""
    with pytest.raises(DecodeError) as caught:
        decode_transforms(payload)
    return str(caught.value)


def test_the_bytes_are_frozen() -> None:
    """A message is written as exactly these bytes, in this version and every later one."""
    message = TransformMessage(TransformBatch.from_transforms(TRANSFORMS), EPOCH_NS)
    assert encode_transforms(message).hex() == SAMPLE.hex()


def test_the_frozen_bytes_are_read() -> None:
    """The frozen bytes are the two transforms that they were written from."""
    message = decode_transforms(SAMPLE)
    assert message.epoch_ns == EPOCH_NS
    assert rows_of(message.batch) == [
        ("world", "turtle1", STAMP_NS, (1.5, -2, 0, 0, 0, 0.6, 0.8)),
        ("turtle1", "drone", STAMP_NS, (-0.5, 0, 1, 0, 0, 0, 1)),
    ]


@given(messages())
def test_what_is_written_is_read_back(message: TransformMessage) -> None:
    """Any batch comes back as it was: names, edges, stamps and numbers to the last bit."""
    read = decode_transforms(encode_transforms(message))
    assert read.epoch_ns == message.epoch_ns
    assert rows_of(read.batch) == rows_of(message.batch)


@given(messages())
def test_the_columns_that_are_read_are_read_only(message: TransformMessage) -> None:
    """The columns that are read are views of the payload and cannot be written."""
    batch = decode_transforms(encode_transforms(message)).batch
    assert not any(a.flags.writeable for a in (batch.edges, batch.stamps_ns, batch.poses))


def test_unknown_keys_are_ignored() -> None:
    """A later tfbus may say more in a message of this version; what is not known is left out."""
    payload = msgpack.packb(sample_columns() | {"covariance": b"...", "b": {"deep": [1]}})
    assert rows_of(decode_transforms(payload).batch) == rows_of(decode_transforms(SAMPLE).batch)


def test_numbers_that_are_not_finite_are_left_to_the_buffer() -> None:
    """Whether a pose makes sense is not judged here: one bad pose spoils no other."""
    columns = sample_columns()
    columns["poses"] = np.full((2, 7), np.nan).tobytes()
    assert len(decode_transforms(msgpack.packb(columns)).batch) == 2


@pytest.mark.parametrize("version", [0, 3, None, "1", True, 1.0])
def test_another_version_is_refused_with_the_remedy(version: object) -> None:
    """A message of another version is refused, and the refusal says what to do."""
    said = refusal(msgpack.packb(sample_columns() | {"v": version}))
    assert f"of version {version!r}; " in said and "reads versions 1 and 2: update" in said


def test_truncated_bytes_are_refused() -> None:
    """A message that was cut off anywhere is refused."""
    for length in range(len(SAMPLE)):
        refusal(SAMPLE[:length])


def test_trailing_bytes_are_refused() -> None:
    """A message with something behind it is refused."""
    assert "not msgpack" in refusal(SAMPLE + b"\0")


@pytest.mark.parametrize("missing", ["v", "epoch", "frames", "edges", "stamps", "poses"])
def test_a_missing_key_is_refused(missing: str) -> None:
    """Each of the six keys must be there."""
    columns = sample_columns()
    del columns[missing]
    assert ("version None" if missing == "v" else f"'{missing}'") in refusal(msgpack.packb(columns))


@pytest.mark.parametrize(
    ("key", "value", "reason"),
    [
        ("epoch", 1.5, "'epoch' is not an integer of nanoseconds"),
        ("epoch", True, "'epoch' is not an integer of nanoseconds"),
        ("seq", 1.0, "'seq' is not an integer"),
        ("seq", True, "'seq' is not an integer"),
        ("seq", None, "'seq' is not an integer"),
        ("frames", "world", "'frames' is not a list of texts"),
        ("frames", ["world", b"turtle1", "drone"], "'frames' is not a list of texts"),
        ("edges", [[0, 1], [1, 2]], "'edges' is not bytes in rows of 8"),
        ("edges", b"\0" * 12, "'edges' is not bytes in rows of 8"),
        ("stamps", b"\0" * 9, "'stamps' is not bytes in rows of 8"),
        ("poses", b"\0" * 55, "'poses' is not bytes in rows of 56"),
        ("poses", b"\0" * 56, "'poses' has 1 row, 'stamps' 2: each transform has one in both"),
        ("stamps", b"", "'edges' has 2 rows, 'stamps' 0: each transform has one in both"),
        ("frames", ["world"], "an edge names frame 2, but there are only 1 frames"),
        (
            "edges",
            b"\xff" * 16,
            "an edge names frame 4294967295, but there are only 3 frames",
        ),
    ],
)
def test_a_column_of_the_wrong_kind_is_refused(key: str, value: object, reason: str) -> None:
    """A column of the wrong type, length or reach is refused, and named."""
    assert refusal(msgpack.packb(sample_columns() | {key: value})) == reason


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        b"hello",
        b"\xc0",
        b"\x91" * 100_000,
        b"\x81\xa1v" * 100_000,
        b"\xdf\xff\xff\xff\xff",
        b"\xdd\xff\xff\xff\xff",
        b"\xc6\xff\xff\xff\xff",
        b"\x81\xa5\xff\xff\xff\xff\xff\x01",
        b"\x81\x90\x01",
        b"\x81\xd6\xff\x00\x00\x00\x00\x01",
        b"\xd7\xff" + b"\xff" * 8,
    ],
    ids=lambda payload: payload[:8].hex() or "nothing",
)
def test_hostile_bytes_are_refused(payload: bytes) -> None:
    """Bytes that are no message, too deep, or longer than they are, get a DecodeError only."""
    refusal(payload)


def decoded_or_refused(payload: bytes) -> None:
    """Any other error than a DecodeError fails the test."""
    try:
        message = decode_transforms(payload)
    except DecodeError as error:
        assert len(str(error)) < 500
    else:
        assert rows_of(message.batch) is not None


@given(st.binary(max_size=300))
def test_random_bytes_raise_nothing_else(payload: bytes) -> None:
    """Random bytes are refused by a DecodeError and nothing else."""
    decoded_or_refused(payload)


@given(st.lists(st.tuples(st.integers(0, len(SAMPLE) - 1), st.integers(0, 255)), max_size=6))
def test_changed_bytes_raise_nothing_else(changes: list[tuple[int, int]]) -> None:
    """A message with some bytes changed is read as another message, or refused."""
    spoilt = bytearray(SAMPLE)
    for at, value in changes:
        spoilt[at] = value
    decoded_or_refused(bytes(spoilt))


scalars = st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats()
values = st.recursive(
    scalars | st.binary(max_size=40) | names,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(names, inner, max_size=4),
    max_leaves=12,
)


@given(
    st.dictionaries(st.sampled_from(["v", "epoch", "frames", "edges", "stamps", "poses"]), values)
)
def test_columns_of_any_type_raise_nothing_else(columns: dict[str, object]) -> None:
    """Maps with the right keys and any values are refused by a DecodeError and nothing else."""
    decoded_or_refused(msgpack.packb(sample_columns() | columns))
