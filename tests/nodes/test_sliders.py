"""The sliders of joints as text: their lines, and their keys."""

import re
import sys
import threading

import pytest

from tests.nodes.robots import ARM, FREE, arm
from tfbus import Robot
from tfbus.base.wording import columns
from tfbus.nodes.robot.board import Board
from tfbus.nodes.robot.sliders import Sliders


def plain(lines: list[str]) -> list[str]:
    """The lines without colours."""
    return [re.sub(r"\x1b\[\d+m", "", line) for line in lines]


@pytest.fixture
def board() -> Board:
    made = Board()
    made.take_robot(arm())
    return made


def test_each_joint_has_a_line(board: Board) -> None:
    """Name, position, unit, limits and a bar; the chosen one is marked."""
    title, _, shoulder, elbow, grip = plain(Sliders(board).lines(80, 24))
    assert title == "arm: 3 joints"
    assert shoulder.startswith("> shoulder    0.000 rad   -0.50 ─")
    assert shoulder.endswith("─ 3.00")
    assert elbow.startswith("  elbow")
    assert grip.startswith("  grip        0.200 m      0.10 ─")


def test_the_bar_shows_where_a_joint_is(board: Board) -> None:
    """The mark is at the left at the lower limit, and at the right at the upper."""
    sliders = Sliders(board)
    board.set({"shoulder": -9.0, "elbow": 9.0})
    _, _, shoulder, elbow, _ = plain(sliders.lines(80, 24))
    assert " ●──" in shoulder and "──● " in elbow


def test_keys_move_the_chosen_joint(board: Board) -> None:
    """Right and left move by a fiftieth of the range, brackets by a tenth of that, and no key moves
    beyond a limit.
    """
    sliders = Sliders(board)
    sliders.press("down")
    sliders.press("down")
    assert sliders.chosen == "grip"
    sliders.press("right")
    assert board.posture.positions["grip"] == pytest.approx(0.204)
    sliders.press("[")
    assert board.posture.positions["grip"] == pytest.approx(0.2036)
    for _ in range(60):
        sliders.press("left")
    assert board.posture.positions["grip"] == 0.1


def test_the_choice_goes_round(board: Board) -> None:
    """Up from the first is the last, and down from there the first."""
    sliders = Sliders(board)
    sliders.press("up")
    assert sliders.chosen == FREE[-1]
    sliders.press("down")
    assert sliders.chosen == FREE[0]


def test_keys_for_all(board: Board) -> None:
    """r moves all joints, 0 puts the chosen one to rest, and z all."""
    sliders = Sliders(board)
    rest = dict(board.posture.positions)
    sliders.press("r")
    assert all(board.posture.positions[name] != rest[name] for name in FREE)
    sliders.press("0")
    assert board.posture.positions["shoulder"] == 0.0 and board.posture.positions["elbow"] != 0.0
    sliders.press("z")
    assert board.posture.positions == rest


@pytest.mark.parametrize("width", [20, 40, 80, 200])
@pytest.mark.parametrize("height", [1, 4, 12])
def test_it_fits_the_terminal(width: int, height: int) -> None:
    """However small the terminal, no line is too long, and the chosen joint is among those shown
    where there is room for one.
    """
    joints = "".join(
        f'<link name="l{n}"/><joint name="a_joint_with_a_long_name_{n}" type="continuous">'
        f'<parent link="base"/><child link="l{n}"/></joint>'
        for n in range(40)
    )
    board = Board()
    board.take_robot(Robot.from_text(f'<robot name="many"><link name="base"/>{joints}</robot>'))
    sliders = Sliders(board)
    for _ in range(45):
        lines = plain(sliders.lines(width, height))
        assert all(columns(line) <= width for line in lines)
        assert height < 4 or (len(lines) <= height and any(line[0] == ">" for line in lines))
        sliders.press("down")


def test_without_a_robot_it_says_so() -> None:
    """Before a description has come, one line says what it waits for, and keys do nothing."""
    sliders = Sliders(Board())
    sliders.press("right")
    [line] = plain(sliders.lines(80, 24))
    assert line.endswith("topic robot_description")


def test_another_robot_has_its_own_joints(board: Board) -> None:
    """The choice stays valid when a robot with fewer joints comes."""
    sliders = Sliders(board)
    sliders.press("up")
    board.take_robot(
        Robot.from_text(
            ARM.replace('name="grip" type="prismatic"', 'name="grip" type="fixed"').replace(
                '<mimic joint="grip" multiplier="-1" offset="0.5"/>', ""
            )
        )
    )
    assert sliders.chosen in board.posture.ranges


def test_another_robot_may_come_from_another_thread(board: Board) -> None:
    """While descriptions come on the node's thread, each screen and each key is of one robot."""
    sliders = Sliders(board)
    robots = arm(), Robot.from_text(ARM.replace('"elbow"', '"knee"'))

    def come() -> None:
        for count in range(2000):
            board.take_robot(robots[count % 2])

    node = threading.Thread(target=come)
    often = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        node.start()
        while node.is_alive():
            assert len(sliders.lines(80, 24)) == 5
            sliders.press("right")
            sliders.press("down")
    finally:
        node.join()
        sys.setswitchinterval(often)
