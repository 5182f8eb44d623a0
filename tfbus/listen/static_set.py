"""The static transforms of one stream: the set that came last, and what the stream lists."""

from tfbus.geometry.columns import Columns
from tfbus.wire.transforms import TransformMessage


class StaticSet:
    """The static transforms of one stream; each message of them is the whole set.

    Not safe by itself: hold the stream's lock around each method. `batch` and `epoch_ns` may be
    read without it; a batch is never changed, only replaced.
    """

    def __init__(self) -> None:
        self.batch: Columns | None = None
        self.epoch_ns: int | None = None
        # The frames that the stream lists as static.
        self.listed: frozenset[str] = frozenset()
        self._seq: int | None = None
        # False where the set may have changed since it last came.
        self._is_current = True
        # The epoch of the set of a former process, which another one has taken over from.
        self._former_ns: int | None = None

    def replace(self, message: TransformMessage, *, is_current: bool) -> frozenset[str] | None:
        """Take the set of a message; `is_current` if its publisher is not gone.

        Returns the children that the former set of this epoch had and the new one does not; None,
        with nothing replaced, if a later set of this epoch is there.
        """
        if message.epoch_ns != self._former_ns:
            self._is_current |= is_current
            self._former_ns = None
        is_same_epoch = message.epoch_ns == self.epoch_ns
        if is_same_epoch and _is_before(message.seq, self._seq):
            return None
        former = (
            children_of(self.batch) if self.batch is not None and is_same_epoch else frozenset()
        )
        self.batch, self.epoch_ns, self._seq = message.rows, message.epoch_ns, message.seq
        return former - children_of(message.rows)

    def is_missing(self) -> bool:
        """Whether a listed transform has not come, or may have changed since."""
        if not self.listed:
            return False
        if self.batch is None or not self._is_current:
            return True
        return not self.listed <= children_of(self.batch)

    def expire(self) -> None:
        """The set may change unnoticed: its publisher is gone."""
        self._is_current = False

    def expire_before(self, started_ns: int) -> None:
        """Another process publishes the stream, which began then: a set of before is not its own,
        even if it comes again.
        """
        if self.epoch_ns is not None and self.epoch_ns < started_ns:
            self._is_current, self._former_ns = False, self.epoch_ns

    def accept_any(self) -> None:
        """Another process publishes the stream: take its set, whatever its epoch and number."""
        self.epoch_ns = self._seq = self._former_ns = None
        self._is_current = False

    def clear(self) -> None:
        """Forget the set: it is no longer read."""
        self.batch = self.epoch_ns = self._seq = None


def children_of(batch: Columns) -> frozenset[str]:
    """The child frames of a batch."""
    return batch.children()


def _is_before(seq: int | None, other: int | None) -> bool:
    return seq is not None and other is not None and seq < other
