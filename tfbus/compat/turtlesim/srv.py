"""ROS's turtlesim.srv: served by `tfbus simulator` under the same names."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from tfbus.compat.missing import missing_messages

__all__ = ["Kill", "SetPen", "Spawn", "TeleportAbsolute", "TeleportRelative"]

if not TYPE_CHECKING:  # type checkers find what is missing themselves
    __getattr__ = missing_messages(__name__)


class Spawn:
    """Puts another turtle on the field."""

    @dataclass(slots=True, kw_only=True)
    class Request:
        """Where it starts, in m and rad; an empty name means the next free turtleN."""

        x: float = 0.0
        y: float = 0.0
        theta: float = 0.0
        name: str = ""

    @dataclass(slots=True, kw_only=True)
    class Response:
        """The name of the new turtle."""

        name: str = ""


class Kill:
    """Takes a turtle off the field."""

    @dataclass(slots=True, kw_only=True)
    class Request:
        """The turtle to take."""

        name: str = ""

    @dataclass(slots=True, kw_only=True)
    class Response:
        """Done."""


class SetPen:
    """Changes the pen that a turtle draws its trail with."""

    @dataclass(slots=True, kw_only=True)
    class Request:
        """Colour parts and width from 0 to 255; `off` is 0 or 1."""

        r: int = 0
        g: int = 0
        b: int = 0
        width: int = 0
        off: int = 0

    @dataclass(slots=True, kw_only=True)
    class Response:
        """Done."""


class TeleportAbsolute:
    """Moves a turtle to a place."""

    @dataclass(slots=True, kw_only=True)
    class Request:
        """The new pose, in m and rad."""

        x: float = 0.0
        y: float = 0.0
        theta: float = 0.0

    @dataclass(slots=True, kw_only=True)
    class Response:
        """Done."""


class TeleportRelative:
    """Moves a turtle from where it is."""

    @dataclass(slots=True, kw_only=True)
    class Request:
        """How far ahead, in m, after a turn in rad."""

        linear: float = 0.0
        angular: float = 0.0

    @dataclass(slots=True, kw_only=True)
    class Response:
        """Done."""
