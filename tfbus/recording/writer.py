"""Writes a recording: items into one MCAP file."""

import errno
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from typing import Literal, get_args

from tfbus.base.errors import InvalidArgumentException
from tfbus.base.file_lock import hold
from tfbus.base.installation import installed_version
from tfbus.recording.items import EventItem, Item, RecordedStream, TopicItem, TransformItem
from tfbus.recording.layout import (
    ABOUT,
    ENCODING,
    EVENT,
    PROFILE,
    REPEATED,
    SCHEMA_ENCODING,
    IndexBuilder,
    check_log_time,
    check_text,
    event_metadata,
    stream_metadata,
    stream_topic,
    topic_metadata,
)
from tfbus.recording.state import BusState
from tfbus.ros.definitions import TF_MESSAGE, Definition
from tfbus.ros.schema import MessageCodecs
from tfbus.ros.tf_message import TFMessageWriter, only_stamp
from tfbus.wire.codec import stamp_in

Compression = Literal["zstd", "lz4", "none"]

# A chunk ends when it has this many bytes: a seek reads one, and a larger one is hardly smaller
# when compressed.
CHUNK_BYTES = 128 * 1024

# Of MCAP: channels are numbered in 16 bits, the numbers of messages in 32.
_MOST_CHANNELS = 2**16 - 2
_SEQUENCES = 2**32

# The bytes of a message besides its data.
_MESSAGE_BYTES = 31


