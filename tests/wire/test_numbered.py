"""Messages of version 2: their bytes, their precision, and refused bytes."""

import math
import tracemalloc
from collections.abc import Sequence

import msgpack
import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.builders import EPOCH_NS, STAMP_NS, description, examples, rows_of
from tfbus.base.errors import DecodeError
from tfbus.geometry.columns import Columns
from tfbus.geometry.transform import Transform, TransformStamped
from tfbus.wire.descriptions import encode_stream, read_description
from tfbus.wire.numbered import FrameNumbers, origin_of
from tfbus.wire.transform_bytes import NameTables, scan_message
from tfbus.wire.transforms import (
    NumberedEncoder,
    TransformMessage,
    TransformReader,
    decode_transforms,
    encode_transforms,
    newest_stamp,
)

Poses = NDArray[np.float64]
NAMED = ((0, "map", "base"), (1, "base", "arm"), (2, "arm", "hand"))
ORIGINS = np.array([[500_000.0, 4e6, 0, 0, 0, 0, 1], [0, 0, 1, 0, 0, 0, 1], [0, 0, 0, 0, 0, 0, 1]])
NUMBERS = FrameNumbers(EPOCH_NS, 3, NAMED, ORIGINS.tobytes())


def encoded(
    poses: Poses, numbers: Sequence[int] = (0, 1, 2), *, is_short: bool = False, stamps: object = 0
) -> bytes:
    """The message of these poses, one a number, all of one time unless stamps are given."""
    times = np.array(stamps or [STAMP_NS] * len(numbers), dtype=np.int64)
    origins = ORIGINS[list(numbers)]
    encoder = NumberedEncoder(EPOCH_NS, numbers, origins.tobytes(), is_short=is_short)
    return encoder.encode(7, times.tobytes(), poses.tobytes())


def decoded(payload: bytes, numbers: FrameNumbers = NUMBERS) -> Poses:
    """The poses in a message."""
    return decode_transforms(payload, numbers).batch.poses


def rotation_error(one: Poses, other: Poses) -> float:
    """The angle between two rotations, in degrees, precise for small ones."""
    one, other = one / np.linalg.norm(one), other / np.linalg.norm(other)
    apart = min(np.linalg.norm(one - other), np.linalg.norm(one + other))
    return math.degrees(4 * math.asin(apart / 2))


quaternions = st.tuples(*[st.floats(-1, 1)] * 4).map(np.array)
far = st.floats(-2e5, 2e5) | st.floats(-1e-3, 1e-3) | st.floats(-4, 4)


@settings(max_examples=examples(300))
@given(st.tuples(far, far, far), quaternions, st.floats(0.996, 1.004), st.booleans())
def test_a_pose_comes_within_the_precision_of_its_form(
    xyz: tuple[float, float, float], quaternion: Poses, norm: float, is_short: bool
) -> None:
    """Compact: 0.1 mm and 0.01 degrees, wherever the frame began; float32: 6e-8 of the distance
    from there, and 1e-5 degrees.
    """
    length = np.linalg.norm(quaternion)
    assume(length > 0.1)
    pose = np.array([*ORIGINS[0, :3] + xyz, *quaternion / length * norm])
    [found] = decoded(encoded(pose[None], (0,), is_short=is_short))
    error_m = np.linalg.norm(found[:3] - pose[:3])
    distance_m = np.linalg.norm(pose[:3] - ORIGINS[0, :3])
    assert error_m < (6e-8 * distance_m + 1e-9 if is_short else 1e-4)
    assert rotation_error(found[3:], pose[3:]) < (1e-5 if is_short else 0.01)


@pytest.mark.parametrize("is_short", [False, True])
def test_a_message_like_one_before_is_read_at_once_as_any_is(is_short: bool) -> None:
    """Nothing of it is decoded as a map, and all of it is the same; without numbers it is not read,
    and with an end that is missing, either.
    """
    tables, numbers = NameTables(), FrameNumbers(EPOCH_NS, 3, NAMED, ORIGINS.tobytes())
    poses = ORIGINS + np.array([3.0, -0.5, 0.0, 0.0, 0.0, 0.0, 0.0])
    payload = encoded(poses, is_short=is_short)
    assert scan_message(payload, tables, numbers) is None
    whole = decode_transforms(payload, numbers)
    found = scan_message(payload, tables, numbers)
    assert found is not None
    assert (found.epoch_ns, found.seq, found.unnamed) == (EPOCH_NS, 7, 0)
    assert found.rows.frames == whole.rows.frames
    assert found.rows.edges_bytes() == whole.rows.edges_bytes()
    assert found.rows.stamps_bytes() == whole.rows.stamps_bytes()
    assert found.rows.poses_bytes() == whole.rows.poses_bytes()
    assert scan_message(payload, tables) is None
    assert not any(scan_message(payload[:end], tables, numbers) for end in range(len(payload)))


