"""Names of frames on the bus and in ROS."""

from tfbus.bridge.options import BridgeOptions
from tfbus.names import mistake_in

# Names come from ROS: at most this many are remembered.
_MOST_NAMES = 100_000


class FrameNames:
    """Turns the names of one side into those of the other; safe from any thread.

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
