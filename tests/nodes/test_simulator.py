"""The simulator and the nodes around it, on the test bus."""

import json
import logging
from collections.abc import Callable
from importlib import import_module
from math import atan2, hypot, pi
from unittest.mock import Mock

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.buses import eventually
from tests.simulated_bus import Bus
from tfbus import Buffer, Node, ServiceError, Transform, TransformListener, TransformStamped
from tfbus.messages import (
    Color,
    Empty,
    Kill,
    Pose,
    RotateAbsolute,
    SetPen,
    Spawn,
    TeleportAbsolute,
    TeleportRelative,
    Twist,
    Vector3,
)
from tfbus.nodes.carrot import carrot_at
from tfbus.nodes.draw_square import Square
from tfbus.nodes.follow import towards
from tfbus.nodes.simulator import Simulator
from tfbus.nodes.turtle.field import MIDDLE_M
from tfbus.nodes.turtle.interface import TurtleInterface
from tfbus.nodes.turtle.world import World


@pytest.fixture
def sim(bus: Bus) -> Node:
    """The node of a running simulator."""
    node = bus.node("sim")
    Simulator(node)
    return node


@pytest.fixture
def user(bus: Bus, sim: Node) -> Node:
    """Another node on the simulator's bus."""
    return bus.node("user")


def poses_of(user: Node, turtle: str) -> list[Pose]:
    """The poses of a turtle as they come, at least one."""
    poses: list[Pose] = []
    user.create_subscription(Pose, f"{turtle}/pose", poses.append)
    eventually(lambda: poses)
    return poses


def keep_sending(user: Node, turtle: str, twist: Twist) -> Callable[[], None]:
    """Command a turtle ten times a second, until the returned function is called."""
    publisher = user.create_publisher(Twist, f"{turtle}/cmd_vel")
    return user.create_timer(0.1, lambda: publisher.publish(twist)).cancel


# Topics


def test_poses_are_stamped_by_the_clock_of_the_simulator(sim: Node, user: Node) -> None:
    """Each pose is stamped with the time at which it was made, later than the one before."""
    before_ns = sim.now_ns()
    poses = poses_of(user, "turtle1")
    eventually(lambda: len(poses) > 10)
    stamps = [pose.stamp_ns for pose in poses]
    assert stamps == sorted(set(stamps))
    assert before_ns <= stamps[0] and stamps[-1] <= user.now_ns()


def test_a_turtle_follows_its_topic(user: Node) -> None:
    """A Twist on turtle1/cmd_vel drives turtle1, and the pose has its speeds."""
    poses = poses_of(user, "turtle1")
    keep_sending(user, "turtle1", Twist(Vector3(x=1.0), Vector3(z=0.5)))
    pose = eventually(lambda: poses[-1] if poses[-1].x > MIDDLE_M + 0.3 else None)
    assert (pose.linear_velocity, pose.angular_velocity) == (1.0, 0.5)
    assert pose.theta > 0.0


def test_the_colour_sensor_follows_the_background(bus: Bus, user: Node) -> None:
    """The parameter background_r changes what turtles see."""
    colors: list[Color] = []
    user.create_subscription(Color, "turtle1/color_sensor", colors.append)
    eventually(lambda: Color(69, 86, 255) in colors)
    assert bus.run("param", "set", "/sim", "background_r", "7").returncode == 0
    eventually(lambda: colors[-1] == Color(7, 86, 255))


def test_holonomic_is_changed_while_it_runs(bus: Bus, user: Node) -> None:
    """Turtles move sideways as soon as the parameter holonomic is true."""
    poses = poses_of(user, "turtle1")
    keep_sending(user, "turtle1", Twist(Vector3(y=1.0)))
    assert bus.run("param", "set", "/sim", "holonomic", "true").returncode == 0
    eventually(lambda: poses[-1].y > MIDDLE_M + 0.1)
    assert poses[-1].x == pytest.approx(MIDDLE_M)


# Services


def test_a_spawned_turtle_is_on_the_bus(user: Node) -> None:
    """The reply to spawn is the turtle's name; by then its pose and services exist."""
    reply = user.create_client(Spawn, "spawn").call(Spawn.Request(2.0, 3.0, 1.0))
    assert reply == Spawn.Response("turtle2")
    pose = poses_of(user, "turtle2")[0]
    assert (pose.x, pose.y, pose.theta) == (2.0, 3.0, 1.0)
    user.create_client(TeleportAbsolute, "turtle2/teleport_absolute").call(
        TeleportAbsolute.Request(4.0, 4.0)
    )


