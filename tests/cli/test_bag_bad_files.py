"""Files that are cut, spoilt or made to harm: each `tfbus bag` command ends in one sentence."""

import os
import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner

from tests.builders import S, at, examples, in_recording
from tfbus.cli import main
from tfbus.recording.items import EventItem, TopicItem
from tfbus.recording.reader import RecordingReader
from tfbus.recording.records import CHUNK, FOOTER, FOOTER_FIELDS, MAGIC, PREFIX, SCHEMA, records_in
from tfbus.recording.writer import RecordingWriter

T0 = 1_700_000_000 * S

COMMANDS = {
    "info": ("info", "{}"),
    "cut": ("cut", "{}", "--from", "+0s", "-o", "out.mcap", "--force"),
    "merge": ("merge", "{}", "-o", "out.mcap", "--force"),
    "filter": ("filter", "{}", "--exclude", "none", "-o", "out.mcap", "--force"),
    "recover": ("recover", "{}", "-o", "out.mcap", "--force"),
    "import": ("import", "{}", "-o", "out.mcap", "--force"),
    "export": ("export", "{}", "-o", "out.csv", "--force"),
}


@pytest.fixture
def whole(tmp_path: Path) -> Iterator[bytes]:
    """The bytes of a recording of a robot and a topic, in chunks that are not compressed; its
    folder is the current one.
    """
    before = Path.cwd()
    os.chdir(tmp_path)
    with RecordingWriter("whole.mcap", compression="none") as writer:
        writer.write(EventItem(T0, "stream", "sim", {"epoch": 1, "frames": []}))
        writer.write(in_recording(T0, [at(1, "laser", T0)], static=True, seq=0))
        for number in range(60):
            now = T0 + number * S // 10
            writer.write(in_recording(now, [at(number, "base", now)], seq=number))
            writer.write(TopicItem(now, "pose", "Own", {"x": number / 7}))
            if number % 10 == 9:
                writer.flush()
    yield Path("whole.mcap").read_bytes()
    os.chdir(before)


def check(name: str, data: bytes) -> int:
    """Run a command on a file with these bytes; its exit code. An error is one sentence."""
    Path("bad.mcap").write_bytes(data)
    arguments = [word.format("bad.mcap") for word in COMMANDS[name]]
    done = CliRunner().invoke(main, ["bag", *arguments], prog_name="tfbus")
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
    assert done.exit_code in (0, 1), done.output
    if done.exit_code:
        last = done.output.splitlines()[-1]
        assert last.startswith("Error: ") and "bad.mcap" in last, done.output
        assert not Path("out.mcap").exists() and not Path("out.csv").exists()
    for path in (Path("out.mcap"), Path("out.csv")):
        path.unlink(missing_ok=True)
    return done.exit_code


@pytest.mark.parametrize("name", COMMANDS)
def test_a_file_that_is_cut(whole: bytes, name: str) -> None:
    """Anywhere, and at the first byte: what is there is taken, or it is refused."""
    step = len(whole) // examples(12)
    codes = [check(name, whole[:length]) for length in (0, 8, *range(step, len(whole), step))]
    assert codes[:2] == [1, 1]
    assert (codes[-1] == 0) == (name != "import")  # which has nothing to do with ours


@pytest.mark.parametrize("name", COMMANDS)
def test_a_file_with_spoilt_bytes(whole: bytes, name: str) -> None:
    """Wherever they are."""
    for place in range(3, len(whole), len(whole) // examples(40)):
        spoilt = bytearray(whole)
        spoilt[place] ^= 0xFF
        check(name, bytes(spoilt))


def records(data: bytes) -> Iterator[tuple[int, bytes]]:
    """The records of a file up to its summary, its chunks opened."""
    for opcode, start, end in records_in(data[len(MAGIC) : -len(MAGIC)]):
        content = data[len(MAGIC) + start : len(MAGIC) + end]
        if opcode == CHUNK:
            inner = content[8 + 8 + 8 + 4 + 4 + 8 :]
            yield from ((each, inner[a:b]) for each, a, b in records_in(inner))
        elif opcode == FOOTER or opcode > 12:
            return
        else:
            yield opcode, content


def bare(parts: Iterator[tuple[int, bytes]]) -> bytes:
    """A file of these records without chunks and summary."""
    found = [PREFIX.pack(opcode, len(content)) + content for opcode, content in parts]
    footer = PREFIX.pack(FOOTER, FOOTER_FIELDS.size) + FOOTER_FIELDS.pack(0, 0, 0)
    return MAGIC + b"".join(found) + footer + MAGIC


def with_wrong_schema(data: bytes) -> bytes:
    """The topic's messages are of another type than the file says."""
    return bare(
        (opcode, content.replace(b"float64 x", b"string[] y") if opcode == SCHEMA else content)
        for opcode, content in records(data)
    )


def with_huge_chunk(data: bytes) -> bytes:
    """The second chunk says that it has 10 GB, and its index too."""
    with RecordingReader("whole.mcap") as reader:
        chunk = reader.chunks[1].chunk
    changed = bytearray(data)
    struct.pack_into("<Q", changed, chunk.offset + PREFIX.size + 16, 10 * 2**30)
    return bytes(changed)


def with_huge_record(data: bytes) -> bytes:
    """The first record behind the header has 10 GB."""
    _, length = PREFIX.unpack_from(data, len(MAGIC))
    end = len(MAGIC) + PREFIX.size + length
    return data[:end] + PREFIX.pack(CHUNK, 10 * 2**30) + data[end:]


def with_wrong_checksums(data: bytes) -> bytes:
    """The checksum of the second chunk is wrong, and so is that of the third."""
    with RecordingReader("whole.mcap") as reader:
        chunks = [reader.chunks[number].chunk for number in (1, 2)]
    changed = bytearray(data)
    for chunk in chunks:
        struct.pack_into("<I", changed, chunk.offset + PREFIX.size + 24, zlib.crc32(b"wrong"))
    return bytes(changed)


@pytest.mark.parametrize(
    "spoil", [with_wrong_schema, with_huge_chunk, with_huge_record, with_wrong_checksums]
)
def test_a_file_that_says_what_is_not_so(whole: bytes, spoil: Callable[[bytes], bytes]) -> None:
    """Its topic's type, its sizes, its checksums."""
    data = spoil(whole)
    assert data != whole
    for name in COMMANDS:
        check(name, data)
