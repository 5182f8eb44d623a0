"""The frames that a stream lists in its description, and those that it has removed."""

# Kept messages of a removed frame may still be on their way. Frame names come from the bus: at
# most this many removed ones are remembered, then all but the last are forgotten.
_MOST_REMOVED = 10_000

# Node, process id and Zenoh's session: they tell one process from the next.
Publisher = tuple[str, int, str]


class Listing:
    """The frames that one stream lists. Not safe by itself: hold the stream's lock around methods.

    The attributes may be read without it.
    """

    def __init__(self) -> None:
        self.children: frozenset[str] = frozenset()
        self.epoch_ns: int | None = None
        self.publisher: Publisher | None = None
        self._removed: frozenset[str] = frozenset()

    def replace(
        self, epoch_ns: int, children: frozenset[str], publisher: Publisher | None
    ) -> frozenset[str]:
        """Take a new list; returns the frames that the publisher has removed since the last one.

        A restarted publisher removes nothing: frames that it does not list are gone. A stream
        whose clock went back has a new epoch too, and is the same publisher.
        """
        is_same_epoch = epoch_ns == self.epoch_ns
        is_same = is_same_epoch or (publisher is not None and publisher == self.publisher)
        dropped = self.children - children if is_same else frozenset()
        kept = is_same_epoch and len(self._removed) < _MOST_REMOVED
        self._removed = ((self._removed if kept else frozenset()) | dropped) - children
        self.children, self.epoch_ns, self.publisher = children, epoch_ns, publisher
        return dropped

    def removed_in(self, epoch_ns: int) -> frozenset[str]:
        """The frames that the stream listed in this epoch, and no longer lists."""
        return self._removed if self.epoch_ns == epoch_ns else frozenset()
