"""Values made to fit a type of ROS."""

from typing import Any

import pytest

from tfbus.ros.counterparts import field_at, fitted, plain, zero
from tfbus.ros.definitions import ODOMETRY, POSE_STAMPED, TURTLE_POSE, Definition
from tfbus.ros.message_type import message_of
from tfbus.ros.schema import MessageCodec
from tfbus.ros.value_codec import UnfitError

MIXED = message_of(
    Definition(
        "my_msgs/msg/Mixed",
        "bool on\nint8 few\nuint8[2] pair\nfloat32[<=2] numbers\nstring name\n"
        "builtin_interfaces/Time[] times\n",
    )
)


def test_what_is_not_there_is_zero() -> None:
    """As in ROS, also within arrays of a fixed size; the result is a message."""
    made = fitted({}, message_of(ODOMETRY))
    assert made == zero(message_of(ODOMETRY))
    assert made["pose"]["covariance"] == [0.0] * 36
    assert MessageCodec.of_definition(ODOMETRY).encode(made) is not None


def test_integers_are_floats_and_floats_have_32_bits() -> None:
    """A float32 comes out as ROS stores it."""
    made = fitted({"x": 1, "theta": 0.1}, message_of(TURTLE_POSE))
    assert (made["x"], type(made["x"])) == (1.0, float)
    assert made["theta"] == 0.10000000149011612


def test_times_are_nanoseconds() -> None:
    """In both directions, also in lists."""
    made = fitted({"header": {"stamp": 7_000_000_005}}, message_of(POSE_STAMPED))
    assert made["header"]["stamp"] == {"sec": 7, "nanosec": 5}
    assert plain(made, message_of(POSE_STAMPED))["header"]["stamp"] == 7_000_000_005
    made = fitted({"times": [1, 2]}, MIXED)
    assert plain(made, MIXED)["times"] == [1, 2]


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"on": 1}, "on must be true or false, not a value of type int"),
        ({"few": 200}, "few is 200, which is no int8"),
        ({"few": 1.5}, "few must be an integer, not a value of type float"),
        ({"few": True}, "few must be an integer, not a value of type bool"),
        ({"pair": [1]}, "pair must have 2 items, not 1"),
        ({"numbers": [1, 2, 3]}, "numbers must have at most 2 items, not 3"),
        ({"numbers": [1, "x"]}, "numbers[1] must be a number, not a value of type str"),
        ({"numbers": [1e300]}, "numbers[0] is 1e+300, which is no float32"),
        ({"name": None}, "name must be a text, not nothing"),
        ({"nme": ""}, "my_msgs/msg/Mixed has no field 'nme'"),
        ({"times": [-(2**70)]}, "times[0].sec is"),
    ],
)
def test_what_does_not_fit_is_named(values: dict[str, Any], said: str) -> None:
    """With its field, and what would fit."""
    with pytest.raises(UnfitError) as caught:
        fitted(values, MIXED)
    assert said in str(caught.value)


def test_bytes_may_be_a_list() -> None:
    """Of numbers from 0 to 255."""
    assert fitted({"pair": [1, 255]}, MIXED)["pair"] == b"\x01\xff"


def test_a_field_is_found_by_its_path() -> None:
    """None where there is none."""
    assert field_at(message_of(POSE_STAMPED), "header.frame_id") is not None
    assert field_at(message_of(POSE_STAMPED), "header.frame") is None
    assert field_at(message_of(POSE_STAMPED), "header.frame_id.x") is None
