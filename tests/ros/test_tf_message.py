"""TFMessage in CDR: the bytes that ROS 2 has, and no bit of a transform lost."""

import gc
import struct
from types import FunctionType, ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from tests.builders import at, messages
from tfbus import DecodeError, InvalidArgumentException, Transform, TransformStamped
from tfbus.geometry.columns import Columns
from tfbus.ros.tf_message import (
    EARLIEST_STAMP_NS,
    LATEST_STAMP_NS,
    TFMessageReader,
    TFMessageWriter,
)

ROSBAGS = get_typestore(Stores.LATEST)
TYPE = "tf2_msgs/msg/TFMessage"

Rows = list[tuple[str, str, int, bytes]]

# The frozen bytes of a message of one transform.
STAMP_NS = 1670400305709085026
SAMPLE = bytes.fromhex(
    "00010000"
    "01000000"
    "31499063 62c7432a"
    "06000000 776f726c6400 0000"
    "08000000 747572746c653100"
    "00000000"
    "000000000000f83f 00000000000000c0 0000000000000000"
    "0000000000000000 0000000000000000 333333333333e33f 9a9999999999e93f"
)
TRANSFORM = TransformStamped(
    STAMP_NS, "world", "turtle1", Transform((1.5, -2, 0), (0, 0, 0.6, 0.8))
)


def rows_of(columns: Columns) -> Rows:
    """All that the rows say, to the last bit."""
    poses = columns.poses_bytes()
    return [
        (columns.frames[parent], columns.frames[child], stamp, poses[56 * row : 56 * (row + 1)])
        for row, ((parent, child), stamp) in enumerate(
            zip(columns.pairs(), columns.stamps_as_ints(), strict=True)
        )
    ]


def rows_by_rosbags(data: bytes) -> Rows:
    """The same, as rosbags reads it."""
    read: Any = ROSBAGS.deserialize_cdr(data, TYPE)
    found = []
    for each in read.transforms:
        stamp, p, q = each.header.stamp, each.transform.translation, each.transform.rotation
        pose = struct.pack("=7d", p.x, p.y, p.z, q.x, q.y, q.z, q.w)
        stamp_ns = stamp.sec * 10**9 + stamp.nanosec
        found.append((each.header.frame_id, each.child_frame_id, stamp_ns, pose))
    return found


def by_rosbags(rows: Rows, *, little_endian: bool = True) -> bytes:
    """The message with these rows, as rosbags writes it."""
    types: Any = ROSBAGS.types
    made = []
    for parent, child, stamp_ns, pose in rows:
        numbers = struct.unpack("=7d", pose)
        stamp = types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9))
        transform = types["geometry_msgs/msg/Transform"](
            types["geometry_msgs/msg/Vector3"](*numbers[:3]),
            types["geometry_msgs/msg/Quaternion"](*numbers[3:]),
        )
        header = types["std_msgs/msg/Header"](stamp, parent)
        made.append(types["geometry_msgs/msg/TransformStamped"](header, child, transform))
    return bytes(ROSBAGS.serialize_cdr(types[TYPE](made), TYPE, little_endian=little_endian))


@st.composite
def columns(draw: st.DrawFn) -> Columns:
    """Any rows whose stamps ROS can have; up to eight different ones, perhaps several times."""
    rows = draw(messages()).rows
    stamps = st.integers(EARLIEST_STAMP_NS, LATEST_STAMP_NS)
    kept = draw(st.lists(stamps, min_size=rows.count, max_size=rows.count))
    times = draw(st.sampled_from([1, 1, 3, 20]))
    return Columns.of_bytes(
        rows.frames,
        rows.edges_bytes() * times,
        np.array(kept * times, dtype=np.int64).tobytes(),
        rows.poses_bytes() * times,
    )


