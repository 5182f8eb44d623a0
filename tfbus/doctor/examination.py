"""All that the checks look at, as one value: gathered first, judged afterwards."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from tfbus.bus.interfaces import Interface
from tfbus.bus.settings import NodeSettings
from tfbus.frames.snapshot import FrameTree
from tfbus.wire.descriptions import NodeDescription


@dataclass(frozen=True)
class Host:
    """This host: what is installed, its interfaces, and what a trial of scouting found.

    `versions` are of Python and of packages, "" where one is not installed. `scouted` is whether
    a session of our own was found by scouting, None where scouting is off. `unreachable` are
    endpoints to connect to that do not answer, with the reason; `routers` counts the routers that
    we are connected to.
    """

    versions: Mapping[str, str]
    is_compiled: bool
    interfaces: tuple[Interface, ...]
    scouted: bool | None
    routers: int
    unreachable: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Flow:
    """How the samples of one frame came while the doctor listened.

    `rate_hz` is by their arrivals, `longest_gap_s` by their stamps; `delay_s` is the least age at
    arrival, below zero for stamps in the future; `at_zero` counts stamps of 0.
    """

    stream: str
    frame: str
    rate_hz: float | None = None
    jitter_s: float | None = None
    longest_gap_s: float = 0.0
    delay_s: float | None = None
    at_zero: int = 0
    out_of_order: int = 0


@dataclass(frozen=True)
class Examination:
    """What was seen of the bus from this host, listening for `listened_s` seconds.

    `rejected` are the reasons for which transforms were refused, with their counts; `largest` the
    size of the largest message of each stream, in bytes.
    """

    settings: NodeSettings
    host: Host
    nodes: tuple[NodeDescription, ...]
    tree: FrameTree
    flows: tuple[Flow, ...]
    listened_s: float
    rejected: Mapping[str, int] = field(default_factory=dict)
    largest: Mapping[str, int] = field(default_factory=dict)
