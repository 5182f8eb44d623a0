"""Joints that move by themselves, and stay within their limits."""

import math
from itertools import pairwise
from typing import Any

import pytest

from tests.nodes.robots import ARM, FREE, arm
from tfbus import Robot
from tfbus.nodes.robot.board import Board
from tfbus.nodes.robot.motions import Motion, RandomPlaces, Row, Sweep, Table
from tfbus.nodes.robot.ranges import ranges_of


def test_limits_are_the_narrower_of_two() -> None:
    """A safety controller narrows the limits, a continuous joint goes from -pi to pi, and a joint
    rests at 0 or in the middle.
    """
    ranges = ranges_of(arm())
    assert tuple(ranges) == FREE
    shoulder, elbow, grip = ranges.values()
    assert (shoulder.lower, shoulder.upper, shoulder.rest) == (-0.5, 3.0, 0.0)
    assert (elbow.lower, elbow.upper) == (-math.pi, math.pi)
    assert (grip.lower, grip.upper, grip.rest) == (0.1, 0.3, pytest.approx(0.2))
    assert not grip.turns


@pytest.mark.parametrize(
    ("lower", "upper", "expected"),
    [
        ("5", "inf", (5.0, 5.0 + math.pi)),
        ("-inf", "-5", (-5.0 - math.pi, -5.0)),
        ("1", "inf", (1.0, 1.0 + math.pi)),
        ("-inf", "inf", (-math.pi, math.pi)),
    ],
)
def test_a_limit_that_is_finite_stays(
    lower: str, upper: str, expected: tuple[float, float]
) -> None:
    """Where a joint has one finite limit, however far out, it goes from or to that one."""
    text = ARM.replace('lower="-1" upper="3"', f'lower="{lower}" upper="{upper}"')
    text = text.replace('soft_lower_limit="-0.5" soft_upper_limit="9"', "")
    shoulder = ranges_of(Robot.from_text(text))["shoulder"]
    assert (shoulder.lower, shoulder.upper) == pytest.approx(expected)


def test_other_rests_stay_within_the_limits() -> None:
    """A rest of the user's counts, at most as far as the joint goes."""
    ranges = ranges_of(arm(), {"elbow": 1.5, "grip": 9.0})
    assert (ranges["elbow"].rest, ranges["grip"].rest) == (1.5, 0.3)


@pytest.mark.parametrize("make", [Sweep, lambda ranges: RandomPlaces(ranges, seed=3)])
def test_motions_keep_to_limits_and_speeds(make: Any) -> None:
    """Whatever moves by itself begins at rest, stays within limits, and is not faster than said."""
    ranges = ranges_of(arm())
    motion: Motion = make(list(ranges.values()))
    step = 0.01
    places = [motion.at(count * step) for count in range(3000)]
    for name, each in ranges.items():
        path = [place[name] for place in places]
        assert path[0] == pytest.approx(each.rest)
        assert min(path) >= each.lower - 1e-9 and max(path) <= each.upper + 1e-9
        assert max(abs(b - a) for a, b in pairwise(path)) <= each.speed * step * 1.01
        assert max(path) - min(path) > 0.5 * each.width


def test_the_same_seed_gives_the_same_places() -> None:
    """Two motions of one seed are the same, of two seeds are not."""
    ranges = list(ranges_of(arm()).values())
    one, same, other = (RandomPlaces(ranges, seed) for seed in (1, 1, 2))
    times = [0.3 * count for count in range(50)]
    path = [one.at(t) for t in times]
    assert path == [same.at(t) for t in times]
    assert path != [other.at(t) for t in times]


def test_a_table_gives_each_row_once() -> None:
    """Rows come at their times from the first, then the table has ended."""
    rows = [Row(5.0, {"a": 1.0}), Row(5.5, {"a": 2.0}), Row(6.0, {"a": 3.0})]
    table = Table(rows)
    assert table.due(0.0) == [(0.0, rows[0])]
    assert table.due(0.6) == [(0.5, rows[1])]
    assert not table.has_ended
    assert table.due(99.0) == [(1.0, rows[2])]
    assert table.has_ended and table.due(100.0) == []


def test_a_table_that_loops_begins_again_one_step_after_its_end() -> None:
    """The first row follows the last as the second follows the first."""
    rows = [Row(0.0, {}), Row(0.5, {"a": 1.0})]
    table = Table(rows, loops=True)
    first, second = rows
    assert table.due(0.9) == [(0.0, first), (0.5, second)]
    assert table.due(1.0) == [(1.0, first)]
    assert table.due(3.4) == [(1.5, second), (2.0, first), (2.5, second), (3.0, first)]


def test_a_time_that_jumps_far_is_no_work() -> None:
    """A simulated time that is set years ahead does not make up for what lies between."""
    ranges = ranges_of(arm())
    places = RandomPlaces(ranges.values(), seed=1)
    places.at(0.0)
    assert places.at(1e9).keys() == ranges.keys()


@pytest.mark.parametrize("loops", [False, True])
def test_a_table_goes_on_at_the_row_of_the_time_after_a_jump(loops: bool) -> None:
    """Rows between are left out; the row that the positions are of then is given, and the next."""
    rows = [Row(100.0 + count, {"a": float(count)}) for count in range(10_000)]
    table = Table(rows, loops=loops)
    table.due(0.0)
    assert table.due(5000.5) == [(5000.0, rows[5000])]
    assert table.due(5001.5) == [(5001.0, rows[5001])]
    later = table.due(1_000_003.5)
    assert later == ([(1_000_003.0, rows[3])] if loops else [(9999.0, rows[-1])])
    assert table.has_ended != loops


def test_a_board_keeps_positions_within_limits() -> None:
    """What is set beyond a limit stays at it; names of no joint come back."""
    board = Board()
    board.take_robot(arm())
    assert board.set({"shoulder": 99.0, "nose": 1.0}) == ["nose"]
    assert board.posture.positions["shoulder"] == 3.0


def test_a_board_keeps_positions_of_joints_that_stay() -> None:
    """Another description leaves joints of the same name where they are, within new limits."""
    board = Board({"elbow": 1.0})
    board.take_robot(arm())
    board.set({"shoulder": 2.5})
    board.take_robot(Robot.from_text(ARM.replace('upper="3"', 'upper="2"')))
    assert board.posture.positions == {"shoulder": 2.0, "elbow": 1.0, "grip": pytest.approx(0.2)}
