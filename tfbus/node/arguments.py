"""Checks what a node's methods are given, and names what they want."""

from typing import Any

from tfbus.runtime.arguments import shown
from tfbus.wire.codec import is_message_type


def check_message_type(call: str, message_type: object) -> None:
    """Raise TypeError if it is no dataclass; `call` is the call as it should be."""
    if not is_message_type(message_type):
        raise TypeError(
            f"{call}: message_type must be a class of messages, a dataclass such as "
            f"tfbus.messages.Pose, not {shown(message_type)}"
        )


def check_parts(call: str, type_: object, parts: tuple[str, ...]) -> None:
    """Raise TypeError if it is no class that holds these dataclasses: a type of service or
    action.
    """
    missing = [part for part in parts if not is_message_type(getattr(type_, part, None))]
    if missing or not isinstance(type_, type):
        raise TypeError(
            f"{call}: the type must be a class that holds the dataclasses {' and '.join(parts)}, "
            f"not {shown(type_)}"
        )


def check_seconds(call: str, seconds: object) -> None:
    """Raise TypeError if it is no number."""
    if isinstance(seconds, str) or not hasattr(seconds, "__float__"):
        raise TypeError(f"{call}: the first argument must be a number, not {shown(seconds)}")


def check_part(what: str, part: Any, message: object) -> None:
    """Raise TypeError if the message is not of the type that the service or action takes."""
    if not isinstance(message, part):
        raise TypeError(f"{what} takes {part.__qualname__}, not {shown(message)}")
