"""The exit codes of commands that are called wrongly, or whose names are nowhere."""

from pathlib import Path

import pytest
from click.testing import CliRunner

from tests.needs import module
from tests.recordings import write_robot
from tests.simulated_bus import Bus
from tfbus.cli import main


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


@pytest.mark.parametrize(
    "words",
    [
        "keys add",
        "keys add arm --namespace",
        "keys add arm --nodes",
    ],
)
def test_a_name_that_nothing_can_have_is_a_mistake_of_the_call(tmp_path: Path, words: str) -> None:
    """A command exits with 2 if a name on its command line has a letter that no name has."""
    module("cryptography")
    keys = str(tmp_path / "keys")
    assert CliRunner().invoke(main, ["keys", "init", keys]).exit_code == 0
    more = ("--role", "publisher", "--keys", keys)
    done = CliRunner().invoke(main, [*words.split(), "a b", *more])
    assert done.exit_code == 2, done.output
    assert "'a b'" in done.output


@pytest.mark.parametrize(
    ("words", "name"),
    [
        ("bag export run.mcap --topic bat -o a.csv", "bat"),
        ("bag export run.mcap map bas -o a.csv", "bas"),
        ("bag filter run.mcap --topics bat -o a.mcap", "bat"),
        ("bag filter run.mcap --streams bat -o a.mcap", "bat"),
        ("bag filter run.mcap --frames bas -o a.mcap", "bas"),
        ("bag filter run.mcap --drop bat -o a.mcap", "bat"),
        ("bag play run.mcap --topics bat", "bat"),
        ("bag play run.mcap --streams bat", "bat"),
        ("bag play run.mcap --remap bat:=tab", "bat"),
        ("echo map bas --bag run.mcap", "bas"),
        ("monitor map bas --bag run.mcap", "bas"),
        ("node info bat --bag run.mcap", "bat"),
        ("param get bat gain --bag run.mcap", "bat"),
        ("plot map bas --bag run.mcap -o a.png", "bas"),
        ("topic delay bat --bag run.mcap", "bat"),
        ("topic echo bat --bag run.mcap", "bat"),
        ("why map bas --bag run.mcap", "bas"),
    ],
)
def test_a_name_that_a_recording_lacks_is_a_failure(
    bus: Bus, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: str, name: str
) -> None:
    """A command exits with 1 if its name is not in the recording, as if it is not on the bus."""
    monkeypatch.chdir(tmp_path)
    write_robot(tmp_path / "run.mcap")
    done = bus.run(*words.split())
    assert done.returncode == 1, done.stderr
    assert f"'{name}'" in done.stdout + done.stderr
    assert not list(tmp_path.glob("a.*"))
