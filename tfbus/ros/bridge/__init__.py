"""The bridge between the bus and ROS: its two directions, and the legs by which it reaches ROS.

Listed here are the names that the nodes `tfbus ros2` and `tfbus ros1` use.
"""

from tfbus.base.lazy_exports import exported

# As in tfbus/__init__.py: names are imported when first used.
TYPE_CHECKING = False

if TYPE_CHECKING:
    from tfbus.ros.bridge.bridge import Bridge as Bridge
    from tfbus.ros.bridge.common import BridgeOptions as BridgeOptions
    from tfbus.ros.bridge.from_ros import with_odometry_frames as with_odometry_frames
    from tfbus.ros.bridge.legs import LegSettings as LegSettings
    from tfbus.ros.bridge.legs import open_leg as open_leg
    from tfbus.ros.bridge.topics import TopicTable as TopicTable
    from tfbus.ros.rmw import BRIDGE_PREFIX as BRIDGE_PREFIX
    from tfbus.ros.rmw import HIGHEST_DOMAIN as HIGHEST_DOMAIN
    from tfbus.ros.rmw import domain_of as domain_of

_MODULE_OF = {
    "BRIDGE_PREFIX": "tfbus.ros.rmw",
    "HIGHEST_DOMAIN": "tfbus.ros.rmw",
    "domain_of": "tfbus.ros.rmw",
    "Bridge": "tfbus.ros.bridge.bridge",
    "BridgeOptions": "tfbus.ros.bridge.common",
    "LegSettings": "tfbus.ros.bridge.legs",
    "TopicTable": "tfbus.ros.bridge.topics",
    "with_odometry_frames": "tfbus.ros.bridge.from_ros",
    "open_leg": "tfbus.ros.bridge.legs",
}

__all__ = sorted(_MODULE_OF)
__getattr__, __dir__ = exported(__name__, _MODULE_OF)
