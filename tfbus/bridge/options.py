"""Options of a bridge: which transforms cross, the clock, and names of frames on either side."""

from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Literal

from tfbus.names import mistake_in

ClockWay = Literal["auto", "to-ros", "from-ros", "off"]


@dataclass(frozen=True)
class BridgeOptions:
    """Which transforms cross, and the clock.

    `frames` are patterns of child frames as the bus names them, such as `robot1/*`: given, only
    these cross. `frame_prefix` is put before the names of frames that come from ROS, and taken off
    names that go there. `rate_limit_hz` is how often a frame goes at most, in each direction.
    `ros_namespace` is that of ROS's topics: "robot1" for /robot1/tf. With `clock` "auto" the side
    that has a clock gives it to the other.
    """

    to_ros: bool = True
    from_ros: bool = True
    frames: tuple[str, ...] = ()
    frame_prefix: str = ""
    rate_limit_hz: float | None = None
    ros_namespace: str = ""
    clock: ClockWay = "auto"

    def selects(self, child: str) -> bool:
        """Whether the frame that the bus knows by this name crosses."""
        return not self.frames or any(fnmatchcase(child, each) for each in self.frames)

    def topic(self, name: str) -> str:
        """The full name of a topic in ROS: "/robot1/tf"."""
        namespace = self.ros_namespace.strip("/")
        return f"/{namespace}/{name}" if namespace else f"/{name}"

    @property
    def directions(self) -> str:
        """Which way it goes, in words."""
        if self.to_ros and self.from_ros:
            return "both directions"
        return "only to ROS" if self.to_ros else "only from ROS"


# Names come from ROS: at most this many are remembered.
_MOST_NAMES = 100_000


class RosFrameNames:
    """Turns the names of one side into the names of the other; safe from any thread.

    A frame of the bus without the prefix keeps its name in ROS, unless ROS has a frame of that name
    itself: that is another one.
    """

    def __init__(self, options: BridgeOptions) -> None:
        self._prefix = options.frame_prefix
        # As ROS has them; with a prefix only, since otherwise one name is one frame.
        self._of_ros: set[str] = set()

    def on_bus(self, name: str) -> str:
        """The name on the bus of a frame of ROS; ROS 1 begins names with a slash."""
        return self._prefix + name.lstrip("/")

    def mistake_in(self, name: str) -> str:
        """Why a frame of ROS cannot be on the bus, as the end of a sentence; "" if it can."""
        return mistake_in(self.on_bus(name)) if name.strip("/") else "must not be empty"

    def met(self, name: str) -> bool:
        """Note a frame that ROS has; whether it is new and may change what goes there."""
        name = name.lstrip("/")
        if not self._prefix or name in self._of_ros or len(self._of_ros) >= _MOST_NAMES:
            return False
        self._of_ros.add(name)
        return True

    def in_ros(self, name: str) -> str | None:
        """The name in ROS of a frame of the bus; None if that is another frame there."""
        if not self._prefix:
            return name
        if name.startswith(self._prefix) and name != self._prefix:
            return name[len(self._prefix) :]
        return None if name in self._of_ros else name
