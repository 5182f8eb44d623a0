"""A turtle: its pose, its commands, and how it moves in one tick.

The order of a tick, the constants and the log texts are turtlesim's (turtle.cpp).
"""

import logging
from dataclasses import dataclass
from math import cos, hypot, pi, remainder, sin
from typing import Protocol

from tfbus import ServiceError
from tfbus.messages import (
    Color,
    Pose,
    RotateAbsolute,
    SetPen,
    TeleportAbsolute,
    TeleportRelative,
    Twist,
)

from . import field
from .canvas import Canvas, Pen

TICK_S = 0.016
COMMAND_TIMEOUT_S = 1.0
ROTATION_TOLERANCE_RAD = 0.02
FARTHEST_JUMP_M = 1000.0
# In m/s and rad/s: across the whole field in one tick.
FASTEST = 1000.0
# turtlesim warns on each of its 62.5 ticks a second while a turtle pushes against the wall.
WALL_WARNING_PERIOD_S = 1.0


class RotationGoal(Protocol):
    """A goal as a turtle needs it: its request, and how to report progress and the end."""

    @property
    def request(self) -> RotateAbsolute.Goal: ...
    def feedback(self, message: RotateAbsolute.Feedback) -> None: ...
    def succeed(self, result: RotateAbsolute.Result) -> None: ...
    def cancel(self, result: RotateAbsolute.Result) -> None: ...
    def abort(self, result: RotateAbsolute.Result, reason: str) -> None: ...


@dataclass
class _Rotation:
    goal: RotationGoal
    start_theta: float
    canceling: bool = False


