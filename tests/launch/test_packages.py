"""Launch files of Python packages: found by package and name, listed, completed, included."""

from pathlib import Path

import pytest

from tests.simulated_bus import Bus
from tfbus.launch.description import LaunchError
from tfbus.launch.find import (
    find_in,
    find_in_package,
    find_launch_file,
    installed_launch_files,
    launch_files_of,
)

A_LAUNCH = "description: Drives.\narguments: {speed: {default: 1}}\nnodes: [{node: simulator}]\n"


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder on Python's path, with the package `fleet7` that must not be imported."""
    package = tmp_path / "site" / "fleet7"
    (package / "launch").mkdir(parents=True)
    (package / "__init__.py").write_text("raise SystemExit('it was imported')")
    (package / "drive.launch.yaml").write_text(A_LAUNCH)
    (package / "launch" / "arm.yaml").write_text(A_LAUNCH)
    (package / "parameters.yaml").write_text("speed: 3\n? [left, right]\n: 4\n")
    info = tmp_path / "site" / "fleet7-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: fleet7\nVersion: 1\n")
    (info / "entry_points.txt").write_text("[tfbus.nodes]\nfleet7_node = fleet7.node:main\n")
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    return tmp_path / "site"


def test_a_package_has_the_files_that_list_nodes(site: Path) -> None:
    """They are those in its folder and in `launch`; a file of parameters, by words or by lists, is
    none of them.
    """
    assert list(launch_files_of("fleet7")) == ["arm.yaml", "drive.launch.yaml"]


@pytest.mark.parametrize("name", ["drive", "drive.launch", "drive.launch.yaml"])
def test_a_file_is_found_with_or_without_its_ending(site: Path, name: str) -> None:
    """As people type it."""
    assert find_in_package("fleet7", name) == site / "fleet7" / "drive.launch.yaml"


@pytest.mark.parametrize(
    ("package", "name", "sentence"),
    [
        ("fleet7", "arn.yaml", "package 'fleet7' has no launch file 'arn.yaml'; did you mean"),
        ("fleet8", "arm", "there is no Python package 'fleet8'; did you mean 'fleet7'?"),
        ("../x", "arm", "there is no Python package '../x'"),
        (
            "turtle_tf2_py",
            "x.launch.py",
            "there is no Python package 'turtle_tf2_py'; use: tfbus launch follow",
        ),
    ],
)
def test_what_is_not_there_gets_a_near_name(
    site: Path, package: str, name: str, sentence: str
) -> None:
    """The error names the nearest file or package."""
    with pytest.raises(LaunchError) as caught:
        find_in_package(package, name)
    assert str(caught.value).startswith(sentence)


def test_it_is_launched_as_by_ros2(site: Path, bus: Bus, tmp_path: Path) -> None:
    """`launch PACKAGE FILE NAME:=VALUE` reads it, also through an include; --list names it."""
    env = {"PYTHONPATH": str(site)}
    dry = bus.run("launch", "fleet7", "drive", "speed:=2", "--dry-run", env=env)
    assert dry.returncode == 0, dry.stderr
    assert "tfbus simulator" in dry.stdout
    including = tmp_path / "all.yaml"
    including.write_text("includes: [{package: fleet7, file: arm}]\n")
    assert bus.run("launch", str(including), "--dry-run", env=env).stdout == dry.stdout
    listed = bus.run("launch", "--list", env=env).stdout.splitlines()
    ours = listed.index("fleet7:")
    assert listed[ours + 1 : ours + 3] == ["  arm.yaml  Drives.", "  drive.launch.yaml  Drives."]
    assert "tfbus:" in listed
    shown = bus.run("launch", "tfbus", "turtle", "--show-args").stdout
    assert shown == bus.run("launch", "turtle", "--show-args").stdout
    alone = bus.run("launch", "fleet7", env=env)
    assert "launch fleet7 arm.yaml" in alone.stderr and "drive.launch.yaml" in alone.stderr


def test_packages_and_their_files_are_completed(site: Path, bus: Bus) -> None:
    """After `launch` come packages, after a package its files, after these the arguments."""
    env = {"PYTHONPATH": str(site), "_TFBUS_COMPLETE": "fish_complete"}

    def candidates(line: str) -> list[str]:
        rows = bus.run(env={**env, "TFBUS_LINE": line}).stdout.splitlines()
        return [row.split("\t")[1] for row in rows if row.startswith("plain")]

    assert candidates("tfbus launch fl") == ["fleet7"]
    assert candidates("tfbus launch fleet7 d") == ["drive.launch.yaml"]
    assert candidates("tfbus launch fleet7 drive s") == ["speed:="]


@pytest.mark.parametrize("name", ["turtle", "turtle.yaml", "turtle.launch.yaml"])
def test_a_supplied_file_is_found_with_or_without_its_ending(name: str) -> None:
    """Alone and after `tfbus`, a file of tfbus goes by its name or its file name."""
    assert find_in("tfbus", name) == find_launch_file(name) == installed_launch_files()["turtle"]


@pytest.mark.parametrize("name", ["turtle.launch.py", "nope.yaml"])
def test_a_file_that_is_not_there_is_answered_by_those_there_are(name: str) -> None:
    """A launch file of ROS in Python, and a file name that nothing has, list what there is."""
    with pytest.raises(LaunchError, match=r"available: .*turtle"):
        find_in("tfbus", name)
