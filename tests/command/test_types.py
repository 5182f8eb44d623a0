"""The types of arguments and options."""

from pathlib import Path

import click
import pytest

from tfbus.command.types import OutputFile


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
