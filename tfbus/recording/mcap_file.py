"""An MCAP file, read by its summary or, if it has none, record by record."""

import errno
import os
import shlex
import zlib
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from operator import attrgetter
from pathlib import Path

from tfbus.base.errors import DecodeError, InvalidArgumentException
from tfbus.base.wording import printable
from tfbus.recording.records import (
    ATTACHMENT,
    ATTACHMENT_INDEX,
    CHANNEL,
    CHUNK,
    CHUNK_INDEX,
    DATA_END,
    FOOTER,
    FOOTER_FIELDS,
    HEADER,
    MAGIC,
    MESSAGE,
    MESSAGE_INDEX,
    METADATA,
    METADATA_INDEX,
    MOST_CHUNK_MESSAGES,
    PREFIX,
    SCHEMA,
    STATISTICS,
    Channel,
    Chunk,
    Damage,
    Fields,
    Message,
    Schema,
    check_log_time,
    chunk_records,
    read_attachment,
    read_channel,
    read_chunk_index,
    read_message,
    read_message_index,
    read_metadata,
    read_schema,
    records_in,
)

# A summary, an attachment or a metadata record of more bytes is not read.
_MOST_RECORD_BYTES = 512 * 2**20

# Messages that stand in the file without a chunk are read in pieces of this size.
_BARE_PIECE_BYTES = 2**20

# Files of rosbag and rosbag2 end so.
_OF_ROS = (".bag", ".db3")

_FOOTER_SIZE = PREFIX.size + FOOTER_FIELDS.size + len(MAGIC)


def how_to_import(path: Path) -> str:
    """The advice on a recording of ROS in another format, a file or a folder of them; "" for
    another path.
    """
    of_ros = path.suffix in _OF_ROS
    if path.is_dir():
        of_ros = any(each.suffix in _OF_ROS for each in path.iterdir())
    if not of_ros:
        return ""
    name = printable(shlex.quote(str(path)))
    return f"it is one of ROS; write one of it: tfbus bag import {name} -o NAME.mcap"


