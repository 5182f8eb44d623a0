"""`tfbus static` as a process, seen by others."""

import signal
from pathlib import Path

import pytest
from click.testing import CliRunner

from tests.simulated_bus import Bus
from tfbus import Buffer, Transform, TransformListener
from tfbus.nodes.static import main
from tfbus.nodes.static_edge import in_new_form
from tfbus.testing.programs import Program


def lookup(bus: Bus, target: str, source: str) -> Transform:
    """The transform as a listener sees it that starts now."""
    buffer = Buffer()
    with TransformListener(buffer, bus.node("late")):
        return buffer.lookup_transform(target, source, timeout_s=10.0).transform


def announced(process: Program) -> list[str]:
    """Its log, without times, once it is ready."""
    process.wait_for_line(": ready$")
    return [line.split("]: ")[-1] for line in process.err]


def test_later_listeners_see_it(bus: Bus) -> None:
    """A static transform reaches processes that start after it, as long as it runs."""
    static = bus.start("static", "world", "camera", "--x", "1", "--yaw", "0.5")
    assert announced(static) == [
        "Spinning until stopped - publishing transform",
        "translation: ('1.000000', '0.000000', '0.000000')",
        "rotation: ('0.000000', '0.000000', '0.247404', '0.968912')",
        "from 'world' to 'camera'",
        "ready",
    ]
    assert lookup(bus, "world", "camera").is_close(Transform.from_rpy(0, 0, 0.5, xyz=(1, 0, 0)))
    echo = bus.run("echo", "world", "camera", "--once", "--style", "foxy")
    assert echo.stdout == (
        "At time 0.000000000\n"
        "- Translation: [1.000, 0.000, 0.000]\n"
        "- Rotation: in Quaternion [0.000, 0.000, 0.247, 0.969]\n"
    )


def test_a_file_publishes_many_edges_at_once(bus: Bus, tmp_path: Path) -> None:
    """With `--file` one process publishes every edge of a YAML file."""
    path = tmp_path / "edges.yaml"
    path.write_text(
        "- {frame_id: world, child_frame_id: camera, x: 1}\n"
        "- {frame_id: camera, child_frame_id: lens, y: 2, yaw: 180, deg: true}\n"
    )
    static = bus.start("static", "--file", str(path))
    assert announced(static).count("Spinning until stopped - publishing transform") == 2
    assert lookup(bus, "lens", "world").is_close(Transform((1, 2, 0), (0, 0, -1, 0)))


def test_two_of_them_join_into_one_tree(bus: Bus) -> None:
    """Many can run at once, each a node with a name of its own."""
    quaternion = ("--qx", "0", "--qy", "0", "--qz", "1", "--qw", "0")
    bus.start("static", "--frame-id", "world", "--child-frame-id", "base", *quaternion)
    bus.start("static", "base", "camera", "--x", "1", "--yaw", "180", "--deg")
    assert lookup(bus, "world", "camera").is_close(Transform((-1, 0, 0), (0, 0, 0, 1)))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_end_it_cleanly(bus: Bus, number: int) -> None:
    """It stays until Ctrl-C or SIGTERM, and then ends with exit code 0."""
    static = bus.start("static", "world", "camera")
    static.wait_for_line(": ready$")
    assert static.stop(number) == 0
    assert "Traceback" not in "\n".join(static.err)


def test_a_mistake_in_a_file_is_one_sentence(tmp_path: Path) -> None:
    """A mistake in the file ends it with exit code 1 and the line and key at fault."""
    path = tmp_path / "edges.yaml"
    path.write_text("- frame_id: world\n  child_frame_id: camera\n  x: far\n")
    result = CliRunner().invoke(main, ["--file", str(path)])
    assert result.exit_code == 1
    assert result.output.startswith(f"Error: {path}:3: [0].x: 'far' ")


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("1 0 0.5 1.57 0 -0.1 /map base", "map base --x 1 --z 0.5 --yaw 1.57 --roll -0.1"),
        ("0 0 0 0 0 0 map base 100", "map base"),
        ("-1 2e-1 3 0 0 1 0 map base", "map base --x -1 --y 2e-1 --z 3 --qz 1"),
        ("0 0 0 0 0 0 1 map base 100", "map base --qw 1"),
    ],
)
def test_the_form_of_ros_is_answered_in_flags(old: str, new: str) -> None:
    """The form of ROS without flags is an error that has the same in flags."""
    result = CliRunner().invoke(main, old.split())
    assert result.exit_code == 2
    assert result.output.endswith(f": tfbus static {new}\n")


@pytest.mark.parametrize(
    "words", ["1 2", "a b", "1 2 3 map base", "1 2 3 4 5 6 map", "1 2 3 4 5 6"]
)
def test_other_rows_are_not_the_form_of_ros(words: str) -> None:
    """Frames may be called as numbers, and what has no frames has no other form."""
    assert in_new_form(words.split()) == ""


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ([], "--frame-id: is missing"),
        (["world"], "--child-frame-id: is missing"),
        (["world", "world"], "--child-frame-id: 'world' is the parent's name too"),
        (["world", "camera", "--frame-id", "map"], "not both"),
        (["world", "camera", "--roll", "1", "--qw", "1"], "--qw: cannot be combined with roll"),
        (["world", "camera", "--x", "nan"], "'--x': must be finite, not nan"),
        (["world", "camera", "--qx", "1"], "divided by its norm it is qx 0.707106781"),
        (["world", "camera", "--file", __file__], "--file cannot be combined with frames"),
    ],
)
def test_mistakes_on_the_command_line_are_errors(arguments: list[str], complaint: str) -> None:
    """A mistake is a sentence that names the flag, with exit code 2."""
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == 2
    assert complaint in result.output
