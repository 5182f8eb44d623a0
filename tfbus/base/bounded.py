"""Tables of a bounded size: names that others choose cannot fill the memory."""

from collections import OrderedDict
from collections.abc import Callable
from typing import Generic, TypeVar

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


class MadeOf(Generic[V]):
    """Results by the identity of the immutable objects that they were made of, whose comparison or
    hash may take longer than the result. Safe from any thread.

    It keeps the objects, so that no other has the identity of one; beyond `most` all are let go.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._made: dict[tuple[int, object], tuple[object, V]] = {}

    def get(self, given: object, how: object = None) -> V | None:
        """The result for an object, made in a way that has a hash; None if it is not known."""
        entry = self._made.get((id(given), how))
        return None if entry is None else entry[1]

    def keep(self, made: V, given: object, how: object = None) -> V:
        """Remember the result for an object, and return it."""
        if len(self._made) >= self._most:
            self._made.clear()
        self._made[id(given), how] = given, made
        return made
