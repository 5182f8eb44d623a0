"""Groups of items, which overlap in time a little, in order of time."""

import heapq
from collections.abc import Callable, Collection, Iterable, Iterator
from typing import TypeVar

from tfbus.errors import DecodeError

T = TypeVar("T")

# What an item takes in memory besides the bytes of its message.
_ITEM_BYTES = 750

# Groups whose times overlap are in memory together; more of them are refused.
_MOST_WAITING = 2**30


def in_order(
    groups: Iterable[tuple[int, Collection[T], int]], time_of: Callable[[T], int]
) -> Iterator[T]:
    """The items of all groups by their times; equal ones in the order of the groups.

    Each group comes with the least time of its items, and the bytes that they have, and groups come
    in order of that time. Raises DecodeError if items that wait for their turn are beyond 1 GB.
    """
    # The time of each, its number, its bytes, and the item.
    waiting: list[tuple[int, int, int, T]] = []
    taken = held = 0
    for from_time, items, size in groups:
        while waiting and waiting[0][0] < from_time:
            _, _, left, item = heapq.heappop(waiting)
            held -= left
            yield item
        each = _ITEM_BYTES + size // max(1, len(items))
        held += each * len(items)
        if held > _MOST_WAITING:
            raise DecodeError("the chunks of the recording overlap in time too much to be read")
        for item in items:
            heapq.heappush(waiting, (time_of(item), taken, each, item))
            taken += 1
    while waiting:
        yield heapq.heappop(waiting)[3]
