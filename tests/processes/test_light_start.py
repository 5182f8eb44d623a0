"""The imports of a process: numpy and others take longer than all else of a node's start."""

import sys
from pathlib import Path

import pytest

from tests.buses import DEADLINE_S, keep_sending, send_static
from tests.live_bus import Bus

pytestmark = pytest.mark.real

_PROGRAM = Path(__file__).with_name("light_start.py")


def test_a_node_that_uses_single_transforms_imports_nothing_heavy(bus: Bus) -> None:
    """It sends, listens and looks up, and has not imported numpy, asyncio, yaml or click."""
    robot = bus.node("robot")
    keep_sending(robot, "map", "robot")
    send_static(robot, "robot", "camera")
    process = bus.start_command([sys.executable, str(_PROGRAM)])
    assert process.wait_for_line(r"^\[") == "[]"


@pytest.mark.parametrize(
    "command",
    [
        ("echo", "map", "camera", "--count", "1"),
        ("frames", "--wait-time", str(DEADLINE_S)),
        ("why", "map", "camera"),
    ],
    ids=lambda command: command[0],
)
def test_commands_that_print_poses_need_no_numpy(bus: Bus, command: tuple[str, ...]) -> None:
    """`tfbus echo`, `frames` and `why` answer without importing it."""
    robot = bus.node("robot")
    keep_sending(robot, "map", "robot")
    send_static(robot, "robot", "camera")
    process = bus.start_command(
        [sys.executable, "-X", "importtime", "-m", "tfbus", *command, *bus.options]
    )
    process.wait_for_line("camera|Translation")
    process.wait()
    imported = {line.rpartition("|")[2].strip() for line in process.err}
    assert "click" in imported
    assert "numpy" not in imported
