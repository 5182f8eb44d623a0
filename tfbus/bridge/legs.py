"""The legs by name."""

import logging
from importlib import import_module

from tfbus.bridge.leg import Leg, LegSettings

# The module of each leg has a function `open_leg(settings, log)`.
_MODULES = {
    "zenoh": "tfbus.bridge.zenoh_leg",
    "dds": "tfbus.bridge.dds_leg",
    "rclpy": "tfbus.bridge.rclpy_leg",
    "rospy": "tfbus.bridge.rospy_leg",
}


def open_leg(via: str, settings: LegSettings, log: logging.Logger) -> Leg:
    """Join ROS by "zenoh", "dds", "rclpy" or "rospy".

    Raises TfbusError if the middleware is not installed, with what installs it, or if it
    cannot be joined.
    """
    leg: Leg = import_module(_MODULES[via]).open_leg(settings, log)
    return leg
