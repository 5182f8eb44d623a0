"""What tfbus does with recordings: each function is a process, see benchmarks/bus/place.py."""

import platform
import random
import time
from collections.abc import Iterable
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from statistics import median

from benchmarks.bus.place import say
from benchmarks.recordings import robot
from benchmarks.recordings.cost import cpu_s, say_cost
from benchmarks.recordings.robot import HOUR, LAST, PERIOD_NS
from tfbus import Buffer, Recording
from tfbus.base.installation import installed_version
from tfbus.buffer.buffer import COMPILED
from tfbus.recording.items import Item, TransformItem
from tfbus.recording.writer import Compression, RecordingWriter

_LOOKUPS = 100


def versions() -> None:
    """The versions of the programs, as they are installed for these processes."""
    kind = "compiled" if COMPILED else "interpreted"
    found = {"tfbus": f"{installed_version()}, {kind}, Python {platform.python_version()}"}
    for name in ("mcap", "mcap-ros2-support", "rosbags"):
        with suppress(PackageNotFoundError):
            found[name] = version(name)
    say(found)


def make(path: str, count: int) -> None:
    """A file for the others to read."""
    _write(path, robot.items(count), "zstd")
    say("made")


def write(folder: str, count: int, compression: Compression) -> None:
    """Columns into a file."""
    few, all_of_them = list(robot.items(10)), list(robot.items(count))
    say_cost(
        lambda: _write(f"{folder}/all.mcap", all_of_them, compression),
        lambda: _write(f"{folder}/few.mcap", few, compression),
    )


def _write(path: str, items: Iterable[Item], compression: Compression) -> None:
    with RecordingWriter(path, compression=compression) as writer:
        writer.write(robot.description())
        for item in items:
            writer.write(item)


def read(path: str) -> None:
    """All transforms as arrays."""
    with Recording(path) as recording:
        end_ns = recording.end_ns
        say_cost(lambda: _arrays(recording, None, None), lambda: _arrays(recording, end_ns, None))


def _arrays(recording: Recording, from_ns: int | None, to_ns: int | None) -> int:
    import numpy as np

    batches = [
        item.rows.as_batch()
        for item in recording.items(from_ns, to_ns)
        if isinstance(item, TransformItem)
    ]
    if not batches:
        return 0
    stamps = np.concatenate([batch.stamps_ns for batch in batches])
    poses = np.concatenate([batch.poses for batch in batches])
    assert len(poses) == len(stamps)
    return len(stamps)


def samples(path: str) -> None:
    """All transforms of one frame as arrays."""

    def job() -> None:
        with Recording(path) as recording:
            assert len(recording.samples(LAST)) >= robot.MINUTE

    say_cost(job)


def open_it(path: str) -> None:
    """Open a file, and say how long it is and which streams it has."""

    def job() -> None:
        with Recording(path) as recording:
            assert recording.duration_s > 0.0
            assert recording.streams

    say_cost(job)


def frames(path: str) -> None:
    """Open a file, and list its frames."""

    def job() -> None:
        with Recording(path) as recording:
            assert len(recording.frames()) > robot.FRAMES

    say_cost(job)


def seek(path: str) -> None:
    """A tenth of a second in the middle as arrays, in a file that is open: the median of many."""
    with Recording(path) as recording:
        middle_ns = (recording.start_ns + recording.end_ns) // 2
        costs = []
        for step in range(20):
            from_ns = middle_ns + step * 1_000_000_000

            def job(from_ns: int = from_ns) -> None:
                assert _arrays(recording, from_ns, from_ns + 100_000_000) >= 5 * robot.FRAMES

            costs.append(cpu_s(job))
    say(median(costs))


def look_up(path: str) -> None:
    """One lookup at stamps anywhere, and at stamps near each other: the median of many."""
    dice = random.Random(1)
    with Recording(path) as recording:
        recording.lookup_transform("map", LAST, robot.START_NS)
        anywhere = [
            cpu_s(lambda: recording.lookup_transform("map", LAST, _stamp(dice.randrange(HOUR - 1))))
            for _ in range(_LOOKUPS)
        ]
        near = [_stamp(HOUR // 2) + 100_000 * step for step in range(2_000)]
        recording.lookup_transform("map", LAST, near[0])
        began = time.process_time()
        for stamp_ns in near:
            recording.lookup_transform("map", LAST, stamp_ns)
        each = (time.process_time() - began) / len(near)
    say({"anywhere": median(anywhere), "near": each})


def first_lookup(path: str) -> None:
    """Open a file, and look up once in the middle."""

    def job() -> None:
        with Recording(path) as recording:
            recording.lookup_transform("map", LAST, _stamp(HOUR // 2))

    say_cost(job)


def play_to_middle(path: str) -> None:
    """The same as a buffer of tf2 must be filled for it: with all from the beginning on."""

    def job(message: int = HOUR // 2) -> None:
        buffer = Buffer(10.0)
        with Recording(path) as recording:
            for item in recording.items(None, robot.log_ns(message + 1)):
                if isinstance(item, TransformItem):
                    buffer.set_transforms(
                        item.rows.as_batch(), static=item.static, authority=item.stream.name
                    )
            buffer.lookup_transform("map", LAST, _stamp(message))

    say_cost(job, lambda: job(100))


def _stamp(message: int) -> int:
    """Between the stamps of a message and those of the next."""
    return robot.log_ns(message) - 1_000_000 + PERIOD_NS // 3
