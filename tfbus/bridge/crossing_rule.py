"""Which frames of ROS cross to the bus: none that came from there, by this bridge or another."""

from collections.abc import Callable

from tfbus.bridge.bridges import Bridges
from tfbus.bridge.common import Common
from tfbus.bridge.ros_sources import RosSource
from tfbus.geometry.transform import TransformStamped
from tfbus.ros.ros_names import is_bridge
from tfbus.runtime import scheduler

# A frame that another bridge sends may be one of this bus that is not known here yet.
_GRACE_S = 2.0

# A bridge that was here first sends what it has sent within this time.
_STILL_SENT_S = 3.0

# Names come from ROS: with more than this, what is known of them is asked again.
_MOST_NAMES = 100_000


class CrossingRule:
    """Says it for each frame by its name on the bus.

    `sent_there(child)` is whether this bridge sends a frame of the bus to ROS, and
    `static_there(child)` the static transform of it that it sends there.
    """

    def __init__(
        self,
        common: Common,
        bridges: Bridges,
        *,
        tells_publishers: bool,
        sent_there: Callable[[str], bool],
        static_there: Callable[[str], TransformStamped | None],
        clock_s: Callable[[], float] = lambda: scheduler.monotonic(),
    ) -> None:
        self._options = common.options
        self._publishers = common.publishers
        self._bus = common.bus
        self._bridges = bridges
        self._tells_publishers = tells_publishers
        self._sent_there = sent_there
        self._static_there = static_there
        self._clock_s = clock_s
        # Frames that other bridges have sent: since when.
        self._met_s: dict[str, float] = {}
        # Frames that a bridge of this bus, which was there first, sends to ROS: when last.
        self._of_seniors_s: dict[str, float] = {}

    def is_of_bridge(self, source: RosSource) -> bool:
        """Whether another bridge sends it, or may."""
        if source.node:
            return is_bridge(source.node)
        return any(map(is_bridge, self._publishers.nodes.values()))

    def crosses(self, source: RosSource, child: str) -> bool:
        """Whether a frame of a source crosses."""
        bridge = self._bridges.of_gid(source.gid) if source.gid else None
        if bridge is not None:
            # It comes from this bus.
            if self._bridges.is_senior(bridge):
                if len(self._of_seniors_s) >= _MOST_NAMES:
                    self._of_seniors_s.clear()
                self._of_seniors_s[child] = self._clock_s()
            return False
        if not self._options.from_ros or not self._options.takes(child):
            return False
        if not self._tells_publishers and self._sent_there(child):
            return False
        if not self.is_of_bridge(source):
            return True
        gids = source.stream.gids | ({*self._publishers.nodes} if not source.gid else set())
        if self._bus.has_from_elsewhere(child, gids):
            return False
        if len(self._met_s) >= _MOST_NAMES:
            self._met_s.clear()
        now_s = self._clock_s()
        return now_s >= self._met_s.setdefault(child, now_s) + _GRACE_S

    def static_crosses(self, source: RosSource, child: str, transform: TransformStamped) -> bool:
        """Whether a static transform crosses: not one that the bridge itself sends to ROS."""
        if not self.crosses(source, child):
            return False
        there = self._static_there(child)
        return (
            there is None
            or there.frame_id != transform.frame_id
            or there.transform != transform.transform
        )

    def sent_by_senior(self, child: str) -> bool:
        """Whether another bridge of this bus, which was there first, sends a frame to ROS."""
        last_s = self._of_seniors_s.get(child)
        return last_s is not None and self._clock_s() < last_s + _STILL_SENT_S
