"""`tfbus echo` as a process: its output, its waits, and its end."""

import json
import math
import re
import signal
import sys
from collections.abc import Callable

import pytest
from click.testing import CliRunner

from tests import live_bus
from tests.buses import eventually, keep_sending
from tests.processes.sim_time import SECOND, start_clock
from tests.simulated_bus import Bus
from tfbus import (
    Buffer,
    InvalidArgumentException,
    Node,
    StaticTransformBroadcaster,
    Transform,
    TransformBroadcaster,
    TransformListener,
    TransformStamped,
)
from tfbus.nodes.echo import Question, answers, main
from tfbus.testing.programs import Program

STAMP_NS = 1_649_109_418_061_570_822


def send_always(node: Node, make: Callable[[], TransformStamped]) -> None:
    """Send a transform fifty times a second; kept for longer than a process takes to start."""
    broadcaster = TransformBroadcaster(node, history_s=60.0)
    node.create_timer(0.02, lambda: broadcaster.send_transform(make()))


@pytest.fixture
def turtle(bus: Bus) -> Node:
    """A node that sends world -> turtle1, always of the same stamp."""
    node = bus.node("mover")
    transform = Transform.from_rpy(0.0, 0.0, 0.224, xyz=(-2.552, 5.871, 0.0))
    send_always(node, lambda: TransformStamped(STAMP_NS, "world", "turtle1", transform))
    return node


@pytest.fixture
def clockwork(bus: Bus) -> Node:
    """A node whose frame hand is at x = seconds since the node started."""
    node = bus.node("clockwork")

    def hand() -> TransformStamped:
        now_ns = node.now_ns()
        x = (now_ns - node.started_ns) / 1e9
        return TransformStamped(now_ns, "world", "hand", Transform((x, 0.0, 0.0)))

    send_always(node, hand)
    return node


def test_it_prints_the_block_of_tf2_echo(bus: Bus, turtle: Node) -> None:
    """Without options it prints the pose of the second frame in the first as tf2_echo does."""
    done = bus.run("echo", "world", "turtle1", "--once")
    assert done.returncode == 0
    assert done.stdout == (
        "At time 1649109418.061570822\n"
        "- Translation: [-2.552, 5.871, 0.000]\n"
        "- Rotation: in Quaternion (xyzw) [0.000, 0.000, 0.112, 0.994]\n"
        "- Rotation: in RPY (radian) [0.000, 0.000, 0.224]\n"
        "- Rotation: in RPY (degree) [0.000, 0.000, 12.834]\n"
        "- Matrix:\n"
        "  0.975 -0.222  0.000 -2.552\n"
        "  0.222  0.975  0.000  5.871\n"
        "  0.000  0.000  1.000  0.000\n"
        "  0.000  0.000  0.000  1.000\n"
    )


def test_styles_and_precision_change_the_text(bus: Bus, turtle: Node) -> None:
    """`--style foxy` has three lines, `-p` sets digits, `-r` the rate, `--count` ends it."""
    options = ("--style", "foxy", "-p", "1", "--count", "2", "-r", "20")
    done = bus.run("echo", "world", "turtle1", *options)
    assert done.stdout == 2 * (
        "At time 1649109418.061570822\n"
        "- Translation: [-2.6, 5.9, 0.0]\n"
        "- Rotation: in Quaternion [0.0, 0.0, 0.1, 1.0]\n"
    )


def test_a_reason_of_which_only_numbers_change_is_said_once(bus: Bus) -> None:
    """As of a robot whose clock is wrong: its samples and ours have no time in common."""
    keep_sending(bus.node("here"), "map", "camera")
    with bus.network.process(bus.network.host("robot7", offset_s=120.0), "robot7"):
        keep_sending(bus.node("there"), "map", "base")
    echo = bus.start("echo", "camera", "base")
    echo.wait_for_line("no common time")
    bus.network.run(10.0)
    assert echo.stderr.count("no common time") == 1
    echo.stop()


def test_it_waits_for_missing_frames(bus: Bus) -> None:
    """It may start first; what is missing goes to stderr, and stdout holds JSON only."""
    echo = bus.start("echo", "world", "turtle1", "--format", "json", "--rate", "50")
    echo.wait_for_line("Waiting for transform world -> turtle1: .*is a broadcaster running")
    node = bus.node("mover")
    send_always(node, lambda: TransformStamped(5, "world", "turtle1", Transform((1.0, 0.0, 0.0))))
    eventually(lambda: len(echo.out) >= 2)
    assert echo.stop() == 0
    for line in echo.out:
        assert json.loads(line)["xyz"] == [1.0, 0.0, 0.0]


def test_it_gives_up_after_a_timeout_and_names_what_exists(bus: Bus, turtle: Node) -> None:
    """With `--timeout` it fails in one sentence that names the frames that are there."""
    done = bus.run("echo", "world", "turtle2", "--timeout", "0.5")
    assert done.returncode == 1
    assert done.stdout == ""
    last = done.stderr.splitlines()[-1]
    assert re.match(r"Error: .* world -> turtle2 within 0.5 s: .*'turtle2'", last)
    assert "mean 'turtle1'?" in last and last.endswith("known: turtle1, world")
    done = bus.run("echo", "world", "gripper", "--timeout", "0.5")
    assert done.stderr.endswith("'gripper'; available: turtle1, world\n")


