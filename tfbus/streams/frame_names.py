"""The frames of each stream: their names here, and the frames that its publishers may send.

Zenoh's access control lets a stream come only from an identity that may have a stream of its name.
Which frames are in a message, and which node a description names, only the receiver sees.
"""

from typing import TYPE_CHECKING

from tfbus.base.bounded import Bounded
from tfbus.base.structs import replace
from tfbus.base.wording import listed
from tfbus.bus.patterns import matches
from tfbus.bus.settings import NodeSettings
from tfbus.streams.info import StreamState
from tfbus.streams.stages import FrameRights
from tfbus.streams.stream_facts import StreamFacts
from tfbus.wire.descriptions import StreamDescription
from tfbus.wire.fleet import Fleet, FrameNames
from tfbus.wire.keys import last_name, namespace_of
from tfbus.wire.transform_bytes import NameTables
from tfbus.wire.transforms import TransformReader

if TYPE_CHECKING:
    # Of closed buses only.
    from tfbus.bus.rights import Rights

# Namespaces come from the bus: the names of at most this many are remembered.
MOST_NAMESPACES = 1000


class StreamNames:
    """Frames of the robots of a fleet have the namespace in front; without a fleet all keep their
    own names.
    """

    def __init__(self, fleet: Fleet | None) -> None:
        self._fleet = fleet
        self._names: Bounded[str, FrameNames] = Bounded(MOST_NAMESPACES)
        # Receptions hold the readers that they use.
        self._readers: Bounded[str, TransformReader] = Bounded(MOST_NAMESPACES)
        self._tables = NameTables()

    def at(self, key: str) -> FrameNames | None:
        """How the frames of a key's stream are called here; None: by their own names."""
        namespace = namespace_of(key) if self._fleet is not None else ""
        if self._fleet is None or not namespace:
            return None
        names = self._names.get(namespace)
        if names is None:
            names = self._names[namespace] = self._fleet.names(namespace)
        return names

    def of_message(self, key: str, frames: tuple[str, ...]) -> tuple[str, ...]:
        """How the frames of a message on a key are called here."""
        names = self.at(key)
        return frames if names is None else names.all_outside(frames)

    def called(self, state: StreamState) -> StreamState:
        """The state of a stream, with frames as they are called here."""
        names, description = self.at(state.key), state.description
        if names is None or description is None:
            return state
        return replace(state, description=names.description_outside(description))

    def reader(self, key: str) -> TransformReader:
        """The reader of messages on a key, one for all keys of a namespace."""
        names = self.at(key)
        namespace = "" if names is None else names.namespace
        reader = self._readers.get(namespace)
        if reader is None:
            reader = self._readers[namespace] = TransformReader(names, self._tables)
        return reader


class StreamRights:
    """The rights that concern streams, as a session of these settings sees their keys."""

    def __init__(self, rights: "Rights", namespace: str) -> None:
        self._rights = rights
        self._namespace = namespace

    @classmethod
    def of_settings(cls, settings: NodeSettings) -> "StreamRights | None":
        """The rights of a closed bus; None on an open one."""
        closed = settings.closed
        return None if closed is None else cls(closed.rights, settings.namespace)

    def frames(self, key: str, facts: StreamFacts, *, is_fleet: bool) -> FrameRights | None:
        """The frames that may come on the stream of a key; None if all may."""
        patterns = self._rights.frames_of_stream(self._stream(key), self._namespace_at(key))
        if patterns is None:
            return None
        prefix = f"{namespace_of(key)}/" if is_fleet and namespace_of(key) else ""
        return FrameRights(patterns, prefix, facts)

    def checked(
        self, key: str, description: StreamDescription
    ) -> tuple[StreamDescription | None, str]:
        """The description without frames that its stream may not have, and why; None if its node
        may not publish it.
        """
        namespace, stream = self._namespace_at(key), self._stream(key)
        if not self._rights.may_be_of(description.node, stream, namespace):
            return None, f"names node {description.node!r}, which may not publish it"
        patterns = self._rights.frames_of_stream(stream, namespace)
        if patterns is None:
            return description, ""
        kept = tuple(
            row for row in description.frames if any(matches(each, row[1]) for each in patterns)
        )
        if len(kept) == len(description.frames):
            return description, ""
        allowed = {child for _, child, _ in kept}
        refused = [child for _, child, _ in description.frames if child not in allowed]
        return replace(description, frames=kept), (
            f"may not publish {listed([repr(child) for child in refused])}, only "
            f"{listed(patterns) or 'nothing'}"
        )

    def _namespace_at(self, key: str) -> str:
        return "/".join(filter(None, (self._namespace, namespace_of(key))))

    def _stream(self, key: str) -> str:
        # A split stream's key has the child frame behind.
        return last_name(key) if "@tfbus/" in key else _stream_in(key, namespace_of(key))


def _stream_in(key: str, namespace: str) -> str:
    below = key.removeprefix(f"{namespace}/") if namespace else key
    return last_name("/".join(below.split("/")[:2]))
