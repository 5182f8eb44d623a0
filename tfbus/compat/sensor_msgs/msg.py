"""ROS's sensor_msgs.msg."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from tfbus.compat.missing import missing_messages
from tfbus.compat.std_msgs.msg import Header

__all__ = ["JointState"]

if not TYPE_CHECKING:  # type checkers find what is missing themselves
    __getattr__ = missing_messages(__name__)


@dataclass(slots=True, kw_only=True)
class JointState:
    """Where the joints of a robot are; on the bus it is `tfbus.messages.JointState`."""

    header: Header = field(default_factory=Header)
    name: list[str] = field(default_factory=list)
    position: list[float] = field(default_factory=list)
    velocity: list[float] = field(default_factory=list)
    effort: list[float] = field(default_factory=list)
