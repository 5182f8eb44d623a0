"""How the frames of several robots are called by who sees them all.

Each robot has a namespace and calls its frames as all others do: `base_link`. Seen from outside
they are `robot7/base_link`, but for those that the robots share, such as `map`.
"""

from collections.abc import Iterable
from dataclasses import replace

from tfbus.errors import InvalidArgumentException
from tfbus.geometry.transform import check_frame_id
from tfbus.wire.descriptions import StreamDescription

# A stream sends a few tables of names, over and over; of one that makes up more, none is kept.
_MOST_TABLES = 64


class FrameNames:
    """The names of one robot's frames as they are seen from outside of its namespace.

    Names that no frame can have stay as they are, for the buffer to refuse.
    """

    def __init__(self, namespace: str, shared_frames: Iterable[str] = ()) -> None:
        self.namespace = namespace
        self.shared_frames = frozenset(shared_frames)
        self._tables: dict[tuple[str, ...], tuple[str, ...]] = {}

    def outside(self, frame: str) -> str:
        """What a frame is called from outside: `robot7/base_link`, or `map` where it is shared."""
        if not self.namespace or not frame or frame[0] == "/" or frame in self.shared_frames:
            return frame
        return f"{self.namespace}/{frame}"

    def all_outside(self, frames: tuple[str, ...]) -> tuple[str, ...]:
        """What the frames of a message are called from outside."""
        if not self.namespace:
            return frames
        outside = self._tables.get(frames)
        if outside is None:
            if len(self._tables) >= _MOST_TABLES:
                self._tables.clear()
            outside = self._tables[frames] = tuple(map(self.outside, frames))
        return outside

    def description_outside(self, description: StreamDescription) -> StreamDescription:
        """The description of a stream, its frames as they are called from outside."""
        if not self.namespace:
            return description
        frames = (
            (self.outside(parent), self.outside(child), static)
            for parent, child, static in description.frames
        )
        return replace(description, frames=tuple(frames))


class Fleet:
    """All robots in the namespaces below a node's own, and the frames that they share."""

    def __init__(self, shared_frames: Iterable[str] = ()) -> None:
        if isinstance(shared_frames, str):
            raise InvalidArgumentException(
                f"shared_frames is the text {shared_frames!r}; write ({shared_frames!r},)"
            )
        self.shared_frames = frozenset(check_frame_id(frame) for frame in shared_frames)

    def names(self, namespace: str) -> FrameNames:
        """The names of the frames of one robot, by its namespace as it is seen here."""
        return FrameNames(namespace, self.shared_frames)


def shared_name(first: str, second: str) -> str:
    """What `robot7/world` and `robot8/world` are called where the robots share it; "" for names
    that are not alike.
    """
    (a, _, name), (b, _, other) = first.rpartition("/"), second.rpartition("/")
    return name if a and b and a != b and name == other else ""
