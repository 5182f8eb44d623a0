"""ROS's rclpy.qos. Of a profile tfbus applies the depth of a subscription and transient local."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import Any

__all__ = [
    "DurabilityPolicy",
    "HistoryPolicy",
    "LivelinessPolicy",
    "QoSDurabilityPolicy",
    "QoSHistoryPolicy",
    "QoSLivelinessPolicy",
    "QoSPresetProfiles",
    "QoSProfile",
    "QoSReliabilityPolicy",
    "ReliabilityPolicy",
    "qos_profile_action_status_default",
    "qos_profile_parameter_events",
    "qos_profile_parameters",
    "qos_profile_sensor_data",
    "qos_profile_services_default",
    "qos_profile_system_default",
    "qos_profile_unknown",
]


class HistoryPolicy(IntEnum):
    """Which messages are kept."""

    SYSTEM_DEFAULT = 0
    KEEP_LAST = 1
    KEEP_ALL = 2
    UNKNOWN = 3


class ReliabilityPolicy(IntEnum):
    """Whether lost messages are sent again; on the bus they always are."""

    SYSTEM_DEFAULT = 0
    RELIABLE = 1
    BEST_EFFORT = 2
    UNKNOWN = 3
    BEST_AVAILABLE = 4


class DurabilityPolicy(IntEnum):
    """Whether the last message is kept for late subscribers: TRANSIENT_LOCAL is `retained`."""

    SYSTEM_DEFAULT = 0
    TRANSIENT_LOCAL = 1
    VOLATILE = 2
    UNKNOWN = 3
    BEST_AVAILABLE = 4


class LivelinessPolicy(IntEnum):
    """The side that says that a publisher lives; on the bus its session does."""

    SYSTEM_DEFAULT = 0
    AUTOMATIC = 1
    MANUAL_BY_TOPIC = 3
    UNKNOWN = 4
    BEST_AVAILABLE = 5


QoSHistoryPolicy = HistoryPolicy
QoSReliabilityPolicy = ReliabilityPolicy
QoSDurabilityPolicy = DurabilityPolicy
QoSLivelinessPolicy = LivelinessPolicy


@dataclass(kw_only=True)
class QoSProfile:
    """How messages of a topic are sent. A setting that tfbus does not apply is logged if it is
    used.
    """

    depth: int = 10
    history: HistoryPolicy = HistoryPolicy.KEEP_LAST
    reliability: ReliabilityPolicy = ReliabilityPolicy.RELIABLE
    durability: DurabilityPolicy = DurabilityPolicy.VOLATILE
    lifespan: Any = None
    deadline: Any = None
    liveliness: Any = None
    liveliness_lease_duration: Any = None
    avoid_ros_namespace_conventions: bool = False


qos_profile_unknown = qos_profile_system_default = QoSProfile(depth=10)
qos_profile_sensor_data = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
qos_profile_services_default = QoSProfile(depth=10)
qos_profile_parameters = qos_profile_parameter_events = QoSProfile(depth=1000)
qos_profile_action_status_default = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class QoSPresetProfiles(Enum):
    """The profiles that have names."""

    UNKNOWN = qos_profile_unknown
    DEFAULT = QoSProfile(depth=10)
    SYSTEM_DEFAULT = qos_profile_system_default
    SENSOR_DATA = qos_profile_sensor_data
    SERVICES_DEFAULT = qos_profile_services_default
    PARAMETERS = qos_profile_parameters
    PARAMETER_EVENTS = qos_profile_parameter_events
    ACTION_STATUS_DEFAULT = qos_profile_action_status_default

    @classmethod
    def short_keys(cls) -> list[str]:
        """Their names in small letters."""
        return [name.lower() for name in cls.__members__]

    @classmethod
    def get_from_short_key(cls, name: str) -> QoSProfile:
        """The profile of this name. Raises KeyError if there is none."""
        profile: QoSProfile = cls[name.upper()].value
        return profile


_NOT_APPLIED = ("lifespan", "deadline", "liveliness", "liveliness_lease_duration")


def applied(qos: Any, topic: str, say: Callable[[str], object]) -> tuple[int, bool]:
    """The depth, and whether the last message is kept; says which policies are not applied.

    Raises TypeError unless it is a profile or a depth.
    """
    if isinstance(qos, int) and not isinstance(qos, bool):
        return _depth(qos), False
    if not hasattr(qos, "depth") or not hasattr(qos, "durability"):
        raise TypeError(f"the QoS of {topic!r} must be a QoSProfile or a depth, not {qos!r}")
    ignored = [name for name in _NOT_APPLIED if getattr(qos, name, None) is not None]
    if int(qos.reliability) == ReliabilityPolicy.BEST_EFFORT:
        ignored.insert(0, "reliability BEST_EFFORT")
    if ignored:
        say(
            f"The QoS of topic {topic!r} is not applied in {' and '.join(ignored)}: the bus sends "
            "all messages reliably"
        )
    return _depth(int(qos.depth)), int(qos.durability) == DurabilityPolicy.TRANSIENT_LOCAL


def _depth(depth: int) -> int:
    if depth < 0:
        raise ValueError(f"the depth of a queue must be 0 or more, not {depth}")
    return depth or 10
