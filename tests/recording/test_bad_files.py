"""Files that are cut, spoilt or made to harm: one sentence, and the rest is read."""

import random
import struct
import subprocess
import sys
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import pytest
import zstandard
from mcap.writer import Writer

from tests.builders import S, as_values, at, examples, in_recording
from tfbus import Recording
from tfbus.base.errors import DecodeError, TransformException
from tfbus.recording.items import EventItem, Item, TopicItem
from tfbus.recording.mcap_file import McapFile
from tfbus.recording.reader import RecordingReader
from tfbus.recording.records import (
    FOOTER,
    FOOTER_FIELDS,
    MAGIC,
    METADATA_INDEX,
    PREFIX,
    STATISTICS,
    records_in,
)
from tfbus.recording.summary import summary_of
from tfbus.recording.writer import Compression, RecordingWriter

T0 = 1_700_000_000 * S


def items() -> list[Item]:
    """Some of each kind."""
    found: list[Item] = [
        EventItem(T0, "stream", "sim", {"epoch": 1, "frames": [["world", "turtle1", False]]}),
        in_recording(T0, [at(1, "laser", T0)], static=True, seq=0),
    ]
    for i in range(8):
        now = T0 + i * S
        found.append(in_recording(now, [at(i, "turtle1", now), at(i, "turtle2", now)], seq=i))
        found.append(TopicItem(now, "pose", "Own", {"x": i / 7}))
    return found


def whole(path: Path, compression: Compression = "zstd") -> bytes:
    """The bytes of a recording of these items, in four chunks."""
    with RecordingWriter(path, compression=compression) as writer:
        for number, item in enumerate(items()):
            writer.write(item)
            if number % 5 == 4:
                writer.flush()
    return path.read_bytes()


def look_at_all(path: Path) -> list[tuple[object, ...]]:
    """Read a file in every way; the values of its items."""
    with RecordingReader(path) as reader:
        found = [as_values(item) for item in reader.items()]
        reader.state_at(T0 + 3 * S)
        summary_of(reader)
    bag = Recording(path)
    bag.frames()
    for stamp in (T0 + S, None):
        try:
            bag.lookup_transform("world", "turtle1", stamp)
        except TransformException:
            continue
    return found


