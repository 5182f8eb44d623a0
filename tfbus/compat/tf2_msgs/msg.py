"""ROS's tf2_msgs.msg."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from tfbus.compat.geometry_msgs.msg import TransformStamped
from tfbus.compat.missing import missing_names

__all__ = ["TFMessage"]

if not TYPE_CHECKING:  # type checkers find what is missing themselves
    __getattr__ = missing_names(
        __name__,
        {"TF2Error": "a lookup raises tf2_ros.TransformException, or one of its subclasses"},
        "write it as a dataclass with ROS's fields, which goes over the bus as it is",
    )


@dataclass(slots=True, kw_only=True)
class TFMessage:
    """Several transforms. On the topics /tf and /tf_static it is what broadcasters send and
    listeners receive.
    """

    transforms: list[TransformStamped] = field(default_factory=list)
