"""Publishers of transforms in ROS."""

import threading
from collections.abc import Callable, Sequence

from tfbus.bridge.legs import Leg
from tfbus.runtime import scheduler
from tfbus.wording import printable

# One that is missing from this many looks, one after the other, is gone.
_GONE_AFTER = 2

# What a publisher that is gone has sent may still come by another bridge.
_REMEMBERED_S = 10.0

# A message may be faster than the word of its publisher: then it is looked for this often.
_LOOK_AGAIN_S = 0.05


class RosPublishers:
    """The publishers of some topics by their gids, as the last look showed them; safe from any
    thread.
    """

    def __init__(
        self,
        leg: Leg,
        topics: Sequence[str],
        clock_s: Callable[[], float] = lambda: scheduler.monotonic(),
    ) -> None:
        self._leg = leg
        self._topics = topics
        self._clock_s = clock_s
        self._lock = threading.Lock()
        self._nodes: dict[str, str] = {}
        self._missed: dict[str, int] = {}
        self._left_s: dict[str, float] = {}
        self._next_look_s = 0.0

    @property
    def nodes(self) -> dict[str, str]:
        """The node of each publisher by its gid, "" if it is not known; without those that are
        gone.
        """
        return self._nodes

    def look(self) -> set[str]:
        """Look who is there; the gids of those that are gone since."""
        listed = self._listed()
        with self._lock:
            self._take(listed)
            gone = set()
            for gid in self._nodes.keys() - listed.keys():
                self._missed[gid] = self._missed.get(gid, 0) + 1
                if self._missed[gid] >= _GONE_AFTER:
                    gone.add(gid)
            self._forget(gone)
        return gone

    def look_for(self, gid: str) -> str | None:
        """The node of a publisher that is new, None if it is not known yet."""
        if gid not in self._nodes and self._clock_s() >= self._next_look_s:
            self._next_look_s = self._clock_s() + _LOOK_AGAIN_S
            listed = self._listed()
            with self._lock:
                self._take(listed)
        return self._nodes.get(gid)

    def replaced_by(self, gid: str, others: set[str]) -> set[str]:
        """Those of `others`, publishers of the same node, that are no longer there: the node was
        started again.
        """
        if not others:
            return set()
        listed = self._listed()
        with self._lock:
            gone = others - listed.keys()
            self._forget(gone)
        return gone

    def has(self, gid: str) -> bool:
        """Whether a publisher is there, or was a few seconds ago."""
        return gid in self._nodes or self._left_s.get(gid, 0.0) > self._clock_s()

    def _listed(self) -> dict[str, str]:
        return {
            each.gid: printable(each.node, 255)
            for topic in self._topics
            for each in self._leg.publishers(topic)
        }

    def _take(self, listed: dict[str, str]) -> None:
        # A new map each time: others read it without the lock.
        self._nodes = {**self._nodes, **listed}
        for gid in listed:
            self._missed.pop(gid, None)

    def _forget(self, gids: set[str]) -> None:
        if gids:
            now_s = self._clock_s()
            self._nodes = {gid: node for gid, node in self._nodes.items() if gid not in gids}
            self._left_s = {gid: left for gid, left in self._left_s.items() if left > now_s}
            for gid in gids:
                self._missed.pop(gid, None)
                self._left_s[gid] = now_s + _REMEMBERED_S
