"""Tables of a bounded size: names that others choose cannot fill the memory."""

from collections import OrderedDict
from collections.abc import Callable
from typing import TypeVar

K = TypeVar("K")
V = TypeVar("V")


class Bounded(OrderedDict[K, V]):
    """A dict of at most `most` items: another one lets the oldest go.

    An item is as old as its last assignment. `evicted` counts the items that had to go, and
    `on_evict(key, value)` is called after each. Not thread-safe, as a dict that is changed by
    several operations is not.
    """

    def __init__(self, most: int, on_evict: Callable[[K, V], object] | None = None) -> None:
        super().__init__()
        self.most = most
        self.evicted = 0
        self._on_evict = on_evict

    def __setitem__(self, key: K, value: V) -> None:
        super().__setitem__(key, value)
        self.move_to_end(key)
        while len(self) > self.most:
            oldest = self.popitem(last=False)
            self.evicted += 1
            if self._on_evict is not None:
                self._on_evict(*oldest)
