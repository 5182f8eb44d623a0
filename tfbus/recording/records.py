"""The records of an MCAP file as values, and its damage; https://mcap.dev/spec has the format.

Every length is checked against the bytes that are there, before anything is made of it."""

import bz2
import struct
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from shutil import disk_usage
from typing import NamedTuple

from tfbus.base.errors import DecodeError
from tfbus.wire.limits import size_text

# The bytes that stay free on a disk onto which a file is unpacked.
_LEAST_FREE = 10**9

_AT_A_TIME = 2**24


def of_zstd(data: bytes, most: int) -> bytes:
    """The bytes in zstd's, at most so many."""
    import zstandard

    try:
        said = zstandard.frame_content_size(data)
        if said > most:  # it would be taken in memory as it is
            raise _too_many(most)
        found: bytes = zstandard.ZstdDecompressor().decompress(data, max_output_size=most or 1)
    except zstandard.ZstdError as error:
        raise DecodeError("compressed bytes cannot be unpacked") from error
    return found


def of_lz4(data: bytes, most: int) -> bytes:
    """The bytes in a frame of lz4, at most so many."""
    import lz4.frame  # type: ignore[import-untyped]  # lz4 has no types

    unpacker = lz4.frame.LZ4FrameDecompressor()
    try:
        found: bytes = unpacker.decompress(data, max_length=most + 1)
    except (RuntimeError, EOFError) as error:
        raise DecodeError("compressed bytes cannot be unpacked") from error
    if len(found) > most:
        raise _too_many(most)
    return found


def of_bz2(data: bytes, most: int) -> bytes:
    """The bytes in a stream of bzip2, at most so many."""
    unpacker = bz2.BZ2Decompressor()
    try:
        found = unpacker.decompress(data, max_length=most + 1)
    except (OSError, EOFError) as error:
        raise DecodeError("compressed bytes cannot be unpacked") from error
    if len(found) > most:
        raise _too_many(most)
    return found


def unpack_zstd_file(packed: Path, plain: Path) -> None:
    """Unpack a file of zstd's, as long as 1 GB of the disk stays free. Raises OSError, too."""
    import zstandard

    with packed.open("rb") as source, plain.open("wb") as target:
        try:
            for part in zstandard.ZstdDecompressor().read_to_iter(source, write_size=_AT_A_TIME):
                if disk_usage(plain.parent).free < _LEAST_FREE + len(part):
                    raise DecodeError(
                        f"it unpacks to more than {size_text(target.tell())}, for which "
                        f"{plain.parent} has no room: TMPDIR names another folder"
                    )
                target.write(part)
        except zstandard.ZstdError as error:
            raise DecodeError("compressed bytes cannot be unpacked") from error


def _too_many(most: int) -> DecodeError:
    return DecodeError(f"compressed bytes unpack to more than {size_text(most)}")


MAGIC = b"\x89MCAP0\r\n"

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX = range(9, 14)
SUMMARY_OFFSET, DATA_END = 14, 15

# Opcode and length, before each record.
PREFIX = struct.Struct("<BQ")
# Of a message: channel, sequence, log time, publish time; its data follow.
MESSAGE_HEAD = struct.Struct("<HIQQ")
# The footer: where the summary and its offsets begin, and its checksum.
FOOTER_FIELDS = struct.Struct("<QQI")

_LAST_NS = 2**63 - 1

# A chunk of more bytes is not decompressed; tfbus writes 128 KiB, rosbag2 768 KiB, mcap 1 MiB.
MOST_CHUNK_BYTES = 256 * 2**20

# Nor one of more messages: each takes memory of its own besides its bytes.
MOST_CHUNK_MESSAGES = 1_000_000


@dataclass(frozen=True, slots=True)
class Schema:
    """The definition of a type of messages."""

    id: int
    name: str
    encoding: str
    data: bytes


@dataclass(frozen=True, slots=True)
class Channel:
    """Messages of one topic, type and publisher."""

    id: int
    schema_id: int
    topic: str
    encoding: str
    metadata: dict[str, str]


