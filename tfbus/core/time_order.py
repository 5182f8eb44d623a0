# cython: boundscheck=False, wraparound=False
"""The rows of a batch in about the order of their times.

One of the modules that are compiled where there is a C compiler (`time_order.pxd` says the C
types). Rows that lie between the same samples share what is computed of these, where they come
one after the other; a few that do not cost little, and so the order may be rough. How rough it is
depends on how evenly the times are spread.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

try:
    import cython
except ImportError:
    from tfbus.core import cython_stub as cython

# Fewer rows share too little; the numbers of more would not be of 32 bits.
_LEAST_ROWS = 1024
_MOST_ROWS = 2**31 - 1
# So many rows have a bucket on average; more buckets would not fit into the nearest cache.
_ROWS_OF_BUCKET = 8
_MOST_BUCKETS = 4096

_AS_THEY_ARE = np.empty(0, dtype=np.int32)


def by_time(stamps: NDArray[np.int64]) -> NDArray[np.int32]:
    """The rows of the stamps (N,) in about the order of these; none where they are in order, or
    too few to gain by it.
    """
    count = len(stamps)
    if not _LEAST_ROWS <= count <= _MOST_ROWS or _are_sorted(stamps.data):
        return _AS_THEY_ARE
    if not cython.compiled:
        return np.argsort(stamps, kind="stable").astype(np.int32)
    rows = np.empty(count, dtype=np.int32)
    buckets = np.empty(count, dtype=np.uint16)
    starts = np.zeros(min(count // _ROWS_OF_BUCKET, _MOST_BUCKETS) + 1, dtype=np.int32)
    _distribute(stamps.data, stamps.min(), stamps.max(), starts.data, buckets.data, rows.data)
    return rows


def _are_sorted(stamps: Any) -> bool:
    for i in range(1, len(stamps)):  # noqa: SIM110  # as C has it
        if stamps[i] < stamps[i - 1]:
            return False
    return True


def _distribute(
    stamps: Any, least: float, most: float, starts: Any, buckets: Any, rows: Any
) -> None:
    """Write the rows of stamps from `least` to `most`, by a counting sort into buckets of equal
    length. `starts` are zeros, one more than buckets; `buckets` is room for those of the stamps.
    """
    with cython.nogil:
        last = len(starts) - 2
        pace = last / (most - least)
        for i in range(len(stamps)):
            way = (stamps[i] - least) * pace
            # Rounding may lead beyond the last. Where the two are one double it is no number, and a
            # thread may write into the stamps meanwhile.
            if way > last:
                way = last
            elif not way >= 0.0:
                way = 0.0
            bucket = cython.cast(cython.Py_ssize_t, way)
            buckets[i] = bucket
            starts[bucket + 1] += 1
        for bucket in range(1, len(starts)):
            starts[bucket] += starts[bucket - 1]
        for i in range(len(stamps)):
            bucket = buckets[i]
            at = starts[bucket]
            starts[bucket] = at + 1
            rows[at] = i
