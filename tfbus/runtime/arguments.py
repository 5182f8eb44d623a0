"""Arguments that callers give: callbacks, seconds to wait, and the right form of a call."""

import functools
import math
from collections.abc import Callable
from functools import partial
from typing import Any, ParamSpec, TypeVar

from tfbus.runtime import scheduler
from tfbus.wording import printable

P = ParamSpec("P")
R = TypeVar("R")

# Of a code object: it is that of an `async def`.
_CO_COROUTINE = 0x80


def check_callback(call: str, callback: object) -> None:
    """Raise TypeError if it cannot be called."""
    if not callable(callback):
        raise TypeError(f"{call}: the last argument must be a function, not {shown(callback)}")


def check_plain(call: str, callback: object) -> None:
    """Raise TypeError if it cannot be called, or is an `async def` that nothing would await."""
    check_callback(call, callback)
    if is_async(callback):
        raise TypeError(
            f"{call}: {shown(callback)} must be a plain function, not an async def, which "
            "nothing would await: let the function hand over to a coroutine, by "
            "asyncio.run_coroutine_threadsafe(coroutine, loop)"
        )


def is_async(callback: object) -> bool:
    """Whether a call of it returns a coroutine: an `async def`, also as a method or partial."""
    while isinstance(callback, partial):
        callback = callback.func
    if not hasattr(callback, "__code__") and not hasattr(callback, "__func__"):
        # Of an object that can be called.
        callback = getattr(type(callback), "__call__", None)  # noqa: B004  # its code is looked at
    code = getattr(getattr(callback, "__func__", callback), "__code__", None)
    # As inspect.iscoroutinefunction does, which takes long to load.
    return code is not None and bool(code.co_flags & _CO_COROUTINE)


def shown(value: object) -> str:
    """The value in a sentence: a class or function by its name, a short value as it is."""
    name = getattr(value, "__qualname__", None)
    if callable(value) and isinstance(name, str):
        return printable(name, 60)
    if value is None or isinstance(value, str | int | float):
        return printable(repr(value), 60)
    return f"a value of type {type(value).__name__}"


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
