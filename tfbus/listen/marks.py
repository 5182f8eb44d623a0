"""The last stage of a stream's reception: marks frames in the buffer as gone, or not."""

from tfbus.geometry.columns import Columns
from tfbus.listen.stream_facts import StreamFacts


class Marks:
    """The marks of the frames of one stream, by its epochs, its statics and its list of frames.

    Safe from any thread; `update` and `settle` are not to be called with the stream's lock held.
    """

    def __init__(self, facts: StreamFacts) -> None:
        # Frames of a former epoch, which the present one has not sent so far.
        self.left_behind: frozenset[str] = frozenset()
        self._stream = facts.name
        self._buffer = facts.buffer
        self._epochs = facts.epochs
        self._static_set = facts.static_set
        self._listing = facts.listing
        # Counts changes of epochs and lists.
        self._turns = 0
        # How many epochs have begun while samples of former ones were not yet dropped.
        self._begun = 0

    def invalidate(self) -> None:
        """An epoch or a list has changed, and `update` follows; with the stream's lock held."""
        self._turns += 1

    def begin_epoch(self) -> None:
        """An epoch has begun, and `end_former` follows; with the stream's lock held."""
        self._begun += 1
        self._turns += 1

    def end_former(self) -> None:
        """The samples of the former epoch are dropped, and `update` follows; with the stream's lock
        held.
        """
        self._begun -= 1
        self._turns += 1

    def update(self) -> None:
        """Mark each frame in the buffer.

        All are gone if the publisher is. Else those are that a former epoch left behind: not
        listed, and without a sample of this epoch. Before this epoch has a list, those that were
        gone stay so until they are sent: all of them where nothing of this epoch has come since the
        publisher was gone, as the one that is there may be another.
        """
        marked = -1
        # It may change meanwhile, on another thread, whose marks must not be overwritten.
        while marked != self._turns:
            marked = self._turns
            held = self._buffer.sent_by(self._stream)
            if self._epochs.gone:
                self.left_behind = frozenset()
                self._buffer.mark_gone(held, True, self._stream)
                continue
            self.left_behind = self._find_left_behind(held)
            if self._listing.epoch_ns == self._epochs.present_ns:
                self._buffer.mark_gone(self.left_behind, True, self._stream)
            self._buffer.mark_gone(held.keys() - self.left_behind, False, self._stream)

    def settle(self, rows: Columns) -> None:
        """Mark the frames of rows that are in the buffer now: frames that were left behind, and are
        sent again, are not gone.
        """
        if self._epochs.gone:
            self.update()
        elif self.left_behind and not self.left_behind.isdisjoint(rows.frames):
            found = self.left_behind & rows.children()
            self.left_behind -= found
            self._buffer.mark_gone(found, False, self._stream)

    def _find_left_behind(self, held: dict[str, int]) -> frozenset[str]:
        current: set[str] = set()
        present_ns, statics = self._epochs.present_ns, self._static_set
        if self._listing.epoch_ns == present_ns:
            current |= self._listing.children
        elif self._epochs.was_gone:
            return frozenset(held)
        if statics.batch is not None and statics.epoch_ns == present_ns:
            current |= statics.batch.children()
        former = {frame for frame, samples in held.items() if self._begun or not samples}
        return frozenset(former - current)