class RecordingWriter(AbstractContextManager["RecordingWriter"]):
    """Writes one file, item by item; use it in a `with`. Not thread-safe.

    After an OSError, as of a full disk, the file ends at the last `flush`, and each further `write`
    raises one.

    `statics_every_s` seconds after they were written the static transforms in force are written
    again, so that a seek or a cut finds them nearby. `about` describes the recorder, as texts in
    the file. Raises FileExistsError for a file that exists, and other OSErrors.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        compression: Compression = "zstd",
        statics_every_s: float = 5.0,
        about: Mapping[str, str] | None = None,
    ) -> None:
        from mcap.writer import CompressionType, Writer  # the extra `bag`

        if compression not in (known := get_args(Compression)):
            raise InvalidArgumentException(
                f"compression {compression!r} is none of {', '.join(known)}"
            )
        self._path = os.fspath(path)
        self._file = open(path, "xb")  # noqa: SIM115 - closed by close
        self._let_go = hold(self._file)  # readers know by the lock that the file grows
        self._process = os.getpid()
        self._has_failed = False
        # Chunks end as `_end_chunk` says.
        self._mcap = Writer(
            self._file, chunk_size=2**62, compression=CompressionType[compression.upper()]
        )
        self._tf = TFMessageWriter()
        self._topics = MessageCodecs()
        self._schemas: dict[Definition, int] = {}
        self._stream_channels: dict[tuple[RecordedStream, bool, bool], int] = {}
        self._topic_channels: dict[tuple[str, str, Definition, bool], int] = {}
        self._channels = 0
        self._sequences: dict[int, int] = {}
        self._state = BusState()
        self._statics_every_ns = int(statics_every_s * 1e9)
        self._statics_ns: int | None = None
        self._index = IndexBuilder()
        self._pending = 0
        self._mcap.start(PROFILE, f"tfbus {installed_version()}")
        self._mcap.add_metadata(
            ABOUT, {"version": installed_version(), **{k: str(v) for k, v in (about or {}).items()}}
        )

    @property
    def size(self) -> int:
        """How many bytes have been written, with bytes that wait for the end of their chunk."""
        return self._file.tell() + self._pending if not self._file.closed else self._size

    _size = 0
    # The bytes of the last message that was written.
    last_data = b""

    def write(self, item: Item) -> None:
        """Write an item. Raises OSError, and InvalidArgumentException, with nothing written, if
        the file cannot hold it, as a stamp after the year 2038.
        """
        check_log_time(item.log_ns)
        with self._failing():
            self._write(item)

    def write_late(self, items: Iterable[Item]) -> Iterator[InvalidArgumentException]:
        """Write items of a time before the last one, whose state they do not change, as a chunk of
        their own; the errors of items that the file cannot hold. Raises OSError.
        """
        with self._failing():
            self._end_chunk()
        for item in items:
            try:
                check_log_time(item.log_ns)
                with self._failing():
                    if isinstance(item, EventItem):
                        self._mcap.add_metadata(EVENT, event_metadata(item))
                    elif isinstance(item, TopicItem):
                        self._write_topic(item)
                    else:
                        channel = self._write_transforms(item)
                        if item.static:
                            self._index.add_change(channel, item.log_ns)
            except InvalidArgumentException as error:
                yield error
        with self._failing():
            self._end_chunk()

    def data_of(self, item: TransformItem | TopicItem) -> bytes:
        """The bytes of an item in the file."""
        if isinstance(item, TransformItem):
            return self._tf.write(item.rows)
        return (item.encoded or self._encoded(item))[1]

    def add_about(self, about: Mapping[str, str]) -> None:
        """Add to the description of the recorder that was not known at the beginning."""
        with self._failing():
            self._mcap.add_metadata(ABOUT, dict(about))

    def flush(self) -> None:
        """End the chunk and give it to the system: the items so far are safe from the end of this
        process.
        """
        with self._failing():
            self._end_chunk()
            self._file.flush()

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Write the summary and the indices, and close the file. In a forked child only close it:
        its parent goes on to write. Raises OSError.
        """
        if self._file.closed:
            return
        if os.getpid() != self._process:
            self._abandon()
            return
        try:
            if not self._has_failed:
                with self._failing():
                    self._end_chunk()
                    self._index.write(self._mcap)
                    self._mcap.finish()  # type: ignore[no-untyped-call]  # mcap leaves it untyped
                    self._file.flush()
        finally:
            self._size = self._file.tell()
            self._let_go()
            self._abandon() if self._has_failed else self._file.close()

    def _write(self, item: Item) -> None:
        if isinstance(item, EventItem):
            self._mcap.add_metadata(EVENT, event_metadata(item))
        elif isinstance(item, TopicItem):
            self._write_topic(item)
        else:
            channel = self._write_transforms(item)
            if item.static:
                self._statics_ns = self._statics_ns or item.log_ns
                if not self._state.says(item):
                    self._index.add_change(channel, item.log_ns)
        self._state.apply(item)
        self._repeat_statics(item.log_ns)
        if self._pending >= CHUNK_BYTES:
            self._end_chunk()

    @contextmanager
    def _failing(self) -> Iterator[None]:
        """Inside the `with` an OSError ends the writing."""
        if self._has_failed:
            raise OSError(errno.EIO, "an earlier error ended the file", self._path)
        try:
            yield
        except OSError:
            self._has_failed = True
            raise

    def _abandon(self) -> None:
        """Close the file without writing the bytes that Python still holds."""
        with suppress(OSError):
            self._file.raw.close()

    def _write_transforms(self, item: TransformItem) -> int:
        """Write transforms; the channel."""
        data = self._tf.write(item.rows)
        channel = self._stream_channel(item)
        newest = only_stamp(item.rows)
        if newest is None:
            newest = max(item.rows.stamps_as_ints(), default=item.log_ns)
        self._add(channel, item.log_ns, data, newest, item.seq or 0)
        self._index.add(channel, item.rows)
        return channel

    def _write_topic(self, item: TopicItem) -> None:
        definition, data = item.encoded or self._encoded(item)
        key = (item.topic, item.type_name, definition, item.retained)
        channel = self._topic_channels.get(key)
        if channel is None:
            check_text(item.topic)
            check_text(item.type_name)
            channel = self._new_channel(f"/{item.topic}", definition, topic_metadata(item))
            self._topic_channels[key] = channel
        stamp_ns = stamp_in(item.values) or 0  # 0 stands for no time
        publish_ns = stamp_ns if 0 < stamp_ns < 2**63 else item.log_ns
        sequence = REPEATED
        if not item.repeated:
            sequence = self._sequences[channel] = self._sequences.get(channel, REPEATED) + 1
        self._add(channel, item.log_ns, data, publish_ns, sequence)

    def _encoded(self, item: TopicItem) -> tuple[Definition, bytes]:
        codec, data = self._topics.encode(item.type_name or item.topic, item.values)
        return codec.definition, data

    def _add(self, channel: int, log_ns: int, data: bytes, publish_ns: int, sequence: int) -> None:
        self.last_data = data
        self._mcap.add_message(channel, log_ns, data, max(0, publish_ns), sequence % _SEQUENCES)
        self._pending += len(data) + _MESSAGE_BYTES

    def _stream_channel(self, item: TransformItem) -> int:
        stream, has_seq = item.stream, item.seq is not None
        key = (stream, item.static, has_seq)
        channel = self._stream_channels.get(key)
        if channel is None:
            for text in (stream.name, stream.node, stream.namespace):
                check_text(text)
            channel = self._new_channel(
                stream_topic(stream, item.static),
                TF_MESSAGE,
                stream_metadata(stream, item.static, has_seq=has_seq),
            )
            self._stream_channels[key] = channel
        return channel

    def _new_channel(self, topic: str, definition: Definition, metadata: dict[str, str]) -> int:
        if self._channels >= _MOST_CHANNELS:
            raise InvalidArgumentException(
                f"the file has {self._channels} channels, and cannot have more: one is needed for "
                "each topic, and each stream between two restarts; begin another file"
            )
        schema = self._schemas.get(definition)
        if schema is None:
            schema = self._mcap.register_schema(
                definition.name, SCHEMA_ENCODING, definition.text.encode()
            )
            self._schemas[definition] = schema
        self._channels += 1
        return self._mcap.register_channel(topic, ENCODING, schema, metadata)

    def _repeat_statics(self, log_ns: int) -> None:
        last_ns = self._statics_ns
        # Also where the system's clock was set back: a reader of that time finds them there.
        if last_ns is None or last_ns <= log_ns < last_ns + self._statics_every_ns:
            return
        self._statics_ns = log_ns
        for item in self._state.items(log_ns):
            if isinstance(item, TransformItem):
                self._write_transforms(item)

    def _end_chunk(self) -> None:
        if self._pending:
            self._index.end_chunk(self._file.tell())
            self._mcap.flush()  # type: ignore[no-untyped-call]  # the same
            self._pending = 0
