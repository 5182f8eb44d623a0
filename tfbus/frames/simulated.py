"""Which publishers use simulated time, as far as their nodes say."""

from collections.abc import Iterable
from dataclasses import dataclass

from tfbus.wire.descriptions import NodeDescription
from tfbus.wording import counted

# The type of the clock's topic, whatever its name.
_CLOCK = "Clock"


@dataclass(frozen=True)
class SimulatedTime:
    """The nodes that publish a simulated time, and the publishers of transforms that follow it.

    All by their full names. `publishers` counts all nodes that publish transforms.
    """

    clocks: tuple[str, ...] = ()
    followers: frozenset[str] = frozenset()
    publishers: int = 0

    @property
    def published(self) -> str:
        """`/clock publishes a simulated time`."""
        verb = "publishes" if len(self.clocks) == 1 else "publish"
        return f"{' and '.join(self.clocks)} {verb} a simulated time"

    @property
    def followed(self) -> str:
        """`the stamps of 1 of 2 publishers follow it`."""
        publishers = counted(self.publishers, "publisher")
        return f"the stamps of {len(self.followers)} of {publishers} follow it"


# Where nothing is known of it.
NOT_SIMULATED = SimulatedTime()


def simulated_time(nodes: Iterable[NodeDescription]) -> SimulatedTime:
    """The publishers and followers of a simulated time among these nodes."""
    nodes = tuple(nodes)
    clocks = tuple(node.name for node in nodes if _CLOCK in node.publishes.values())
    publishers = [node for node in nodes if node.streams]
    followers = [node.name for node in publishers if _CLOCK in node.subscribes.values()]
    return SimulatedTime(clocks, frozenset(followers if clocks else ()), len(publishers))
