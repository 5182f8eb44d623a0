"""The messages of the supplied nodes: their values, which survive the bus."""

import inspect
import math
from dataclasses import is_dataclass
from functools import partial

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tfbus import DecodeError, messages
from tfbus.messages import (
    Clock,
    Color,
    Pose,
    RotateAbsolute,
    SetClock,
    SetPen,
    Spawn,
    TeleportAbsolute,
    TeleportRelative,
    Twist,
    Vector3,
)
from tfbus.wire.codec import decode_message, encode_map, encode_message, from_map

numbers = st.floats(allow_nan=False, allow_infinity=False)
vectors = st.builds(Vector3, numbers, numbers, numbers)
parts = st.integers(0, 255)
POSE = {"x": 0.0, "y": 0.0, "theta": 0.0, "linear_velocity": 0.0, "angular_velocity": 0.0}
MESSAGES = st.one_of(
    st.builds(Twist, vectors, vectors),
    st.builds(Pose, st.integers(0, 2**63 - 1), numbers, numbers, numbers, numbers, numbers),
    st.builds(Color, parts, parts, parts),
    st.builds(Clock, st.integers(0, 2**63 - 1), numbers, st.booleans()),
    st.builds(Spawn.Request, numbers, numbers, numbers, st.text()),
    st.builds(SetPen.Request, parts, parts, parts, parts, st.booleans()),
)


def message_types() -> list[type]:
    """Every dataclass of the module, those inside services and goals too."""
    found = []
    for _, outer in inspect.getmembers(messages, inspect.isclass):
        if outer.__module__ == messages.__name__:
            inner = [value for value in vars(outer).values() if inspect.isclass(value)]
            found += [one for one in (outer, *inner) if is_dataclass(one)]
    return found


@given(MESSAGES)
def test_a_message_arrives_as_it_was_sent(message: object) -> None:
    """Every message that can be made is the same after the bus, to the last bit."""
    assert decode_message(type(message), encode_message(message)) == message


@pytest.mark.parametrize("message_type", message_types(), ids=lambda t: t.__qualname__)
def test_a_message_never_changes(message_type: type) -> None:
    """Messages are frozen: many may hold one."""
    assert message_type.__dataclass_params__.frozen  # dataclass


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_number_that_is_not_finite_is_refused(bad: float) -> None:
    """No message takes a number that is not finite."""
    for make in (
        lambda: Vector3(0.0, 0.0, bad),
        lambda: Spawn.Request(bad, 0.0),
        lambda: TeleportAbsolute.Request(0.0, bad),
        lambda: TeleportRelative.Request(0.0, bad),
        lambda: RotateAbsolute.Goal(bad),
        *(partial(Pose, **{"stamp_ns": 0, **POSE, name: bad}) for name in POSE),
    ):
        with pytest.raises(ValueError, match="must be finite, not"):
            make()


@pytest.mark.parametrize("bad", [-1, 256, 10**20])
def test_a_part_of_a_colour_is_a_byte(bad: int) -> None:
    """Colours and widths outside of 0 to 255 are refused with the range."""
    with pytest.raises(ValueError, match="from 0 to 255"):
        Color(0, bad, 0)
    with pytest.raises(ValueError, match=r"width .*from 0 to 255"):
        SetPen.Request(width=bad)


@pytest.mark.parametrize("bad", [-1, 2**63])
def test_a_time_is_a_stamp(bad: int) -> None:
    """A clock's time is a valid stamp, from 1970 on."""
    for make in (Clock, SetClock.Request):
        with pytest.raises(ValueError, match=f"stamp_ns .*nanoseconds .*not {bad}"):
            make(bad)


def test_invalid_messages_are_not_decoded() -> None:
    """Bytes that hold an impossible message do not decode, and the error says which part."""
    data = encode_map({"linear": {"x": math.nan}, "angular": {}})
    with pytest.raises(DecodeError, match="x must be finite"):
        decode_message(Twist, data)


@pytest.mark.parametrize(
    ("scan", "named"),
    [(messages.LaserScan(1.5, "lidar"), "stamp_ns"), (messages.LaserScan(1, None), "frame_id")],
)
def test_a_header_is_checked_before_it_is_sent(scan: messages.LaserScan, named: str) -> None:
    """Every listener would drop it."""
    with pytest.raises(TypeError, match=f"{named} must be"):
        encode_message(scan)


def test_an_empty_twist_stops() -> None:
    """What is left out of a Twist is zero: `{}` on the command line stops a turtle."""
    assert decode_message(Twist, encode_map({})) == Twist(Vector3(0, 0, 0), Vector3(0, 0, 0))


class _Uncopied(list[int]):
    """A list that may not be repeated."""

    def __mul__(self, times: object) -> list[int]:
        raise AssertionError("a billion times this list takes all memory")

    __rmul__ = __mul__


@pytest.mark.parametrize("field", ["sec", "nanosec"])
def test_a_stamp_of_ros_is_checked_before_it_is_converted(field: str) -> None:
    """A list in the place of a number of seconds is refused, and not taken a billion times."""
    stamp = {"sec": 1, "nanosec": 2, field: _Uncopied([0])}
    with pytest.raises(DecodeError, match=r"'header' .*sec and nanosec"):
        from_map(messages.PoseStamped, {"header": {"stamp": stamp, "frame_id": "map"}})
    with pytest.raises(DecodeError, match=r"'lifetime' .*sec and nanosec"):
        from_map(messages.Marker, {"lifetime": stamp})
