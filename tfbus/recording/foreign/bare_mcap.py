"""MCAP files that others wrote: with messages of ROS 1, ROS 2 or Foxglove."""

from collections.abc import Iterator
from pathlib import Path

from tfbus.errors import DecodeError
from tfbus.recording.damage import united
from tfbus.recording.foreign.messages import ForeignChannel, ForeignMessage, ros_type_name
from tfbus.recording.layout import is_retained
from tfbus.recording.mcap_file import McapFile
from tfbus.recording.ordered import in_order
from tfbus.recording.records import MOST_CHUNK_BYTES, Message
from tfbus.recording.unpacked import of_zstd
from tfbus.wording import printable

# What publishes a channel, and whether that is retained, as the converter of rosbag1 names it.
_PUBLISHER, _LATCHING = "callerid", "latching"


class BareMcap:
    """One MCAP file. Raises DecodeError if it is none, or one of ours, and OSError.

    With `is_packed` each message is compressed for itself, as rosbag2 may do.
    """

    def __init__(self, path: Path, *, is_packed: bool = False) -> None:
        self._is_packed = is_packed
        self.name = printable(str(path))
        self._file = McapFile(path)
        if self._file.library.startswith("tfbus "):
            self._file.close()
            raise DecodeError(
                f"{self.name} is a recording of tfbus and needs no import: cut, merge and filter "
                "take it as it is"
            )
        self._chunks = sorted(self._file.chunks, key=lambda chunk: chunk.from_ns)
        self.start_ns = min((chunk.from_ns for chunk in self._chunks), default=0)
        self.end_ns = max((chunk.to_ns for chunk in self._chunks), default=0)
        self._channels: dict[int, ForeignChannel] = {}
        self.note = self._note()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    @property
    def damage(self) -> list[str]:
        """The unreadable parts so far: `128 kB with 98 messages from +3.21s to +3.44s`."""
        return [each.text(self.start_ns) for each in united(self._file.damage)]

    def messages(self) -> Iterator[ForeignMessage]:
        """All messages in order of log time, whatever that of the file; without those that cannot
        be read.
        """
        for message in in_order(self._groups(), lambda message: message.log_ns):
            yield self._message(message)

    def _groups(self) -> Iterator[tuple[int, list[Message], int]]:
        for chunk in self._chunks:
            messages = self._file.messages(chunk)
            yield chunk.from_ns, messages, sum([len(message.data) for message in messages])

    def _note(self) -> str:
        if not self._file.is_complete:
            return f"{self.name} is cut short: what is there is read"
        return ""

    def _message(self, message: Message) -> ForeignMessage:
        channel = self._channels.get(message.channel)
        if channel is None:
            channel = self._channels[message.channel] = self._channel(message.channel)
        data = of_zstd(message.data, MOST_CHUNK_BYTES) if self._is_packed else message.data
        return ForeignMessage(message.log_ns, channel, data)

    def _channel(self, number: int) -> ForeignChannel:
        channel = self._file.channels[number]
        schema = self._file.schemas.get(channel.schema_id)
        if schema is None:
            return ForeignChannel(channel.topic, "", channel.encoding)
        is_text = schema.encoding in ("ros1msg", "ros2msg", "ros2idl", "jsonschema")
        return ForeignChannel(
            channel.topic,
            ros_type_name(schema.name),
            channel.encoding,
            schema.encoding,
            schema.data.decode(errors="replace") if is_text else "",
            channel.metadata.get(_PUBLISHER, ""),
            is_retained(channel.metadata) or channel.metadata.get(_LATCHING) == "1",
        )