def test_the_sample_stays_as_it_is() -> None:
    """One transform has these bytes, and they are that transform."""
    assert TFMessageWriter().write(Columns.of_transforms([TRANSFORM])) == SAMPLE
    assert list(TFMessageReader().read(SAMPLE)) == [TRANSFORM]


@given(columns())
def test_what_is_written_is_what_rosbags_writes(rows: Columns) -> None:
    """Bytes are those of rosbags, the first time and, from the layout that is kept, the second."""
    writer = TFMessageWriter()
    expected = by_rosbags(rows_of(rows))
    assert [writer.write(rows), writer.write(rows)] == [expected, expected]
    assert rows_by_rosbags(expected) == rows_of(rows)


@given(columns(), st.booleans())
def test_what_rosbags_writes_is_read(rows: Columns, little_endian: bool) -> None:
    """Rows come back bit by bit, in both byte orders, the first time and, from the layout that is
    kept then, the third.
    """
    data = by_rosbags(rows_of(rows), little_endian=little_endian)
    reader = TFMessageReader()
    for _ in range(3):
        assert rows_of(reader.read(data)) == rows_of(rows)


@given(columns(), columns())
def test_messages_do_not_mix(one: Columns, other: Columns) -> None:
    """A reader and a writer tell messages of other frames, or of other numbers, from another."""
    writer, reader = TFMessageWriter(), TFMessageReader()
    for rows in (one, other, one, one, other, other, one):
        assert rows_of(reader.read(writer.write(rows))) == rows_of(rows)


def test_repeated_messages_share_their_frames() -> None:
    """Names are made once, so that what compares them is fast."""
    reader = TFMessageReader()
    for count in (1, 3):
        data = TFMessageWriter().write(
            Columns.of_transforms([at(0, f"j{row}") for row in range(count)])
        )
        reader.read(data)
        reader.read(data)
        assert reader.read(data).frames is reader.read(data).frames


def test_one_transform_of_known_names_is_read_without_columns() -> None:
    """Its frames, stamp and pose; nothing else is, until its names have come."""
    reader, writer = TFMessageReader(), TFMessageWriter()
    assert reader.read_one(SAMPLE) is None
    rows = reader.read(SAMPLE)
    assert reader.read_one(SAMPLE) == (("world", "turtle1"), STAMP_NS, rows.poses_bytes())
    two = writer.write(Columns.of_transforms([TRANSFORM, TRANSFORM]))
    assert reader.read_one(two) is None
    for size in range(len(SAMPLE)):
        assert reader.read_one(SAMPLE[:size]) is None
    no_stamp = SAMPLE[:12] + struct.pack("<I", 10**9) + SAMPLE[16:]
    assert reader.read_one(no_stamp) is None
    with pytest.raises(DecodeError):
        reader.read(no_stamp)


def test_numbers_that_are_none_stay_as_they_are() -> None:
    """Bits of doubles that are no number are kept: the buffer judges them, not the recording."""
    odd = struct.pack("=7Q", 0x7FF0000000000001, 0xFFF8DEADBEEF0000, 2**63, 1, 0, 0, 0)
    rows = Columns.of_bytes(("a", "b"), struct.pack("=2I", 0, 1), struct.pack("=q", -1), odd)
    for times in (1, 9):
        many = Columns.of_bytes(
            rows.frames, rows.edges * times, rows.stamps * times, rows.poses * times
        )
        assert (
            rows_of(TFMessageReader().read(TFMessageWriter().write(many))) == rows_of(rows) * times
        )


@pytest.mark.parametrize("stamp_ns", [EARLIEST_STAMP_NS - 1, LATEST_STAMP_NS + 1, 4 * 10**18])
@pytest.mark.parametrize("count", [1, 3, 9])
def test_a_stamp_that_ros_cannot_have_is_refused(stamp_ns: int, count: int) -> None:
    """Seconds have 32 bits; the sentence names the frame."""
    rows = [at(child=f"joint{row}") for row in range(count - 1)] + [at(0, "late", stamp_ns)]
    with pytest.raises(InvalidArgumentException, match=r"frame 'late' .*2038"):
        TFMessageWriter().write(Columns.of_transforms(rows))


