"""`tfbus joints` as a process: the sources of its positions, and the transforms after them."""

import math
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest

from tests import live_bus, needs
from tests.buses import eventually, send_until
from tests.nodes.robots import ARM, FREE
from tests.simulated_bus import Bus
from tfbus import Node
from tfbus.messages import JointState, RobotDescription, SetClock


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """The file of the arm."""
    path = tmp_path / "arm.urdf"
    path.write_text(ARM)
    return path


def heard(bus: Bus) -> tuple[Node, list[JointState]]:
    """A node, and the joint states that it hears."""
    node = bus.node("listener")
    states: list[JointState] = []
    node.create_subscription(JointState, "joint_states", states.append)
    return node, states


def positions(state: JointState) -> dict[str, float]:
    return dict(zip(state.name, state.position, strict=True))


def test_at_rest_it_publishes_zeros(bus: Bus, path: Path) -> None:
    """Without a terminal all joints rest, where --set and ROS's zeros say."""
    _, states = heard(bus)
    process = bus.start("joints", str(path), "--set", "elbow=0.5", "--param", "zeros.grip=0.15")
    process.wait_for_line("Publishing 3 joints of arm")
    state = eventually(lambda: states)[0]
    assert positions(state) == {"shoulder": 0.0, "elbow": 0.5, "grip": 0.15}
    assert (state.velocity, state.effort) == ((), ())
    assert process.stop() == 0


def test_the_robot_comes_from_the_bus(bus: Bus) -> None:
    """Without a file it waits for a description, and follows each new one."""
    node, states = heard(bus)
    process = bus.start("joints")
    process.wait_for_line("Waiting for a robot on topic robot_description")
    process.wait_for_line("No robot on topic robot_description so far")
    publisher = node.create_publisher(RobotDescription, "robot_description", retained=True)
    publisher.publish(RobotDescription(ARM))
    eventually(lambda: states and states[-1].name == FREE)
    publisher.publish(RobotDescription("<robot"))
    process.wait_for_line("Ignored a description: robot_description:1: not XML")
    publisher.publish(RobotDescription(ARM.replace('"elbow"', '"knee"')))
    eventually(lambda: states[-1].name == ("shoulder", "knee", "grip"))


@pytest.mark.parametrize("how", ["--sweep", "--random"])
def test_it_moves_within_limits(bus: Bus, path: Path, how: str) -> None:
    """A motion changes all positions, within their limits, with velocities on request."""
    _, states = heard(bus)
    bus.start("joints", str(path), how, "--velocities", "--rate", "100")
    eventually(lambda: len(states) > 150)
    for name, lower, upper in (("shoulder", -0.5, 3.0), ("grip", 0.1, 0.3)):
        path_of_joint = [positions(state)[name] for state in states]
        assert len(set(path_of_joint)) > 20
        assert min(path_of_joint) >= lower and max(path_of_joint) <= upper
    assert all(len(state.velocity) == 3 for state in states)
    assert any(velocity != 0.0 for state in states for velocity in state.velocity)


def test_a_motion_goes_on_where_the_time_goes_back(bus: Bus, path: Path) -> None:
    """With simulated time that is set back, joints move on from where they were."""
    bus.start("clock", "--start", "5000s").wait_for_line("It is ")
    node, states = heard(bus)
    bus.start("joints", str(path), "--sweep", "--sim-time")
    eventually(lambda: len(states) > 10)
    client = node.create_client(SetClock, "clock/set")
    client.call(SetClock.Request(5_000_000_000), timeout_s=20.0)
    eventually(lambda: states[-1].stamp_ns < 1_000_000_000_000)
    before = len(states)
    eventually(lambda: len(states) > before + 20)
    assert len({positions(state)["shoulder"] for state in states[before:]}) > 10


def test_targets_move_joints(bus: Bus, path: Path) -> None:
    """joint_targets moves joints, at most to their limits; names of no joint are named once."""
    node, states = heard(bus)
    process = bus.start("joints", str(path))
    targets = node.create_publisher(JointState, "joint_targets")
    target = JointState(0, ("shoulder", "grip", "nose"), (1.5, 9.0, 1.0))
    send_until(
        lambda: targets.publish(target),
        lambda: bool(states) and positions(states[-1])["shoulder"] == 1.5,
    )
    assert positions(states[-1])["grip"] == 0.3
    process.wait_for_line("Ignored names that are of no free joint: 'nose'")


def test_a_target_takes_a_joint_out_of_a_motion(bus: Bus, path: Path) -> None:
    """While the others sweep, a joint that a target has moved stays there."""
    node, states = heard(bus)
    bus.start("joints", str(path), "--sweep")
    targets = node.create_publisher(JointState, "joint_targets")
    send_until(
        lambda: targets.publish(JointState(0, ("elbow",), (0.25,))),
        lambda: bool(states) and positions(states[-1])["elbow"] == 0.25,
    )
    before = len(states)
    eventually(lambda: len(states) > before + 10)
    assert {positions(state)["elbow"] for state in states[before:]} == {0.25}
    assert len({positions(state)["shoulder"] for state in states[before:]}) > 5


