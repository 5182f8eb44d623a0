"""`tfbus frames` against a live bus: its output and its files."""

import errno
import json
import os
import re
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import yaml

from tests import live_bus
from tests.buses import DEADLINE_S, keep_sending, send_static
from tests.processes.sim_time import follower, start_clock
from tests.simulated_bus import Bus
from tfbus import Transform, TransformBroadcaster, TransformStamped
from tfbus.testing.programs import Program


@pytest.fixture
def robot(bus: Bus) -> Bus:
    """A bus with world -> base at 20 Hz and base -> camera, static."""
    keep_sending(bus.node("odometry"), "world", "base")
    send_static(bus.node("mount"), "base", "camera")
    return bus


def test_it_prints_the_tree_and_its_publishers(robot: Bus) -> None:
    """It has the tree, rates from the publishers' history, and the publishers at once."""
    done = robot.run("frames")
    assert (done.returncode, done.stderr) == (0, "")
    lines = done.stdout.splitlines()
    assert lines[0] == "world"
    assert re.fullmatch(r"└─ base       \d.* old, .*by odometry.*", lines[1])
    assert lines[2] == "   └─ camera  static, by mount"
    publishers = "\n".join(lines[lines.index("Publishers:") :])
    assert re.search(r"mount: /mount .+, pid \d+, 1 frame\n", publishers)
    assert "Problems:" not in lines
    assert max(map(len, lines[:3])) <= 80
    assert "\x1b" not in done.stdout


def test_without_frames_it_fails(bus: Bus) -> None:
    """Without a broadcaster it exits with 1 and a reason."""
    done = bus.run("frames", "--wait-time", "0.2")
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith("Error: no frame after 0.2 s: ")


def test_a_frame_that_is_listed_and_never_comes_is_named(bus: Bus) -> None:
    """Its broadcaster runs: the reason is not that none does."""
    node = bus.node("arm")
    broadcaster = TransformBroadcaster(node, history_s=0.0)
    broadcaster.send_transform(TransformStamped(1, "world", "base", Transform.identity()))
    done = bus.run("frames")
    assert done.returncode == 1
    assert "no transform of 'base'" in done.stderr and "though /arm on " in done.stderr


def test_problems_are_shown_and_checked(robot: Bus) -> None:
    """Two publishers of a frame and a tree apart are named; --check then exits with 1."""
    assert robot.run("frames", "--check").returncode == 0
    send_static(robot.node("other_mount"), "base", "camera")
    send_static(robot.node("elsewhere"), "map", "dock")
    done = robot.run("frames", "--check")
    assert done.returncode == 1
    problems = done.stdout.split("Problems:\n")[1]
    assert "conflict: 'camera' is published" in problems and "/mount on " in problems
    assert "disconnected: 'map' and 1 frame" in problems


def test_files_are_what_their_endings_say(robot: Bus, tmp_path: Path) -> None:
    """Each file opens with a program of its kind, and names all frames."""
    endings = ("svg", "pdf", "png", "dot", "json", "yaml", "mmd", "txt")
    files = {ending: tmp_path / f"frames.{ending}" for ending in endings}
    outputs = [argument for file in files.values() for argument in ("--output", str(file))]
    done = robot.run("frames", *outputs)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines() == [f"Wrote {file}: 3 frames" for file in files.values()]
    names = {"world", "base", "camera"}
    texts = {element.text for element in ElementTree.parse(files["svg"]).iter()}
    assert names <= texts
    assert set(json.loads(files["json"].read_text())["roots"]) == {"world"}
    assert yaml.safe_load(files["yaml"].read_text()).keys() == {"base", "camera"}
    assert '"base" -> "camera"' in files["dot"].read_text()
    assert files["mmd"].read_text().startswith("flowchart TD")
    assert files["txt"].read_text().startswith("world\n└─ base")
    image = pytest.importorskip("matplotlib.image", reason="needs matplotlib").imread(files["png"])
    assert image.shape[1] > 500
    assert image.std() > 0.0
    reader = pytest.importorskip("pypdf", reason="needs pypdf").PdfReader(files["pdf"])
    assert all(name in reader.pages[0].extract_text() for name in names)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["-o", "frames.gif"], "must end with one of .svg, .pdf, "),
        (["-o", "nowhere/frames.svg"], "there is no folder nowhere to write frames.svg into"),
        (["--watch", "--json"], "--watch shows the tree in the terminal"),
    ],
)
def test_mistakes_are_errors(bus: Bus, arguments: list[str], message: str) -> None:
    """A mistake in an option is one sentence, with exit code 2, before it listens."""
    done = bus.run("frames", *arguments)
    assert (done.returncode, done.stdout) == (2, "")
    assert message in done.stderr


@contextmanager
def no_room() -> Iterator[None]:
    """No file can be written: a limit on the size of files fails as a full disk does, in the
    middle of the file.
    """
    resource = pytest.importorskip("resource", reason="needs Unix")
    before, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, most))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (before, most))


