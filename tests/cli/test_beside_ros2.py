"""The tools on one network with ROS 2: they show tfbus's keys, and not a word of the rest."""

import threading
from collections.abc import Iterator

import pytest

from tests.buses import keep_sending, send_static
from tests.ros2_on_zenoh import Ros2
from tests.simulated_bus import Bus


@pytest.fixture
def beside(bus: Bus) -> Iterator[Bus]:
    """A bus with one robot, on which ROS 2 sends 50 times a second."""
    ros2 = Ros2(getattr(bus, "endpoint", ""))
    ros2.rmw_zenoh()
    ros2.bridge()
    ended = threading.Event()

    def send() -> None:
        while not ended.wait(0.02):
            ros2.send()

    thread = threading.Thread(target=send)
    thread.start()
    robot = bus.node("sim", namespace="robot7")
    keep_sending(robot, "world", "base")
    send_static(robot, "base", "laser")
    yield bus
    ended.set()
    thread.join()
    ros2.close()


@pytest.mark.parametrize(
    ("arguments", "shown"),
    [
        (["echo", "robot7/base", "robot7/laser", "--fleet", "--once"], "- Translation: [0.000"),
        (["frames", "--fleet"], "robot7/sim: /robot7/sim"),
        (["node", "list"], "/robot7/sim"),
        (["topic", "hz", "/robot7/tf", "--once"], "average rate"),
        (["monitor", "--fleet", "--once"], "robot7/base"),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else "",
)
def test_a_tool_is_silent_about_ros_2(beside: Bus, arguments: list[str], shown: str) -> None:
    """It shows what streams send, names nothing of ROS 2, and warns of nothing."""
    done = beside.run(*arguments)
    logged = [line for line in done.stderr.splitlines() if "[INFO]" not in line]
    assert (done.returncode, logged) == (0, [])
    assert shown in done.stdout
    assert "dds_" not in done.stdout and "bot1" not in done.stdout


@pytest.mark.real
def test_top_shows_streams_alone(beside: Bus) -> None:
    """As the other tools, in a terminal."""
    shown = beside.run_in_terminal("top", "--fleet", until="robot7/laser")
    assert "dds_" not in shown and "bot1" not in shown and "Dropped" not in shown