class McapFile:
    """The parts of one file: `schemas`, `channels` by their ids, `chunks` in the order of the file,
    the `metadata` records, and how many messages each channel has.

    `is_complete` is whether it ends as it should. A file that was cut short is read from its
    beginning to where it ends. An unreadable part in the middle is left out: `on_damage` is called
    with it when it is met first, and `damage` has all parts met so far.

    Raises DecodeError unless it is an MCAP file, and OSError.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self.profile = self.library = ""
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.chunks: list[Chunk] = []
        self.metadata: list[tuple[str, dict[str, str]]] = []
        self.counts: Counter[int] = Counter()
        self.is_complete = False
        self.on_damage: Callable[[Damage], object] = lambda damage: None
        # By the place in the file or, of messages that are whole, by their channel.
        self._damage: dict[tuple[str, int], Damage] = {}
        self._attachments: dict[str, tuple[int, int]] = {}
        self._file = os.open(self.path, os.O_RDONLY)
        try:
            self._open()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the file."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    @property
    def damage(self) -> list[Damage]:
        """The unreadable parts met so far."""
        return list(self._damage.values())

    def is_damaged(self, offset: int) -> bool:
        """Whether the chunk that begins here was asked for, and could not be read."""
        return ("", offset) in self._damage

    def note_damage(self, damage: Damage) -> None:
        """Note an unreadable part: once for each place, or each stream or topic in `what`."""
        key = damage.what, 0 if damage.what else damage.offset
        if key not in self._damage:
            self._damage[key] = damage
            self.on_damage(damage)

    def messages(self, chunk: Chunk) -> list[Message]:
        """The messages of a chunk in the order of the file; none if it is damaged."""
        try:
            return self._messages(chunk)
        except (DecodeError, OSError) as error:  # the latter where the disk cannot read it
            self.note_damage(self._damage_of(chunk, error))
            return []

    def attachment(self, name: str) -> bytes | None:
        """The bytes of the last attachment of this name; None if there is none, or it is
        damaged.
        """
        place = self._attachments.get(name)
        if place is None:
            return None
        try:
            found, content = read_attachment(self._content(ATTACHMENT, *place))
        except DecodeError:
            return None
        return content if found == name else None

    def log_times(self, chunk: Chunk) -> dict[int, list[int]]:
        """The log times of a chunk's messages by channel, in the order of the file: of the index
        behind the chunk, without decompressing it, if there is one.
        """
        times = self._indexed_times(chunk)
        if not times:
            for message in self.messages(chunk):
                times.setdefault(message.channel, []).append(message.log_ns)
        return times

    def _indexed_times(self, chunk: Chunk) -> dict[int, list[int]]:
        """The same of the index; empty if there is none, or it is damaged."""
        times: dict[int, list[int]] = {}
        try:
            index = self._read(chunk.offset + chunk.length, chunk.index_length)
            for opcode, start, end in records_in(index):
                if opcode == MESSAGE_INDEX:
                    channel, found = read_message_index(index[start:end])
                    times[channel] = found
        except (DecodeError, OSError):
            times.clear()
        return times

    def _damage_of(self, chunk: Chunk, error: Exception) -> Damage:
        """The loss with a chunk: its index says it, and else its first fields."""
        indexed = [time for times in self._indexed_times(chunk).values() for time in times]
        said = [time for time in (chunk.from_ns, chunk.to_ns) if time] or indexed
        if not said and not chunk.is_bare:
            said = self._said_times(chunk)
        return Damage(
            chunk.offset,
            chunk.length + chunk.index_length,
            str(error),
            min(said, default=None),
            max(said, default=None),
            len(indexed) or None,
        )

    def _said_times(self, chunk: Chunk) -> list[int]:
        try:
            fields = Fields(self._read(chunk.offset + PREFIX.size, 16))
            times = [fields.number(8), fields.number(8)]
            check_log_time(max(times))
        except (DecodeError, OSError):
            return []
        return times if 0 < times[0] <= times[1] else []

    def _open(self) -> None:
        self.size = os.fstat(self._file).st_size
        if os.path.isdir(self.path):
            raise IsADirectoryError(errno.EISDIR, "is a folder", str(self.path))
        begin = os.pread(self._file, len(MAGIC), 0)
        if not begin:
            raise DecodeError(f"{self._name} is not a recording: it is an empty file, of 0 bytes")
        if begin != MAGIC:
            why = "it does not begin as MCAP files do"
            raise DecodeError(f"{self._name} is not a recording: {how_to_import(self.path) or why}")
        self._read_header()
        try:
            self._read_summary()
        except DecodeError:
            self._clear()
            self._scan()

    @property
    def _name(self) -> str:
        return printable(str(self.path))

    def _clear(self) -> None:
        for each in (self.schemas, self.channels, self.chunks, self.metadata, self.counts):
            each.clear()
        self._attachments.clear()
        self._damage.clear()
        self.is_complete = False

    def _read(self, offset: int, length: int) -> bytes:
        """These bytes of the file. Raises DecodeError if it ends before, and
        InvalidArgumentException if it is closed.
        """
        if self._file < 0:
            raise InvalidArgumentException(f"{self._name} is closed: read it within its `with`")
        if offset < 0 or length < 0 or offset + length > self.size:
            raise DecodeError("a record lies beyond the end of the file")
        parts = []
        while length:
            part = os.pread(self._file, length, offset)
            if not part:
                raise DecodeError("the file became shorter")
            parts.append(part)
            offset, length = offset + len(part), length - len(part)
        return parts[0] if len(parts) == 1 else b"".join(parts)

    def _content(self, opcode: int, offset: int, length: int) -> bytes:
        """The content of the record of this kind that is in these bytes of the file."""
        if length > _MOST_RECORD_BYTES:
            raise DecodeError(
                f"a record of {length:,} bytes; at most {_MOST_RECORD_BYTES:,} are read"
            )
        record = self._read(offset, length)
        if length < PREFIX.size or PREFIX.unpack_from(record) != (opcode, length - PREFIX.size):
            raise DecodeError("a record is not where the index says")
        return record[PREFIX.size :]

    def _read_header(self) -> None:
        try:
            opcode, length = PREFIX.unpack(self._read(len(MAGIC), PREFIX.size))
            if opcode == HEADER and length < 10_000:
                fields = Fields(self._read(len(MAGIC) + PREFIX.size, length))
                self.profile, self.library = fields.text(), fields.text()
        except DecodeError:
            pass

    # The summary

    def _read_summary(self) -> None:
        at = self.size - _FOOTER_SIZE
        footer = self._read(at, _FOOTER_SIZE)
        opcode, length = PREFIX.unpack_from(footer)
        if not footer.endswith(MAGIC) or (opcode, length) != (FOOTER, FOOTER_FIELDS.size):
            raise DecodeError("it has no footer")
        start, _, crc = FOOTER_FIELDS.unpack_from(footer, PREFIX.size)
        if start == 0:
            raise DecodeError("it has no summary")
        if at - start > _MOST_RECORD_BYTES:
            raise DecodeError("its summary is too large")
        summary = self._read(start, at - start)
        if crc and crc != zlib.crc32(footer[: PREFIX.size + 16], zlib.crc32(summary)):
            raise DecodeError("the checksum of the summary is wrong")
        self._take_summary(summary)
        self.is_complete = True

    def _take_summary(self, summary: bytes) -> None:
        stated: Fields | None = None
        metadata = []
        for opcode, start, end in records_in(summary):
            content = summary[start:end]
            if opcode == CHUNK_INDEX:
                self.chunks.append(read_chunk_index(content))
            elif opcode == METADATA_INDEX:
                fields = Fields(content)
                metadata.append((fields.number(8), fields.number(8)))
            elif opcode == ATTACHMENT_INDEX:
                self._take_attachment_index(Fields(content))
            elif opcode == STATISTICS:
                stated = Fields(content)
            else:
                self._take_definition(opcode, content)
        for offsets in ([offset for offset, _ in metadata], [each.offset for each in self.chunks]):
            if len(set(offsets)) < len(offsets):
                # Each entry would be read and held again.
                raise DecodeError("its summary names a record twice")
        if stated is None:
            raise DecodeError("it has no statistics")
        self._check_statistics(stated, len(metadata))
        for offset, length in metadata:
            self.metadata.append(read_metadata(self._content(METADATA, offset, length)))

    def _check_statistics(self, stated: Fields, metadata: int) -> None:
        """Take the counts; raises DecodeError if the summary leaves out a part of the file."""
        messages, _, channels, _ = (stated.number(size) for size in (8, 2, 4, 4))
        said_metadata, chunks = stated.number(4), stated.number(4)
        stated.raw(16)
        self.counts.update(stated.pairs(2, 8))
        is_whole = (
            channels <= len(self.channels)
            and chunks == len(self.chunks)
            and said_metadata == metadata
            and (chunks or not messages)
        )
        if not is_whole:
            raise DecodeError("its summary leaves out a part")
        self.chunks.sort(key=attrgetter("offset"))

    def _take_attachment_index(self, fields: Fields) -> None:
        offset, length = fields.number(8), fields.number(8)
        fields.raw(24)
        self._attachments[fields.text()] = (offset, length)

    def _take_definition(self, opcode: int, content: bytes) -> None:
        if opcode == SCHEMA:
            schema = read_schema(content)
            self.schemas[schema.id] = schema
        elif opcode == CHANNEL:
            channel = read_channel(content)
            self.channels[channel.id] = channel

    # The whole file, where the summary is missing

    def _scan(self) -> None:
        at = len(MAGIC)
        bare: list[int] = []  # where the messages without a chunk begin, and end
        while at + PREFIX.size <= self.size:
            opcode, length = PREFIX.unpack(self._read(at, PREFIX.size))
            end = at + PREFIX.size + length
            if end > self.size or opcode == 0:
                break
            is_bare = opcode in (MESSAGE, SCHEMA, CHANNEL)
            if is_bare:
                bare = [bare[0] if bare else at, end]
            if bare and (not is_bare or bare[1] - bare[0] > _BARE_PIECE_BYTES):
                self._scan_chunk(Chunk(bare[0], bare[1] - bare[0], 0, 0, is_bare=True))
                bare = []
            if opcode in (FOOTER, DATA_END):
                self.is_complete = self._ends_well(at)
                break
            if not is_bare:
                self._scan_record(opcode, at, end - at)
            at = end
        if bare:
            self._scan_chunk(Chunk(bare[0], bare[1] - bare[0], 0, 0, is_bare=True))

    def _ends_well(self, at: int) -> bool:
        return self._read(self.size - len(MAGIC), len(MAGIC)) == MAGIC and at < self.size

    def _scan_record(self, opcode: int, offset: int, length: int) -> None:
        try:
            if opcode == CHUNK:
                self._scan_chunk(Chunk(offset, length, 0, 0))
            elif opcode == METADATA:
                self.metadata.append(read_metadata(self._content(opcode, offset, length)))
            elif opcode == ATTACHMENT:
                name, _ = read_attachment(self._content(opcode, offset, length))
                self._attachments[name] = (offset, length)
        except DecodeError as error:
            if opcode != ATTACHMENT:  # an index, which is made again
                self.note_damage(Damage(offset, length, str(error)))

    def _scan_chunk(self, chunk: Chunk) -> None:
        """Read the times and counts of a chunk that no index names."""
        try:
            messages = self._messages(chunk)
        except DecodeError as error:
            indexed = replace(chunk, index_length=self._index_length(chunk.offset + chunk.length))
            self.note_damage(self._damage_of(indexed, error))
            return
        if not messages:
            return
        self.counts.update([message.channel for message in messages])
        times = [message.log_ns for message in messages]
        self.chunks.append(
            Chunk(
                chunk.offset,
                chunk.length,
                min(times),
                max(times),
                frozenset([message.channel for message in messages]),
                size=sum(len(message.data) for message in messages),
                is_bare=chunk.is_bare,
            )
        )

    def _index_length(self, at: int) -> int:
        """How many bytes of the index of a chunk's messages are here."""
        end = at
        while end + PREFIX.size <= self.size:
            opcode, length = PREFIX.unpack(self._read(end, PREFIX.size))
            if opcode != MESSAGE_INDEX or end + PREFIX.size + length > self.size:
                break
            end += PREFIX.size + length
        return end - at

    def _records(self, chunk: Chunk) -> bytes:
        if chunk.is_bare:
            return self._read(chunk.offset, chunk.length)
        return chunk_records(self._content(CHUNK, chunk.offset, chunk.length))

    def _messages(self, chunk: Chunk) -> list[Message]:
        data = self._records(chunk)
        messages = []
        for number, (opcode, start, end) in enumerate(records_in(data)):
            if number > MOST_CHUNK_MESSAGES:
                raise DecodeError(f"a chunk of more than {MOST_CHUNK_MESSAGES:,} messages")
            if opcode == MESSAGE:
                messages.append(read_message(data, start, end))
            else:
                self._take_definition(opcode, data[start:end])
        if not {message.channel for message in messages} <= self.channels.keys():
            raise DecodeError("a message belongs to no channel")
        return messages
