"""The readable parts of recordings that are cut short or damaged."""

from collections.abc import Iterable
from pathlib import Path
from random import Random

import pytest

from tests.builders import at, examples
from tfbus.base.errors import DecodeError
from tfbus.geometry.columns import Columns
from tfbus.recording.items import EventItem, Item, RecordedStream, TransformItem
from tfbus.recording.reader import RecordingReader
from tfbus.recording.recover import Loss, Salvage
from tfbus.recording.writer import RecordingWriter

S = 1_000_000_000
SIM = RecordedStream("sim", "/sim", epoch_ns=5)
CHUNKS = 20


def write(path: Path) -> list[int]:
    """A recording of 20 chunks with 10 messages each; the log times of its transforms."""
    log_times = []
    with RecordingWriter(path, statics_every_s=1000) as writer:
        writer.write(EventItem(S, "stream", "sim", {"epoch": 5}))
        for chunk in range(CHUNKS):
            for number in range(10):
                log_ns = S + chunk * 1000 + number
                rows = Columns.of_transforms([at(chunk, "base", log_ns)])
                writer.write(TransformItem(log_ns, SIM, rows, seq=number))
                log_times.append(log_ns)
            writer.flush()
        writer.write(EventItem(2 * S, "stream gone", "sim"))
    return log_times


def salvaged(path: Path) -> tuple[list[Item], Loss]:
    """The items that can be read, and what cannot."""
    salvage = Salvage(path)
    items = list(salvage.items())
    loss = salvage.loss
    salvage.close()
    return items, loss


def log_times(items: Iterable[Item]) -> list[int]:
    """The log times of the transforms."""
    return [item.log_ns for item in items if isinstance(item, TransformItem)]


def test_a_whole_recording_loses_nothing(tmp_path: Path) -> None:
    """All items come, in order, and no loss is said."""
    expected = write(tmp_path / "a.mcap")
    items, loss = salvaged(tmp_path / "a.mcap")
    assert log_times(items) == expected
    assert [item.kind for item in items if isinstance(item, EventItem)] == ["stream", "stream gone"]
    assert not loss


def test_wherever_it_is_cut_all_whole_chunks_are_there(tmp_path: Path) -> None:
    """And nothing else."""
    path = tmp_path / "a.mcap"
    expected = write(path)
    with RecordingReader(path) as reader:
        ends = [chunk.offset + chunk.length for part in reader.parts for chunk in part.chunks]
    data = path.read_bytes()
    for size in range(len(data) - 1, 8, -len(data) // examples(60)):
        path.write_bytes(data[:size])
        whole = sum(end <= size for end in ends)
        if whole == 0:
            continue
        items, loss = salvaged(path)
        assert log_times(items) == expected[: 10 * whole]
        assert loss


def test_a_damaged_chunk_is_left_out(tmp_path: Path) -> None:
    """The chunks before and behind it are there, whichever byte of it is wrong."""
    path = tmp_path / "a.mcap"
    expected = write(path)
    with RecordingReader(path) as reader:
        [part] = reader.parts
        chunk = part.chunks[7]
        start, end = chunk.offset, chunk.offset + chunk.length
    data = path.read_bytes()
    without = expected[:70] + expected[80:]
    for place in range(start, end, 5):
        path.write_bytes(data[:place] + bytes([data[place] ^ 0xFF]) + data[place + 1 :])
        items, _ = salvaged(path)
        # Some bytes, as the times of the chunk, are not needed to read it.
        assert log_times(items) in (without, expected), f"byte {place}"


@pytest.mark.parametrize("gap", [1, 50, 3000])
@pytest.mark.parametrize("seed", range(5))
def test_bytes_that_are_missing_cost_what_is_around_them(
    tmp_path: Path, gap: int, seed: int
) -> None:
    """Without the summary too: reading goes on at the next chunk."""
    path = tmp_path / "a.mcap"
    expected = write(path)
    with RecordingReader(path) as reader:
        [part] = reader.parts
        chunk_size = part.chunks[1].length
    data = path.read_bytes()
    start = Random(seed).randrange(300, len(data) // 2)
    path.write_bytes(data[:start] + data[start + gap :])
    items, loss = salvaged(path)
    found = log_times(items)
    assert set(found) <= set(expected)
    assert len(found) >= len(expected) - 10 * (gap / chunk_size + 3)
    assert found[-10:] == expected[-10:]
    assert loss


def test_a_file_that_begins_wrongly_is_read(tmp_path: Path) -> None:
    """The first bytes say only what kind of file it is."""
    path = tmp_path / "a.mcap"
    expected = write(path)
    path.write_bytes(bytes(4) + path.read_bytes()[4:])
    assert log_times(salvaged(path)[0]) == expected


@pytest.mark.parametrize("data", [b"", b"\x89MCAP0\r\n", bytes(5000), Random(1).randbytes(5000)])
def test_a_file_with_nothing_in_it_is_refused(tmp_path: Path, data: bytes) -> None:
    """With a DecodeError, which names it."""
    path = tmp_path / "a.mcap"
    path.write_bytes(data)
    with pytest.raises(DecodeError, match=r"a\.mcap holds no recording"):
        Salvage(path)
