"""What a node tells about itself on the bus, as docs/wire.md has it."""

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class ParameterDescription:
    """A parameter: its name, what it is now, of which type, and, for numbers, its bounds."""

    name: str
    value: Any
    type: str
    description: str = ""
    minimum: Any = None
    maximum: Any = None


@dataclass(frozen=True)
class NodeDescription:
    """A node: who, where, since when (ns since the Unix epoch), and its interfaces.

    `publishes`, `subscribes`, `serves` and `calls` map names to the names of their types.
    """

    name: str
    host: str
    pid: int
    version: str
    session: str
    started_ns: int
    streams: tuple[str, ...]
    parameters: tuple[ParameterDescription, ...]
    publishes: dict[str, str]
    subscribes: dict[str, str]
    serves: dict[str, str]
    calls: dict[str, str]
