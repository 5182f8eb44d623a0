"""The messages of transforms, as `tfbus topic echo` prints them."""

from dataclasses import dataclass
from typing import Any

from tfbus.discover.graph import TRANSFORMS_TYPE

# The name here, and that of ROS.
TRANSFORMS_TYPES = (TRANSFORMS_TYPE, "TFMessage")


@dataclass(frozen=True)
class TransformMessage:
    """The transforms of a stream, as tfbus topic echo prints them; a TransformBroadcaster sends
    them. Each has stamp_ns, frame_id, child_frame_id, and a transform of a translation (x, y, z)
    and a rotation (x, y, z, w). epoch is the start of the stream, and seq counts its messages.
    """

    epoch: int
    seq: int
    transforms: list[dict[str, Any]]
