"""The names that recorded streams and topics have on the bus if they are replayed."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from tfbus.recording.items import RecordedStream
from tfbus.wire.keys import check_namespace, check_no_transforms, check_topic, escape


@dataclass(frozen=True)
class ReplayedNames:
    """`prefix` is a namespace that all names go into, "" for none. `remappings` have another name
    for some, which gets no prefix. Names are full, with or without a slash before them.

    Raises InvalidNameError if the prefix is no namespace.
    """

    prefix: str = ""
    remappings: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "prefix", check_namespace(self.prefix))
        pairs = {old.lstrip("/"): new.lstrip("/") for old, new in self.remappings.items()}
        object.__setattr__(self, "remappings", pairs)

    def topic(self, name: str) -> str:
        """The name of a topic. Raises InvalidNameError if no topic can have it."""
        new = self.remappings.get(name) or self._below(name)
        return check_no_transforms(check_topic(new))

    def stream(self, stream: RecordedStream) -> str:
        """The name of a stream."""
        return self.remappings.get(stream.name) or self._below(stream.name)

    def stream_key(self, stream: RecordedStream) -> str:
        """The key of a stream's token and description, as `wire.keys.stream_key` with its namespace
        before it.
        """
        if new := self.remappings.get(stream.name):
            namespace, _, own = new.rpartition("/")
        else:
            namespace = self._below(stream.namespace) if stream.namespace else self.prefix
            own = stream.name.removeprefix(f"{stream.namespace}/" if stream.namespace else "")
        key = f"@tfbus/stream/{escape(own)}"
        return f"{check_namespace(namespace)}/{key}" if namespace else key

    def _below(self, name: str) -> str:
        return f"{self.prefix}/{name}" if self.prefix else name