@dataclass(frozen=True, slots=True)
class Chunk:
    """The place of a chunk in the file: from the first byte of its record on, `length` bytes; the
    log times and the channels of its messages; how long the index of messages behind it is, 0 if
    there is none; and how many bytes its records have. A bare one is of messages that stand in the
    file without a chunk.
    """

    offset: int
    length: int
    from_ns: int
    to_ns: int
    channels: frozenset[int] = frozenset()
    index_length: int = 0
    size: int = 0
    is_bare: bool = False


class Message(NamedTuple):
    """A message as it stands in a chunk; a tuple, as there are many."""

    channel: int
    sequence: int
    log_ns: int
    publish_ns: int
    data: bytes


class Fields:
    """Reads the fields of a record, one after the other. Raises DecodeError if it is too short
    for one.
    """

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    def number(self, size: int) -> int:
        """The next unsigned integer of `size` bytes."""
        return int.from_bytes(self.raw(size), "little")

    def raw(self, size: int) -> bytes:
        """The next `size` bytes."""
        end = self._at + size
        if end > len(self._data):
            raise DecodeError("a record is shorter than its fields")
        part = self._data[self._at : end]
        self._at = end
        return part

    def text(self) -> str:
        """The next text."""
        try:
            return self.raw(self.number(4)).decode()
        except UnicodeDecodeError as error:
            raise DecodeError("a text is not UTF-8") from error

    def texts(self) -> dict[str, str]:
        """The next map of texts."""
        part = Fields(self.raw(self.number(4)))
        found = {}
        while not part.is_at_end:
            name = part.text()
            found[name] = part.text()
        return found

    def pairs(self, key_size: int, value_size: int) -> dict[int, int]:
        """The next map of integers."""
        part = Fields(self.raw(self.number(4)))
        found = {}
        while not part.is_at_end:
            key = part.number(key_size)
            found[key] = part.number(value_size)
        return found

    @property
    def is_at_end(self) -> bool:
        """Whether nothing is left."""
        return self._at >= len(self._data)


def read_schema(data: bytes) -> Schema:
    """A schema of its record."""
    fields = Fields(data)
    number, name, encoding = fields.number(2), fields.text(), fields.text()
    return Schema(number, name, encoding, fields.raw(fields.number(4)))


def read_channel(data: bytes) -> Channel:
    """A channel of its record."""
    fields = Fields(data)
    return Channel(fields.number(2), fields.number(2), fields.text(), fields.text(), fields.texts())


def read_metadata(data: bytes) -> tuple[str, dict[str, str]]:
    """The name of a metadata record, and its entries."""
    fields = Fields(data)
    return fields.text(), fields.texts()


def read_attachment(data: bytes) -> tuple[str, bytes]:
    """The name of an attachment, and its bytes."""
    fields = Fields(data)
    fields.raw(16)
    name, _ = fields.text(), fields.text()
    content = fields.raw(fields.number(8))
    crc = fields.number(4)
    if crc and crc != zlib.crc32(data[:-4]):
        raise DecodeError("the checksum of an attachment is wrong")
    return name, content


def read_chunk_index(data: bytes) -> Chunk:
    """The place of a chunk, of its index record."""
    fields = Fields(data)
    from_ns, to_ns, offset, length = (fields.number(8) for _ in range(4))
    check_log_time(max(from_ns, to_ns))
    channels = frozenset(fields.pairs(2, 8))
    index_length, _, _, size = fields.number(8), fields.text(), fields.number(8), fields.number(8)
    return Chunk(offset, length, from_ns, to_ns, channels, index_length, size)


def read_message_index(data: bytes) -> tuple[int, list[int]]:
    """A channel, and the log times of its messages in a chunk, of their index record."""
    fields = Fields(data)
    channel = fields.number(2)
    entries = fields.raw(fields.number(4))
    if len(entries) % 16:
        raise DecodeError("an index of messages is not whole")
    times = memoryview(entries).cast("Q").tolist()[::2]
    check_log_time(max(times, default=0))
    return channel, times


def chunk_records(record: bytes) -> bytes:
    """The records in a chunk, decompressed and checked. `record` is the chunk's, without prefix."""
    fields = Fields(record)
    fields.raw(16)
    size, crc, compression = fields.number(8), fields.number(4), fields.text()
    data = fields.raw(fields.number(8))
    if size > MOST_CHUNK_BYTES:
        raise DecodeError(f"a chunk of {size:,} bytes, at most {MOST_CHUNK_BYTES:,} are read")
    records = _decompressed(data, size, compression)
    if len(records) != size:
        raise DecodeError(f"a chunk has {len(records):,} bytes in the place of {size:,}")
    if crc and crc != zlib.crc32(records):
        raise DecodeError("the checksum of a chunk is wrong")
    return records


