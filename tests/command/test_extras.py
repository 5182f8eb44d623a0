"""What an extra needs, as a command that works wherever tfbus came from."""

import shutil
import sys

import pytest

from tfbus.command.extras import install_command


@pytest.mark.parametrize(
    ("extra", "library"),
    [("plot", "matplotlib"), ("sim", "pygame-ce"), ("top", "textual"), ("view", "viser")],
)
def test_the_library_is_named_with_its_version(extra: str, library: str) -> None:
    """The command names the library itself, which an index has whether it has tfbus or not."""
    command, _, requirement = install_command(extra).partition(" install ")
    assert command.endswith("pip")
    assert requirement.startswith(f"'{library}>=") or requirement.startswith(f"'{library}<")


def test_the_pip_is_that_of_this_python(monkeypatch: pytest.MonkeyPatch) -> None:
    """If another pip is first on PATH, the command calls this Python's."""
    monkeypatch.setattr(shutil, "which", lambda name: "/usr/bin/pip")
    monkeypatch.setattr(sys, "executable", "/robot/bin/python")
    assert install_command("top").startswith("/robot/bin/python -m pip install ")
    monkeypatch.setattr(sys, "executable", "/usr/bin/python3")
    assert install_command("top").startswith("pip install ")
