"""A turtle's topics, services and action on the bus."""

from collections.abc import Callable

from tfbus import GoalHandle, Node, ServiceError
from tfbus.messages import (
    Color,
    Pose,
    RotateAbsolute,
    SetPen,
    TeleportAbsolute,
    TeleportRelative,
    Twist,
)

from .turtle import Turtle
from .world import World


class TurtleInterface:
    """The topics and services `<name>/...` of the turtle that has this name in the world.

    It outlives the turtle: after a reset it serves the new turtle1.
    """

    def __init__(self, node: Node, world: World, name: str) -> None:
        self._world = world
        self._name = name
        self._pose = node.create_publisher(Pose, f"{name}/pose")
        self._color = node.create_publisher(Color, f"{name}/color_sensor")
        self._close: list[Callable[[], None]] = [
            self._pose.close,
            self._color.close,
            node.create_subscription(Twist, f"{name}/cmd_vel", self._command).close,
            node.create_service(SetPen, f"{name}/set_pen", self._set_pen).close,
            node.create_service(
                TeleportAbsolute, f"{name}/teleport_absolute", self._teleport_absolute
            ).close,
            node.create_service(
                TeleportRelative, f"{name}/teleport_relative", self._teleport_relative
            ).close,
            node.create_goal_server(RotateAbsolute, f"{name}/rotate_absolute", self._rotate).close,
        ]

    def publish(self, stamp_ns: int) -> None:
        """Publish the turtle's pose and the colour under it, as of stamp_ns."""
        self._pose.publish(self._turtle.pose(stamp_ns))
        self._color.publish(self._world.color_under(self._name))

    def close(self) -> None:
        """Leave the bus."""
        for close in self._close:
            close()

    @property
    def _turtle(self) -> Turtle:
        # A request may have waited while its turtle was killed.
        if self._name not in self._world.turtles:
            raise ServiceError(f"there is no turtle [{self._name}]")
        return self._world.turtles[self._name]

    def _command(self, twist: Twist) -> None:
        if self._name in self._world.turtles:
            self._turtle.command(twist, holonomic=self._world.holonomic)

    def _set_pen(self, request: SetPen.Request) -> SetPen.Response:
        self._turtle.set_pen(request)
        return SetPen.Response()

    def _teleport_absolute(self, request: TeleportAbsolute.Request) -> TeleportAbsolute.Response:
        self._turtle.teleport_absolute(request)
        return TeleportAbsolute.Response()

    def _teleport_relative(self, request: TeleportRelative.Request) -> TeleportRelative.Response:
        self._turtle.teleport_relative(request)
        return TeleportRelative.Response()

    def _rotate(self, goal: GoalHandle) -> None:
        goal.on_cancel(self._turtle.cancel_rotation)
        self._turtle.rotate(goal)