def _decompressed(data: bytes, size: int, compression: str) -> bytes:
    if compression == "":
        return data
    if compression == "zstd":
        return of_zstd(data, size)
    if compression == "lz4":
        return of_lz4(data, size)
    raise DecodeError(f"a chunk is compressed as {compression!r}; zstd, lz4 and none are read")


def records_in(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Opcode, and where the content begins and ends, of each record in the bytes.

    Raises DecodeError if the last one is not whole.
    """
    at, end = 0, len(data)
    while at < end:
        if at + PREFIX.size > end:
            raise DecodeError("a record is cut")
        opcode, length = PREFIX.unpack_from(data, at)
        at += PREFIX.size
        if length > end - at:
            raise DecodeError("a record is longer than what is left")
        yield opcode, at, at + length
        at += length


def check_log_time(log_ns: int) -> None:
    """Raise DecodeError for a time that nanoseconds of 64 bits with a sign do not have."""
    if log_ns > _LAST_NS:
        raise DecodeError(f"a log time of {log_ns} ns is after the year 2262")


def read_message(data: bytes, start: int, end: int) -> Message:
    """A message, whose record's content is from `start` to `end`."""
    if end - start < MESSAGE_HEAD.size:
        raise DecodeError("a message is shorter than its fields")
    channel, sequence, log_ns, publish_ns = MESSAGE_HEAD.unpack_from(data, start)
    check_log_time(log_ns)
    return Message(channel, sequence, log_ns, publish_ns, data[start + MESSAGE_HEAD.size : end])


@dataclass(frozen=True)
class Damage:
    """Bytes of a file that cannot be read: from `offset` on, `size` bytes; the log times of their
    messages and how many there are, None if the file does not say.

    With `what`, as "topic 'pose'", it is messages that are whole, but do not fit their channel.
    """

    offset: int
    size: int
    reason: str
    from_ns: int | None = None
    to_ns: int | None = None
    messages: int | None = None
    what: str = ""

    def text(self, start_ns: int | None = None) -> str:
        """The damaged parts, with times since the beginning of the recording: `128 kB with 98
        messages from +3.21s to +3.44s`; in UTC if that is None.
        """
        found = f"messages of {self.what}" if self.what else size_text(self.size)
        if self.messages is not None and not self.what:
            found += f" with {self.messages:,} message{'' if self.messages == 1 else 's'}"
        if self.from_ns is None or self.to_ns is None or start_ns == 0:
            return found
        begin, end = (time_text(log_ns, start_ns) for log_ns in (self.from_ns, self.to_ns))
        return f"{found} at {begin}" if begin == end else f"{found} from {begin} to {end}"


def time_text(log_ns: int, start_ns: int | None) -> str:
    """A log time since the beginning of the recording, or in UTC."""
    if start_ns is None:
        return f"{datetime.fromtimestamp(log_ns / 1e9, UTC):%Y-%m-%dT%H:%M:%S.%f}"[:-4] + "Z"
    if log_ns < start_ns:
        return f"{(start_ns - log_ns) / 1e9:.2f}s before the beginning"
    return f"+{(log_ns - start_ns) / 1e9:.2f}s"


def united(damage: Iterable[Damage]) -> list[Damage]:
    """Damage in the order of the file; adjacent parts are joined."""
    found: list[Damage] = []
    for each in sorted(damage, key=lambda one: (bool(one.what), one.offset)):
        last = found[-1] if found and not each.what else None
        if last is None or last.what or each.offset > last.offset + last.size:
            found.append(each)
            continue
        end = max(last.offset + last.size, each.offset + each.size)
        times = [time for time in (last.from_ns, last.to_ns, each.from_ns, each.to_ns) if time]
        counts = [count for count in (last.messages, each.messages) if count is not None]
        found[-1] = replace(
            last,
            size=end - last.offset,
            from_ns=min(times, default=None),
            to_ns=max(times, default=None),
            messages=sum(counts) if len(counts) == 2 else None,
        )
    return found
