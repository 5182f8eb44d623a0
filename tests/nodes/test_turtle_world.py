"""The turtles' world, stepped without a clock; the numbers are turtlesim's."""

import logging
from dataclasses import dataclass, field
from math import cos, pi, sin

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.builders import examples
from tfbus import ServiceError
from tfbus.messages import (
    Color,
    RotateAbsolute,
    SetPen,
    TeleportAbsolute,
    TeleportRelative,
    Twist,
    Vector3,
)
from tfbus.nodes.turtle.canvas import Canvas, Pen
from tfbus.nodes.turtle.field import MIDDLE_M, SIZE_M, to_pixels
from tfbus.nodes.turtle.turtle import Turtle, wrap
from tfbus.nodes.turtle.world import BACKGROUND, World

PEN = Color(179, 184, 255)

numbers = st.floats(allow_nan=False, allow_infinity=False)
speeds = st.floats(-20.0, 20.0)
angles = st.floats(-100.0, 100.0)
places = st.floats(0.0, SIZE_M)


@dataclass
class Goal:
    """A rotation that records what the turtle reports."""

    request: RotateAbsolute.Goal
    remaining: list[float] = field(default_factory=list)
    ending: tuple[str, float] | None = None
    reason: str = ""

    def feedback(self, message: RotateAbsolute.Feedback) -> None:
        self.remaining.append(message.remaining)

    def succeed(self, result: RotateAbsolute.Result) -> None:
        self._end("succeeded", result)

    def cancel(self, result: RotateAbsolute.Result) -> None:
        self._end("canceled", result)

    def abort(self, result: RotateAbsolute.Result, reason: str) -> None:
        self.reason = reason
        self._end("aborted", result)

    def _end(self, status: str, result: RotateAbsolute.Result) -> None:
        assert self.ending is None, "a goal ends once"
        self.ending = (status, result.delta)


def drive(forward: float = 0.0, turn: float = 0.0, left: float = 0.0) -> Twist:
    return Twist(Vector3(x=forward, y=left), Vector3(z=turn))


def turtle1(world: World) -> Turtle:
    return world.turtles["turtle1"]


def steps(world: World, ticks: int) -> None:
    for _ in range(ticks):
        world.step()


# The field


def test_the_field_is_turtlesims() -> None:
    """500 pixels at 45 pixels a metre are a field of 11.088889 m; turtle1 is in its middle."""
    pose = turtle1(World()).pose(stamp_ns=7)
    assert f"{SIZE_M:.6f}" == "11.088889"
    assert f"{pose.x:.6f} {pose.y:.6f} {pose.theta:.6f}" == "5.544445 5.544445 0.000000"
    assert (pose.stamp_ns, pose.linear_velocity, pose.angular_velocity) == (7, 0.0, 0.0)


# Driving


def test_a_turtle_drives_straight() -> None:
    """At 2 m/s a turtle is 0.032 m further after each tick of 16 ms."""
    world = World()
    turtle1(world).command(drive(2.0))
    world.step()
    assert turtle1(world).x == pytest.approx(MIDDLE_M + 0.032)
    world.step()
    assert turtle1(world).x == pytest.approx(MIDDLE_M + 0.064)


def test_a_turtle_turns_before_it_moves() -> None:
    """In one tick the heading changes first, and the turtle moves along the new one."""
    world = World()
    turtle1(world).command(drive(1.0, turn=10.0))
    world.step()
    pose = turtle1(world).pose(0)
    assert pose.theta == pytest.approx(0.16)
    assert pose.x == pytest.approx(MIDDLE_M + 0.016 * cos(0.16))
    assert pose.y == pytest.approx(MIDDLE_M + 0.016 * sin(0.16))


def test_a_command_holds_for_one_second() -> None:
    """Without a new command a turtle stops after 62 ticks, the last that is within a second."""
    world = World()
    turtle1(world).command(drive(1.0))
    steps(world, 62)
    assert turtle1(world).pose(0).linear_velocity == 1.0
    world.step()
    assert turtle1(world).pose(0).linear_velocity == 0.0
    assert turtle1(world).x == pytest.approx(MIDDLE_M + 62 * 0.016)


def test_a_new_command_holds_for_one_more_second() -> None:
    """Each command restarts the second."""
    world = World()
    for _ in range(3):
        turtle1(world).command(drive(0.0, turn=0.5))
        steps(world, 40)
    assert turtle1(world).pose(0).angular_velocity == 0.5


