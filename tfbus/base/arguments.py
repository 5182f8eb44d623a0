"""Arguments that callers give: callbacks, seconds, the right form of a call, and its signature."""

from __future__ import annotations

import functools
import math
import os
import sys
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

from tfbus.base import scheduler
from tfbus.base.wording import printable

if TYPE_CHECKING:
    import ast
    import inspect

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
    also for infinity and times that no lock can wait (292 years).

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


class SourceSignature:
    """The `__signature__` of a class, from the `__init__` in the .py file beside the module.

    Read when `help` or an IDE asks. A subclass with another `__init__` has its own.
    """

    def __get__(self, instance: object, owner: type) -> "inspect.Signature":
        written = next(each for each in owner.__mro__ if vars(each).get("__signature__") is self)
        above = owner.__mro__[: owner.__mro__.index(written)]
        module = sys.modules[written.__module__]
        if any("__init__" in vars(each) for each in above):
            raise AttributeError("__signature__")
        folder, name = os.path.split(module.__file__ or "")
        source = os.path.join(folder, name.partition(".")[0] + ".py")
        try:
            arguments = _init_of(source, written.__name__)
        except (OSError, StopIteration, SyntaxError):
            raise AttributeError("__signature__") from None
        return _signature(arguments, vars(module))


def _init_of(source: str, name: str) -> ast.arguments:
    import ast  # slow, as is inspect below, and a node needs neither

    with open(source, encoding="utf-8") as file:
        body = ast.parse(file.read()).body
    written = next(node for node in body if isinstance(node, ast.ClassDef) and node.name == name)
    return next(
        node.args
        for node in written.body
        if isinstance(node, ast.FunctionDef) and node.name == "__init__"
    )


def _signature(arguments: ast.arguments, names: dict[str, Any]) -> "inspect.Signature":
    """The signature of a function with these arguments, without `self`."""
    import inspect

    def parameter(argument: ast.arg, kind: Any, default: ast.expr | None) -> inspect.Parameter:
        return inspect.Parameter(
            argument.arg,
            kind,
            default=inspect.Parameter.empty if default is None else _value(default, names),
            annotation=inspect.Parameter.empty
            if argument.annotation is None
            else _value(argument.annotation, names),
        )

    placed = arguments.args[1:]
    defaults = [None] * (len(placed) - len(arguments.defaults)) + list(arguments.defaults)
    by_place, by_name = inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY
    return inspect.Signature(
        [
            *(parameter(a, by_place, d) for a, d in zip(placed, defaults, strict=True)),
            *(
                parameter(a, by_name, d)
                for a, d in zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True)
            ),
        ],
        return_annotation=None,
    )


def _value(expression: ast.expr, names: dict[str, Any]) -> Any:
    """Its value in the module; its text if a name is there for type checkers only."""
    import ast

    text = ast.unparse(expression)
    try:
        return eval(compile(ast.Expression(expression), "<signature>", "eval"), names)
    except NameError:
        return text
