"""A recording outlives crashes of its process and faults of its disk."""

import os
import random
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests import needs
from tests.buses import eventually, keep_sending
from tests.live_bus import Bus, Process
from tfbus.recording.items import TransformItem
from tfbus.recording.reader import RecordingReader
from tfbus.ros.tf_message import TFMessageReader

pytestmark = pytest.mark.real

ROOT = Path(__file__).parents[2]

# The process may write files of at most this size.
LIMITED = """
import resource, runpy, sys
resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))
sys.argv[0] = "tfbus"
runpy.run_module("tfbus", run_name="__main__")
"""


def by_another_reader(path: Path) -> list[float]:
    """The x of all transforms in a file, in its order, by the reader of the MCAP project."""
    from mcap.exceptions import McapError
    from mcap.records import Message
    from mcap.stream_reader import StreamReader

    reader, found = TFMessageReader(), []
    with path.open("rb") as file:
        try:
            for record in StreamReader(file, emit_chunks=False).records:
                if isinstance(record, Message):
                    rows = reader.read(record.data)
                    found += [each.transform.x for each in rows]
        except (McapError, EOFError, OSError, ValueError, __import__("struct").error):
            pass  # it ends in the middle of a record
    return found


def by_tfbus(path: Path) -> list[float]:
    with RecordingReader(path) as recording:
        return [
            each.transform.x
            for item in recording.items()
            if isinstance(item, TransformItem) and not item.static
            for each in item.rows
        ]


@pytest.fixture
def killed(tmp_path: Path) -> Iterator[list[tuple[Path, int]]]:
    """Two recordings that were killed at random moments, and how many messages they had on the
    disk.
    """
    command = [sys.executable, "-m", "tests.processes.recording_process"]
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    paths = [tmp_path / f"run{number}.mcap" for number in range(2)]
    processes = [Process([*command, str(path)], env, ROOT) for path in paths]
    try:
        for process in processes:
            flushes = random.randint(1, 4)
            eventually(lambda p=process, n=flushes: len(p.out) >= n)
            process.stop(signal.SIGKILL)
        yield [(path, int(process.out[-1])) for path, process in zip(paths, processes, strict=True)]
    finally:
        for process in processes:
            process.kill()


def test_after_kill_9_all_is_there_that_was_on_the_disk(killed: list[tuple[Path, int]]) -> None:
    """Both readers give the messages from the first on, without a gap, up to the last flush."""
    for path, flushed in killed:
        found = by_tfbus(path)
        assert len(found) >= flushed
        assert found == list(range(len(found)))
        assert by_another_reader(path) == found


def test_a_full_disk_ends_the_recording_with_a_sentence(bus: Bus, tmp_path: Path) -> None:
    """The process ends with 1, and what it wrote until then can be read."""
    node = bus.node("robot")
    for number in range(20):
        keep_sending(node, "map", f"link{number}", rate_hz=50.0)
    path = tmp_path / "run.mcap"
    process = bus.start_command(
        [
            *(sys.executable, "-c", LIMITED, "bag", "record", "-o", str(path)),
            *("--compression", "none"),
        ]
    )
    assert process.wait() == 1
    assert any("stopped recording: File" in line for line in process.err)
    found = by_another_reader(path)
    assert found and by_tfbus(path) == found


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 512 KiB; the test is skipped where none can be mounted."""
    if os.geteuid() != 0:
        needs.skip("a disk of its own", "run as root")
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=512k", "tfbus-test", str(folder)]
    done = subprocess.run(mount, capture_output=True, text=True)
    if done.returncode:
        needs.skip("a disk of its own", done.stderr.strip())
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


def test_a_small_disk_leaves_the_files_before_whole(bus: Bus, small_disk: Path) -> None:
    """The recorder stops shortly before the disk is full, or when it is; what it wrote stays."""
    node = bus.node("robot")
    for number in range(20):
        keep_sending(node, "map", f"link{number}", rate_hz=50.0)
    process = bus.start(
        *("bag", "record", "-o", str(small_disk / "run"), "--compression", "none"),
        *("--max-size", "100kB"),
    )
    assert process.wait() == 1
    said = "\n".join(process.err)
    assert re.search("Error: stopped recording: .*(is full|No space left)", said)
    *before, last = sorted(small_disk.iterdir())
    assert before
    for path in before:
        with RecordingReader(path) as recording:
            assert recording.is_complete
        assert by_another_reader(path)
    assert by_tfbus(last) == by_another_reader(last)
