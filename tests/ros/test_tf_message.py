"""TFMessage in CDR: the bytes that ROS 2 has, and no bit of a transform lost."""

import struct
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from tests.builders import messages
from tfbus import Transform, TransformStamped
from tfbus.geometry.columns import Columns
from tfbus.ros.tf_message import (
    EARLIEST_STAMP_NS,
    LATEST_STAMP_NS,
    TFMessageReader,
    TFMessageWriter,
    decode_tf_message,
    encode_tf_message,
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
    assert encode_tf_message(Columns.of_transforms([TRANSFORM])) == SAMPLE
    assert list(decode_tf_message(SAMPLE)) == [TRANSFORM]


@given(columns())
def test_what_is_written_is_what_rosbags_writes(rows: Columns) -> None:
    """Bytes are those of rosbags, the first time and, from the layout that is kept, the second."""
    writer = TFMessageWriter()
    expected = by_rosbags(rows_of(rows))
    assert [writer.write(rows), writer.write(rows)] == [expected, expected]
    assert rows_by_rosbags(expected) == rows_of(rows)


@given(columns(), st.booleans())
def test_what_rosbags_writes_is_read(rows: Columns, little_endian: bool) -> None:
    """Rows come back bit by bit, in both byte orders, the first time and the second."""
    data = by_rosbags(rows_of(rows), little_endian=little_endian)
    reader = TFMessageReader()
    assert rows_of(reader.read(data)) == rows_of(rows)
    assert rows_of(reader.read(data)) == rows_of(rows)


@given(columns(), columns())
def test_messages_do_not_mix(one: Columns, other: Columns) -> None:
    """A reader and a writer tell messages of other frames, or of other numbers, from another."""
    writer, reader = TFMessageWriter(), TFMessageReader()
    for rows in (one, other, one):
        assert rows_of(reader.read(writer.write(rows))) == rows_of(rows)
