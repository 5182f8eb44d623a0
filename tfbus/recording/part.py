"""A file of a recording: its streams, topics and events, and its chunks as items."""

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Collection, Container, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

from tfbus.base.errors import DecodeError
from tfbus.base.file_lock import is_held
from tfbus.base.wording import printable
from tfbus.geometry.columns import Columns
from tfbus.geometry.packed import EDGE_SIZE, POSE_SIZE, STAMP_SIZE
from tfbus.recording.items import (
    EventItem,
    Item,
    RecordedStream,
    Selection,
    TopicItem,
    TransformItem,
)
from tfbus.recording.layout import (
    ABOUT,
    ATTACHMENT,
    ENCODING,
    EVENT,
    REPEATED,
    SCHEMA_ENCODING,
    Index,
    IndexBuilder,
    decode_index,
    event_of,
    has_seq,
    is_numbered,
    is_retained,
    is_static_topic,
    stream_of,
    topic_of,
)
from tfbus.recording.mcap_file import McapFile
from tfbus.recording.records import Channel, Chunk, Damage, Message, Schema
from tfbus.recording.state import BusState
from tfbus.ros.counterparts import AS_IN_ROS, Counterpart, counterpart_of_ros, on_bus
from tfbus.ros.definitions import TF_MESSAGE, Definition
from tfbus.ros.message_type import PACKAGE, message_of
from tfbus.ros.schema import MessageCodec
from tfbus.ros.tf_message import TFMessageReader, equal_parts, read_many

Decode = Callable[[bytes], dict[str, Any]]


@dataclass(frozen=True, slots=True)
class StreamChannel:
    """A channel with transforms."""

    id: int
    stream: RecordedStream
    is_static: bool
    has_seq: bool


@dataclass(frozen=True, slots=True)
class TopicChannel:
    """A channel with messages of a topic; `decode` is None if tfbus does not read them, and
    `definition` if it is one of ours. `is_numbered` is whether a number says which messages only
    repeat the one in force. `ros_type` is the name of the type in the file, as ROS has it.
    """

    id: int
    topic: str
    type_name: str
    decode: Decode | None
    definition: Definition | None = None
    is_retained: bool = False
    is_numbered: bool = False
    ros_type: str = ""

    @property
    def is_readable(self) -> bool:
        """Whether tfbus reads the messages."""
        return self.decode is not None


# If static sets changed more often than that, their chunks are not read to see whether they can be.
_MOST_READ_CHANGES = 256


