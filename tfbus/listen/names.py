"""How the frames of each stream are called here, and the reader of its messages."""

from tfbus.listen.info import StreamState
from tfbus.runtime.structs import replace
from tfbus.wire.fleet import Fleet, FrameNames
from tfbus.wire.keys import namespace_of
from tfbus.wire.scan import NameTables
from tfbus.wire.transforms import TransformReader

# Namespaces come from the bus: the names of at most this many are remembered.
MOST_NAMESPACES = 1000


class StreamNames:
    """Frames of the robots of a fleet have the namespace in front; without a fleet all keep their
    own names.
    """

    def __init__(self, fleet: Fleet | None) -> None:
        self._fleet = fleet
        self._names: dict[str, FrameNames] = {}
        self._readers: dict[str, TransformReader] = {}
        self._tables = NameTables()

    def at(self, key: str) -> FrameNames | None:
        """How the frames of a key's stream are called here; None: by their own names."""
        namespace = namespace_of(key) if self._fleet is not None else ""
        if self._fleet is None or not namespace:
            return None
        names = self._names.get(namespace)
        if names is None:
            self._make_room()
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

    def _make_room(self) -> None:
        # Receptions hold the readers that they use.
        if len(self._names) >= MOST_NAMESPACES:
            self._names.clear()
            self._readers.clear()
