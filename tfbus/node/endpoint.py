"""What all of a node's topics, services and goals have in common: a name, a type, and an end."""

from typing import Protocol

from tfbus.wire.codec import type_name


class Closable(Protocol):
    """Something of the session that ends when it is no longer needed."""

    def close(self) -> None:
        """End it; twice is fine."""


class Interface:
    """One side of a topic, a service or a goal; it ends with its node, or by `close()` before."""

    def __init__(self, name: str, type_: type | str) -> None:
        """Of a type, or of the name of one where only its bytes are handled."""
        self.name = name
        self.type_name = type_ if isinstance(type_, str) else type_name(type_)
        self.closed = False
        self._parts: list[Closable] = []

    def close(self) -> None:
        """End it: nothing is sent, heard or served any more. Twice is fine."""
        self.closed = True
        while self._parts:
            self._parts.pop().close()