@settings(max_examples=examples(100))
@given(st.lists(st.floats(), min_size=7, max_size=7), st.booleans())
@example([0.0, -5e38, 0.0, 0.0, 0.0, 0.0, 1.0], True)
def test_a_pose_that_does_not_fit_is_sent_as_it_is(values: list[float], is_short: bool) -> None:
    """Never another one: what is no number, or no rotation, is refused by the buffer as ever."""
    pose = np.array([values])
    with np.errstate(all="ignore"):
        norm = float((pose[0, 3:] ** 2).sum())
    [found] = decoded(encoded(pose, (1,), is_short=is_short))
    if not abs(norm - 1) <= 0.01 or not (abs(pose) < 3.4e38).all():
        assert found.tobytes() == pose.tobytes()


@settings(max_examples=examples(200))
@given(
    st.one_of(st.lists(st.floats(), min_size=7, max_size=7), st.just([0.0, 0, 1, 0, 0, 0, 1])),
    st.integers(0, 2**64 - 1),
    st.integers(-(2**63), 2**63 - 1),
    st.booleans(),
)
def test_a_transform_alone_has_the_bytes_of_a_message_of_one(
    values: list[float], seq: int, stamp_ns: int, is_short: bool
) -> None:
    """Whatever its pose, number and stamp are; a stamp below zero is left to the other encoder."""
    encoder = NumberedEncoder(EPOCH_NS, [1], ORIGINS[1].tobytes(), is_short=is_short)
    stamp, pose = np.int64(stamp_ns).tobytes(), np.array(values, dtype=np.float64).tobytes()
    expected = encoder.encode(seq, stamp, pose) if stamp_ns >= 0 else None
    one = encoder.of_one("base", "arm")
    assert one.encode_bytes(seq, ("base", "arm"), stamp_ns, pose) == expected
    assert one.encode_bytes(seq, ("map", "arm"), stamp_ns, pose) is None


@pytest.mark.parametrize("is_short", [False, True])
def test_a_stamped_transform_has_the_bytes_of_its_columns(is_short: bool) -> None:
    """Between its own frames; one between others is left to the other encoder."""
    encoder = NumberedEncoder(EPOCH_NS, [1], ORIGINS[1].tobytes(), is_short=is_short)
    one = encoder.of_one("base", "arm")
    for x in (0.0, 0.1, 5.0, 1e3, 1e5, 1e7):
        stamped = TransformStamped(STAMP_NS, "base", "arm", Transform((x, 0.0, 1.0)))
        columns = Columns.of_transforms((stamped,))
        expected = encoder.encode(9, columns.stamps_bytes(), columns.poses_bytes())
        assert one.encode(9, stamped) == expected
        assert one.encode(9, TransformStamped(STAMP_NS, "map", "arm", stamped.transform)) is None


def test_a_frame_that_only_turns_takes_six_bytes_and_one_at_its_origin_none() -> None:
    """So fifty joints at one time are a message of about 400 bytes."""
    turned = [0, 0, 1, 0, 0, math.sin(0.3), math.cos(0.3)]
    joints = np.array([turned] * 3)
    origins = [(n, "base", f"joint{n}") for n in range(50)]
    numbers = FrameNumbers(EPOCH_NS, 50, origins, ORIGINS[[1]].repeat(50, 0).tobytes())
    encoder = NumberedEncoder(
        EPOCH_NS, range(50), ORIGINS[[1]].repeat(50, 0).tobytes(), is_short=False
    )
    stamps = np.array([STAMP_NS] * 50).tobytes()
    still = encoder.encode(0, stamps, ORIGINS[[1]].repeat(50, 0).tobytes())
    assert len(still) < 80
    assert np.array_equal(decoded(still, numbers), ORIGINS[[1]].repeat(50, 0))
    payload = encoder.encode(0, stamps, joints[[0]].repeat(50, 0).tobytes())
    assert len(payload) == len(still) + 300 + 1
    assert abs(decoded(payload, numbers) - joints[0]).max() < 1e-4