class Part:
    """A file of a recording. Raises OSError, and DecodeError unless it is one."""

    def __init__(self, file: McapFile, number: int = 0) -> None:
        self.file = file
        self.path = file.path
        self.number = number
        self.size = self.file.size
        self.is_complete = self.file.is_complete
        # Whether a recorder of this host was writing it when it was opened.
        self.is_growing = not self.is_complete and is_held(self.path)
        self.counts = self.file.counts
        self.stream_channels: dict[int, StreamChannel] = {}
        self.topic_channels: dict[int, TopicChannel] = {}
        self.tf = TFMessageReader()
        self.unreadable = 0
        for channel in self.file.channels.values():
            self._take_channel(channel, self.file.schemas.get(channel.schema_id))
        self.chunks = [StoredChunk(self, chunk) for chunk in self.file.chunks]

    def close(self) -> None:
        """Close the file."""
        self.file.close()

    @property
    def name(self) -> str:
        """The path as it can be printed."""
        return printable(str(self.path))

    @property
    def end_ns(self) -> int:
        """The log time of the last item; 0 if there is none."""
        events = [event.log_ns for event in self.events]
        return max([*(chunk.to_ns for chunk in self.chunks), *events], default=0)

    @property
    def about(self) -> Mapping[str, str]:
        """The metadata of the recorder, and of a tool that wrote the file of others."""
        said: dict[str, str] = {}
        for name, record in self.file.metadata:
            if name == ABOUT:
                said |= record
        return {printable(name): printable(text, 1000) for name, text in said.items()}

    @property
    def events(self) -> list[EventItem]:
        """The readable events in the order of the file."""
        found = []
        for name, record in self.file.metadata:
            if name == EVENT:
                try:
                    event = event_of(record)
                except DecodeError:
                    continue
                if event is not None:
                    found.append(event)
        return found

    @cached_property
    def index(self) -> Index:
        """Which transforms the chunks hold: of the file, or made by reading it once."""
        return self._said_index or self._made_index()

    @property
    def static_changes(self) -> Iterator[tuple[int, RecordedStream]]:
        """The log times at which streams got another static set, if the file says them."""
        for channel, log_ns in self._said_index.changes if self._said_index else ():
            if channel in self.stream_channels:
                yield log_ns, self.stream_channels[channel].stream

    @cached_property
    def static_times(self) -> list[tuple[int, int]]:
        """Channels, and the log times at which they got another static set; if the set cannot be
        read, the time at which it came again. If there are many it is as the index says.
        """
        known = [each for each in self.index.changes if each[0] in self.stream_channels]
        if len(known) > _MOST_READ_CHANGES:
            return known
        if not self._has_damage(known):
            return known
        came = [
            (channel.id, item.log_ns)
            for chunk in self.chunks
            if chunk.static_streams
            for item, channel in chunk.statics()
        ]
        later = (
            [each for each in came if each[0] == channel and each[1] >= log_ns]
            for channel, log_ns in known
        )
        return [min(times) for times in later if times]

    def _has_damage(self, changes: Collection[tuple[int, int]]) -> bool:
        """Whether a chunk with one of these changes cannot be read."""
        times = sorted(log_ns for _, log_ns in changes)
        for chunk in self.chunks:
            at = bisect_left(times, chunk.from_ns)
            if chunk.static_streams and at < len(times) and times[at] <= chunk.to_ns:
                self.file.messages(chunk.chunk)
                if self.file.is_damaged(chunk.offset):
                    return True
        return False

    def changed_sets(self, streams: Collection[str]) -> Iterator[TransformItem]:
        """The static sets of these streams in the chunks in which one of them got another."""
        times = sorted(
            log_ns
            for channel, log_ns in self.static_times
            if self.stream_channels[channel].stream.name in streams
        )
        state = BusState()
        for chunk in self.chunks:
            at = bisect_left(times, chunk.from_ns)
            if chunk.static_streams and at < len(times) and times[at] <= chunk.to_ns:
                for item, _ in chunk.statics():
                    if item.stream.name in streams and not state.says(item):
                        state.apply(item)
                        yield item

    @cached_property
    def _said_index(self) -> Index | None:
        said = self.file.attachment(ATTACHMENT) if self.is_complete else None
        offsets = [chunk.offset for chunk in self.chunks]
        try:
            return None if said is None else decode_index(said, offsets, self.stream_channels)
        except DecodeError:
            return None

    def _made_index(self) -> Index:
        builder = IndexBuilder()
        state = BusState()
        for chunk in self.chunks:
            for group in chunk.groups(self.stream_channels):
                builder.add(group.channel.id, group.rows, len(group.log_ns))
            if chunk.static_streams:
                for item, channel in chunk.statics():
                    if not state.says(item):
                        builder.add_change(channel.id, item.log_ns)
                    state.apply(item)
            builder.end_chunk(chunk.offset)
        return builder.build()

    def note_unreadable(self, chunk: Chunk, message: Message, error: DecodeError) -> None:
        """Count a message that does not fit its channel; the first of a channel is damage."""
        self.unreadable += 1
        stream = self.stream_channels.get(message.channel)
        topic = self.topic_channels.get(message.channel)
        if stream is not None:
            what = f"stream '{stream.stream.name}'"
        else:
            what = f"topic '{topic.topic}'" if topic is not None else "no topic"
        log_ns = message.log_ns
        size = len(message.data)
        self.file.note_damage(Damage(chunk.offset, size, str(error), log_ns, log_ns, None, what))

    def _take_channel(self, channel: Channel, schema: Schema | None) -> None:
        is_tf = schema is not None and schema.name == TF_MESSAGE.name
        if is_tf and channel.encoding == ENCODING:
            self.stream_channels[channel.id] = StreamChannel(
                channel.id,
                stream_of(channel.topic, channel.metadata),
                is_static_topic(channel.topic),
                has_seq(channel.metadata),
            )
            return
        topic = printable(topic_of(channel.topic, channel.metadata))
        ros_type = schema.name if schema else ""
        said = channel.metadata.get("tfbus.type", ros_type)
        counterpart = counterpart_of_ros(ros_type, said, topic)
        self.topic_channels[channel.id] = TopicChannel(
            channel.id,
            topic,
            counterpart.type_name if counterpart else printable(said),
            _decoder(channel, schema, counterpart),
            _definition(schema),
            is_retained(channel.metadata),
            is_numbered(channel.metadata),
            printable(ros_type),
        )


