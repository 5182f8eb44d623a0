"""The newest stamps that a stream has sent: they show that its clock went back."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

# Stamps may go back by this much, as when a sensor's data comes twice or in bursts. By more, the
# clock itself was set back: a simulator was reset, or a recording starts again.
MOST_BACK_NS = 1_000_000_000

# No stamp is more than MOST_BACK_NS before it.
_NEVER = -(2**63) + MOST_BACK_NS

Rows = NDArray[np.intp]


class NewestStamps:
    """The newest stamp sent of each child frame. A caller names frames by rows, which are looked
    up together. Used by one thread at a time.
    """

    def __init__(self) -> None:
        self._row_of: dict[str, int] = {}
        self._free: list[int] = []
        self._newest = np.full(16, _NEVER, dtype=np.int64)
        # Reads and writes a single stamp in a fifth of the time.
        self._one = self._newest.data

    def rows(self, children: Sequence[str]) -> Rows:
        """The rows of these frames, valid until one of them is forgotten."""
        return np.array([self._row(child) for child in children], dtype=np.intp)

    def note(self, rows: Rows, stamps_ns: NDArray[np.int64]) -> int | None:
        """Note the stamps that are sent now, one a row; None where all are noted.

        Where one is more than 1 s older than the newest of its row, nothing is noted, and its
        position returned.
        """
        if len(rows) == 1:
            return self.note_one(int(rows[0]), int(stamps_ns[0]))
        too_old = stamps_ns < self._newest[rows] - MOST_BACK_NS
        if np.count_nonzero(too_old):
            return int(too_old.argmax())
        # A row may come more than once.
        np.maximum.at(self._newest, rows, stamps_ns)
        return None

    def newest_ns(self, row: int) -> int:
        """The newest stamp of a row."""
        return int(self._one[row])

    def forget(self, child: str) -> None:
        """Forget the stamp and the row of this frame."""
        row = self._row_of.pop(child, None)
        if row is not None:
            self._one[row] = _NEVER
            self._free.append(row)

    def clear(self) -> None:
        """Forget all stamps; the rows stay valid."""
        self._newest[:] = _NEVER

    def note_one(self, row: int, stamp_ns: int) -> int | None:
        """As `note` of one row, in a fraction of the time."""
        newest_ns = self._one[row]
        if stamp_ns < newest_ns - MOST_BACK_NS:
            return 0
        if stamp_ns > newest_ns:
            self._one[row] = stamp_ns
        return None

    def _row(self, child: str) -> int:
        row = self._row_of.get(child)
        if row is None:
            row = self._row_of[child] = self._free.pop() if self._free else len(self._row_of)
            if row >= len(self._newest):
                self._grow()
        return row

    def _grow(self) -> None:
        self._newest = np.concatenate([self._newest, np.full_like(self._newest, _NEVER)])
        self._one = self._newest.data
