"""Types that every ROS 2 has, by name."""

from functools import cache

from tfbus.ros.counterparts import LIVE_COUNTERPARTS
from tfbus.ros.definitions import CLOCK, TF_MESSAGE, Definition

_OWN = {each.definition.name: each.definition for each in LIVE_COUNTERPARTS.values()}
_OWN |= {each.name: each for each in (CLOCK, TF_MESSAGE)}


@cache
def standard_definition(ros_type: str) -> Definition | None:
    """The definition of `sensor_msgs/msg/Imu`; None for a type that ROS 2 does not come with, and
    without rosbags (the extra `bags`) for most others.
    """
    if ros_type in _OWN:
        return _OWN[ros_type]
    try:
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        return None
    store = get_typestore(Stores.ROS2_KILTED)
    if ros_type not in store.types:
        return None
    return Definition(ros_type, store.generate_msgdef(ros_type, ros_version=2)[0])