class Turtle:
    """A turtle at (x, y) m from the lower left corner, heading theta rad from the x axis.

    It moves by at most 1000 m/s along each axis, and turns by at most 1000 rad/s. Commands may come
    at any time; its next `step` carries them out.
    """

    def __init__(self, name: str, x: float, y: float, theta: float, log: logging.Logger) -> None:
        self.name = name
        self.x = x
        self.y = y
        self.theta = wrap(theta)
        self.pen = Pen()
        self._log = log
        self._forward = self._left = self._turning = 0.0
        self._silent_ticks = 0
        self._teleports: list[TeleportAbsolute.Request | TeleportRelative.Request] = []
        self._rotation: _Rotation | None = None
        self._ticks_to_wall_warning = 0
        self._has_been_limited = False

    # Commands

    def command(self, twist: Twist, *, holonomic: bool = False) -> None:
        """Move with these velocities for the next second; sideways only if holonomic."""
        self._abort_rotation("Velocity command received during rotation goal. Aborting goal")
        self._forward = self._limited(twist.linear.x)
        self._left = self._limited(twist.linear.y) if holonomic else 0.0
        self._turning = self._limited(twist.angular.z)
        self._silent_ticks = 0

    def set_pen(self, request: SetPen.Request) -> None:
        """Change or lift the pen."""
        if request.off:
            self.pen = Pen(self.pen.color, self.pen.width, down=False)
        else:
            self.pen = Pen(Color(request.r, request.g, request.b), request.width or 1)

    def teleport_absolute(self, request: TeleportAbsolute.Request) -> None:
        """Jump to a pose on the next tick. Raises ServiceError if it is off the field."""
        check_on_field(request.x, request.y)
        self._teleports.append(request)

    def teleport_relative(self, request: TeleportRelative.Request) -> None:
        """Turn, then jump ahead, on the next tick; the wall stops it.

        Raises ServiceError for a jump of 1000 m or more.
        """
        if abs(request.linear) >= FARTHEST_JUMP_M:
            raise ServiceError(
                f"linear must be less than {FARTHEST_JUMP_M:g} m, not {request.linear:g}"
            )
        self._teleports.append(request)

    def rotate(self, goal: RotationGoal) -> None:
        """Turn to the goal's heading; aborts a rotation under way."""
        self._abort_rotation(
            "Rotation goal received before a previous goal finished. Aborting previous goal"
        )
        self._rotation = _Rotation(goal, self.theta)

    def cancel_rotation(self) -> None:
        """Stop turning to the goal's heading on the next tick."""
        if self._rotation is not None:
            self._rotation.canceling = True

    def leave(self) -> None:
        """Abort a rotation under way, before the turtle leaves the field."""
        self._abort_rotation(f"Turtle [{self.name}] left the field. Aborting its rotation goal")

    # State

    def pose(self, stamp_ns: int) -> Pose:
        """Its pose and commanded velocities, as of stamp_ns."""
        speed = hypot(self._forward, self._left)
        return Pose(stamp_ns, self.x, self.y, self.theta, speed, self._turning)

    # Motion

    def step(self, canvas: Canvas, background: Color) -> Color:
        """Live one tick, drawing on the canvas. Returns the colour seen under the turtle."""
        for request in self._teleports:
            self._teleport(request, canvas)
        self._teleports.clear()
        self._follow_rotation()
        self._stop_when_silent()
        before = (self.x, self.y)
        self._move()
        self._stay_on_field()
        color = canvas.color_at(*field.to_pixels(self.x, self.y), background)
        if (self.x, self.y) != before:
            self._draw(before, canvas)
        return color

    def _teleport(
        self, request: TeleportAbsolute.Request | TeleportRelative.Request, canvas: Canvas
    ) -> None:
        before = (self.x, self.y)
        if isinstance(request, TeleportAbsolute.Request):
            self.x, self.y, self.theta = request.x, request.y, wrap(request.theta)
        else:
            self.theta = wrap(self.theta + request.angular)
            self.x += cos(self.theta) * request.linear
            self.y += sin(self.theta) * request.linear
        self._draw(before, canvas)

    def _follow_rotation(self) -> None:
        if self._rotation is None:
            return
        goal = self._rotation.goal
        remaining = wrap(goal.request.theta - self.theta)
        if self._rotation.canceling:
            self._log.info("Rotation goal canceled")
            goal.cancel(self._rotation_result(self._rotation))
            self._end_rotation()
            return
        goal.feedback(RotateAbsolute.Feedback(remaining))
        if abs(remaining) < ROTATION_TOLERANCE_RAD:
            self._log.info("Rotation goal completed successfully")
            goal.succeed(self._rotation_result(self._rotation))
            self._end_rotation()
        else:
            self._forward = self._left = 0.0
            self._turning = -1.0 if remaining < 0.0 else 1.0
            self._silent_ticks = 0

    def _limited(self, speed: float) -> float:
        """The speed, at most FASTEST either way; the first that is more is logged."""
        limited = min(max(speed, -FASTEST), FASTEST)
        if limited != speed and not self._has_been_limited:
            self._has_been_limited = True
            self._log.warning(
                "Turtle [%s] moves at %g, not at %g: a velocity is at most %g m/s or rad/s "
                "(logged once)",
                self.name,
                limited,
                speed,
                FASTEST,
            )
        return limited

    def _end_rotation(self) -> None:
        self._rotation = None
        self._forward = self._left = self._turning = 0.0

    def _abort_rotation(self, reason: str) -> None:
        if self._rotation is not None:
            self._log.warning("%s", reason)
            self._rotation.goal.abort(self._rotation_result(self._rotation), reason)
            self._rotation = None

    def _rotation_result(self, rotation: _Rotation) -> RotateAbsolute.Result:
        return RotateAbsolute.Result(wrap(rotation.start_theta - self.theta))

    def _stop_when_silent(self) -> None:
        self._silent_ticks += 1
        if self._silent_ticks * TICK_S > COMMAND_TIMEOUT_S:
            self._forward = self._left = self._turning = 0.0

    def _move(self) -> None:
        self.theta = wrap(self.theta + self._turning * TICK_S)
        ahead, aside = cos(self.theta), sin(self.theta)
        self.x += (ahead * self._forward - aside * self._left) * TICK_S
        self.y += (aside * self._forward + ahead * self._left) * TICK_S

    def _stay_on_field(self) -> None:
        self._ticks_to_wall_warning -= 1
        if field.contains(self.x, self.y):
            return
        if self._ticks_to_wall_warning <= 0:
            self._ticks_to_wall_warning = round(WALL_WARNING_PERIOD_S / TICK_S)
            self._log.warning("Oh no! I hit the wall! (Clamping from [x=%f, y=%f])", self.x, self.y)
        self.x = min(max(self.x, 0.0), field.SIZE_M)
        self.y = min(max(self.y, 0.0), field.SIZE_M)

    def _draw(self, before: tuple[float, float], canvas: Canvas) -> None:
        if self.pen.down:
            canvas.stroke(field.to_pixels(*before), field.to_pixels(self.x, self.y), self.pen)


def wrap(angle: float) -> float:
    """The same direction in [-pi, pi)."""
    wrapped = remainder(angle, 2.0 * pi)  # exact, also for angles that rounding would spoil
    return wrapped if wrapped < pi else -pi


def check_on_field(x: float, y: float) -> None:
    """Raise ServiceError if a point is off the field."""
    if not field.contains(x, y):
        raise ServiceError(
            f"({x:g}, {y:g}) is off the field: x and y must be from 0 to {field.SIZE_M:f}"
        )
