"""All that the checks look at, as one value: gathered first, judged afterwards."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from tfbus.bus.interfaces import Interface
from tfbus.bus.settings import NodeSettings
from tfbus.doctor.ros_around import RosAround
from tfbus.frames.snapshot import FrameTree
from tfbus.monitor.flow import EdgeFlow
from tfbus.wire.descriptions import NodeDescription


@dataclass(frozen=True)
class Host:
    """This host: what is installed, its interfaces, and the result of a trial of scouting.

    `versions` are of Python and of packages, "" if one is not installed. `scouted` is whether
    scouting found a session of our own, None if scouting is off. `unreachable` are endpoints to
    connect to that do not answer, with the reason. `routers` counts the connected routers.
    `listens_beyond` are the endpoints that other hosts can reach. `why_interpreted` is why the
    compiler failed, if it did. `scouts` are other processes of this host that take part in
    scouting, by their pids. `name` is what its nodes say is their host.
    """

    versions: Mapping[str, str]
    is_compiled: bool
    interfaces: tuple[Interface, ...]
    scouted: bool | None
    routers: int
    unreachable: Mapping[str, str] = field(default_factory=dict)
    listens_beyond: tuple[str, ...] = ()
    why_interpreted: str = ""
    scouts: Mapping[int, str] = field(default_factory=dict)
    name: str = ""


@dataclass(frozen=True)
class Examination:
    """The bus as seen from this host in `listened_s` seconds.

    `rejected` counts rejected transforms by their reason. `largest` is the size of each stream's
    largest message, in bytes. `out_of_reach` says of a bus here that this process gets no link to,
    where it sees no node; "" for none.
    """

    settings: NodeSettings
    host: Host
    nodes: tuple[NodeDescription, ...]
    tree: FrameTree
    flows: tuple[EdgeFlow, ...]
    listened_s: float
    rejected: Mapping[str, int] = field(default_factory=dict)
    largest: Mapping[str, int] = field(default_factory=dict)
    ros: RosAround = field(default_factory=RosAround)
    out_of_reach: str = ""
