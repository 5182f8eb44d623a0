"""ROS's builtin_interfaces.msg."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from tfbus.compat.missing import missing_messages

__all__ = ["Duration", "Time"]

if not TYPE_CHECKING:  # type checkers find what is missing themselves
    __getattr__ = missing_messages(__name__)


@dataclass(slots=True, kw_only=True)
class Time:
    """A time since the Unix epoch: whole seconds, and nanoseconds from 0 to 999,999,999."""

    sec: int = 0
    nanosec: int = 0


@dataclass(slots=True, kw_only=True)
class Duration:
    """A span of time: whole seconds, and nanoseconds from 0 to 999,999,999 to be added."""

    sec: int = 0
    nanosec: int = 0
