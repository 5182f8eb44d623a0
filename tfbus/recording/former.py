"""Finds the last item before a moment of a recording, by reading only what is needed."""

from collections.abc import Callable, Iterator
from typing import Protocol

from tfbus.recording.items import Item
from tfbus.recording.selection import ALL, Selection

# This much is read at first, and then four times as much each time.
_FIRST_SPAN_NS = 200_000_000


class _Source(Protocol):
    def items(
        self, from_ns: int | None = None, to_ns: int | None = None, selection: Selection = ALL
    ) -> Iterator[Item]: ...


def last_item(
    source: _Source,
    start_ns: int,
    until_ns: int,
    selection: Selection = ALL,
    is_wanted: Callable[[Item], bool] = lambda item: True,
) -> Item | None:
    """The last item that is wanted from one log time to another, both included; None if there
    is none.
    """
    span_ns = _FIRST_SPAN_NS
    while until_ns >= start_ns:
        from_ns = max(until_ns - span_ns, start_ns)
        found = None
        for item in source.items(from_ns, until_ns, selection):
            if is_wanted(item):
                found = item
        if found is not None:
            return found
        until_ns, span_ns = from_ns - 1, 4 * span_ns
    return None