def test_a_name_that_is_no_unicode_is_refused() -> None:
    """A lone surrogate cannot be UTF-8."""
    rows = Columns.of_bytes(("a\ud800", "b"), struct.pack("=2I", 0, 1), bytes(8), bytes(56))
    with pytest.raises(InvalidArgumentException, match=r"'a\\ud800' .*Unicode"):
        TFMessageWriter().write(rows)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "0 bytes are no CDR message"),
        (b"\0\1\0", "3 bytes are no CDR message"),
        (b"\0\1\0\0", "ends too early"),
        (b"\0\3" + SAMPLE[2:], "encoded as a parameter list"),
        (b"\0\7" + SAMPLE[2:], "encoded as XCDR2"),
        (b"\x12\x34" + SAMPLE[2:], "encoded as 0x1234"),
        (SAMPLE[:4] + b"\xff\xff\xff\x7f" + SAMPLE[8:], "a sequence of 2147483647 items"),
        (SAMPLE.replace(b"world\0", b"worl\xff\0"), r"'worl\\xff' at byte 20 is not UTF-8"),
        (SAMPLE.replace(b"world\0", b"worlds"), "text at byte 20 does not end in a zero"),
        (SAMPLE[:12] + b"\x00\xca\x9a\x3b" + SAMPLE[16:], "1000000000 nanoseconds"),
        (SAMPLE + bytes(4), "4 bytes more than its type"),
    ],
    ids=range(11),
)
def test_what_is_no_message_is_refused(data: bytes, reason: str) -> None:
    """One sentence says what is wrong, by a new reader and by one that knows the names."""
    reader = TFMessageReader()
    reader.read(SAMPLE)
    for read in (TFMessageReader().read, reader.read):
        with pytest.raises(DecodeError, match=reason):
            read(data)


@pytest.mark.parametrize("count", [0, 1, 3])
def test_a_message_that_was_cut_off_is_refused(count: int) -> None:
    """Wherever it ends."""
    data = TFMessageWriter().write(
        Columns.of_transforms([at(0, f"j{row}") for row in range(count)])
    )
    reader = TFMessageReader()
    reader.read(data)
    for size in range(len(data)):
        with pytest.raises(DecodeError):
            reader.read(data[:size])


def test_bytes_that_fill_up_are_passed_over() -> None:
    """Some writers fill messages up to a multiple of four, and leave anything between fields."""
    garbage = SAMPLE.replace(b"world\0\0\0", b"world\0xy")
    assert garbage != SAMPLE
    for data in (SAMPLE + bytes(3), garbage):
        assert list(TFMessageReader().read(data)) == [TRANSFORM]


def test_layouts_are_not_kept_without_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """Names that never come again are forgotten, here from 128 layouts on."""
    monkeypatch.setattr("tfbus.ros.tf_message._MOST_LAYOUTS", 128)
    writer, reader = TFMessageWriter(), TFMessageReader()
    for number in range(1000):
        rows = [at(0, f"{number}_{row}") for row in range(1 + number % 3)]
        data = writer.write(Columns.of_transforms(rows))
        for _ in range(3):
            assert list(reader.read(data)) == rows
    for each in (writer, reader):
        assert sum(text.partition("_")[0].isdigit() for text in texts_held(each)) < 1000


def texts_held(owner: object) -> set[str]:
    """All texts that an object holds, in whatever it holds."""
    found, seen, left = set[str](), set[int](), [owner]
    while left:
        for each in gc.get_referents(left.pop()):
            if isinstance(each, str):
                found.add(each)
            elif id(each) not in seen and not isinstance(each, type | FunctionType | ModuleType):
                seen.add(id(each))
                left.append(each)
    return found
