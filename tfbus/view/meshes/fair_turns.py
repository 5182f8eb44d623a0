"""Whose turn it is: those who wait share the time by who has used least of it."""

from collections import deque
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

T = TypeVar("T")

_MOST_REMEMBERED = 1_000


class FairTurns(Generic[T]):
    """Items that wait, each of a sender: the next is of the sender that has used the least time.

    A sender that comes anew, or again, begins where the last turn was: neither is past idleness a
    credit, nor does another name make one younger. Not safe from several threads at once.
    """

    def __init__(self) -> None:
        self._waiting: dict[Hashable, deque[T]] = {}
        self._used_s: dict[Hashable, float] = {}
        self._turn_s = 0.0

    def add(self, sender: Hashable, item: T) -> None:
        """Add an item at the end of its sender's."""
        if sender not in self._waiting:
            self._waiting[sender] = deque()
            self._used_s[sender] = max(self._used_s.get(sender, 0.0), self._turn_s)
        self._waiting[sender].append(item)

    def next(self) -> tuple[Hashable, T] | None:
        """Take the next item, with its sender; None if none waits."""
        if not self._waiting:
            return None
        sender = min(self._waiting, key=self._used_s.__getitem__)
        self._turn_s = self._used_s[sender]
        items = self._waiting[sender]
        item = items.popleft()
        if not items:
            del self._waiting[sender]
        return sender, item

    def use(self, sender: Hashable, seconds: float) -> None:
        """A sender has used this time."""
        self._used_s[sender] = max(self._used_s.get(sender, 0.0), self._turn_s) + seconds
        if len(self._used_s) > _MOST_REMEMBERED:
            self._used_s = {
                each: used
                for each, used in self._used_s.items()
                if each in self._waiting or used > self._turn_s
            }

    def keep(self, is_wanted: Callable[[T], bool]) -> None:
        """Forget the other items."""
        kept = {each: deque(filter(is_wanted, items)) for each, items in self._waiting.items()}
        self._waiting = {each: items for each, items in kept.items() if items}

    def clear(self) -> None:
        """Forget all items."""
        self._waiting.clear()
