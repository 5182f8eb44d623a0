"""Arrays of the messages that other libraries decode into objects."""

from collections.abc import Iterable
from typing import Any

import numpy as np


def arrays(messages: Iterable[Any]) -> int:
    """Stamps and poses of all transforms as arrays; how many there are."""
    stamps, poses = [], []
    for message in messages:
        for one in message.transforms:
            stamp, transform = one.header.stamp, one.transform
            xyz, quat = transform.translation, transform.rotation
            stamps.append(stamp.sec * 1_000_000_000 + stamp.nanosec)
            poses.append((xyz.x, xyz.y, xyz.z, quat.x, quat.y, quat.z, quat.w))
    return len(np.array(stamps)) and len(np.array(poses))