def test_other_publishers_are_merged(bus: Bus, path: Path) -> None:
    """--source takes positions from another topic, as source_list does."""
    node, states = heard(bus)
    bus.start("joints", str(path), "--source", "gripper/joint_states")
    other = node.create_publisher(JointState, "gripper/joint_states")
    send_until(
        lambda: other.publish(JointState(0, ("grip",), (0.25,))),
        lambda: bool(states) and positions(states[-1])["grip"] == 0.25,
    )
    assert states[-1].name == FREE


def test_a_table_is_played(bus: Bus, path: Path, tmp_path: Path) -> None:
    """The rows of a CSV file come in order, within limits; the last one stays."""
    table = tmp_path / "moves.csv"
    table.write_text("time,elbow,grip\n0,0.1,0.2\n0.05,0.2,0.2\n0.1,0.3,99\n")
    _, states = heard(bus)
    process = bus.start("joints", str(path), "--csv", str(table))
    process.wait_for_line("Kept joints within their limits: 'grip'")
    process.wait_for_line("The last row is published; its positions stay")
    eventually(lambda: states and positions(states[-1])["elbow"] == 0.3)
    seen = len(states)
    eventually(lambda: len(states) > seen + 3)
    assert positions(states[-1]) == {"shoulder": 0.0, "elbow": 0.3, "grip": 0.3}


def test_rows_have_the_stamps_of_their_times(bus: Bus, path: Path, tmp_path: Path) -> None:
    """Of a table at 1 kHz several rows are due at once; their stamps are 1 ms apart all the same,
    and so are the velocities right.
    """
    table = tmp_path / "moves.csv"
    rows = "".join(f"{count / 1000},{count / 1000}\n" for count in range(400))
    table.write_text(f"time,elbow\n{rows}")
    _, states = heard(bus)
    process = bus.start("joints", str(path), "--csv", str(table), "--loop", "--velocities")
    process.wait_for_line("Publishing 3 joints of arm")
    eventually(lambda: len(states) > 300)
    pairs = [
        (one, other)
        for one, other in pairwise(list(states))
        if 0 < positions(other)["elbow"] - positions(one)["elbow"] < 0.0015
    ]
    assert len(pairs) > 100
    for one, other in pairs:
        assert other.stamp_ns - one.stamp_ns == pytest.approx(1_000_000, abs=1000)
        assert other.velocity[1] == pytest.approx(1.0, abs=0.01)


def test_a_loop_that_is_too_fast_is_refused(bus: Bus, path: Path, tmp_path: Path) -> None:
    """Two rows 1 ns apart would be 500 million messages a second."""
    table = tmp_path / "moves.csv"
    table.write_text("ns,elbow\n0,0\n1,1\n")
    done = bus.run("joints", str(path), "--csv", str(table), "--loop")
    assert done.returncode == 1
    assert "cannot be looped" in done.stderr


def test_a_table_of_another_robot_ends_it(bus: Bus, tmp_path: Path) -> None:
    """Where the robot comes from the bus, a table that is not of it ends the process with 1."""
    table = tmp_path / "moves.csv"
    table.write_text("knee\n1\n")
    node = bus.node("other")
    process = bus.start("joints", "--csv", str(table))
    publisher = node.create_publisher(RobotDescription, "robot_description", retained=True)
    publisher.publish(RobotDescription(ARM))
    process.wait_for_line("Error: .*moves.csv:1: the robot has no joint 'knee'")
    assert process.wait() == 1


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("elbw=0.5", "the robot has no free joint 'elbw'; did you mean 'elbow'"),
        ("mount=0.1", "joint 'mount' is fixed, so it cannot be set"),
        ("grip_right=0.1", "joint 'grip_right' mimics another, so it cannot be set"),
    ],
)
def test_a_joint_that_cannot_be_set_ends_it(bus: Bus, path: Path, given: str, said: str) -> None:
    """Also where the robot comes from the bus, with 1."""
    done = bus.run("joints", str(path), "--set", given)
    assert (done.returncode, said in " ".join(done.stderr.split())) == (2, True)
    node = bus.node("other")
    process = bus.start("joints", "--set", given)
    publisher = node.create_publisher(RobotDescription, "robot_description", retained=True)
    publisher.publish(RobotDescription(ARM))
    process.wait_for_line(f"Error: {said}")
    assert process.wait() == 1


def test_a_position_of_rest_beyond_the_limits_is_named(bus: Bus) -> None:
    """The joint rests at its limit."""
    node, states = heard(bus)
    process = bus.start("joints", "--set", "grip=5")
    publisher = node.create_publisher(RobotDescription, "robot_description", retained=True)
    publisher.publish(RobotDescription(ARM))
    process.wait_for_line(
        "Position 5 of joint 'grip' is not within its limits, 0.1 to 0.3: it rests at 0.3"
    )
    assert positions(eventually(lambda: states)[-1])["grip"] == 0.3


