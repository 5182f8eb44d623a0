"""Moves the stamps of a recording to the time of now."""

from itertools import islice
from typing import TYPE_CHECKING

from tfbus.bag.in_force import Source
from tfbus.bag.player import Pace
from tfbus.geometry.columns import Columns
from tfbus.recording.items import TransformItem
from tfbus.recording.selection import Selection

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
else:
    from tfbus.core import lazy_numpy as np

# A recording whose stamps are further from its log times than this was made with simulated time.
_OTHER_CLOCK_NS = 60_000_000_000

# This many messages of transforms, of this many items, say it.
_MESSAGES, _ITEMS = 50, 2000


def stamps_ahead_ns(source: Source, selection: Selection, from_ns: int) -> int:
    """By how much the stamps of a recording are ahead of its log times, from a moment on.

    0 where they are of the same clock: then a difference is a delay, and stays one.
    """
    items = islice(source.items(from_ns, None, selection), _ITEMS)
    dynamic = (item for item in items if isinstance(item, TransformItem) and not item.static)
    ahead = [
        stamp_ns - item.log_ns
        for item in islice(dynamic, _MESSAGES)
        if (stamp_ns := item.rows.last_stamp_ns()) is not None
    ]
    middle = sorted(ahead)[len(ahead) // 2] if ahead else 0
    return middle if abs(middle) > _OTHER_CLOCK_NS else 0


def moved_ns(stamp_ns: int, pace: Pace, ahead_ns: int) -> int:
    """A stamp of now, as `moved` has those of rows."""
    return pace.wall_ns + round((stamp_ns - pace.log_ns - ahead_ns) / pace.rate)


def moved(rows: Columns, pace: Pace, ahead_ns: int) -> Columns:
    """The rows with stamps of now: that of `pace.log_ns + ahead_ns` becomes `pace.wall_ns`.

    At rate 1 all are moved by the same number of nanoseconds.
    """
    # As a Python integer: the offset of years at once could be beyond 64 bits.
    origin_ns = pace.log_ns + ahead_ns
    stamps = rows.stamps_ns()
    if pace.rate == 1.0:
        stamps = stamps + (pace.wall_ns - origin_ns)
    else:
        since = np.rint((stamps - origin_ns) / pace.rate)
        stamps = since.astype(np.int64) + pace.wall_ns
    return _stamped(rows, stamps)


def moved_to(rows: Columns, stamp_ns: int) -> Columns:
    """The rows with this stamp."""
    return _stamped(rows, np.full(rows.count, stamp_ns, np.int64))


def _stamped(rows: Columns, stamps: "NDArray[np.int64]") -> Columns:
    return Columns.of_bytes(rows.frames, rows.edges_bytes(), stamps.tobytes(), rows.poses_bytes())
