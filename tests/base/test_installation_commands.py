"""The commands that complete an installation: its extras, and its kernel."""

import shutil
import sys
from pathlib import Path

import pytest

from tfbus.base.installation import compile_command, install_command


def test_an_extra_is_named_as_it_is_typed() -> None:
    """The command names tfbus with the extra, quoted for a shell."""
    command, _, requirement = install_command("bag").partition(" install ")
    assert command.endswith("pip")
    assert requirement == "'tfbus[bag]'"


def test_sources_that_are_not_installed_are_named_by_their_folder(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """An index need not have tfbus: the command installs the sources themselves."""
    from importlib import metadata

    def missing(name: str) -> metadata.Distribution:
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "distribution", missing)
    assert install_command("bag", str(tmp_path)).endswith(f"--editable '{tmp_path}[bag]'")


def test_the_kernel_is_compiled_by_the_command_for_a_clone_or_a_wheel(tmp_path: Path) -> None:
    """A clone is installed in place; a wheel is made again from the sources of an index."""
    assert compile_command(str(tmp_path)).endswith("--no-binary tfbus tfbus")
    for name in ("setup.py", "pyproject.toml"):
        (tmp_path / name).touch()
    assert compile_command(str(tmp_path)).endswith(f"--editable {tmp_path}")


def test_in_the_environment_that_make_has_made_the_kernel_is_made_by_make(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """There the doctor advises no reinstallation: `make kernel` compiles it in place."""
    for name in ("setup.py", "pyproject.toml", "Makefile"):
        (tmp_path / name).touch()
    monkeypatch.setattr(sys, "prefix", str(tmp_path / ".venv"))
    assert compile_command(str(tmp_path)) == f"make -C {tmp_path} kernel"


def test_the_pip_is_that_of_this_python(monkeypatch: pytest.MonkeyPatch) -> None:
    """If another pip is first on PATH, the command calls this Python's."""
    monkeypatch.setattr(shutil, "which", lambda name: "/usr/bin/pip")
    monkeypatch.setattr(sys, "executable", "/robot/bin/python")
    assert install_command("top").startswith("/robot/bin/python -m pip install ")
    monkeypatch.setattr(sys, "executable", "/usr/bin/python3")
    assert install_command("top").startswith("pip install ")
