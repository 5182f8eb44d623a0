"""Groups of items, which overlap in time a little, in order of time."""

import heapq
from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

T = TypeVar("T")


def in_order(groups: Iterable[tuple[int, Iterable[T]]], time_of: Callable[[T], int]) -> Iterator[T]:
    """The items of all groups by their times; equal ones in the order of the groups.

    Each group comes with the least time of its items, and groups come in order of that.
    """
    waiting: list[tuple[int, int, T]] = []
    taken = 0
    for from_time, items in groups:
        while waiting and waiting[0][0] < from_time:
            yield heapq.heappop(waiting)[2]
        for item in items:
            heapq.heappush(waiting, (time_of(item), taken, item))
            taken += 1
    while waiting:
        yield heapq.heappop(waiting)[2]
