"""Calls whose arguments do not fit."""

import inspect

import pytest

from tfbus import StaticTransformBroadcaster, TransformBroadcaster, TransformListener
from tfbus.compat import tf2_ros
from tfbus.runtime.right_form import called_as


@called_as("double(number)")
def double(number: int, *, twice: bool = False) -> int:
    """Twice the number."""
    return double.__wrapped__(2 * number) if twice else 2 * number


def test_a_call_that_fits_is_as_it_was() -> None:
    """Its result, its signature and its docstring."""
    assert double(2, twice=True) == 8
    assert str(inspect.signature(double)) == "(number: int, *, twice: bool = False) -> int"
    assert double.__doc__ == "Twice the number."


def test_a_call_that_does_not_fit_names_the_right_form() -> None:
    """Where an argument is missing, too many, or of no such name."""
    for call in (lambda: double(), lambda: double(1, 2), lambda: double(1, once=True)):
        with pytest.raises(TypeError, match=r"double\(\) .*; call it as in double\(number\)$"):
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