@pytest.mark.parametrize("ending", ["svg", "png", "json", "txt"])
def test_a_full_disk_leaves_the_former_file(robot: Bus, tmp_path: Path, ending: str) -> None:
    """A file that cannot be written whole stays as it was; one sentence, exit code 1."""
    file = tmp_path / f"frames.{ending}"
    file.write_text("former")
    with no_room():
        done = robot.run("frames", "-o", str(file))
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith(f"Error: {file} ")
    assert done.stderr.endswith(": File too large\n") and done.stderr.count("\n") == 1
    assert file.read_text() == "former"
    assert [each.name for each in tmp_path.glob(f"*frames.{ending}*")] == [file.name]


@pytest.mark.real
def test_a_full_disk_behind_stdout_is_one_sentence(robot: live_bus.Bus) -> None:
    """Output that cannot be written ends with exit code 1 and the reason."""
    shell = f'exec "$@" --wait-time {DEADLINE_S} > /dev/full'
    done = robot.start_command(
        ["bash", "-c", shell, "bash", sys.executable, "-m", "tfbus", "frames"]
    )
    assert done.wait() == 1
    [error] = done.err
    assert error.startswith("Error: the output ") and error.endswith(os.strerror(errno.ENOSPC))


def test_json_is_for_scripts(robot: Bus) -> None:
    """--json prints one object: frames, streams and problems."""
    report = json.loads(robot.run("frames", "--json").stdout)
    frames = {frame["name"]: frame for frame in report["frames"]}
    assert frames["camera"]["static"]
    assert frames["base"]["rate_hz"] == pytest.approx(20.0, rel=0.5)
    assert {stream["name"] for stream in report["streams"]} == {"odometry", "mount"}
    assert report["problems"] == []


def test_watching_leaves_the_scrollback(robot: Bus) -> None:
    """In a terminal it is on the alternate screen, cut to its height; the last page stays."""
    shown = robot.run_in_terminal("frames", "--watch", until="more line", lines=5)
    before, _, after = shown.partition("\x1b[?1049l")
    pages = before.removeprefix("\x1b[?1049h\x1b[?25l").split("\x1b[H")[1:]
    assert all(page.count("\n") == 4 for page in pages)
    assert "└─ base" in after and "Publishers:" in after


def test_simulated_time_is_said(bus: Bus) -> None:
    """Without --sim-time it says whose frames follow a clock; with it, nothing is wrong."""
    start_clock(bus, "--start", "-60s")
    keep_sending(follower(bus, "odometry"), "world", "base")
    done = bus.run("frames")
    assert "simulated: use --sim-time" in done.stdout
    problem = " ".join(done.stdout.split("Problems:")[1].split())
    assert problem.startswith("clock: /clock ") and " 1 of 1 " in problem
    assert "late: " not in problem
    assert "Problems:" not in bus.run("frames", "--sim-time").stdout


def test_stamps_ahead_are_a_problem(bus: Bus) -> None:
    """Stamps of five minutes later are named, with what to do; --check then exits with 1."""
    keep_sending(bus.node("arm"), "world", "base", late_ns=-300_000_000_000)
    done = bus.run("frames", "--check", "-t", "20")
    assert done.returncode == 1
    assert re.search("base +AHEAD, 5 min", done.stdout)
    publishers, problem = done.stdout.split("Problems:")
    assert publishers.rstrip().endswith(", 5 min ahead")
    problem = " ".join(problem.split())
    assert problem.startswith("ahead: ") and "'base' are 5 min" in problem
    assert "have /arm on " in problem and "node.now_ns()" in problem


def test_stamps_long_past_are_a_problem(bus: Bus) -> None:
    """Samples that come 5 s after their stamps are named, with what to do; --check then fails."""
    keep_sending(bus.node("arm"), "world", "base", late_ns=5_000_000_000)
    done = bus.run("frames", "--check", "-t", "20")
    assert done.returncode == 1
    problem = " ".join(done.stdout.split("Problems:")[1].split())
    assert problem.startswith("late: ") and "'base' come 5.0 s after" in problem
    assert "have /arm on " in problem and "node.now_ns()" in problem


def test_a_simulated_time_ahead_of_ours_is_no_problem_of_stamps(bus: Bus) -> None:
    """With --sim-time nothing is wrong; without, the simulated time is what is."""
    start_clock(bus, "--start", "+3600s")
    keep_sending(follower(bus, "odometry"), "world", "base")
    problem = bus.run("frames", "-t", "20").stdout.split("Problems:")[1]
    assert "clock: /clock publishes" in problem
    assert "in the future" not in problem
    done = bus.run("frames", "--sim-time", "--check", "-t", "20")
    assert (done.returncode, "Problems:" in done.stdout) == (0, False)


def test_watching_follows_what_changes(robot: Bus) -> None:
    """--watch marks a publisher that ends, and ends with Ctrl-C."""
    mount = robot.node("short_lived")
    send_static(mount, "base", "gripper")
    watch: Program = robot.start("frames", "--watch")
    watch.wait_for_line("gripper.*static, by short_lived")
    mount.close()
    watch.wait_for_line("gripper.*GONE, static, by short_lived")
    watch.wait_for_line("gone: the publisher of 'gripper' is gone: /short_lived on ")
    assert watch.stop() == 0