def test_sideways_only_if_holonomic() -> None:
    """linear.y moves a turtle to its left in a holonomic world, and does nothing in another."""
    world = World()
    turtle1(world).command(drive(left=1.0), holonomic=False)
    world.step()
    assert turtle1(world).y == MIDDLE_M
    turtle1(world).command(drive(left=1.0), holonomic=True)
    world.step()
    assert turtle1(world).y == pytest.approx(MIDDLE_M + 0.016)


def test_the_speed_in_a_pose_is_a_magnitude() -> None:
    """A turtle that drives backwards has a positive linear_velocity, as in turtlesim."""
    world = World()
    turtle1(world).command(drive(-1.5, turn=-0.5))
    world.step()
    pose = turtle1(world).pose(0)
    assert (pose.linear_velocity, pose.angular_velocity) == (1.5, -0.5)
    assert pose.x < MIDDLE_M


def test_the_wall_stops_a_turtle(caplog: pytest.LogCaptureFixture) -> None:
    """At the wall a turtle stays on the field, keeps its commanded speed, and says so."""
    world = World()
    world.spawn(SIZE_M - 0.01, 3.0, 0.0, "bold")
    bold = world.turtles["bold"]
    bold.command(drive(1.0))
    world.step()
    assert (bold.x, bold.pose(0).linear_velocity) == (SIZE_M, 1.0)
    assert caplog.messages == ["Oh no! I hit the wall! (Clamping from [x=11.094889, y=3.000000])"]


def test_the_wall_is_logged_once_a_second(caplog: pytest.LogCaptureFixture) -> None:
    """A turtle that pushes against the wall for 3 s warns three times, not on each tick."""
    world = World()
    turtle1(world).teleport_absolute(TeleportAbsolute.Request(SIZE_M, 1.0))
    for _ in range(3 * 62):
        turtle1(world).command(drive(1.0))
        world.step()
    assert len(caplog.messages) == 3


@given(st.lists(st.tuples(speeds, speeds, speeds, st.integers(1, 20)), max_size=8))
@settings(max_examples=examples(30), deadline=None)
def test_every_drive_stays_on_the_field(commands: list[tuple[float, float, float, int]]) -> None:
    """However it is driven, a turtle stays on the field with its heading in [-pi, pi)."""
    world = World()
    turtle = turtle1(world)
    turtle.set_pen(SetPen.Request(off=True))
    for forward, left, turn, ticks in commands:
        turtle.command(drive(forward, turn, left), holonomic=True)
        for _ in range(ticks):
            world.step()
            pose = turtle.pose(0)
            assert 0.0 <= pose.x <= SIZE_M and 0.0 <= pose.y <= SIZE_M
            assert -pi <= pose.theta < pi


@given(forward=numbers, left=numbers, turn=numbers, theta=numbers)
@settings(max_examples=examples(50), deadline=None)
def test_no_finite_command_breaks_the_world(
    forward: float, left: float, turn: float, theta: float
) -> None:
    """Absurd speeds and headings leave a turtle somewhere on the field, heading somewhere."""
    world = World()
    turtle = turtle1(world)
    turtle.teleport_absolute(TeleportAbsolute.Request(1.0, 1.0, theta))
    turtle.teleport_relative(TeleportRelative.Request(999.0, theta))
    turtle.command(drive(forward, turn, left), holonomic=True)
    steps(world, 2)
    assert 0.0 <= turtle.x <= SIZE_M and 0.0 <= turtle.y <= SIZE_M and -pi <= turtle.theta < pi
    turtle.pose(0)  # which has finite numbers only


def test_a_velocity_beyond_all_turtles_is_limited(caplog: pytest.LogCaptureFixture) -> None:
    """To 1000 m/s and rad/s, with one line of the log; the wall is named in few digits."""
    world = World()
    turtle = turtle1(world)
    for _ in range(2):
        turtle.command(drive(1e308, -1e308, 1e308), holonomic=True)
        world.step()
    assert turtle.pose(0).angular_velocity == -1000.0
    assert turtle.pose(0).linear_velocity == pytest.approx(2.0**0.5 * 1000.0)
    limited, wall = caplog.messages
    assert "[turtle1] moves at 1000, " in limited and "not at 1e+308: " in limited
    assert limited.endswith("(logged once)")
    assert "hit the wall" in wall and len(wall) < 100


@given(angle=st.floats(-1e6, 1e6))
def test_a_wrapped_angle_is_the_same_direction(angle: float) -> None:
    """An angle is wrapped into [-pi, pi) and keeps its direction."""
    assert -pi <= wrap(angle) < pi
    assert cos(wrap(angle)) == pytest.approx(cos(angle), abs=1e-9)
    assert sin(wrap(angle)) == pytest.approx(sin(angle), abs=1e-9)


