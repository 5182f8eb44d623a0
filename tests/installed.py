"""Promises of the package as it is installed, away from its sources.

Not collected with the other tests: run it in an environment that has the wheel.
"""

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

TFBUS = str(Path(sys.executable).with_name("tfbus"))


def run(*command: str, cwd: Path | None = None) -> str:
    """What the command prints; it must succeed."""
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_it_is_the_installed_one() -> None:
    """The package under test is not the one in the sources."""
    import tfbus

    assert "site-packages" in str(tfbus.__file__)


@pytest.mark.parametrize("name", ["nodes", "configs"])
def test_nothing_else_is_put_at_the_top_level(name: str) -> None:
    """Only `tfbus` is installed: the nodes and launch files lie within it."""
    assert importlib.util.find_spec(name) is None
    assert importlib.util.find_spec(f"tfbus.{name}") is not None


def test_every_node_has_its_help() -> None:
    """Each subcommand that `tfbus --help` lists can be imported."""
    from tfbus.cli import NODES, TOOLS

    for name in [*NODES, *TOOLS]:
        assert "Usage:" in run(TFBUS, name, "--help")


def test_launch_files_are_found_by_name() -> None:
    """`tfbus launch turtle` works in any folder."""
    assert "turtlename" in run(TFBUS, "launch", "turtle", "--show-args")


def test_a_created_package_installs_and_passes_its_test(tmp_path: Path) -> None:
    """What `tfbus create` writes works as written."""
    run(TFBUS, "create", "my_robot", "--node", "my_node", cwd=tmp_path)
    folder = tmp_path / "my_robot"
    run(sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "-e", ".", cwd=folder)
    assert "passed" in run(sys.executable, "-m", "pytest", "-q", cwd=folder)
    assert "--param" in run(TFBUS, "my_node", "--help", cwd=folder)