@pytest.mark.parametrize("compression", ["zstd", "none"])
def test_a_file_cut_anywhere(tmp_path: Path, compression: Compression) -> None:
    """What is there is the beginning of the whole, more the later it is cut; it is cut short."""
    data = whole(tmp_path / "a.mcap", compression)
    expected = [as_values(item) for item in items()]
    cut, most = tmp_path / "cut.mcap", 0
    for length in range(len(MAGIC), len(data), len(data) // examples(200)):
        cut.write_bytes(data[:length])
        with RecordingReader(cut) as reader:
            found = [as_values(item) for item in reader.items()]
            assert not reader.is_complete
        assert [each for each in expected if each in found] == found
        assert len(found) >= most
        most = len(found)
    assert most == len(expected)


def test_bytes_that_are_no_recording(tmp_path: Path) -> None:
    """It is said in one sentence."""
    for text in (b"", b"MCAP", b"#ROSBAG V2.0\n", MAGIC[:-1]):
        (tmp_path / "a.mcap").write_bytes(text)
        with pytest.raises(DecodeError, match="is not a recording"):
            RecordingReader(tmp_path / "a.mcap")


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_spoilt_bytes(tmp_path: Path, compression: Compression) -> None:
    """Anywhere: what cannot be read is a DecodeError, never another error."""
    data = whole(tmp_path / "a.mcap", compression)
    spoilt, rng = tmp_path / "b.mcap", random.Random(1)
    for _ in range(examples(60)):
        changed = bytearray(data)
        for _ in range(rng.choice((1, 1, 5))):
            changed[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        spoilt.write_bytes(changed)
        try:
            look_at_all(spoilt)
        except DecodeError as error:
            assert str(spoilt) in str(error)


def without_checksums(data: bytes) -> bytes:
    """The file without its summary, and with chunks whose checksums are not checked."""
    changed, at_ = bytearray(), len(MAGIC)
    changed += MAGIC
    while at_ < len(data) - len(MAGIC):
        opcode, length = struct.unpack_from("<BQ", data, at_)
        record = bytearray(data[at_ : at_ + 9 + length])
        if opcode == 15:
            break
        if opcode == 6:
            record[9 + 24 : 9 + 28] = bytes(4)
        changed += record
        at_ += len(record)
    return bytes(changed)


def test_spoilt_bytes_that_no_checksum_finds(tmp_path: Path) -> None:
    """The same where only the fields themselves can be judged."""
    data = without_checksums(whole(tmp_path / "a.mcap", "none"))
    spoilt, rng = tmp_path / "b.mcap", random.Random(2)
    for _ in range(examples(80)):
        changed = bytearray(data)
        for _ in range(rng.choice((1, 1, 5))):
            changed[rng.randrange(len(MAGIC), len(data))] = rng.randrange(256)
        spoilt.write_bytes(changed)
        try:
            look_at_all(spoilt)
        except DecodeError:
            continue


def record(opcode: int, *fields: bytes) -> bytes:
    """A record of MCAP."""
    content = b"".join(fields)
    return struct.pack("<BQ", opcode, len(content)) + content


def chunk_of(data: bytes, size: int, compression: bytes = b"zstd") -> bytes:
    """A chunk that says that its records have this size."""
    name = struct.pack("<I", len(compression)) + compression
    head = struct.pack("<QQQI", T0, T0, size, 0)
    return record(6, head, name, struct.pack("<Q", len(data)), data)


def huge_frame() -> bytes:
    """zstd's data that says that it has 10 GB."""
    return b"\x28\xb5\x2f\xfd\xe0" + struct.pack("<Q", 10 * 2**30) + b"\x01\0\0"


HARMFUL: dict[str, Callable[[], bytes]] = {
    "10 GB declared": lambda: chunk_of(b"x" * 100, 10 * 2**30),
    "10 GB in the frame": lambda: chunk_of(huge_frame(), 1000),
    "a bomb": lambda: chunk_of(zstandard.compress(bytes(2**28 + 1)), 1000),
    "a bomb as declared": lambda: chunk_of(zstandard.compress(bytes(2**28 + 1)), 2**28 + 1),
    "a record of 16 EB": lambda: struct.pack("<BQ", 6, 2**64 - 1) + b"x" * 100,
    "a text of 4 GB": lambda: record(12, struct.pack("<I", 2**32 - 1), b"x"),
    "zeros": lambda: bytes(100_000),
    "a message of no channel": lambda: record(5, struct.pack("<HIQQ", 7, 0, T0, T0), b"x"),
    "an unknown compression": lambda: chunk_of(b"x", 1, b"\x1b[31m"),
}


@pytest.mark.real
@pytest.mark.parametrize("name", HARMFUL)
@pytest.mark.real
def test_a_harmful_file_takes_no_memory(tmp_path: Path, name: str) -> None:
    """It is read, or refused, by a process that may have 1 GB."""
    path = tmp_path / "a.mcap"
    with_start = record(1, struct.pack("<I", 0) * 2)
    path.write_bytes(MAGIC + with_start + HARMFUL[name]() + record(15, bytes(4)))
    code = f"""
import resource
from tfbus.base.errors import DecodeError
from tfbus.recording.reader import RecordingReader
resource.setrlimit(resource.RLIMIT_AS, (2**30, 2**30))
try:
    with RecordingReader({str(path)!r}, on_damage=lambda part, damage: None) as reader:
        print(len(list(reader.items())))
except DecodeError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert len(done.stdout.splitlines()) == 1


def test_messages_of_a_chunk_are_decoded_one_by_one(tmp_path: Path) -> None:
    """Their values take many times their bytes: those of one message are there at a time."""
    path, count, numbers = tmp_path / "a.mcap", 12, 20_000
    data = b"\0\1\0\0" + struct.pack("<I", numbers) + b"\0\x70" * numbers
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=2**30)
        writer.start()
        schema = writer.register_schema("a/msg/Grid", "ros2msg", b"int16[] cells\n")
        channel = writer.register_channel("/grid", "cdr", schema)
        for number in range(count):
            writer.add_message(channel, T0 + number, data, T0 + number)
        writer.finish()
    tracemalloc.start()
    try:
        with RecordingReader(path) as reader:
            assert len(reader.chunks) == 1
            assert sum(1 for _ in reader.items()) == count
            most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert most < count * numbers * 40 / 4


def test_an_index_of_another_file_is_not_believed(tmp_path: Path) -> None:
    """Where the index does not fit, it is made again: the answers are the same."""
    data = bytearray(whole(tmp_path / "a.mcap"))
    at_ = data.index(b"tfbus.index")
    assert data[at_ - 4 : at_] == struct.pack("<I", 11)
    start = data.index(b"application/zstd", at_) + 16 + 8
    data[start : start + 4] = b"spoi"
    (tmp_path / "b.mcap").write_bytes(data)
    expected = Recording(tmp_path / "a.mcap").lookup_transform("world", "turtle1", T0 + S)
    found = Recording(tmp_path / "b.mcap")
    assert found.is_complete
    assert found.lookup_transform("world", "turtle1", T0 + S) == expected


def test_an_index_of_messages_with_a_time_beyond_64_bits_is_not_believed(tmp_path: Path) -> None:
    """The messages themselves are read, and their times."""
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("a/msg/Number", "ros2msg", b"int32 x\n")
        channel = writer.register_channel("/number", "cdr", schema)
        for number in range(3):
            data = b"\0\1\0\0" + struct.pack("<i", number)
            writer.add_message(channel, T0 + number, data, T0 + number)
        writer.finish()
    spoilt = bytearray(path.read_bytes())
    entry = spoilt.index(struct.pack("<Q", T0 + 1))  # in the index: the chunk is compressed
    struct.pack_into("<Q", spoilt, entry, 2**63 + 7)
    path.write_bytes(spoilt)
    with RecordingReader(path) as reader:
        (topic,) = summary_of(reader).topics
        assert topic.flow.messages == 3


def test_a_summary_that_names_a_record_twice_is_not_believed(tmp_path: Path) -> None:
    """Each entry would be read and held: the file is read without its summary."""
    data = whole(tmp_path / "a.mcap")
    foot = len(data) - len(MAGIC) - PREFIX.size - FOOTER_FIELDS.size
    start, offsets, _ = FOOTER_FIELDS.unpack_from(data, foot + PREFIX.size)
    summary = []
    for opcode, begin, end in records_in(data[start : offsets or foot]):
        content = bytearray(data[start + begin : start + end])
        if opcode == STATISTICS:
            (count,) = struct.unpack_from("<I", content, 18)
            struct.pack_into("<I", content, 18, count + 1)
        summary.append(record(opcode, bytes(content)))
        if opcode == METADATA_INDEX and opcode not in [each[0] for each in summary[:-1]]:
            summary.append(summary[-1])
    spoilt = data[:start] + b"".join(summary)
    (tmp_path / "b.mcap").write_bytes(
        spoilt + record(FOOTER, FOOTER_FIELDS.pack(start, 0, 0)) + MAGIC
    )
    first, second = McapFile(tmp_path / "a.mcap"), McapFile(tmp_path / "b.mcap")
    assert len(second.metadata) == len(first.metadata) > 0
    first.close()
    second.close()
