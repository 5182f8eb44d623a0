"""What a buffer could not take, counted by its reason."""

from collections import Counter

# Reasons name frames, and frames come from the bus: what is kept of them has an end.
MOST_REASONS = 100
OTHER_REASONS = "other reasons"


class Rejections(Counter[str]):
    """How many rows of batches could not be taken, by their reason; `last` is the newest reason,
    and `rows` how many there were of all.

    Of more than 100 reasons the later ones are counted together.
    """

    last: str = ""
    rows: int = 0

    def add(self, reason: str) -> None:
        """Count one row."""
        self.last = reason
        self.rows += 1
        self[reason if reason in self or len(self) < MOST_REASONS else OTHER_REASONS] += 1