def test_rows_keep_their_frames_and_stamps() -> None:
    """In any order, more than one of a frame, at one time or several."""
    poses = ORIGINS[[2, 0, 1, 2]]
    for stamps in ([STAMP_NS] * 4, [4, 3, -2, 1]):
        message = decode_transforms(encoded(poses, (2, 0, 1, 2), stamps=stamps), NUMBERS)
        assert (message.epoch_ns, message.seq, message.unnamed) == (EPOCH_NS, 7, 0)
        assert [row[:3] for row in rows_of(message.batch)] == [
            (*NAMED[number][1:], stamp) for number, stamp in zip((2, 0, 1, 2), stamps, strict=True)
        ]
        assert np.array_equal(message.batch.poses, poses)


def test_rows_without_names_are_left_out_and_counted() -> None:
    """Rows of numbers that are still to be described are; not of numbers that are no longer."""
    payload = encoded(ORIGINS)
    fewer = FrameNumbers(EPOCH_NS, 2, NAMED[:1], ORIGINS[:1].tobytes())
    message = decode_transforms(payload, fewer)
    assert [row[1] for row in rows_of(message.batch)] == ["base"]
    assert message.unnamed == 1
    of_another_epoch = FrameNumbers(EPOCH_NS + 1, 3, NAMED, ORIGINS.tobytes())
    message = decode_transforms(payload, of_another_epoch)
    assert (len(message.rows), message.unnamed) == (0, 3)


def test_rows_that_nobody_has_named_cost_nothing() -> None:
    """However many a message says it has: only those with names are made."""
    payload = msgpack.packb(
        {"v": 2, "epoch": EPOCH_NS, "runs": [0, 300_000], "stamps": 5, "forms": b"\0", "poses": b""}
    )
    decode_transforms(encoded(ORIGINS), NUMBERS)
    tracemalloc.start()
    message = decode_transforms(payload, NUMBERS)
    _, most_bytes = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most_bytes < 1e6
    assert (len(message.rows), message.unnamed) == (3, 299_997)
    assert np.array_equal(message.batch.poses, ORIGINS)


def test_a_frame_comes_as_often_as_it_was_sent() -> None:
    """Also at its origin all the time, which takes no bytes."""
    numbers = (0, 1, 2) * 60
    message = decode_transforms(encoded(ORIGINS[list(numbers)], numbers), NUMBERS)
    assert np.array_equal(message.batch.poses, ORIGINS[list(numbers)])


def test_messages_of_other_rows_each_do_not_fill_the_memory() -> None:
    """The rows that are kept take as much memory as the numbers themselves, not more."""
    count = 300
    named = [(n, "base", f"joint{n}") for n in range(count)]
    origins = ORIGINS[[1]].repeat(count, 0).tobytes()
    numbers = FrameNumbers(EPOCH_NS, count, named, origins)
    message = {"v": 2, "epoch": EPOCH_NS, "stamps": 5, "forms": b"\0", "poses": b""}
    tracemalloc.start()
    for first in range(100):
        runs = [first, count - first, 0, first]
        assert len(decode_transforms(msgpack.packb(message | {"runs": runs}), numbers).rows)
    kept_bytes, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert kept_bytes < 5e5


@pytest.mark.parametrize(
    ("change", "mistake"),
    [
        ({"epoch": "x"}, "'epoch' is not an integer"),
        ({"seq": "x"}, "'seq' is not an integer"),
        ({"seq": None}, "'seq' is not an integer"),
        ({"runs": [0]}, "'runs' must be pairs"),
        ({"runs": [0, -3]}, "'runs' must be pairs"),
        ({"runs": [0, 10**9]}, "at most 300,000 rows"),
        ({"runs": [0, 3] * 300}, "no more than the stream has numbers and the message bytes"),
        ({"runs": [0, "3"]}, "'runs' is not a list of integers"),
        ({"stamps": b"123"}, "do not have the bytes of 3 rows"),
        ({"stamps": b""}, "do not have the bytes of 3 rows"),
        ({"stamps": 2**63}, "'stamps' is neither"),
        ({"forms": b""}, "do not have the bytes"),
        ({"forms": b"\x0a"}, "do not have the bytes"),
        ({"forms": None}, "'forms' or 'poses' is not bytes"),
        ({"poses": b"1"}, "do not have the bytes"),
        ({"v": 3}, "of version 3; this tfbus reads versions 1 and 2: update the older"),
    ],
)
def test_a_message_that_is_none_is_refused_with_the_reason(
    change: dict[str, object], mistake: str
) -> None:
    """Compiled and interpreted, whether such rows came before or not."""
    payload = encoded(ORIGINS)
    numbers = FrameNumbers(EPOCH_NS, 3, NAMED, ORIGINS.tobytes())
    reader = TransformReader()
    assert len(reader.read(payload, numbers).rows) == 3
    spoilt = msgpack.packb(msgpack.unpackb(payload) | change)
    with pytest.raises(DecodeError, match=mistake):
        reader.read(spoilt, numbers)
    with pytest.raises(DecodeError, match=mistake):
        decode_transforms(spoilt, numbers)


