"""Reports of a buffer: its frames, their changes, and counts of rows that it did not store."""

from collections import Counter
from typing import Literal

from tfbus.base.structs import Struct

# Reasons name frames, and frames come from the bus: without a limit they would fill the memory.
MOST_REASONS = 100
OTHER_REASONS = "other reasons"

Kind = Literal[
    "added",
    "removed",
    "reparented",
    "became static",
    "became dynamic",
    "conflict",
    "too old",
    "publisher gone",
    "publisher back",
]


class FrameInfo(Struct):
    """A frame, and the edge that joins it to its parent.

    `parent` is None for a root, which has no edge: then the rest but `children` is empty.
    `samples` is how many are held; `static` whether the edge holds at all times.
    `rate_hz` is how often samples come, None for static frames and below two samples; times in
    which they were interrupted do not count.
    `oldest_ns` and `newest_ns` are the stamps of the samples held, in nanoseconds since the Unix
    epoch, None without one. `authority` is the publisher of the last sample. `conflicts` counts
    samples that repeated a stamp with a different value, `refused` samples too old to be stored,
    `crowded_out` samples dropped because there were more than `max_samples`.
    `gone` is whether its publisher is gone, as a listener has noticed: killed, closed, or out of
    reach.
    """

    name: str
    parent: str | None = None
    children: tuple[str, ...] = ()
    static: bool = False
    samples: int = 0
    rate_hz: float | None = None
    oldest_ns: int | None = None
    newest_ns: int | None = None
    authority: str = ""
    conflicts: int = 0
    refused: int = 0
    gone: bool = False
    crowded_out: int = 0


class Change(Struct):
    """A change of one frame.

    `kind` is "added", "removed", "reparented", "became static", "became dynamic", "conflict" (a
    sample of the same stamp was replaced), "too old" (a sample was refused), "publisher gone" or
    "publisher back". The transform that made the change has `parent`, `authority` and `stamp_ns`;
    before it the frame had `former_parent` and `former_authority`.

    Two living publishers of one frame, `authority` and `former_authority`, are a "conflict" too.
    """

    kind: Kind
    frame: str
    parent: str | None
    former_parent: str | None
    authority: str
    former_authority: str
    stamp_ns: int


class Rejections(Counter[str]):
    """How many rows of batches were not stored, by reason; `last` is the newest reason, and `rows`
    the number of all.

    Beyond 100 reasons further ones are counted together.
    """

    last: str = ""
    rows: int = 0

    def add(self, reason: str) -> None:
        """Count one row."""
        self.last = reason
        self.rows += 1
        self[reason if reason in self or len(self) < MOST_REASONS else OTHER_REASONS] += 1
