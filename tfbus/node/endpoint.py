"""The common part of topics, services and actions of a node: checks, a name, a type, an end."""

from typing import Any, Protocol

from tfbus.runtime.arguments import shown
from tfbus.wire.codec import is_message_type, type_name


class Closable(Protocol):
    """A declaration of the session."""

    def close(self) -> None:
        """End it; twice is fine."""


class Endpoint:
    """An end of a topic, service or action; it ends with its node, or by `close()` before.

    `type_` is a message class, or its name if the endpoint handles bytes only. `retained` says
    of a publisher whether its last message also reaches subscribers that join later. `definition`
    is that of the type in ROS, if it has one that others cannot know.
    """

    def __init__(
        self, name: str, type_: type | str, *, retained: bool = False, definition: str = ""
    ) -> None:
        self.name = name
        self.definition = definition
        self.retained = retained
        self.type_name = type_ if isinstance(type_, str) else type_name(type_)
        self.closed = False
        self._parts: list[Closable] = []

    def close(self) -> None:
        """End it: it sends, receives and serves nothing after that. Twice is fine."""
        self.closed = True
        while self._parts:
            self._parts.pop().close()


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
