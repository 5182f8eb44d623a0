"""The types of arguments and options."""

from pathlib import Path

import click
import pytest

from tfbus.bus.settings import NodeSettings
from tfbus.command.types import LogLevel, NodeName, OutputFile, ParameterName


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("a.gif", "must end with .svg"),
        ("nowhere/a.svg", "there is no folder"),
        ("folder.svg", "is a directory"),
    ],
)
def test_a_file_to_write_is_checked_before_the_work(
    tmp_path: Path, name: str, message: str
) -> None:
    """Another ending, a missing folder, or a folder of that name is a usage error."""
    (tmp_path / "folder.svg").mkdir()
    with pytest.raises(click.UsageError, match=message):
        OutputFile(".svg").convert(str(tmp_path / name), None, None)


def test_a_file_to_write_may_exist(tmp_path: Path) -> None:
    """It is overwritten."""
    path = tmp_path / "a.svg"
    path.touch()
    assert OutputFile(".svg").convert(str(path), None, None) == path


@pytest.mark.parametrize("name", ["sim", "/sim", "/robot7/sim", "robot7/arm/sim", "/sim/"])
def test_a_node_goes_by_its_name_or_its_full_name(name: str) -> None:
    """Names of nodes may have a namespace, and a leading slash as in ROS."""
    assert NodeName().convert(name, None, None) == name


@pytest.mark.parametrize("name", ["caf\udce9", "", "/", "a b", "sim\x1b[2J"])
def test_a_name_that_no_node_has_is_a_usage_error(name: str) -> None:
    """The error is one sentence that a terminal can show."""
    with pytest.raises(click.UsageError, match="cannot be") as caught:
        NodeName().convert(name, None, None)
    assert str(caught.value.message).isprintable()


@pytest.mark.parametrize("name", ["caf\udce9", "", "/rate", "a b"])
def test_a_name_that_no_parameter_has_is_a_usage_error(name: str) -> None:
    """The error is one sentence that a terminal can show."""
    with pytest.raises(click.UsageError, match="name of a parameter") as caught:
        ParameterName().convert(name, None, None)
    assert str(caught.value.message).isprintable()


@pytest.mark.parametrize(
    ("text", "level"), [("warn", "warning"), ("WARN", "warning"), ("debug", "debug")]
)
def test_a_log_level_has_the_name_that_ros_gives_it_too(text: str, level: str) -> None:
    """On a command line, and in settings, so in the environment."""
    assert LogLevel().convert(text, None, None) == level
    assert NodeSettings("n", log_level=text).log_level == level
