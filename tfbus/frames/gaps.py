"""Which times between samples are gaps."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
else:
    from tfbus.core import lazy_numpy as np

# A time without a sample is a gap if it is longer than this many periods, and than this.
_PERIODS, _LEAST_S = 5.0, 0.25


def least_gap_s(period_s: float) -> float:
    """The time in seconds beyond which there is a gap between samples of this period."""
    return max(_LEAST_S, _PERIODS * period_s)


def least_gap_between(between_ns: NDArray[np.int64]) -> float:
    """The time in ns beyond which there is a gap, by the times between samples (N,)."""
    period_ns = float(np.median(between_ns)) if len(between_ns) else 0.0
    return least_gap_s(period_ns / 1e9) * 1e9


def gaps_in(between_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which of the times between samples (N,) are gaps (N,)."""
    return between_ns > least_gap_between(between_ns)
