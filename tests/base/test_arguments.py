"""Arguments that callers give."""

import inspect
import math
import threading

import numpy as np
import pytest

from tfbus import StaticTransformBroadcaster, TransformBroadcaster, TransformListener
from tfbus.base.arguments import called_as, seconds_to_wait
from tfbus.compat import tf2_ros


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
    with pytest.raises(ValueError, match=r"timeout_s .*or None"):
        seconds_to_wait(math.nan)


@pytest.mark.parametrize("given", ["1", [1], print])
def test_what_is_no_number_is_no_timeout(given: object) -> None:
    """The error names the type."""
    with pytest.raises(TypeError, match=f"timeout_s .*not {type(given).__name__}$"):
        seconds_to_wait(given)  # that is the test


@called_as("double(number)")
def double(number: int, *, twice: bool = False) -> int:
    """Twice the number."""
    return double.__wrapped__(2 * number) if twice else 2 * number


def test_a_call_that_fits_is_as_it_was() -> None:
    """Its result, its signature and its docstring."""
    assert double(2, twice=True) == 8
    assert inspect.signature(double) == inspect.signature(double.__wrapped__)
    assert double.__doc__ == "Twice the number."


def test_a_call_that_does_not_fit_names_the_right_form() -> None:
    """Where an argument is missing, too many, or of no such name."""
    for call in (lambda: double(), lambda: double(1, 2), lambda: double(1, once=True)):
        with pytest.raises(TypeError, match=r"double\(\) .*; .* double\(number\)$"):
            call()


def test_an_error_within_the_call_stays_as_it_is() -> None:
    """A TypeError of another cause does not ask for other arguments."""

    @called_as("fail(number)")
    def fail(number: object) -> object:
        return number + 1

    with pytest.raises(TypeError, match=r"^(?!.*call it as)"):
        fail("text")


@pytest.mark.parametrize(
    ("cls", "form"),
    [
        (TransformListener, "TransformListener(buffer, node)"),
        (TransformBroadcaster, "TransformBroadcaster(node)"),
        (StaticTransformBroadcaster, "StaticTransformBroadcaster(node)"),
        (tf2_ros.TransformListener, "TransformListener(buffer, node)"),
        (tf2_ros.TransformBroadcaster, "TransformBroadcaster(node)"),
        (tf2_ros.StaticTransformBroadcaster, "StaticTransformBroadcaster(node)"),
    ],
)
def test_the_classes_of_transforms_name_their_arguments(cls: type, form: str) -> None:
    """Where the node is missing, as programs of ROS sometimes have it."""
    with pytest.raises(TypeError) as raised:
        cls()
    assert str(raised.value).endswith(f"; call it as in {form}")
