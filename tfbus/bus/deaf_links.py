"""Links that were opened and are never read.

If the time to open a link ends just as the last answer comes, as in a process that gets no CPU or
stands still, Zenoh gives the link up after it has begun to send, and before it begins to read. It
sends keep-alives from then on, so that the other end takes it for linked, and would notice no
silence, since that is noticed by reading.
"""

from collections.abc import Mapping, Set

from tfbus.base import scheduler
from tfbus.base.structs import Struct
from tfbus.bus.zenoh_sockets import Ends, Received

# A link is deaf if for this many leases bytes waited, and none was read. A link that is read has a
# keep-alive to read in each quarter of a lease.
_LEASES = 3


class _Young(Struct):
    """A link that has not been read yet, as far as is known: how much was read at the first look,
    and since when bytes wait.
    """

    read: int
    waiting_s: float | None


class DeafLinks:
    """Looks at new links, once in a lease, until they are read. For one thread."""

    def __init__(self, lease_s: float) -> None:
        self._lease_s = lease_s
        self._young: dict[Ends, _Young | None] = {}
        self._looked_s = 0.0

    def watch(self, links: Set[Ends]) -> None:
        """Look at these links, too."""
        if links and not self._young:
            self._looked_s = scheduler.monotonic()
        self._young |= dict.fromkeys(links)

    @property
    def links(self) -> Set[Ends]:
        """The links that it looks at."""
        return self._young.keys()

    @property
    def next_s(self) -> float | None:
        """When the next look is due; None without a link to look at."""
        return self._looked_s + self._lease_s if self._young else None

    def look(self, received: Mapping[Ends, Received]) -> set[Ends]:
        """The links that are deaf, by what the open ones have received. It looks at them no more,
        nor at those that are read.
        """
        now_s = scheduler.monotonic()
        # A process that stood still has read nothing meanwhile.
        was_late = now_s - self._looked_s > 2 * self._lease_s
        self._looked_s = now_s
        former, self._young = self._young, {}
        deaf = set()
        for link, was in former.items():
            has = received.get(link)
            if has is None or (was is not None and has.read > was.read):
                continue
            waiting_s = None if was is None or was_late else was.waiting_s
            if has.waiting and waiting_s is None:
                waiting_s = now_s
            if waiting_s is not None and now_s - waiting_s >= _LEASES * self._lease_s:
                deaf.add(link)
            else:
                self._young[link] = _Young(has.read, waiting_s)
        return deaf
