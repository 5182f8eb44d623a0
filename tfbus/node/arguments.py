"""Checks what a node's methods are given, and names what they want."""

from functools import partial
from typing import Any

from tfbus.wire.codec import is_message_type
from tfbus.wording import printable

# Of a code object: it is that of an `async def`.
_CO_COROUTINE = 0x80


def check_message_type(call: str, message_type: object) -> None:
    """Raise TypeError where it is no dataclass; `call` is the call as it should be."""
    if not is_message_type(message_type):
        raise TypeError(
            f"{call}: message_type must be a class of messages, a dataclass such as "
            f"tfbus.messages.Pose, not {_shown(message_type)}"
        )


def check_parts(call: str, type_: object, parts: tuple[str, ...]) -> None:
    """Raise TypeError where it is no class that holds these dataclasses: a type of service or
    action.
    """
    missing = [part for part in parts if not is_message_type(getattr(type_, part, None))]
    if missing or not isinstance(type_, type):
        raise TypeError(
            f"{call}: the type must be a class that holds the dataclasses {' and '.join(parts)}, "
            f"not {_shown(type_)}"
        )


def check_callback(call: str, callback: object) -> None:
    """Raise TypeError where it cannot be called."""
    if not callable(callback):
        raise TypeError(f"{call}: the last argument must be a function, not {_shown(callback)}")


def check_plain(call: str, callback: object) -> None:
    """Raise TypeError where it cannot be called, or is an `async def` that nothing would await."""
    check_callback(call, callback)
    if is_async(callback):
        raise TypeError(f"{call}: {_shown(callback)} must be a plain function, not an async def")


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


def check_seconds(call: str, seconds: object) -> None:
    """Raise TypeError where it is no number."""
    if isinstance(seconds, str) or not hasattr(seconds, "__float__"):
        raise TypeError(f"{call}: the first argument must be a number, not {_shown(seconds)}")


def check_part(what: str, part: Any, message: object) -> None:
    """Raise TypeError where the message is not of the type that the service or action takes."""
    if not isinstance(message, part):
        raise TypeError(f"{what} takes {part.__qualname__}, not {_shown(message)}")


def _shown(value: object) -> str:
    """The value in a sentence: a class or function by its name, a short value as it is."""
    name = getattr(value, "__qualname__", None)
    if callable(value) and isinstance(name, str):
        return printable(name, 60)
    if value is None or isinstance(value, str | int | float):
        return printable(repr(value), 60)
    return f"a value of type {type(value).__name__}"
