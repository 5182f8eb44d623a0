"""The ROS around this host, as the doctor has found it."""

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Participant:
    """A participant of DDS, about one a process: its id, the name of its DDS, and whether it is of
    ROS 2.
    """

    id: bytes
    vendor: str
    is_ros: bool


@dataclass(frozen=True)
class RosAround:
    """The ROS that is seen from this host.

    `nodes` are the full names of the nodes that rmw_zenoh has, by domain; `at` is the endpoint
    through which they are seen, "" if it is rmw_zenoh's usual one. `bridges` is the number of
    zenoh-bridge-ros2dds. `participants` are those of DDS in `domain`, of which `listened_s` seconds
    were heard; `is_dds_here` is whether one is on this host. `domain` is -1 if ROS_DOMAIN_ID is
    none. `distro` is the ROS that is sourced. `master_nodes` is the number of nodes of ROS 1 at
    `master`, None if that does not answer.
    """

    nodes: Mapping[int, frozenset[str]] = field(default_factory=dict)
    at: str = ""
    bridges: int = 0
    domain: int = 0
    participants: tuple[Participant, ...] = ()
    is_dds_here: bool = False
    listened_s: float = 0.0
    distro: str = ""
    is_ros1: bool = False
    master: str = ""
    master_nodes: int | None = None
