"""ROS's turtlesim.msg."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from tfbus.compat.missing import missing_messages

__all__ = ["Color", "Pose"]

if not TYPE_CHECKING:  # type checkers find what is missing themselves
    __getattr__ = missing_messages(__name__)


@dataclass(slots=True, kw_only=True)
class Pose:
    """Where a turtle is; on the bus it is `tfbus.messages.Pose`, which has a stamp too."""

    x: float = 0.0
    y: float = 0.0
    theta: float = 0.0
    linear_velocity: float = 0.0
    angular_velocity: float = 0.0


@dataclass(slots=True, kw_only=True)
class Color:
    """A colour; each part from 0 to 255."""

    r: int = 0
    g: int = 0
    b: int = 0
