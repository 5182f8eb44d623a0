"""ROS's std_msgs.msg, of which transforms need the header."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from tfbus.compat.builtin_interfaces.msg import Time
from tfbus.compat.missing import missing_messages

__all__ = ["Header", "String"]

if not TYPE_CHECKING:  # type checkers find what is missing themselves
    __getattr__ = missing_messages(__name__)


@dataclass(slots=True, kw_only=True)
class Header:
    """When something was measured, and the frame that its numbers are in."""

    stamp: Time = field(default_factory=Time)
    frame_id: str = ""


@dataclass(slots=True, kw_only=True)
class String:
    """A text."""

    data: str = ""
