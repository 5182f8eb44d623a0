"""`tfbus plot` against a live bus and from a recording: the files it writes."""

import math
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest

from tests.buses import eventually
from tests.simulated_bus import Bus
from tfbus import TfbusError, Transform, TransformBroadcaster, TransformStamped
from tfbus.frames.picture import PANELS, draw
from tfbus.geometry.trajectory import Trajectory, of_checked


@pytest.fixture
def robot(bus: Bus) -> Bus:
    """A bus on which world -> turtle1 moves, 50 times a second."""
    move(bus)
    return bus


def move(bus: Bus) -> list[int]:
    """Let world -> turtle1 move, 50 times a second; the stamps that were sent so far."""
    node = bus.node("sim")
    broadcaster = TransformBroadcaster(node)
    sent: list[int] = []

    def send() -> None:
        now_ns = node.now_ns()
        angle = now_ns % 10**10 / 1e9
        pose = Transform.from_rpy(0.0, 0.0, angle, [math.cos(angle), math.sin(angle), 0.0])
        broadcaster.send_transform(TransformStamped(now_ns, "world", "turtle1", pose))
        sent.append(now_ns)

    node.create_timer(0.02, send)
    return sent


def texts(svg: Path) -> set[str]:
    """The texts in a drawing."""
    return {element.text for element in ElementTree.parse(svg).iter() if element.text}


def test_it_plots_what_it_listens_to(robot: Bus, tmp_path: Path) -> None:
    """After the time asked for it writes position, orientation, speed and path."""
    file = tmp_path / "turtle1.svg"
    done = robot.run("plot", "world", "turtle1", "--for", "1", "-o", str(file))
    assert done.returncode == 0
    assert done.stdout.startswith(f"Wrote {file}: ")
    labels = {"position (m)", "orientation (degrees)", "linear speed (m/s)", "path from above"}
    assert labels <= texts(file)
    assert any(text.startswith("turtle1 seen from world") for text in texts(file))


def test_it_plots_the_history_of_publishers(robot: Bus, tmp_path: Path) -> None:
    """Without waiting it shows the last ten seconds, also those before it was started."""
    file = tmp_path / "turtle1.png"
    done = robot.run("plot", "world", "turtle1", "--show", "path", "-o", str(file))
    assert (done.returncode, done.stderr) == (0, "")
    assert (
        pytest.importorskip("matplotlib.image", reason="needs matplotlib").imread(file).std() > 0.0
    )


def test_a_recording_needs_no_bus(bus: Bus, tmp_path: Path) -> None:
    """With --from it draws what echo has written."""
    recording, file = tmp_path / "run.csv", tmp_path / "run.svg"
    recording.write_text(
        "stamp_ns,frame_id,child_frame_id,x,y,z,qx,qy,qz,qw,roll,pitch,yaw\n"
        "1670400300000000000,world,turtle1,0,0,0,0,0,0,1,0,0,0\n"
        "1670400301000000000,world,turtle1,1,0,0,0,0,0,1,0,0,0\n"
    )
    done = bus.run("plot", "--from", str(recording), "--show", "position", "-o", str(file))
    assert (done.returncode, done.stdout) == (0, f"Wrote {file}: 2 poses over 1.0 s\n")
    [title] = [text for text in texts(file) if text.startswith("turtle1 seen from world")]
    assert title.endswith("2022-12-07 08:05:00 UTC")


def test_a_frame_that_stands_still_is_a_straight_line() -> None:
    """Where a frame moves by less than can be, axes still span a millimetre, or a tenth of a
    degree, and a millimetre a second.
    """
    pytest.importorskip("matplotlib", reason="needs matplotlib")
    count = 50
    noise = 1e-14 * np.sin(np.arange(3 * count)).reshape(count, 3)
    stamps_ns = np.arange(count) * 20_000_000
    track = Trajectory("world", "rock", stamps_ns, noise + np.array([5.0, 2.0, 0.0]))
    position, orientation, speed, path, angular = draw(track, PANELS).axes
    spans = [np.ptp(axes.get_ylim()) for axes in (position, orientation, speed, path, angular)]
    assert (np.array(spans) >= [0.001, 0.1, 0.001, 0.001, 0.001]).all()
    assert np.ptp(path.get_xlim()) >= 0.001


@pytest.mark.parametrize("x", [1.7e308, np.inf])
def test_a_frame_that_is_too_far_away_is_not_plotted(x: float) -> None:
    """A stranger may send any number: the sentence says which frame it is."""
    pytest.importorskip("matplotlib", reason="needs matplotlib")
    xyz, quat_xyzw = np.array([[x, 0.0, 0.0]] * 2), np.array([[0.0, 0.0, 0.0, 1.0]] * 2)
    track = of_checked("map", "far", np.arange(2) * 10**9, xyz, quat_xyzw)
    with pytest.raises(TfbusError, match="'far' is farther"):
        draw(track, PANELS)


def test_an_interrupted_plot_is_of_what_came_before(bus: Bus, tmp_path: Path) -> None:
    """Ctrl-C while it listens ends that early, and what has come is drawn."""
    file = tmp_path / "turtle1.svg"
    sent = move(bus)
    plot = bus.start("plot", "world", "turtle1", "--for", "600", "-o", str(file))
    plot.wait_for_line("Listening")
    already = len(sent)
    eventually(lambda: len(sent) > already + 25)
    assert plot.stop() == 0
    plot.wait_for_line("Interrupted: plotting what has arrived so far")
    plot.wait_for_line(r"Wrote .*turtle1.svg: \d+ poses over ")


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["world", "turtle1"], 2, "there is no display for a window: write a file with -o"),
        (["-o", "x.svg"], 2, "name two frames: tfbus plot world turtle1"),
        (["--from", __file__, "--rate", "5", "-o", "x.svg"], 2, "--from plots all poses of a file"),
        (
            ["--from", "no.csv", "-o", "x.svg"],
            2,
            "for '--from': File 'no.csv' does not exist",
        ),
        (["a", "b", "-o", "x.gif"], 2, "must end with one of .png, .svg, .pdf"),
        (["world", "turtel1", "-o", "x.svg"], 1, "did you mean 'turtle1'?"),
    ],
)
def test_mistakes_are_errors(robot: Bus, arguments: list[str], code: int, message: str) -> None:
    """A mistake is one sentence."""
    done = robot.run("plot", *arguments, env={"DISPLAY": "", "WAYLAND_DISPLAY": ""})
    assert done.returncode == code
    assert message in done.stderr
    assert "Traceback" not in done.stderr
