"""TFMessage of ROS 1 as bytes."""

import contextlib
import struct
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests import needs
from tfbus import Transform, TransformStamped
from tfbus.base.errors import DecodeError, InvalidArgumentException
from tfbus.geometry.columns import Columns
from tfbus.ros.ros1 import decode_ros1_tf_message, encode_ros1_tf_message

ROWS = st.lists(
    st.tuples(
        st.text(st.characters(exclude_categories=("Cs",)), max_size=8),
        st.text(st.characters(exclude_categories=("Cs",)), max_size=8),
        st.integers(0, 2**31 - 1),
        st.integers(0, 999_999_999),
        st.lists(st.floats(width=64), min_size=7, max_size=7),
    ),
    max_size=5,
)


@cache
def types_of_rosbags() -> Any:
    """The types of ROS 1 as the library rosbags has them."""
    needs.module("rosbags.typesys")
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    definition = "geometry_msgs/TransformStamped[] transforms"
    store.register(get_types_from_msg(definition, "tf2_msgs/msg/TFMessage"))
    return store


def as_rosbags_writes(rows: list[Any]) -> bytes:
    """The message as the library rosbags serializes it."""
    store = types_of_rosbags()
    types = store.types
    transforms = [
        types["geometry_msgs/msg/TransformStamped"](
            types["std_msgs/msg/Header"](
                at, types["builtin_interfaces/msg/Time"](sec, nanosec), parent
            ),
            child,
            types["geometry_msgs/msg/Transform"](
                types["geometry_msgs/msg/Vector3"](*pose[:3]),
                types["geometry_msgs/msg/Quaternion"](*pose[3:]),
            ),
        )
        for at, (parent, child, sec, nanosec, pose) in enumerate(rows)
    ]
    message = types["tf2_msgs/msg/TFMessage"](transforms)
    return bytes(store.serialize_ros1(message, "tf2_msgs/msg/TFMessage"))


@given(ROWS)
def test_what_rosbags_writes_is_read_bit_by_bit(rows: list[Any]) -> None:
    """Names, stamps and poses of every transform are those that were written."""
    columns = decode_ros1_tf_message(as_rosbags_writes(rows))
    names = [(columns.frames[a], columns.frames[b]) for a, b in columns.pairs()]
    assert names == [(parent, child) for parent, child, *_ in rows]
    assert columns.stamps_as_ints() == [sec * 10**9 + ns for _, _, sec, ns, _ in rows]
    assert columns.poses_bytes() == np.array([row[-1] for row in rows], np.float64).tobytes()


@given(st.binary(max_size=300))
def test_bytes_that_are_no_message_are_refused(data: bytes) -> None:
    """Whatever the bytes, there is a message or a DecodeError."""
    with contextlib.suppress(DecodeError):
        decode_ros1_tf_message(data)


@given(ROWS.filter(bool), st.data())
def test_a_message_that_is_cut_is_refused(rows: list[Any], data: st.DataObject) -> None:
    """At whatever byte."""
    whole = as_rosbags_writes(rows)
    with pytest.raises(DecodeError):
        decode_ros1_tf_message(whole[: data.draw(st.integers(0, len(whole) - 1))])


def test_an_absurd_count_is_refused() -> None:
    """Before memory is taken."""
    with pytest.raises(DecodeError, match=r"4294967295 transforms.* 8 bytes"):
        decode_ros1_tf_message(struct.pack("<I", 2**32 - 1) + bytes(8))


@given(ROWS)
def test_what_is_written_is_what_was_read(rows: list[Any]) -> None:
    """Byte by byte but for the sequence numbers, which are 0: ROS 1 sets none where it matters."""
    message = as_rosbags_writes(rows[:1])
    assert encode_ros1_tf_message(decode_ros1_tf_message(message)) == message
    columns = decode_ros1_tf_message(as_rosbags_writes(rows))
    again = decode_ros1_tf_message(encode_ros1_tf_message(columns))
    assert (again.frames, again.edges_bytes()) == (columns.frames, columns.edges_bytes())
    assert again.stamps_bytes() == columns.stamps_bytes()
    assert again.poses_bytes() == columns.poses_bytes()


def test_a_time_that_ros_1_does_not_have_is_refused() -> None:
    """With the frame."""
    early = TransformStamped(-1, "map", "odom", Transform.identity())
    with pytest.raises(InvalidArgumentException, match=r"frame 'odom' .*ROS 1"):
        encode_ros1_tf_message(Columns.of_transforms([early]))
