"""Calls whose arguments do not fit: the error names the right form beside what Python says."""

import functools
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


def called_as(form: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Let the TypeError of a call that lacks arguments, or has others, say how it is called:
    `TransformListener(buffer, node)`.
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        @functools.wraps(function)
        def call(*args: P.args, **named: P.kwargs) -> R:
            try:
                return function(*args, **named)
            except TypeError as error:
                if _fit(function, args, named):  # it is raised within the call
                    raise
                raise TypeError(f"{error}; call it as in {form}") from None

        return call

    return decorate


def _fit(function: Callable[..., Any], args: tuple[Any, ...], named: dict[str, Any]) -> bool:
    """Whether the function takes these arguments, by their number and names."""
    import inspect  # slow, and most calls fit

    try:
        inspect.signature(function).bind(*args, **named)
    except TypeError:
        return False
    return True
