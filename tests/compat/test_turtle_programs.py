"""Programs with ROS's names as processes on a bus: each works as under ROS."""

import sys
from pathlib import Path
from signal import SIGINT, SIGTERM

import pytest

from tests.builders import x_of
from tests.buses import eventually
from tests.live_bus import Bus as LiveBus
from tests.simulated_bus import Bus
from tfbus import Buffer, Node, messages
from tfbus.testing.programs import Program

ROOT = Path(__file__).parents[2]


def start(bus: Bus, *arguments: str) -> Program:
    """One of the programs, once it is ready."""
    process = bus.start_python("tests.compat.turtle_programs", *arguments)
    process.wait_for_line("ready")
    return process


def stop(process: Program, number: int = SIGINT) -> None:
    """End it: quietly, whatever the signal."""
    assert process.stop(number) == 0
    assert not [line for line in process.err if "Traceback" in line], process.err


def test_turtle2_follows_turtle1(bus: Bus) -> None:
    """The broadcasters, the listener, the service and the topic of the tutorial, as five
    processes.
    """
    simulator = bus.start("simulator")
    simulator.wait_for_line("ready")
    programs = [
        start(bus, "turtle", "--ros-args", "-p", f"turtlename:={turtle}", "-r", f"__node:={node}")
        for turtle, node in (("turtle1", "frame1"), ("turtle2", "frame2"))
    ]
    follower = start(bus, "follower")
    follower.wait_for_line("Spawned turtle2")
    follower.wait_for_line("Reached it")
    simulator.wait_for_line(r"Spawning turtle \[turtle2\] at x=\[4.0")
    for program in (*programs, follower):
        stop(program)


@pytest.mark.parametrize(
    ("program", "target", "source", "x"),
    [
        (("carrot",), "carrot1", "turtle1", 0.0),
        (("static", "shelf", "1.5", "2", "1.57"), "world", "shelf", 1.5),
    ],
)
def test_frames_of_programs_are_on_the_bus(
    bus: Bus, buffer: Buffer, program: tuple[str, ...], target: str, source: str, x: float
) -> None:
    """A listener of tfbus receives them; SIGTERM ends the program as Ctrl-C does."""
    process = start(bus, *program)
    eventually(lambda: x_of(buffer, target, source) == x)
    stop(process, SIGTERM)


def test_a_frame_that_moves_has_the_time_of_the_clock(bus: Bus, buffer: Buffer) -> None:
    """It stays a metre from its parent, wherever it is."""
    process = start(bus, "moving_carrot")
    eventually(lambda: buffer.can_transform("turtle1", "carrot1"))
    xyz = buffer.lookup_transform("turtle1", "carrot1").transform.xyz
    assert abs((xyz @ xyz) - 1.0) < 1e-9
    stop(process)


def test_messages_with_headers_are_sent(bus: Bus, receiver: Node) -> None:
    """A point with its frame, for each pose of the simulator."""
    bus.start("simulator").wait_for_line("ready")
    process = start(bus, "points")
    got: list[bytes] = []
    receiver.create_raw_subscription("turtle1/point", got.append)
    eventually(lambda: any(b"frame_id\xa5world" in payload for payload in got))
    stop(process)


def test_waiting_in_three_ways(bus: Bus) -> None:
    """With a timeout, in a coroutine and by a callback: all get it when it comes, not before."""
    waiter = start(bus, "waiter")
    waiter.wait_for_line("blocked: there is no frame")
    assert not [line for line in waiter.err if "got" in line]
    wheel = start(bus, "wheel")
    for line in (
        "blocked: got it",
        "suspended: got it",
        "called: got wheel",
        "parent: 'base_link'",
    ):
        waiter.wait_for_line(line)
    stop(waiter)
    stop(wheel)


@pytest.mark.real
def test_launch_starts_a_ported_program(bus: LiveBus, tmp_path: Path, buffer: Buffer) -> None:
    """With a name and parameters, as it starts any node of a file."""
    (tmp_path / "turtle.py").write_text(
        "import sys\n"
        f"sys.path.insert(0, {str(ROOT)!r})\n"
        "from tests.compat.turtle_programs import TurtleFrame, rclpy\n"
        "rclpy.init()\n"
        "rclpy.spin(TurtleFrame())\n"
    )
    (tmp_path / "one.launch.yaml").write_text(
        "nodes:\n  - {node: turtle.py, name: frame7, parameters: {turtlename: turtle7}}\n"
    )
    launch = bus.start_command(
        [sys.executable, "-m", "tfbus", "launch", str(tmp_path / "one.launch.yaml")]
    )
    launch.wait_for_line(r"\[frame7\]: ready")
    publisher = bus.node("poses").create_publisher(messages.Pose, "turtle7/pose")
    pose = messages.Pose(1, 3.0, 0.0, 0.0, 0.0, 0.0)

    def came() -> bool:
        publisher.publish(pose)
        return x_of(buffer, "world", "turtle7") == 3.0

    eventually(came)
    launch.stop()
