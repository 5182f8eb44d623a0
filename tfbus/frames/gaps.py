"""Which times between samples are gaps."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
else:
    from tfbus.core import lazy_numpy as np

# A time without a sample is a gap if it is this many periods long, and at least this long.
GAP_PERIODS, LEAST_GAP_S = 5.0, 0.25


def gaps_in(between_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which of the times between samples (N,) are gaps (N,)."""
    if not len(between_ns):
        return between_ns > 0
    limit_ns = max(LEAST_GAP_S * 1e9, GAP_PERIODS * float(np.median(between_ns)))
    return between_ns > limit_ns