def _definition(schema: Schema | None) -> Definition | None:
    """A definition that others wrote. Ours are made again when they are written, under a name that
    is free in the new file.
    """
    if schema is None or schema.name.startswith(PACKAGE):
        return None
    try:
        return Definition(schema.name, schema.data.decode())
    except UnicodeDecodeError:
        return None


def _decoder(
    channel: Channel, schema: Schema | None, counterpart: Counterpart | None
) -> Decode | None:
    if schema is None or (channel.encoding, schema.encoding) != (ENCODING, SCHEMA_ENCODING):
        return None
    try:
        definition = Definition(schema.name, schema.data.decode())
        codec = MessageCodec.of_definition(definition, counterpart)
    except (DecodeError, UnicodeDecodeError):
        return None
    if definition.name not in AS_IN_ROS:
        return codec.decode
    message = message_of(definition)
    return lambda data: on_bus(codec.decode(data, arrays=True), message)


@dataclass(frozen=True, slots=True)
class Group:
    """Messages of one channel with the same frames and edges: their log times, and the rows of all
    of them, each message's after the other's.
    """

    channel: StreamChannel
    log_ns: list[int]
    rows: Columns

    def until(self, log_ns: int) -> "Group | None":
        """The messages up to a log time; None if there are none."""
        return self._slice(0, bisect_right(self.log_ns, log_ns))

    def behind(self, log_ns: int) -> "Group | None":
        """The messages behind a log time; None if there are none."""
        return self._slice(bisect_right(self.log_ns, log_ns), len(self.log_ns))

    def messages(self) -> "list[Group]":
        """Each message by itself."""
        found = (self._slice(at, at + 1) for at in range(len(self.log_ns)))
        return [each for each in found if each is not None]

    def _slice(self, start: int, end: int) -> "Group | None":
        if start >= end or end - start == len(self.log_ns):
            return self if start < end else None
        rows, size = self.rows, self.rows.count // len(self.log_ns)
        first, last = start * size, end * size
        part = Columns.of_bytes(
            rows.frames,
            rows.edges_bytes()[EDGE_SIZE * first : EDGE_SIZE * last],
            rows.stamps_bytes()[STAMP_SIZE * first : STAMP_SIZE * last],
            rows.poses_bytes()[POSE_SIZE * first : POSE_SIZE * last],
        )
        return Group(self.channel, self.log_ns[start:end], part)