def test_half_a_turn_is_minus_pi() -> None:
    """pi itself wraps to -pi, and -pi stays."""
    assert (wrap(pi), wrap(-pi), wrap(3 * pi)) == (-pi, -pi, -pi)


@given(commands=st.lists(st.tuples(speeds, speeds), max_size=5))
@settings(max_examples=examples(20), deadline=None)
def test_the_world_is_deterministic(commands: list[tuple[float, float]]) -> None:
    """Two worlds with the same commands are the same, to the last bit and pixel."""

    def story() -> tuple[object, bytes]:
        world = World()
        for forward, turn in commands:
            turtle1(world).command(drive(forward, turn))
            steps(world, 3)
        snapshot = world.snapshot()
        return snapshot.turtles, snapshot.ink.tobytes()

    assert story() == story()


# Teleporting


def test_teleports_happen_on_the_next_tick_in_their_order() -> None:
    """A turtle stays until the world steps; then all its jumps happen."""
    world = World()
    turtle = turtle1(world)
    turtle.teleport_absolute(TeleportAbsolute.Request(2.0, 3.0, pi / 2))
    turtle.teleport_relative(TeleportRelative.Request(1.0, pi / 2))
    assert turtle.x == MIDDLE_M
    world.step()
    assert (turtle.x, turtle.y) == pytest.approx((1.0, 3.0))
    assert abs(turtle.theta) == pytest.approx(pi)


def test_a_relative_teleport_turns_first() -> None:
    """The turtle moves along its new heading."""
    world = World()
    turtle1(world).teleport_relative(TeleportRelative.Request(linear=2.0, angular=pi / 2))
    world.step()
    assert (turtle1(world).x, turtle1(world).y) == pytest.approx((MIDDLE_M, MIDDLE_M + 2.0))


@pytest.mark.parametrize(("x", "y"), [(-0.1, 1.0), (1.0, -0.1), (11.1, 1.0), (1.0, 11.1)])
def test_a_teleport_off_the_field_is_refused(x: float, y: float) -> None:
    """A place off the field is refused with the size of the field."""
    with pytest.raises(ServiceError, match=r"off the field: .* 11\.088889"):
        turtle1(World()).teleport_absolute(TeleportAbsolute.Request(x, y))


@given(x=places, y=places, theta=angles)
@settings(max_examples=examples(50), deadline=None)
def test_a_turtle_is_where_it_was_teleported_to(x: float, y: float, theta: float) -> None:
    """Every place on the field can be reached by a teleport."""
    world = World()
    turtle1(world).teleport_absolute(TeleportAbsolute.Request(x, y, theta))
    world.step()
    pose = turtle1(world).pose(0)
    assert (pose.x, pose.y) == (x, y)
    assert cos(pose.theta - theta) == pytest.approx(1.0)


# Rotating to a heading


@given(theta=st.floats(-10.0, 10.0))
@settings(max_examples=examples(20), deadline=None)
def test_a_rotation_goes_the_shorter_way_at_one_rad_a_second(theta: float) -> None:
    """It turns the turtle by 0.016 rad a tick, until at most 0.02 rad are left."""
    world, goal = World(), Goal(RotateAbsolute.Goal(theta))
    turtle1(world).rotate(goal)
    ticks = 0
    while goal.ending is None:
        world.step()
        ticks += 1
    assert ticks <= pi / 0.016 + 2
    assert abs(wrap(theta - turtle1(world).theta)) < 0.02
    assert goal.remaining == sorted(goal.remaining, key=abs, reverse=True)
    assert goal.ending == ("succeeded", pytest.approx(wrap(-turtle1(world).theta)))
    assert turtle1(world).pose(0).angular_velocity == 0.0


def test_a_rotation_is_not_stopped_by_the_command_timeout() -> None:
    """A rotation that takes three seconds needs no commands."""
    world, goal = World(), Goal(RotateAbsolute.Goal(3.0))
    turtle1(world).rotate(goal)
    steps(world, 200)
    assert goal.ending == ("succeeded", pytest.approx(-2.992))


def test_a_canceled_rotation_stops_the_turtle(caplog: pytest.LogCaptureFixture) -> None:
    """A cancelled rotation ends on the next tick, and reports how far it came."""
    caplog.set_level(logging.INFO)
    world, goal = World(), Goal(RotateAbsolute.Goal(3.0))
    turtle1(world).rotate(goal)
    steps(world, 10)
    turtle1(world).cancel_rotation()
    world.step()
    assert goal.ending == ("canceled", pytest.approx(-0.16))
    assert turtle1(world).theta == pytest.approx(0.16)
    assert caplog.messages[-1] == "Rotation goal canceled"


