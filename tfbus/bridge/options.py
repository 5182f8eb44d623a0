"""The transforms that cross between the bus and ROS, and the clock, by options."""

from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Literal

ClockWay = Literal["auto", "to-ros", "from-ros", "off"]


@dataclass(frozen=True)
class BridgeOptions:
    """Which transforms cross, and the clock.

    `frames` are patterns of child frames as the bus names them, such as `robot1/*`: given, only
    those cross. `frame_prefix` is put before the names of frames that come from ROS, and taken off
    those that go there. `rate_limit_hz` is how often a frame goes at most, in each direction.
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

    def takes(self, child: str) -> bool:
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
