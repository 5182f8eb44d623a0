"""ROS's Time and Duration."""

import operator
from collections.abc import Callable
from typing import Any

import pytest

from tfbus.compat.builtin_interfaces import msg as builtin
from tfbus.compat.rclpy.clock import Clock
from tfbus.compat.rclpy.duration import Duration, Infinite, seconds_of
from tfbus.compat.rclpy.time import ClockType, Time
from tfbus.ros.transforms import stamp_ns_of

S = 1_000_000_000


class OfRos1:
    """A stamp as genpy's."""

    secs, nsecs = 3, 4


def test_a_time_is_its_seconds_and_nanoseconds_together() -> None:
    """Both are added, and come apart again."""
    time = Time(seconds=1.5, nanoseconds=7)
    assert time.nanoseconds == 1_500_000_007
    assert time.seconds_nanoseconds() == (1, 500_000_007)


@pytest.mark.parametrize("nanoseconds", [0, 1, S - 1, S, 1_795_252_263_740_641_361])
def test_a_time_survives_a_message(nanoseconds: int) -> None:
    """To a message and back, to the nanosecond."""
    time = Time(nanoseconds=nanoseconds, clock_type=ClockType.ROS_TIME)
    assert Time.from_msg(time.to_msg()) == time
    assert time.to_msg().sec == nanoseconds // S


@pytest.mark.parametrize("nanoseconds", [0, -1, -S, 5 * S + 3])
def test_a_duration_survives_a_message(nanoseconds: int) -> None:
    """Negative ones too: the nanoseconds of the message are never negative."""
    message = Duration(nanoseconds=nanoseconds).to_msg()
    assert 0 <= message.nanosec < S
    assert Duration.from_msg(message).nanoseconds == nanoseconds


def test_times_and_durations_are_added_and_subtracted() -> None:
    """Time and duration make a time, two times a duration."""
    one, second = Time(seconds=1), Duration(seconds=1)
    assert one + second == second + one == Time(seconds=2)
    assert Time(seconds=2) - second == one
    assert (one - Time(seconds=3)).nanoseconds == -2 * S
    assert (second + second * 2 - second * 0.5).nanoseconds == 2_500_000_000
    assert second * float("inf") == Infinite


@pytest.mark.parametrize("compare", [operator.eq, operator.lt, operator.ge, operator.sub])
def test_times_of_two_clocks_are_not_compared(compare: Callable[[Any, Any], Any]) -> None:
    """Nor subtracted: it is an error as in ROS, which names both clocks."""
    with pytest.raises(TypeError, match=r"SYSTEM_TIME .*ROS_TIME"):
        compare(Time(), Time(clock_type=ClockType.ROS_TIME))


def test_times_and_durations_have_an_order() -> None:
    """Of one clock."""
    assert Time(seconds=1) < Time(seconds=2) >= Time(seconds=2) != Time(seconds=1)
    assert Duration(seconds=-1) < Duration() <= Duration() < Duration(nanoseconds=1)
    assert Time() != 0 and Duration() != 0


@pytest.mark.parametrize(
    ("make", "error"),
    [
        (lambda: Time(seconds=-1), ValueError),
        (lambda: Time(seconds=2**40), OverflowError),
        (lambda: Duration(seconds=2**40), OverflowError),
        (lambda: Time(seconds=1) - Duration(seconds=2), ValueError),
        (lambda: Duration() * float("nan"), ValueError),
        (lambda: Time.from_msg(Time()), TypeError),
    ],
)
def test_a_time_that_cannot_be_is_an_error(make: Callable[[], Any], error: type[Exception]) -> None:
    """Of the same class as in rclpy."""
    with pytest.raises(error):
        make()


@pytest.mark.parametrize(
    ("time", "stamp_ns"),
    [
        (Time(seconds=3, nanoseconds=4), 3 * S + 4),
        (builtin.Time(sec=3, nanosec=4), 3 * S + 4),
        (OfRos1(), 3 * S + 4),
        (Time(), 0),
    ],
)
def test_what_counts_as_a_time(time: Any, stamp_ns: int) -> None:
    """A Time, and any message's stamp."""
    assert stamp_ns_of(time) == stamp_ns


@pytest.mark.parametrize("time", [0, 1.5, None, "now", Duration(seconds=1)])
def test_what_is_no_time_says_what_to_write(time: Any) -> None:
    """Seconds as a number, and a duration, are refused."""
    with pytest.raises(TypeError, match=r"a Time .*\(seconds="):
        stamp_ns_of(time)


@pytest.mark.parametrize("timeout", [1.0, None, Time(seconds=1)])
def test_what_is_no_timeout_says_what_to_write(timeout: Any) -> None:
    """Seconds as a number, and a time, are refused."""
    with pytest.raises(TypeError, match=r"timeout=Duration\(seconds=\.\.\.\)"):
        seconds_of(timeout)


def test_a_clock_counts_since_the_epoch() -> None:
    """The system's, in its own type."""
    now = Clock().now()
    assert now.clock_type == ClockType.SYSTEM_TIME and now.nanoseconds > 1_700_000_000 * S
    assert Clock(clock_type=ClockType.STEADY_TIME).now().nanoseconds < now.nanoseconds