def test_a_command_aborts_a_rotation(caplog: pytest.LogCaptureFixture) -> None:
    """Driving the turtle ends its rotation."""
    world, goal = World(), Goal(RotateAbsolute.Goal(3.0))
    turtle1(world).rotate(goal)
    steps(world, 10)
    turtle1(world).command(drive(1.0))
    assert goal.ending == ("aborted", pytest.approx(-0.16))
    assert goal.reason == "Velocity command received during rotation goal. Aborting goal"
    assert caplog.messages == [goal.reason]


def test_a_new_rotation_aborts_the_old_one() -> None:
    """The last rotation counts."""
    world, old, new = World(), Goal(RotateAbsolute.Goal(3.0)), Goal(RotateAbsolute.Goal(-1.0))
    turtle1(world).rotate(old)
    world.step()
    turtle1(world).rotate(new)
    assert old.ending is not None and old.ending[0] == "aborted"
    assert old.reason.startswith("Rotation goal received before a previous goal finished.")
    steps(world, 100)
    assert new.ending is not None and new.ending[0] == "succeeded"


def test_a_killed_turtle_aborts_its_rotation() -> None:
    """The client gets the reason: the turtle has left."""
    world, goal = World(), Goal(RotateAbsolute.Goal(3.0))
    turtle1(world).rotate(goal)
    world.kill("turtle1")
    assert goal.ending is not None and goal.ending[0] == "aborted"
    assert "left the field" in goal.reason


# The turtles


def test_turtles_without_a_name_are_numbered() -> None:
    """An empty name becomes the next free turtleN."""
    world = World()
    world.spawn(1.0, 1.0, 0.0, "turtle3")
    assert [world.spawn(2.0, 2.0, 0.0).name for _ in range(2)] == ["turtle2", "turtle4"]
    world.kill("turtle2")
    assert world.spawn(2.0, 2.0, 0.0).name == "turtle5"


def test_a_name_is_given_once() -> None:
    """A second turtle of one name is refused with turtlesim's words."""
    with pytest.raises(ServiceError, match=r"^A turtle named \[turtle1\] already exists$"):
        World().spawn(1.0, 1.0, 0.0, "turtle1")


@pytest.mark.parametrize("name", ["a/b", "*", "7up", "turtle 1", "-"])
def test_a_name_is_fit_for_a_topic(name: str) -> None:
    """A name that cannot be part of a topic's is refused; the error says which can."""
    with pytest.raises(ServiceError, match="letters, digits and _"):
        World().spawn(1.0, 1.0, 0.0, name)


def test_a_refused_spawn_leaves_no_trace() -> None:
    """Off the field no turtle appears, and its number is not used up."""
    world = World()
    with pytest.raises(ServiceError, match="off the field"):
        world.spawn(12.0, 1.0, 0.0)
    assert list(world.turtles) == ["turtle1"]
    assert world.spawn(1.0, 1.0, 0.0).name == "turtle2"


def test_an_unknown_turtle_cannot_be_killed() -> None:
    """Killing a turtle that does not exist is refused with turtlesim's words."""
    with pytest.raises(ServiceError, match=r"^Tried to kill turtle \[nemo\], which does not exist"):
        World().kill("nemo")


def test_the_log_reads_as_turtlesims(caplog: pytest.LogCaptureFixture) -> None:
    """Spawning, clearing and resetting are logged word for word as turtlesim logs them."""
    caplog.set_level(logging.INFO)
    world = World()
    world.clear()
    world.reset()
    spawning = "Spawning turtle [turtle1] at x=[5.544445], y=[5.544445], theta=[0.000000]"
    assert caplog.messages == [spawning, "Clearing turtlesim.", "Resetting turtlesim.", spawning]


def test_a_reset_leaves_turtle1_alone_on_a_clean_field() -> None:
    """The turtle is a new one; background and rules stay."""
    world = World()
    world.background, world.holonomic = Color(1, 2, 3), True
    turtle1(world).set_pen(SetPen.Request(255, 0, 0, 9))
    turtle1(world).command(drive(2.0))
    world.spawn(1.0, 1.0, 0.0)
    steps(world, 20)
    world.reset()
    assert list(world.turtles) == ["turtle1"]
    assert turtle1(world).x == MIDDLE_M and turtle1(world).pen == Pen()
    assert not world.snapshot().ink.any()
    assert (world.background, world.holonomic) == (Color(1, 2, 3), True)
    assert world.spawn(1.0, 1.0, 0.0).name == "turtle2"


# Pen and ink


