"""The exit codes of commands that are called wrongly."""

import pytest

from tests.simulated_bus import Bus


def test_a_word_after_a_launch_file_of_tfbus_may_be_an_argument(bus: Bus) -> None:
    """It is sought in a package of that name, and the form of an argument is said too."""
    done = bus.run("launch", "turtle", "headless")
    assert done.returncode == 2
    assert "no Python package 'turtle'; if 'headless' is an argument of turtle" in done.stderr


@pytest.mark.parametrize(
    "words",
    [
        "bag info none.mcap",
        "frames --bag none.mcap",
        "joints none.urdf",
        "joints --csv none.csv",
        "keys check --keys none",
        "launch none.yaml",
        "launch none",
        "plot --from none.csv -o plot.png",
        "robot_state none.urdf",
        "service install none.yaml --dry-run",
        "static --file none.yaml",
        "static a b --params-file none.yaml",
        "static a b --secure none",
        "teleop",
        "top",
        "topic pub scan PointCloud --file none.ply",
        "view --urdf none.urdf",
    ],
)
def test_a_file_or_terminal_that_is_not_there_is_a_mistake_of_the_call(
    bus: Bus, words: str
) -> None:
    """A command exits with 2 if a file that it is given is not there, and without its terminal."""
    done = bus.run(*words.split())
    assert done.returncode == 2, done.stderr
    assert "Error: " in done.stderr