@pytest.mark.parametrize(
    ("request_", "reason"),
    [
        (Spawn.Request(2.0, 2.0, name="turtle1"), r"A turtle named \[turtle1\] already exists"),
        (Spawn.Request(20.0, 2.0), "off the field"),
        (Spawn.Request(2.0, 2.0, name="a/b"), "cannot name a turtle"),
    ],
)
def test_a_refused_spawn_says_why(user: Node, request_: Spawn.Request, reason: str) -> None:
    """What turtlesim only logs, the caller gets as an error."""
    with pytest.raises(ServiceError, match=reason):
        user.create_client(Spawn, "spawn").call(request_)


def test_a_request_that_waited_while_its_turtle_was_killed_is_refused() -> None:
    """A command then moves nothing."""
    node = Mock()
    TurtleInterface(node, World(), "bob")
    set_pen, *_ = [made.args[2] for made in node.create_service.call_args_list]
    with pytest.raises(ServiceError, match=r"no turtle \[bob\]"):
        set_pen(SetPen.Request())
    [command] = [made.args[2] for made in node.create_subscription.call_args_list]
    command(Twist())


def test_a_killed_turtle_leaves_the_bus(user: Node) -> None:
    """After kill the turtle's services are gone, and its name is free again."""
    user.create_client(Spawn, "spawn").call(Spawn.Request(2.0, 2.0, name="bob"))
    pen = user.create_client(SetPen, "bob/set_pen")
    pen.call(SetPen.Request())
    kill = user.create_client(Kill, "kill")
    kill.call(Kill.Request("bob"))
    eventually(lambda: not pen.wait_for_service(0.0))
    with pytest.raises(ServiceError, match="which does not exist"):
        kill.call(Kill.Request("bob"))
    user.create_client(Spawn, "spawn").call(Spawn.Request(2.0, 2.0, name="bob"))
    pen.call(SetPen.Request())


def test_teleports_move_the_turtle(user: Node) -> None:
    """The services teleport_absolute and teleport_relative show in the next poses."""
    poses = poses_of(user, "turtle1")
    user.create_client(TeleportAbsolute, "turtle1/teleport_absolute").call(
        TeleportAbsolute.Request(1.0, 2.0, pi / 2)
    )
    eventually(lambda: (poses[-1].x, poses[-1].y) == (1.0, 2.0))
    user.create_client(TeleportRelative, "turtle1/teleport_relative").call(
        TeleportRelative.Request(linear=3.0, angular=0.0)
    )
    eventually(lambda: poses[-1].y == pytest.approx(5.0))


def test_reset_keeps_turtle1_on_the_bus(user: Node) -> None:
    """After reset turtle1 is in the middle and follows commands, and the others are gone."""
    poses = poses_of(user, "turtle1")
    user.create_client(Spawn, "spawn").call(Spawn.Request(2.0, 2.0))
    others = user.create_client(SetPen, "turtle2/set_pen")
    assert others.wait_for_service(5.0)
    teleport = user.create_client(TeleportAbsolute, "turtle1/teleport_absolute")
    teleport.call(TeleportAbsolute.Request(1.0, 1.0))
    eventually(lambda: poses[-1].x == 1.0)
    user.create_client(Empty, "reset").call(Empty.Request())
    eventually(lambda: poses[-1].x == MIDDLE_M)
    eventually(lambda: not others.wait_for_service(0.0))
    teleport.call(TeleportAbsolute.Request(9.0, 9.0))
    eventually(lambda: poses[-1].x == 9.0)


# The goal


def test_a_rotation_reports_progress_and_result(user: Node) -> None:
    """rotate_absolute sends the shrinking rest of the turn, then the whole turn."""
    remaining: list[float] = []
    poses_of(user, "turtle1")  # a goal is not kept for a simulator that is yet to be found
    goal = user.create_goal_client(RotateAbsolute, "turtle1/rotate_absolute").send(
        RotateAbsolute.Goal(0.5), on_feedback=lambda feedback: remaining.append(feedback.remaining)
    )
    result = goal.result(timeout_s=20.0)
    assert result.status == "succeeded"
    assert result.result.delta == pytest.approx(-0.5, abs=0.02)
    assert remaining[0] == pytest.approx(0.5) and remaining == sorted(remaining, reverse=True)


def test_a_rotation_is_canceled(user: Node) -> None:
    """A cancelled rotation ends at once, and the turtle rests."""
    poses = poses_of(user, "turtle1")
    client = user.create_goal_client(RotateAbsolute, "turtle1/rotate_absolute")
    goal = client.send(RotateAbsolute.Goal(3.0))
    eventually(lambda: poses[-1].theta > 0.1)
    goal.cancel()
    assert goal.result(timeout_s=20.0).status == "canceled"
    eventually(lambda: poses[-1].angular_velocity == 0.0)
    assert 0.1 < poses[-1].theta < 2.9