def test_what_it_waits_for_is_said_once(bus: Bus, turtle: Node) -> None:
    """Not each second, as the same hint tells nothing new."""
    echo = bus.start("echo", "world", "turtle2", "--timeout", "5")
    assert echo.wait() == 1
    assert len(re.findall("Waiting for .*world -> turtle2: .*no frame", echo.stderr)) == 1
    assert re.match("Error: .*world -> turtle2", echo.stderr.splitlines()[-1])


def test_csv_has_one_header(bus: Bus, turtle: Node) -> None:
    """CSV starts with one line of column names."""
    done = bus.run("echo", "world", "turtle1", "--format", "csv", "--count", "2", "--rate", "20")
    header, *rows = done.stdout.splitlines()
    assert header.startswith("stamp_ns,frame_id,child_frame_id,x,y,z,qx")
    assert len(rows) == 2
    assert rows[0].startswith(f"{STAMP_NS},world,turtle1,-2.552,5.871,0.0,")


def test_an_absolute_time_is_waited_for_and_printed_once(bus: Bus, clockwork: Node) -> None:
    """`--at` a time to come waits for it, prints the pose of exactly that time, and ends."""
    at_ns = clockwork.now_ns() + 1_500_000_000
    done = bus.run("echo", "world", "hand", "--at", str(at_ns), "--format", "json")
    assert done.returncode == 0
    answer = json.loads(done.stdout)
    assert answer["stamp_ns"] == at_ns
    assert answer["xyz"][0] == pytest.approx((at_ns - clockwork.started_ns) / 1e9, abs=1e-6)


def test_a_time_that_is_over_fails_at_once(bus: Bus, clockwork: Node) -> None:
    """`--at` a time before all that is known fails without waiting for what cannot come."""
    done = bus.run("echo", "world", "hand", "--at", "2022-04-04T21:56:58Z")
    assert done.returncode == 1
    assert "history that publishers keep" in done.stderr
    assert "Waiting" not in done.stderr
    assert "-3s is 3s ago" in bus.run("echo", "world", "hand", "--at", "3s").stderr


@pytest.mark.parametrize("at", ["-3s", "a date"])
def test_a_moment_before_the_start_is_known(bus: Bus, clockwork: Node, at: str) -> None:
    """A time before echo was started is answered from what the publisher has kept."""
    eventually(lambda: clockwork.now_ns() - clockwork.started_ns > 4e9)
    before_ns = clockwork.now_ns() - 3_000_000_000
    asked = str(before_ns) if at == "a date" else at
    done = bus.run("echo", "world", "hand", "--at", asked, "--once", "--format", "json")
    assert done.returncode == 0
    answer = json.loads(done.stdout)
    assert answer["stamp_ns"] == before_ns if at == "a date" else answer["stamp_ns"] > before_ns
    x = (answer["stamp_ns"] - clockwork.started_ns) / 1e9
    assert answer["xyz"][0] == pytest.approx(x, abs=1e-6)


def test_it_says_once_when_what_it_shows_is_not_sent_any_more(bus: Bus) -> None:
    """When the publisher of a frame on its path has gone, one line says so."""
    static = bus.start("static", "world", "camera", "--x", "1")
    static.wait_for_line("ready")
    echo = bus.start("echo", "world", "camera", "--rate", "20")
    eventually(lambda: echo.out)
    static.stop(signal.SIGKILL)
    echo.wait_for_line("'camera': publisher gone; showing its last pose")
    before = len(echo.out)
    eventually(lambda: len(echo.out) > before + 30)
    assert len([line for line in echo.err if "publisher gone" in line]) == 1
    assert echo.stop() == 0


def test_a_transform_that_stalls_is_logged_once(bus: Bus) -> None:
    """If a running publisher stops sending, one line says so, and the last pose is printed."""
    node = bus.node("sim")
    broadcaster = TransformBroadcaster(node)
    echo = bus.start("echo", "world", "rock", "--rate", "20")
    sending = node.create_timer(
        0.02,
        lambda: broadcaster.send_transform(
            TransformStamped(node.now_ns(), "world", "rock", Transform.identity())
        ),
    )
    eventually(lambda: echo.out)
    sending.cancel()
    echo.wait_for_line(r"Nothing newer for 5\.\d s; showing the last pose")
    before = len(echo.out)
    eventually(lambda: len(echo.out) > before + 30)
    assert len([line for line in echo.err if "Nothing newer" in line]) == 1


