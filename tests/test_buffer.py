"""The buffer: what goes in comes out, between any two frames, at any time that is known."""

import pytest

from tfbus.buffer import Buffer
from tfbus.errors import (
    ConnectivityException,
    FutureExtrapolationException,
    LookupException,
    LoopException,
    PastExtrapolationException,
    TimeoutException,
)
from tfbus.transform import Transform, TransformStamped


def moved(stamp_ns: int, parent: str, child: str, x: float) -> TransformStamped:
    return TransformStamped(stamp_ns, parent, child, Transform((x, 0, 0)))


def test_between_two_samples_the_answer_is_interpolated():
    """Half way in time between two samples the frame is half way in space."""
    buffer = Buffer()
    buffer.set_transform(moved(100, "world", "robot", 1.0))
    buffer.set_transform(moved(200, "world", "robot", 3.0))
    assert buffer.lookup_transform("world", "robot", 150).transform.x == 2.0
    assert buffer.lookup_transform("robot", "world", 150).transform.x == -2.0
    assert buffer.latest_common_time("world", "robot") == 200


def test_what_is_out_of_reach_is_refused_by_kind():
    """Too old, too new, unknown, not connected and a loop are errors of different classes."""
    buffer = Buffer()
    buffer.set_transform(moved(100, "world", "robot", 1.0))
    buffer.set_transform(moved(200, "world", "robot", 3.0))
    buffer.set_transform(moved(200, "moon", "rover", 3.0))
    with pytest.raises(PastExtrapolationException):
        buffer.lookup_transform("world", "robot", 50)
    with pytest.raises(FutureExtrapolationException):
        buffer.lookup_transform("world", "robot", 250)
    with pytest.raises(TimeoutException):
        buffer.lookup_transform("world", "robot", 250, timeout_s=0.01)
    with pytest.raises(LookupException):
        buffer.lookup_transform("world", "robbot")
    with pytest.raises(ConnectivityException):
        buffer.lookup_transform("world", "rover")
    with pytest.raises(LoopException):
        buffer.set_transform(moved(200, "robot", "world", 1.0))