def test_driving_aborts_a_rotation(user: Node) -> None:
    """A velocity command aborts the action; its client gets the reason."""
    poses = poses_of(user, "turtle1")
    client = user.create_goal_client(RotateAbsolute, "turtle1/rotate_absolute")
    goal = client.send(RotateAbsolute.Goal(3.0))
    eventually(lambda: poses[-1].theta > 0.0)
    keep_sending(user, "turtle1", Twist(Vector3(x=0.5)))
    result = goal.result(timeout_s=20.0)
    assert result.status == "aborted"
    assert result.reason.startswith("Velocity command received")


# The nodes around it


@pytest.fixture
def buffer(user: Node) -> Buffer:
    """A buffer that listens."""
    buffer = Buffer()
    TransformListener(buffer, user)
    return buffer


def test_the_broadcaster_stamps_frames_as_the_pose(bus: Bus, user: Node, buffer: Buffer) -> None:
    """world -> turtle1 -> drone have the stamps of poses; the world's origin is mid-field."""
    poses = poses_of(user, "turtle1")
    user.create_client(TeleportAbsolute, "turtle1/teleport_absolute").call(
        TeleportAbsolute.Request(MIDDLE_M + 1.0, MIDDLE_M + 2.0, pi / 2)
    )
    eventually(lambda: poses[-1].x > MIDDLE_M + 0.9)
    bus.start("broadcaster").wait_for_line("ready")
    drone = buffer.lookup_transform("world", "drone", timeout_s=20.0)
    wanted = Transform.from_rpy(0.0, 0.0, pi / 2, (1.0, 1.5, 1.0))
    assert drone.transform.is_close(wanted, atol=1e-6)
    eventually(lambda: drone.stamp_ns in [pose.stamp_ns for pose in poses])


def test_the_follower_comes_near_its_target(bus: Bus, user: Node, buffer: Buffer) -> None:
    """follow spawns turtle2 at (4, 2), and drives it until it is at turtle1."""
    bus.start("broadcaster")
    second = ["--name", "broadcaster2", "--param", "turtlename=turtle2", "--param", "drone=drone2"]
    bus.start("broadcaster", *second)
    follow = bus.start("follow")
    far = buffer.lookup_transform("turtle2", "turtle1", timeout_s=20.0).transform
    assert hypot(far.x, far.y) > 1.0

    def is_near() -> bool:
        near = buffer.lookup_transform("turtle2", "turtle1").transform
        return hypot(near.x, near.y) < 0.5

    eventually(is_near)
    assert follow.stop() == 0


def test_the_follower_goes_on_after_a_restart(bus: Bus, user: Node) -> None:
    """If turtle2 exists already, follow says so and drives it."""
    user.create_client(Spawn, "spawn").call(Spawn.Request(1.0, 1.0, name="turtle2"))
    follow = bus.start("follow")
    follow.wait_for_line("already exists")
    follow.wait_for_line("ready")


def test_the_follower_comes_back_after_a_reset(bus: Bus, sim: Node, user: Node) -> None:
    """A reset takes turtle2 away; follow spawns it again, and it drives to turtle1."""
    bus.start("broadcaster")
    bus.start("broadcaster", "--name", "broadcaster2", "--param", "turtlename=turtle2")
    follow = bus.start("follow")
    poses = poses_of(user, "turtle2")
    follow.wait_for_line("ready")

    def away_m(pose: Pose) -> float:
        return hypot(pose.x - 4.0, pose.y - 2.0)

    eventually(lambda: away_m(poses[-1]) > 0.5)
    before = len(poses)
    user.create_client(Empty, "reset").call(Empty.Request())
    follow.wait_for_line("turtle2 was gone, as after a reset; spawned it again")
    # It is near its start for a moment only, which the last pose alone may miss.
    eventually(lambda: any(away_m(pose) < 0.4 for pose in poses[before:]))
    eventually(lambda: away_m(poses[-1]) > 0.5)
    assert follow.stop() == 0


def test_the_carrot_hangs_beside_its_parent(bus: Bus, buffer: Buffer) -> None:
    """carrot sends turtle1 -> carrot1, 2 m to the left; options name its frames."""
    bus.start("carrot", "--param", "parent_frame=cart", "--param", "frame=bait")
    bait = buffer.lookup_transform("cart", "bait", timeout_s=20.0).transform
    assert bait.is_close(Transform((0.0, 2.0, 0.0)))


