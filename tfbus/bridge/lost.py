"""Messages of ROS that never came here, as far as the middleware lets one know."""

import threading
from collections import Counter

# Publishers come from ROS: of at most as many the last number is known.
_MOST_PUBLISHERS = 10_000


class LostMessages:
    """Counts by the numbers of messages, and by rooms that were full. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._counts: Counter[str] = Counter()
        self._last: dict[tuple[str, str], int] = {}

    @property
    def counts(self) -> dict[str, int]:
        """How many messages of each topic were lost, at least."""
        with self._lock:
            return dict(self._counts)

    def came(self, topic: str, gid: str, number: int) -> None:
        """A message has come that its publisher, with this gid, gave this number."""
        key = topic, gid
        last = self._last.get(key)
        if last is not None and number <= last:
            return  # one that was kept, for those who come late
        if last is None and len(self._last) >= _MOST_PUBLISHERS:
            self._last.clear()
        self._last[key] = number
        if last is not None and number > last + 1:
            self._lose(topic, number - last - 1)

    def was_full(self, topic: str) -> None:
        """As many messages waited as may wait: what came before them is lost, one at least."""
        self._lose(topic, 1)

    def _lose(self, topic: str, count: int) -> None:
        with self._lock:
            self._counts[topic] += count