class StoredChunk:
    """A chunk of a file; log times in nanoseconds. Unreadable messages are left out, and noted by
    the file.
    """

    __slots__ = (
        "chunk",
        "from_ns",
        "length",
        "offset",
        "part",
        "retained_topics",
        "static_streams",
        "to_ns",
    )

    def __init__(self, part: Part, chunk: Chunk) -> None:
        self.part = part
        self.chunk = chunk
        self.offset, self.length = chunk.offset, chunk.length
        self.from_ns, self.to_ns = chunk.from_ns, chunk.to_ns
        self.static_streams = frozenset(
            part.stream_channels[channel].stream.name
            for channel in chunk.channels
            if channel in part.stream_channels and part.stream_channels[channel].is_static
        )
        self.retained_topics = frozenset(
            part.topic_channels[channel].topic
            for channel in chunk.channels
            if channel in part.topic_channels and part.topic_channels[channel].is_retained
        )

    def is_taken(self, selection: Selection) -> bool:
        """Whether it may hold an item that the selection takes."""
        if selection.is_all or not self.chunk.channels:
            return True
        return any(self._is_taken(channel, selection) for channel in self.chunk.channels)

    def items(
        self, selection: Selection, tf: TFMessageReader
    ) -> tuple[list["Item | UnreadItem"], int]:
        """The items of the channels that the selection takes, whole, in the order of the file, and
        the bytes of their messages. `tf` reads transforms: of one thread, as it is not safe from
        several.
        """
        messages = self.part.file.messages(self.chunk)
        channels = {message.channel for message in messages}
        taken = {channel for channel in channels if self._is_taken(channel, selection)}
        messages = [message for message in messages if message.channel in taken]
        rows = self._rows_of(messages, tf)
        items: list[Item | UnreadItem] = []
        for at, message in enumerate(messages):
            stream = self.part.stream_channels.get(message.channel)
            if stream is None:
                items.append(UnreadItem(message.log_ns, self, message))
            elif at in rows:
                items.append(_transforms(message, stream, rows[at]))
        return items, sum([len(message.data) for message in messages])

    def groups(
        self, channels: Container[int], children: Collection[str] | None = None
    ) -> list[Group]:
        """The transforms of these channels, with all child frames or these, many messages at a
        time.
        """
        of_channel: dict[int, list[Message]] = {}
        for message in self.part.file.messages(self.chunk):
            if message.channel in channels:
                of_channel.setdefault(message.channel, []).append(message)
        found = []
        for number, messages in of_channel.items():
            channel = self.part.stream_channels[number]
            for members, rows in self._groups_of(messages, self.part.tf, children):
                found.append(Group(channel, [messages[at].log_ns for at in members], rows))
        return found

    def statics(self) -> Iterator[tuple[TransformItem, StreamChannel]]:
        """The sets of static transforms, in the order of the file, and their channels."""
        streams = self.part.stream_channels
        for message in self.part.file.messages(self.chunk):
            channel = streams.get(message.channel)
            if channel is not None and channel.is_static:
                try:
                    rows = self.part.tf.read(message.data)
                except DecodeError as error:
                    self.part.note_unreadable(self.chunk, message, error)
                    continue
                yield _transforms(message, channel, rows), channel

    def _is_taken(self, channel: int, selection: Selection) -> bool:
        stream = self.part.stream_channels.get(channel)
        if stream is not None:
            return selection.takes_transforms(stream.stream.name, static=stream.is_static)
        topic = self.part.topic_channels.get(channel)
        return topic is not None and topic.is_readable and selection.takes_topic(topic.topic)

    def _groups_of(
        self,
        messages: list[Message],
        tf: TFMessageReader,
        children: Collection[str] | None = None,
    ) -> list[tuple[list[int], Columns]]:
        """The transforms of messages that are alike, with their indices; unreadable messages are
        left out.
        """
        try:
            return read_many(tf, [message.data for message in messages], children)
        except DecodeError:
            pass
        found = []
        for at, message in enumerate(messages):
            try:
                groups = read_many(tf, [message.data], children)
            except DecodeError as error:
                self.part.note_unreadable(self.chunk, message, error)
                continue
            found += [([at], rows) for _, rows in groups]
        return found

    def _rows_of(self, messages: list[Message], tf: TFMessageReader) -> dict[int, Columns]:
        """The transforms of the messages of streams, by their indices."""
        members: dict[int, list[int]] = {}
        for at, message in enumerate(messages):
            if message.channel in self.part.stream_channels:
                members.setdefault(message.channel, []).append(at)
        found: dict[int, Columns] = {}
        for of_channel in members.values():
            for group, rows in self._groups_of([messages[at] for at in of_channel], tf):
                for at, each in zip(group, equal_parts(rows, len(group)), strict=True):
                    found[of_channel[at]] = each
        return found

    def topic_item(self, message: Message) -> TopicItem | None:
        """The item of a message of a topic; None if it cannot be read."""
        topic = self.part.topic_channels[message.channel]
        if topic.decode is None:
            return None
        try:
            values = topic.decode(message.data)
        except DecodeError as error:
            self.part.note_unreadable(self.chunk, message, error)
            return None
        encoded = None if topic.definition is None else (topic.definition, message.data)
        return TopicItem(
            message.log_ns,
            topic.topic,
            topic.type_name,
            values,
            encoded,
            topic.is_retained,
            topic.is_retained and topic.is_numbered and message.sequence == REPEATED,
        )


class UnreadItem(NamedTuple):
    """A message of a topic, which is decoded when its turn comes: its values take up to fifty
    times its bytes.
    """

    log_ns: int
    chunk: StoredChunk
    message: Message

    def read(self) -> TopicItem | None:
        """The item; None if it cannot be read."""
        return self.chunk.topic_item(self.message)


def read_items(items: Iterable[Item | UnreadItem]) -> Iterator[Item]:
    """The readable items, each decoded when it is asked for."""
    for each in items:
        item = each.read() if isinstance(each, UnreadItem) else each
        if item is not None:
            yield item


def _transforms(message: Message, channel: StreamChannel, rows: Columns) -> TransformItem:
    seq = message.sequence if channel.has_seq else None
    return TransformItem(message.log_ns, channel.stream, rows, channel.is_static, seq)