def test_a_mimic_moves_like_the_other(bus: Bus, user: Node) -> None:
    """With mimic between their topics, turtle2 does what turtle1 does."""
    user.create_client(Spawn, "spawn").call(Spawn.Request(2.0, 2.0))
    poses = poses_of(user, "turtle2")
    topics = ["input/pose:=turtle1/pose", "output/cmd_vel:=turtle2/cmd_vel"]
    bus.start("mimic", *[word for topic in topics for word in ("--remap", topic)])
    keep_sending(user, "turtle1", Twist(Vector3(x=0.5), Vector3(z=0.3)))
    eventually(lambda: poses[-1].x > 2.1)
    assert (poses[-1].linear_velocity, poses[-1].angular_velocity) == (0.5, 0.3)


def test_draw_square_resets_and_drives(bus: Bus, user: Node) -> None:
    """draw_square puts turtle1 in the middle and drives it forward from there."""
    poses = poses_of(user, "turtle1")
    user.create_client(TeleportAbsolute, "turtle1/teleport_absolute").call(
        TeleportAbsolute.Request(1.0, 1.0)
    )
    eventually(lambda: poses[-1].x == 1.0)
    square = bus.start("draw_square")
    square.wait_for_line(r"New goal \[7\.544445 5\.544445, 0\.000000\]")
    eventually(lambda: poses[-1].x > MIDDLE_M + 0.1)
    assert poses[-1].linear_velocity == 1.0
    assert square.stop() == 0


# Their decisions, without a bus


def test_draw_square_draws_a_square() -> None:
    """Four sides and four corners bring the turtle back to its start, again and again."""
    world = World()
    turtle = world.turtles["turtle1"]
    square = Square(turtle.pose(0), logging.getLogger("square"))
    corners = [square.target]
    for _ in range(6000):
        turtle.command(square.command(turtle.pose(0)))
        world.step()
        if square.target is not corners[-1]:
            corners.append(square.target)
    assert len(corners) > 9
    sides = corners[::2]  # every second target is the end of a side
    for a, b, c in zip(sides, sides[1:], sides[2:], strict=False):
        assert hypot(b.x - a.x, b.y - a.y) == pytest.approx(2.0, abs=0.25)
        turned = atan2(c.y - b.y, c.x - b.x) - atan2(b.y - a.y, b.x - a.x)
        assert turned % (2 * pi) == pytest.approx(pi / 2, abs=0.2)


@given(x=st.floats(-10, 10), y=st.floats(-10, 10))
def test_a_follower_turns_to_its_target(x: float, y: float) -> None:
    """It drives forward at half the distance a second, and turns to the side of the target."""
    twist = towards(TransformStamped(0, "turtle2", "turtle1", Transform((x, y, 0.0))))
    assert twist.linear.x == pytest.approx(0.5 * hypot(x, y))
    assert twist.angular.z == pytest.approx(atan2(y, x))


@given(turns=st.floats(0.0, 1e9), radius=st.floats(0.1, 100.0))
def test_a_carrot_keeps_its_distance(turns: float, radius: float) -> None:
    """On its way around, the carrot is always at its radius."""
    x, y, z = carrot_at(turns, radius)
    assert hypot(x, y) == pytest.approx(radius)
    assert z == 0.0


def test_a_carrot_goes_clockwise_from_the_left() -> None:
    """It is to the left at first, ahead after a quarter, to the right after a half."""
    assert carrot_at(0.0, 2.0) == (0.0, 2.0, 0.0)
    assert carrot_at(0.25, 2.0) == pytest.approx((2.0, 0.0, 0.0))
    assert carrot_at(0.5, 2.0) == pytest.approx((0.0, -2.0, 0.0))


@pytest.mark.parametrize(
    "name", ["broadcaster", "carrot", "clock", "draw_square", "follow", "simulator", "teleop"]
)
def test_the_help_of_a_node_lists_its_parameters(bus: Bus, name: str) -> None:
    """--help has what the running node declares: name, type, bounds and default."""
    command = import_module(f"tfbus.nodes.{name}").main
    listed = {each.name: each for each in command.declared}
    shown = bus.run(name, "--help").stdout.split("Parameters, set by --param NAME=VALUE")[1]
    assert all(f"\n  {each}  " in shown for each in listed)
    if name in ("clock", "simulator", "broadcaster", "carrot"):
        options = ["--headless"] * (name == "simulator")
        bus.start(name, *options, "--name", "it").wait_for_line("ready|It is")
        described = json.loads(bus.run("param", "describe", "it", "--json").stdout)
        assert {each["name"]: each["value"] for each in described} == {
            each.name: each.default for each in listed.values()
        }
