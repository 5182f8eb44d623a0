"""The contents of a recording, item by item, each with the time at which it was received."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from tfbus.geometry.columns import Columns
from tfbus.ros.definitions import Definition
from tfbus.ros.message_type import message_of

EventKind = Literal[
    "stream", "stream gone", "node", "node gone", "paused", "resumed", "dropped", "filled"
]


@dataclass(frozen=True)
class RecordedStream:
    """A stream in one epoch.

    `name` is as a session without a namespace has it, `robot7/sim`, and `namespace` its part
    `robot7`. `node` is the full name of its publisher, "" if no description had come. `split`
    is whether each frame has a key of its own.
    """

    name: str
    node: str = ""
    namespace: str = ""
    epoch_ns: int = 0
    split: bool = False


@dataclass(frozen=True)
class TransformItem:
    """A message of transforms. With `static` the rows are all static transforms of the stream, and
    replace those before. `seq` counts the messages of its key in its epoch.
    """

    log_ns: int
    stream: RecordedStream
    rows: Columns
    static: bool = False
    seq: int | None = None


@dataclass(frozen=True)
class TopicItem:
    """A message of a topic: its fields by name, as they go over the bus. `type_name` is the name of
    its type, as its publisher's node says, "" if it does not. A `retained` one stays in force until
    the next.

    `encoded` is the same message as ROS 2 has it, with the definition of its type, if it comes
    from a file: so it is written again as it was. A `repeated` one was in force already at its log
    time, as at the beginning of a file: it was not sent then.
    """

    log_ns: int
    topic: str
    type_name: str
    values: Mapping[str, Any]
    encoded: tuple[Definition, bytes] | None = field(default=None, compare=False, repr=False)
    retained: bool = False
    repeated: bool = field(default=False, compare=False)

    @property
    def with_arrays(self) -> Mapping[str, Any]:
        """Its fields with arrays of numpy in the place of binaries."""
        if self.encoded is None:
            return self.values
        from tfbus.ros.counterparts import with_arrays  # with all messages, which few items need

        found: dict[str, Any] = with_arrays(self.values, message_of(self.encoded[0]))
        return found

    @property
    def content(self) -> object:
        """Its type and fields in a form that has a hash, equal to that of a message with the same
        bits.
        """
        return self.type_name, _with_hash(self.values)


def _with_hash(value: Any) -> object:
    if isinstance(value, Mapping):
        return tuple([(name, _with_hash(each)) for name, each in value.items()])
    if isinstance(value, memoryview | bytes):
        return bytes(value)
    if isinstance(value, list) and value and isinstance(value[0], dict | list | bytes | memoryview):
        return tuple(map(_with_hash, value))
    # As a text: 1, 1.0 and True are equal, and nan is not.
    return repr(value)


@dataclass(frozen=True)
class EventItem:
    """An event on the bus, or of the recorder.

    "stream": the stream `name` is there, or has another description, whose fields are `facts` (as
    in docs/reference/wire.md). "node": the same of a node. "stream gone", "node gone": its token
    was lost. "paused", "resumed": the recorder was. "dropped": `facts["messages"]` messages were
    not recorded, as the disk or the machine was too slow. "filled": the recorder `name`
    was out of reach until `facts["until"]`, and `facts["messages"]` that it had kept were written
    later; `facts["lost"]` are the streams and nodes that seemed to be gone then.
    """

    log_ns: int
    kind: EventKind
    name: str = ""
    facts: Mapping[str, Any] = field(default_factory=dict)

    @property
    def dropped(self) -> int:
        """How many messages were not recorded; 0 of other events, and where that is no number."""
        messages = self.facts.get("messages") if self.kind == "dropped" else 0
        return messages if isinstance(messages, int) else 0


Item = TransformItem | TopicItem | EventItem