def ink_at(world: World, x: float, y: float) -> tuple[int, ...]:
    column, row = (round(value) for value in to_pixels(x, y))
    return tuple(int(part) for part in world.snapshot().ink[row, column])


def test_a_turtle_draws_its_path() -> None:
    """The default pen is down, 3 pixels wide, of colour (179, 184, 255)."""
    world = World()
    turtle1(world).command(drive(2.0))
    steps(world, 50)
    assert ink_at(world, MIDDLE_M + 1.0, MIDDLE_M) == (179, 184, 255, 255)
    column = world.snapshot().ink[:, round(to_pixels(MIDDLE_M + 1.0, 0.0)[0]), 3]
    assert column.sum() == pytest.approx(3 * 255, abs=3)


def test_a_teleport_draws_a_line() -> None:
    """The pen draws along a jump."""
    world = World()
    turtle1(world).teleport_absolute(TeleportAbsolute.Request(1.0, 1.0))
    world.step()
    middle_of_way = (1.0 + MIDDLE_M) / 2
    assert ink_at(world, middle_of_way, middle_of_way)[:3] == (179, 184, 255)


def test_a_lifted_pen_draws_nothing_and_keeps_its_colour() -> None:
    """`off` lifts the pen; its colour and width stay."""
    world = World()
    turtle1(world).set_pen(SetPen.Request(255, 0, 0, 9))
    turtle1(world).set_pen(SetPen.Request(0, 0, 0, 1, off=True))
    turtle1(world).command(drive(2.0))
    steps(world, 50)
    assert turtle1(world).pen == Pen(Color(255, 0, 0), 9, down=False)
    assert not world.snapshot().ink.any()


def test_width_zero_draws_as_one() -> None:
    """A pen of width 0 is one pixel wide."""
    world = World()
    turtle1(world).set_pen(SetPen.Request(255, 0, 0, 0))
    assert turtle1(world).pen.width == 1


def test_clear_wipes_the_ink() -> None:
    """After clear the field is empty; the turtles stay."""
    world = World()
    turtle1(world).command(drive(2.0))
    steps(world, 20)
    x = turtle1(world).x
    world.clear()
    assert not world.snapshot().ink.any()
    assert turtle1(world).x == x


def test_the_colour_sensor_sees_background_and_ink() -> None:
    """A turtle on clean ground sees the background, on its own fresh trail the pen's colour."""
    world = World()
    world.step()
    assert world.color_under("turtle1") == BACKGROUND
    world.background = Color(10, 20, 30)
    world.step()
    assert world.color_under("turtle1") == Color(10, 20, 30)
    turtle1(world).command(drive(1.0))
    steps(world, 10)
    assert world.color_under("turtle1") == PEN


def test_a_snapshot_does_not_change() -> None:
    """An older snapshot does not show later events, and is read-only."""
    world = World()
    before = world.snapshot()
    turtle1(world).command(drive(2.0))
    steps(world, 20)
    assert before.turtles[0].x == MIDDLE_M and not before.ink.any()
    assert world.snapshot().ink.any()
    with pytest.raises(ValueError, match="read-only"):
        before.ink[0, 0] = 1


def test_snapshots_of_the_same_ink_share_it() -> None:
    """If nothing was drawn between two snapshots, the ink is not copied."""
    world = World()
    assert world.snapshot().ink is world.snapshot().ink


@given(
    start=st.tuples(st.floats(-600, 1100), st.floats(-600, 1100)),
    end=st.tuples(st.floats(-600, 1100), st.floats(-600, 1100)),
    width=st.integers(1, 255),
)
@settings(max_examples=examples(50), deadline=None)
def test_a_stroke_is_the_same_from_both_ends(
    start: tuple[float, float], end: tuple[float, float], width: int
) -> None:
    """A line from A to B has the ink of a line from B to A, to one part in 255."""
    there, back = Canvas(500), Canvas(500)
    there.stroke(start, end, Pen(PEN, width))
    back.stroke(end, start, Pen(PEN, width))
    difference = there.copy()[..., 3].astype(int) - back.copy()[..., 3]
    assert abs(difference).max() <= 1


def test_many_short_strokes_are_as_thin_as_one_long() -> None:
    """A trail of a hundred short strokes has the ink of one line."""
    one, many = Canvas(200), Canvas(200)
    one.stroke((20.3, 50.0), (120.3, 80.0), Pen())
    for i in range(100):
        many.stroke((20.3 + i, 50.0 + 0.3 * i), (21.3 + i, 50.3 + 0.3 * i), Pen())
    difference = one.copy()[..., 3].astype(int) - many.copy()[..., 3]
    assert abs(difference).max() <= 1