def test_the_newest_stamp_is_read_without_names() -> None:
    """Of one for all, and of one for each; what is none is refused."""
    assert newest_stamp(encoded(ORIGINS)) == STAMP_NS
    assert newest_stamp(encoded(ORIGINS, stamps=[4, 9, -2])) == 9
    assert newest_stamp(encode_transforms(TransformMessage(Columns.of_transforms([]), 7))) is None
    for wrong in (2**64 - 1, True, None):
        spoilt = msgpack.packb(msgpack.unpackb(encoded(ORIGINS)) | {"stamps": wrong})
        with pytest.raises(DecodeError, match="'stamps' is neither"):
            newest_stamp(spoilt)


@settings(max_examples=examples(200))
@given(st.data())
def test_spoilt_bytes_are_read_alike_or_refused(data: st.DataObject) -> None:
    """By the compiled reader and the plain one: neither reads beyond them."""
    payload = bytearray(encoded(ORIGINS + np.array([0.3, 1, 0, 0, 0, 0, 0])))
    numbers = FrameNumbers(EPOCH_NS, 3, NAMED, ORIGINS.tobytes())
    reader = TransformReader()
    reader.read(bytes(payload), numbers)
    for _ in range(data.draw(st.integers(1, 3))):
        payload[data.draw(st.integers(0, len(payload) - 1))] = data.draw(st.integers(0, 255))
    spoilt = bytes(
        payload[: data.draw(st.integers(0, len(payload)))] if data.draw(st.booleans()) else payload
    )
    results = []
    for read in (reader.read, decode_transforms):
        try:
            message = read(spoilt, numbers)
            results.append((message.rows.poses_bytes(), message.epoch_ns, message.seq))
        except DecodeError:
            results.append(None)
    assert results[0] == results[1]


def test_bits_that_are_no_rotation_are_no_numbers() -> None:
    """So the buffer refuses the row, and counts it."""
    payload = msgpack.packb(
        {
            "v": 2,
            "epoch": EPOCH_NS,
            "runs": [1, 1],
            "stamps": 5,
            "forms": b"\x04",
            "poses": b"\xfc\xff\xff\xff\xff\x7f",
        }
    )
    assert np.isnan(decoded(payload)).any()


def test_an_origin_is_a_pose() -> None:
    """Normalised; none where the first pose is no pose."""
    assert (
        origin_of(np.array([1, 2, 3, 0, 0, 0, 0.999]).tobytes())
        == np.array([1.0, 2, 3, 0, 0, 0, 1]).tobytes()
    )
    for pose in ([math.nan, 0, 0, 0, 0, 0, 1], [0, 0, 0, 0, 0, 0, 2], [1e10, 0, 0, 0, 0, 0, 1]):
        assert origin_of(np.array(pose).tobytes()) == ORIGINS[2].tobytes()


def test_a_description_says_the_numbers_and_one_without_does_not_mention_them() -> None:
    """An earlier version reads both."""
    rows = [("map", "base", False)]
    plain = encode_stream(description(rows))
    assert {"poses", "numbered", "origins", "next_number"}.isdisjoint(msgpack.unpackb(plain))
    told = description(
        rows, poses="compact", next_number=3, numbered=NAMED, origins=ORIGINS.tobytes()
    )
    found, _ = read_description(encode_stream(told))
    assert found == told
    with pytest.raises(DecodeError, match="origins"):
        read_description(msgpack.packb(msgpack.unpackb(encode_stream(told)) | {"origins": b""}))
