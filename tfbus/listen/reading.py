"""What a listener reads of all that is sent; without more ado, everything."""

from collections.abc import Callable
from typing import Protocol

from tfbus.bus.handles import Declaration
from tfbus.listen.watch import StreamState
from tfbus.wire.fleet import FrameNames
from tfbus.wire.keys import (
    ALL_STATIC_TRANSFORMS,
    ALL_STATIC_TRANSFORMS_EVERYWHERE,
    ALL_TRANSFORMS,
    ALL_TRANSFORMS_EVERYWHERE,
    transforms_key_beside,
)

# Have what comes on a key of a stream received, until the declaration is closed: stream, key,
# and whether it carries static transforms.
Subscribe = Callable[[str, str, bool], Declaration]
# A key is read no more, and its frames would only grow old: stream, key, frames.
Forget = Callable[[str, str, set[str]], object]


class Reading(Protocol):
    """What a listener reads of all that is sent."""

    def need(self, target: str, source: str) -> None:
        """Read what a lookup of this pair needs, from now on and for ever."""

    def update(self, state: StreamState, names: FrameNames | None) -> None:
        """Take what a stream says of its frames now, and what they are called here."""

    def keys_of(self, stream_key: str) -> list[str]:
        """The keys of the dynamic transforms of the stream of a token that are read now."""

    def close(self) -> None:
        """Read nothing any more. Twice is fine."""


class Everything:
    """Reads all streams of a namespace; `everywhere` also those of the namespaces below it."""

    def __init__(self, subscribe: Subscribe, *, everywhere: bool = False) -> None:
        moving, fixed = (
            (ALL_TRANSFORMS_EVERYWHERE, ALL_STATIC_TRANSFORMS_EVERYWHERE)
            if everywhere
            else (ALL_TRANSFORMS, ALL_STATIC_TRANSFORMS)
        )
        self._declarations = [subscribe("", moving, False), subscribe("", fixed, True)]

    def need(self, target: str, source: str) -> None:
        """Whatever it is, it is read."""

    def update(self, state: StreamState, names: FrameNames | None) -> None:
        """Whatever there is, it is read."""

    def keys_of(self, stream_key: str) -> list[str]:
        """All keys of the stream, as one key expression."""
        return [f"{transforms_key_beside(stream_key)}/**"]

    def close(self) -> None:
        """Read nothing any more. Twice is fine."""
        for declaration in self._declarations:
            declaration.close()
