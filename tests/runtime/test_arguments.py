"""Seconds to wait."""

import math
import threading

import numpy as np
import pytest

from tfbus.runtime.arguments import seconds_to_wait


@pytest.mark.parametrize(
    ("given", "seconds"),
    [
        (1.5, 1.5),
        (0, 0.0),
        (np.float32(0.5), 0.5),
        (-1, 0.0),
        (-math.inf, 0.0),
        (None, None),
        (math.inf, None),
        (threading.TIMEOUT_MAX, None),
        (1e300, None),
    ],
)
def test_a_timeout_is_what_a_lock_can_wait_for(given: float, seconds: float | None) -> None:
    """A deadline that has passed waits no time, and infinity waits for ever."""
    assert seconds_to_wait(given) == seconds


def test_nan_is_no_timeout() -> None:
    """A wait for NaN seconds would never end, and take a whole core."""
    with pytest.raises(ValueError, match="timeout_s must be a number of seconds, or None"):
        seconds_to_wait(math.nan)


@pytest.mark.parametrize("given", ["1", [1], print])
def test_what_is_no_number_is_no_timeout(given: object) -> None:
    """The error names the type."""
    with pytest.raises(TypeError, match="timeout_s must be a number of seconds or None, not "):
        seconds_to_wait(given)  # that is the test
