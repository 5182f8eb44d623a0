"""Rosters of robots, and their order."""

import pytest

from tfbus.errors import InvalidArgumentException, LookupException
from tfbus.frames.fleet import RobotStatus, roster_of, worst_first
from tfbus.frames.snapshot import Problem
from tfbus.wording import natural_order


def test_numbers_in_names_count_as_numbers() -> None:
    """robot2 is before robot10, and names without numbers are as ever."""
    names = ["robot2", "robot2/arm1", "robot2/arm12", "robot10", "robot", "2", "10", "tower"]
    expected = ["2", "10", "robot", "robot2", "robot2/arm1", "robot2/arm12", "robot10", "tower"]
    assert sorted(names, key=natural_order) == expected
    assert natural_order("1" * 10_000) != natural_order("01")


@pytest.mark.parametrize(
    ("texts", "names"),
    [
        (["robot[1-3]"], ["robot1", "robot2", "robot3"]),
        (["robot[08-10]"], ["robot08", "robot09", "robot10"]),
        (["robot[1,4-5,x]"], ["robot1", "robot4", "robot5", "robotx"]),
        (["hall[1-2]/r[1-2]"], ["hall1/r1", "hall1/r2", "hall2/r1", "hall2/r2"]),
        (["tower", "/tower/"], ["tower"]),
    ],
)
def test_a_roster_has_ranges(texts: list[str], names: list[str]) -> None:
    """A range stands for all its numbers, and its zeros stay; each robot is there once."""
    assert list(roster_of(texts)) == names


@pytest.mark.parametrize(
    "text",
    ["robot[]", "robot[3-1]", "robot[1-]", "robot[1-99999]", "a[1-200][1-200]", "a*", "a//b"],
)
def test_a_roster_refuses_mistakes(text: str) -> None:
    """A range that is none, too many robots, and names that cannot be namespaces are errors."""
    with pytest.raises(InvalidArgumentException):
        roster_of([text])


def test_the_worst_come_first() -> None:
    """Gone, missing, in trouble, well: each in the order of names."""
    problem = Problem("gone", ("robot10/arm",), "its publisher is gone")
    robots = [
        RobotStatus("robot10", "there"),
        RobotStatus("robot2", "there"),
        RobotStatus("robot30", "there", problems=(problem,)),
        RobotStatus("robot4", "missing"),
        RobotStatus("robot5", "gone"),
        RobotStatus("robot1", "there", stale=1),
    ]
    names = [robot.name for robot in worst_first(robots)]
    assert names == ["robot5", "robot4", "robot1", "robot30", "robot2", "robot10"]


@pytest.mark.parametrize(
    ("frame", "nearest"),
    [
        ("robot7/base_link", ()),
        ("robot27/base_lnk", ("robot27/base_link",)),
        ("base_link", ()),
        ("mapp", ("map",)),
    ],
)
def test_similar_names_are_of_the_same_robot(frame: str, nearest: tuple[str, ...]) -> None:
    """An unknown frame is never answered with a frame of another robot."""
    error = LookupException("", frame=frame, known=["map", "robot27/base_link", "robot27/arm"])
    assert error.nearest[:1] == nearest[:1]
    assert nearest or "robot27" not in error.advice
