"""The bridge between the bus and ROS: what crosses it, and the legs by which it reaches ROS.

Listed here is what the nodes `tfbus ros2` and `tfbus ros1` use.
"""

from tfbus.runtime.lazy_exports import exported

# As in tfbus/__init__.py: names are imported when first used.
TYPE_CHECKING = False

if TYPE_CHECKING:
    from tfbus.bridge.bridge import Bridge as Bridge
    from tfbus.bridge.leg import LegSettings as LegSettings
    from tfbus.bridge.legs import open_leg as open_leg
    from tfbus.bridge.odometry_frames import with_odometry_frames as with_odometry_frames
    from tfbus.bridge.options import BridgeOptions as BridgeOptions
    from tfbus.bridge.topics import TopicTable as TopicTable

_MODULE_OF = {
    "Bridge": "tfbus.bridge.bridge",
    "BridgeOptions": "tfbus.bridge.options",
    "LegSettings": "tfbus.bridge.leg",
    "TopicTable": "tfbus.bridge.topics",
    "with_odometry_frames": "tfbus.bridge.odometry_frames",
    "open_leg": "tfbus.bridge.legs",
}

__all__ = sorted(_MODULE_OF)
__getattr__ = exported(__name__, _MODULE_OF)


def __dir__() -> list[str]:
    return __all__
