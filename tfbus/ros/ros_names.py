"""Numbers of domains of ROS 2, and how bridges are called in ROS."""

import os
import re
from collections.abc import Mapping

from tfbus.errors import SettingsError
from tfbus.ros.message_type import PACKAGE
from tfbus.wording import printable

# The most that the ports of DDS leave room for.
HIGHEST_DOMAIN = 232

# The node of a bridge has a name in ROS that begins so.
BRIDGE_PREFIX = "tfbus_"

_MESSAGE_TYPE = re.compile(r"[A-Za-z]\w{0,99}/msg/[A-Za-z]\w{0,99}", re.ASCII)


def is_domain(text: str) -> bool:
    """Whether this is the number of a domain of ROS 2."""
    return text.isascii() and text.isdecimal() and len(text) <= 3 and int(text) <= HIGHEST_DOMAIN


def domain_of(given: int | None = None, environ: Mapping[str, str] = os.environ) -> int:
    """The number of the domain: the one that is given, else ROS_DOMAIN_ID, else 0. Raises
    SettingsError if it is none.
    """
    text = environ.get("ROS_DOMAIN_ID", "").strip() or "0" if given is None else str(given)
    if not is_domain(text):
        whose = "ROS_DOMAIN_ID" if given is None else "the domain of ROS"
        raise SettingsError(
            f"{whose} is '{printable(text, 40)}': it must be a number from 0 to {HIGHEST_DOMAIN}"
        )
    return int(text)


def is_message_type(name: str) -> bool:
    """Whether this is the full name of a message of ROS, `sensor_msgs/msg/Imu`; ours have none."""
    return _MESSAGE_TYPE.fullmatch(name) is not None and not name.startswith(PACKAGE)


def is_bridge(node: str) -> bool:
    """Whether a node of ROS is that of a bridge, by its name or full name."""
    return node.rpartition("/")[2].startswith(BRIDGE_PREFIX)
