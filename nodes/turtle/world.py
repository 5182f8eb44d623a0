"""The turtles' world: the field, its ink, and the turtles on it, in turtlesim's ticks of 16 ms.

It knows no clock, no window and no bus; the simulator steps it in time.
"""

import logging
import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from tfbus import ServiceError
from tfbus.messages import Color

from . import field
from .canvas import Canvas
from .turtle import Turtle, check_on_field

BACKGROUND = Color(69, 86, 255)

# A turtle's name becomes part of the names of its topics, as in ROS.
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


@dataclass(frozen=True, slots=True)
class TurtleView:
    """A turtle as a window shows it: m from the lower left corner, rad from the x axis."""

    name: str
    x: float
    y: float
    theta: float


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """The world at one moment, as a window draws it.

    `ink` is (size, size, 4) bytes from `Canvas.copy`; two snapshots of the same ink share one
    array and one `version`.
    """

    background: Color
    turtles: tuple[TurtleView, ...]
    ink: NDArray[np.uint8]
    version: int

    def looks_like(self, other: "Snapshot | None") -> bool:
        """Whether a picture of the other is the same as of this one."""
        return (
            other is not None
            and self.ink is other.ink
            and (self.background, self.turtles) == (other.background, other.turtles)
        )


class World:
    """The field with turtle1 in its middle. Use it from one thread.

    `background` and `holonomic` may be set at any time. Errors that turtlesim only logs are
    raised, as ServiceError.
    """

    def __init__(self, log: logging.Logger | None = None) -> None:
        self.background = BACKGROUND
        self.holonomic = False
        self._log = log or logging.getLogger("turtle")
        self._canvas = Canvas(field.SIZE_PX)
        self._ink = (self._canvas.version, self._canvas.copy())
        self._turtles: dict[str, Turtle] = {}
        self._colors: dict[str, Color] = {}
        self._last_number = 0
        self.spawn(field.MIDDLE_M, field.MIDDLE_M, 0.0)

    @property
    def turtles(self) -> Mapping[str, Turtle]:
        """The turtles by name, in the order they were spawned; read-only."""
        return MappingProxyType(self._turtles)

    def spawn(self, x: float, y: float, theta: float, name: str = "") -> Turtle:
        """A new turtle; without a name it becomes the next free turtleN.

        Raises ServiceError for a place off the field, and for a taken or malformed name.
        """
        check_on_field(x, y)
        if name and not _NAME.fullmatch(name):
            raise ServiceError(
                f"{name!r} cannot name a turtle: use letters, digits and _, with a letter first"
            )
        if name in self._turtles:
            raise ServiceError(f"A turtle named [{name}] already exists")
        turtle = Turtle(name or self._next_name(), x, y, theta, self._log)
        self._turtles[turtle.name] = turtle
        self._colors[turtle.name] = self.background
        self._log.info(
            "Spawning turtle [%s] at x=[%f], y=[%f], theta=[%f]", turtle.name, x, y, theta
        )
        return turtle

    def kill(self, name: str) -> None:
        """Take a turtle off the field; its trail stays. Raises ServiceError for an unknown name."""
        if name not in self._turtles:
            raise ServiceError(f"Tried to kill turtle [{name}], which does not exist")
        self._turtles.pop(name).leave()
        del self._colors[name]

    def clear(self) -> None:
        """Wipe the field."""
        self._log.info("Clearing turtlesim.")
        self._canvas.clear()

    def reset(self) -> None:
        """Clear the field, with turtle1 in its middle; background and rules stay."""
        self._log.info("Resetting turtlesim.")
        for name in list(self._turtles):
            self.kill(name)
        self._last_number = 0
        self.spawn(field.MIDDLE_M, field.MIDDLE_M, 0.0)
        self._canvas.clear()

    def step(self) -> None:
        """Advance by one tick of 16 ms."""
        for turtle in self._turtles.values():
            self._colors[turtle.name] = turtle.step(self._canvas, self.background)

    def color_under(self, name: str) -> Color:
        """The colour that the turtle's sensor saw in the last tick: ink, or the background."""
        return self._colors[name]

    def snapshot(self) -> Snapshot:
        """The world now, for a window in another thread."""
        if self._ink[0] != self._canvas.version:
            self._ink = (self._canvas.version, self._canvas.copy())
        turtles = tuple(TurtleView(t.name, t.x, t.y, t.theta) for t in self._turtles.values())
        version, ink = self._ink
        return Snapshot(self.background, turtles, ink, version)

    def _next_name(self) -> str:
        while True:
            self._last_number += 1
            name = f"turtle{self._last_number}"
            if name not in self._turtles:
                return name
