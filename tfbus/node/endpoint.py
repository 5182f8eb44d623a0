"""The common part of topics, services and actions of a node: a name, a type, an end."""

from typing import Protocol

from tfbus.wire.codec import type_name


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
