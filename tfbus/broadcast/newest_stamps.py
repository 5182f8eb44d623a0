"""The newest stamps that a stream has sent: they show that its clock went back."""

from array import array
from collections.abc import Sequence
from typing import TypeAlias

from tfbus.core import lazy_numpy as np

# Stamps may go back by this much, as when a sensor's data comes twice or in bursts. By more, the
# clock itself was set back: a simulator was reset, or a recording starts again.
MOST_BACK_NS = 1_000_000_000

# No stamp is more than MOST_BACK_NS before it.
_NEVER = -(2**63) + MOST_BACK_NS

# Fewer stamps than this are judged one by one, more by numpy.
_MANY = 50

# Of 64 bits each.
Rows: TypeAlias = "array[int]"  # as a text, since Python 3.11 has no array[int]


class NewestStamps:
    """The newest stamp sent of each child frame. A caller names frames by rows, which are looked
    up together. Used by one thread at a time.
    """

    def __init__(self) -> None:
        self._row_of: dict[str, int] = {}
        self._free: list[int] = []
        self._newest = array("q")

    def rows(self, children: Sequence[str]) -> Rows:
        """The rows of these frames, valid until one of them is forgotten."""
        return array("q", [self._row(child) for child in children])

    def note(self, rows: Rows, stamps_ns: Sequence[int]) -> int | None:
        """Note the stamps that are sent now, one a row; None if all are noted.

        `stamps_ns` has a buffer of signed integers of 64 bits. If one is more than 1 s older
        than the newest of its row, nothing is noted, and its position returned.
        """
        if len(rows) >= _MANY:
            return self._note_many(rows, stamps_ns)
        newest = self._newest
        for position, (row, stamp_ns) in enumerate(zip(rows, stamps_ns, strict=True)):
            if stamp_ns < newest[row] - MOST_BACK_NS:
                return position
        for row, stamp_ns in zip(rows, stamps_ns, strict=True):
            # A row may come more than once.
            if stamp_ns > newest[row]:
                newest[row] = stamp_ns
        return None

    def _note_many(self, rows: Rows, stamps_ns: Sequence[int]) -> int | None:
        # Views for this call only: an array with views cannot grow.
        newest, at = np.frombuffer(self._newest, np.int64), np.frombuffer(rows, np.int64)
        stamps = np.frombuffer(stamps_ns, np.int64)
        too_old = stamps < newest[at] - MOST_BACK_NS
        if np.count_nonzero(too_old):
            return int(too_old.argmax())
        np.maximum.at(newest, at, stamps)
        return None

    def newest_ns(self, row: int) -> int:
        """The newest stamp of a row."""
        return self._newest[row]

    def forget(self, child: str) -> None:
        """Forget the stamp and the row of this frame."""
        row = self._row_of.pop(child, None)
        if row is not None:
            self._newest[row] = _NEVER
            self._free.append(row)

    def clear(self) -> None:
        """Forget all stamps; the rows stay valid."""
        self._newest = array("q", [_NEVER]) * len(self._newest)

    def note_one(self, row: int, stamp_ns: int) -> int | None:
        """As `note` of one row, in a fraction of the time."""
        newest_ns = self._newest[row]
        if stamp_ns < newest_ns - MOST_BACK_NS:
            return 0
        if stamp_ns > newest_ns:
            self._newest[row] = stamp_ns
        return None

    def _row(self, child: str) -> int:
        row = self._row_of.get(child)
        if row is None:
            row = self._row_of[child] = self._free.pop() if self._free else len(self._row_of)
            if row == len(self._newest):
                self._newest.append(_NEVER)
        return row