def test_parameters_of_ros_that_it_has_not_are_answered(bus: Bus, path: Path) -> None:
    """With what does the same; `zeros.JOINT` is among the parameters of the help."""
    process = bus.start("joints", str(path), "--ros-args", "-p", "source_list:=[a]")
    process.wait_for_line("parameter source_list of joint_state_publisher: give each topic by --so")
    assert "zeros.JOINT" in bus.run("joints", "--help").stdout


def test_a_recording_is_played(bus: Bus, path: Path, tmp_path: Path) -> None:
    """The joint states of a recording come again, with the time of now, velocities and efforts."""
    needs.module("mcap")
    from tfbus.recording.items import TopicItem
    from tfbus.recording.writer import RecordingWriter
    from tfbus.wire.codec import as_map

    file = tmp_path / "run.mcap"
    with RecordingWriter(file) as writer:
        for count in range(5):
            state = JointState(count, ("elbow", "other"), (count / 10, 1.0), (0.5, 0.5), (7.0, 7.0))
            writer.write(TopicItem(count * 20_000_000, "joint_states", "JointState", as_map(state)))
    node, states = heard(bus)
    bus.start("joints", str(path), "--bag", str(file))
    eventually(lambda: states and positions(states[-1])["elbow"] == 0.4)
    first = states[0]
    assert abs(first.stamp_ns - node.now_ns()) < 60e9
    moving = next(state for state in states if state.velocity)
    velocities = dict(zip(moving.name, moving.velocity, strict=True))
    assert velocities["elbow"] == 0.5 and math.isnan(velocities["grip"])
    assert dict(zip(moving.name, moving.effort, strict=True))["elbow"] == 7.0


@pytest.mark.real
def test_sliders_in_a_terminal(bus: live_bus.Bus, path: Path, tmp_path: Path) -> None:
    """In tmux the sliders show each joint; keys move them, what a target moves is shown, the log
    stays above them, and q gives the shell back.
    """
    needs.program("tmux")
    node, states = heard(bus)
    env = {**bus.env, "TMUX_TMPDIR": str(tmp_path), "TERM": "xterm-256color"}

    def tmux(*arguments: str) -> str:
        command = ["tmux", "-f", "/dev/null", *arguments]
        return subprocess.run(command, env=env, capture_output=True, text=True).stdout

    def shown() -> str:
        return tmux("capture-pane", "-p")

    command = f"{sys.executable} -m tfbus joints {path}; echo left; cat"
    tmux("new-session", "-d", "-x", "80", "-y", "20", command)
    try:
        eventually(lambda: "> shoulder    0.000 rad" in shown())
        tmux("send-keys", "Down")
        eventually(lambda: "> elbow" in shown())

        def moved() -> bool:
            tmux("send-keys", "Right")
            return bool(states) and positions(states[-1])["elbow"] > 0.3

        eventually(moved)
        targets = node.create_publisher(JointState, "joint_targets")
        send_until(
            lambda: targets.publish(JointState(0, ("shoulder", "nose"), (1.234, 0.0))),
            lambda: "shoulder    1.234 rad" in shown(),
        )
        eventually(lambda: "Ignored names" in shown() and shown().count("arm: 3 joints") == 1)
        assert shown().count("elbow") == 1
        tmux("send-keys", "q")
        eventually(lambda: "left" in shown())
    finally:
        tmux("kill-server")


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["--zero", "--sweep"], 2, "give one of --zero, --sweep, --random, --csv and --bag"),
        (["--loop"], 2, "--loop needs --csv or --bag"),
        (["--seed", "1"], 2, "--seed needs --random"),
        (["PATH", "--set", "elbo=1"], 2, "no free joint 'elbo'; did you mean 'elbow'?"),
        (["PATH", "--set", "elbow"], 2, "is not of the form JOINT=POSITION"),
        (["PATH", "--set", "elbow=x"], 2, "the position of 'elbow': 'x' is not a number"),
        (["none.urdf"], 2, "File 'none.urdf' does not exist"),
        (["PATH", "--csv", "none.csv"], 2, "File 'none.csv' does not exist"),
        (["PATH", "--bag", "none.mcap"], 2, "Path 'none.mcap' does not exist"),
    ],
)
def test_a_mistake_is_one_sentence(
    bus: Bus, path: Path, arguments: list[str], code: int, said: str
) -> None:
    """A mistake on the command line or in a file ends it with one sentence."""
    done = bus.run("joints", *[str(path) if each == "PATH" else each for each in arguments])
    assert done.returncode == code
    assert said in " ".join(done.stderr.split())
    assert "Traceback" not in done.stderr
