"""Seconds to wait, as callers give them."""

import math

from tfbus.runtime import scheduler


def seconds_to_wait(timeout_s: float | None) -> float | None:
    """How long to wait: 0 for a negative time, as of a deadline that has passed; None for ever,
    also for infinity and what no lock can wait for (292 years).

    Raises TypeError if it is no number, ValueError if it is NaN.
    """
    if timeout_s is None:
        return None
    if isinstance(timeout_s, str) or not hasattr(timeout_s, "__float__"):
        raise TypeError(
            f"timeout_s must be a number of seconds or None, not {type(timeout_s).__name__}"
        )
    seconds = float(timeout_s)
    if math.isnan(seconds):
        raise ValueError("timeout_s must be a number of seconds, or None to wait for ever, not nan")
    return max(seconds, 0.0) if seconds < scheduler.TIMEOUT_MAX else None
