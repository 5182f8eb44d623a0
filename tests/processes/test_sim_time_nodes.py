"""Processes under simulated time: their ends, and their timers."""

from collections.abc import Callable
from contextlib import suppress
from signal import SIGINT, SIGTERM

import pytest

from tests.buses import DEADLINE_S, eventually
from tests.processes.sim_time import SECOND, Remote, follower, start_clock
from tests.simulated_bus import Bus
from tfbus import Buffer, Node, SystemClock, TimeoutException
from tfbus.messages import Pose, RotateAbsolute, Twist, Vector3


def loop() -> None:
    """Goes on by simulated time."""
    with Node.from_args("loop") as node:
        node.wait_for_clock()
        print("looping")
        while node.wait(1.0):
            pass


def lookup() -> None:
    """Waits for a transform that never comes."""
    with Node.from_args("lookup") as node:
        node.wait_for_clock()
        print("looping")
        Buffer(clock=node.clock).lookup_transform("a", "b", timeout_s=1.0)


def callback() -> None:
    """Waits for a transform that never comes in a callback."""
    with Node.from_args("callback") as node:
        buffer = Buffer(clock=node.clock)
        node.wait_for_clock()

        def look() -> None:
            print("looping")
            with suppress(TimeoutException):
                buffer.lookup_transform("a", "b", timeout_s=1.0)

        node.create_timer(0.01, look, clock=SystemClock())
        node.spin()


def no_clock() -> None:
    """Waits for a clock that is not there."""
    with Node.from_args("patient") as node:
        print("looping")
        node.wait_for_clock()


@pytest.mark.parametrize("program", [loop, lookup, callback, no_clock])
def test_a_node_ends_at_once_while_the_clock_is_paused(
    bus: Bus, program: Callable[[], None]
) -> None:
    """Ctrl-C ends a node that waits by a clock that stands still, wherever it waits."""
    if program is not no_clock:
        start_clock(bus, "--paused")
    process = bus.network.program("outside", program, "--sim-time", env=bus.env)
    process.wait_for_line("looping")
    assert process.stop(SIGINT) == 0
    assert not [line for line in process.err if "Did not wait" in line]


@pytest.mark.parametrize("number", [SIGINT, SIGTERM])
def test_the_tools_end_at_once_while_the_clock_is_paused(bus: Bus, number: int) -> None:
    """echo and the simulator end on a signal while time stands still, and so does the clock."""
    clock = start_clock(bus, "--paused")
    tools = [
        bus.start("echo", "world", "turtle1", "--sim-time"),
        bus.start("simulator", "--headless", "--sim-time"),
    ]
    for tool in tools:
        tool.wait_for_line("Printing|ready")
    for process in (*tools, clock):
        assert process.stop(number) == 0


def test_echo_times_out_without_a_clock(bus: Bus) -> None:
    """echo with a timeout ends with 1 where there is no clock to count it by."""
    echo = bus.run("echo", "world", "turtle1", "--sim-time", "--timeout", "0.2")
    assert echo.returncode == 1
    assert "no message on 'clock'" in echo.stderr


# -- the turtle


def test_a_turtle_drives_in_simulated_time(bus: Bus) -> None:
    """With the clock set on by 0.8 s a turtle at 1 m/s is 0.8 m farther, however long it took."""
    start_clock(bus, "--paused", "--start", "100s")
    sim = bus.start("simulator", "--headless", "--sim-time")
    node = follower(bus)
    remote = Remote(node)
    poses: list[Pose] = []
    node.create_subscription(Pose, "turtle1/pose", poses.append)
    drive = node.create_publisher(Twist, "turtle1/cmd_vel")
    sim.wait_for_line("ready")
    assert node.wait_for_clock(DEADLINE_S)

    # The simulator has followed the clock, and gets a command to drive.
    second = 100.0

    def step() -> Pose | None:
        nonlocal second
        second += 0.016
        drive.publish(Twist(linear=Vector3(x=1.0)))
        remote.set(second)
        stamp_ns = node.now_ns()
        return eventually(
            lambda: next((pose for pose in poses if pose.stamp_ns == stamp_ns), None), within_s=0.5
        )

    def driving() -> bool:
        try:
            pose = step()
        except AssertionError:  # the simulator did not hear of this one
            return False
        return pose is not None and pose.linear_velocity == 1.0

    eventually(driving)
    before = poses[-1]
    remote.set(second + 0.8)
    after = eventually(lambda: poses[-1] if poses[-1].stamp_ns == node.now_ns() else None)
    assert after.x - before.x == pytest.approx(0.8)


def test_a_turtle_turns_ten_times_faster(bus: Bus) -> None:
    """At ten times the real speed a turtle turns by 1 rad in each second of its own time."""
    start_clock(bus, "--rate", "10", "--start", "0s")
    bus.start("simulator", "--headless", "--sim-time")
    node = follower(bus)
    poses: list[Pose] = []
    node.create_subscription(Pose, "turtle1/pose", poses.append)
    turn = node.create_goal_client(RotateAbsolute, "turtle1/rotate_absolute")
    goal = turn.send(RotateAbsolute.Goal(3.0), timeout_s=DEADLINE_S)
    assert goal.result(timeout_s=DEADLINE_S).status == "succeeded"
    turning = eventually(lambda: [pose for pose in list(poses) if 0.1 < pose.theta < 2.9])
    first, last = turning[0], turning[-1]
    seconds = (last.stamp_ns - first.stamp_ns) / SECOND
    assert last.theta - first.theta == pytest.approx(seconds, rel=0.3)