def test_only_changes_are_printed(bus: Bus) -> None:
    """With --changed a pose is printed once, until it is another one."""
    node = bus.node("sim")
    broadcaster = StaticTransformBroadcaster(node)

    def put(x: float) -> None:
        broadcaster.send_transform(
            TransformStamped(node.now_ns(), "world", "rock", Transform((x, 0, 0)))
        )

    put(1.0)
    echo = bus.start("echo", "world", "rock", "--changed", "--rate", "50", "--format", "json")
    eventually(lambda: len(echo.out) == 1)
    put(2.0)
    eventually(lambda: len(echo.out) == 2)
    assert [json.loads(line)["xyz"][0] for line in echo.out] == [1.0, 2.0]


def test_a_question_that_can_never_be_answered_fails_at_once(
    bus: Bus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An error that waiting cannot fix ends it at once, whatever the timeout."""

    def refuse(*_: object) -> TransformStamped:
        raise InvalidArgumentException("no such thing")

    monkeypatch.setattr(Question, "ask", refuse)
    node = bus.node("echo")
    listener = TransformListener(Buffer(), node)
    asked = answers(node, listener, Question("a", "b"), rate_hz=1.0, timeout_s=math.inf)
    with pytest.raises(InvalidArgumentException, match="no such thing"):
        next(asked)


def test_a_fixed_frame_joins_two_times(bus: Bus, clockwork: Node) -> None:
    """With `--fixed-frame` it prints a frame at one time, seen from another now."""
    options = ("--at", "-1s", "--fixed-frame", "world", "--format", "json", "--once")
    done = bus.run("echo", "hand", "hand", *options)
    assert json.loads(done.stdout)["xyz"][0] == pytest.approx(-1.0, abs=0.5)


def test_a_fixed_frame_joins_two_times_of_a_clock_that_stands(bus: Bus) -> None:
    """The history that it waits for comes by real time."""
    start_clock(bus, "--paused", "--start", "100s")
    send = TransformBroadcaster(bus.node("sim")).send_transform
    for second in range(98, 101):
        pose = Transform((float(second), 0.0, 0.0))
        send(TransformStamped(second * SECOND, "world", "hand", pose))
    options = ("--at", "-1s", "--fixed-frame", "world", "--format", "json", "--once", "--sim-time")
    echo = bus.start("echo", "hand", "hand", *options)
    assert echo.wait(timeout_s=5.0) == 0
    assert json.loads(echo.out[0])["xyz"] == [-1.0, 0.0, 0.0]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("frame", ["turtle1", "nowhere"])
def test_signals_end_it_cleanly(bus: Bus, turtle: Node, number: int, frame: str) -> None:
    """Ctrl-C and SIGTERM end it with exit code 0, while it prints and while it waits."""
    echo = bus.start("echo", "world", frame)
    echo.wait_for_line("At time" if frame == "turtle1" else "Waiting")
    assert echo.stop(number) == 0
    assert "Traceback" not in "\n".join(echo.err)


@pytest.mark.real
def test_a_closed_pipe_ends_it_quietly(bus: live_bus.Bus, turtle: Node) -> None:
    """`tfbus echo ... | head -3` prints three lines and no error."""
    echo = f"{sys.executable} -m tfbus echo world turtle1 --rate 50"
    shell = bus.start_command(["bash", "-c", f"{echo} | head -3; exit ${{PIPESTATUS[0]}}"])
    assert shell.wait() == 0
    assert len(shell.out) == 3
    # What it prints, and on a busy machine what it waits for.
    assert [line for line in shell.err if "[INFO]" not in line] == []


def test_many_echoes_run_at_once(bus: Bus, turtle: Node) -> None:
    """Every echo is a node with a name of its own."""
    names = {node_name(bus.start("echo", "world", "turtle1")) for _ in range(2)}
    assert len(names) == 2
    assert node_name(bus.start("echo", "world", "turtle1", "--name", "echo")) == "echo"


def node_name(process: Program) -> str:
    """The name that a node puts before its lines."""
    line = process.wait_for_line("Printing world -> turtle1")
    return line.split("]: ")[0].rsplit("[", 1)[1]


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["/world", "turtle1"], "write 'world'"),
        (["world", ""], "name must not be empty"),
        (["world", "turtle1", "--rate", "0"], "at least 1e-06"),
        (["world", "turtle1", "--rate", "nan"], "must be finite"),
        (["world", "turtle1", "--rate", "1e-10"], "at least 1e-06"),
        (["world", "turtle1", "--timeout", "inf"], "must be finite"),
        (["world", "turtle1", "--at", "99999999999999999999999h"], "too far away"),
        (["world", "turtle1", "--timeout", "-1"], "must be more than 0"),
        (["world", "turtle1", "--precision", "-1"], "0<=x<=17"),
        (["world", "turtle1", "--at", "noon"], "is not a time"),
        (["world", "turtle1", "--once", "--count", "2"], "mutually exclusive"),
        (["world"], "Missing argument 'SOURCE'"),
        (["world", "turtle1", "2.5"], "the rate is an option: --rate 2.5"),
    ],
)
def test_mistakes_on_the_command_line_are_errors(arguments: list[str], complaint: str) -> None:
    """A mistake is one sentence, with exit code 2, before it joins the bus."""
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == 2
    assert complaint in result.output
