"""Items from the bus, as items of a recording."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

from tfbus.recording.items import EventItem, RecordedStream, TopicItem, TransformItem
from tfbus.ros.schema import MessageCodec
from tfbus.wire.codec import decode_map
from tfbus.wire.descriptions import StreamDescription
from tfbus.wire.transforms import TransformReader


class Names:
    """Names as a session of this namespace has them, as one without a namespace does."""

    def __init__(self, namespace: str) -> None:
        self._prefix = f"{namespace}/" if namespace else ""

    def full(self, name: str) -> str:
        """`turtle1/pose` in the namespace robot7 is `robot7/turtle1/pose`."""
        return name[1:] if name.startswith("/") else f"{self._prefix}{name}"

    def namespace(self, below: str) -> str:
        """The namespace of what is in the namespace `below` ours."""
        return f"{self._prefix}{below}".rstrip("/")


class TransformSource:
    """The transforms of one key of a stream; `described` has the descriptions of streams."""

    def __init__(
        self,
        name: str,
        namespace: str,
        described: Mapping[str, StreamDescription],
        reader: TransformReader,
        *,
        static: bool,
    ) -> None:
        self.kind = "statics" if static else "transforms"
        self.is_essential = static
        self.name = name
        self._namespace = namespace
        self._described = described
        self._reader = reader
        self._static = static
        self._last: tuple[StreamDescription | None, RecordedStream] | None = None

    def is_described(self) -> bool:
        """Whether its publisher's node is known."""
        return self.name in self._described

    def item(self, log_ns: int, payload: bytes) -> TransformItem:
        """A message, read. Raises DecodeError."""
        message = self._reader.read(payload)
        description = self._described.get(self.name)
        last = self._last
        if last is None or last[0] is not description or last[1].epoch_ns != message.epoch_ns:
            last = self._last = (description, self._stream(description, message.epoch_ns))
        return TransformItem(log_ns, last[1], message.rows, self._static, message.seq)

    def _stream(self, description: StreamDescription | None, epoch_ns: int) -> RecordedStream:
        if description is None:
            return RecordedStream(self.name, "", self._namespace, epoch_ns)
        return RecordedStream(
            self.name, description.node, self._namespace, epoch_ns, description.split
        )


class TopicSource:
    """The messages of one topic; `types` has the type names of topics, and `codecs` those of ROS's
    types among them. Retained ones stay in force, and so begin each file.

    `on_unfit(name)` is called for a message that is not of the type that its publisher says.
    """

    kind = "topics"

    def __init__(
        self,
        name: str,
        types: Mapping[str, str],
        codecs: Mapping[str, MessageCodec] = MappingProxyType({}),
        *,
        retained: bool = False,
        on_unfit: Callable[[str], object] = lambda name: None,
    ) -> None:
        self.name = name
        self.is_essential = retained
        self._types = types
        self._codecs = codecs
        self._on_unfit = on_unfit

    def is_described(self) -> bool:
        """Whether its type is known."""
        return self.name in self._types

    def item(self, log_ns: int, payload: bytes) -> TopicItem:
        """A message, read. Raises DecodeError."""
        values = decode_map(payload)
        type_name = self._types.get(self.name, "")
        encoded = None
        if (codec := self._codecs.get(self.name)) is not None:
            if (message := codec.encode_fitted(values)) is not None:
                encoded = codec.definition, message
            else:
                self._on_unfit(self.name)
        return TopicItem(log_ns, self.name, type_name, values, encoded, self.is_essential)


class EventSource:
    """What happened: its payloads are events."""

    kind = "events"
    is_essential = True

    def is_described(self) -> bool:
        """An event says all itself."""
        return True

    def item(self, log_ns: int, payload: Any) -> EventItem:
        """The event, at the time when it came."""
        event: EventItem = payload
        return replace(event, log_ns=log_ns)


EVENTS = EventSource()
