"""The files of a recording that is written: their names, one after the other, on one disk."""

import os
import re
import shutil
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from tfbus.errors import InvalidArgumentException
from tfbus.recording.items import Item
from tfbus.recording.writer import RecordingWriter
from tfbus.wording import printable

ENDING = ".mcap"

# Of recordings in other formats; any other text after a point is a part of the name.
_OF_OTHERS = (".db3", ".bag", ".sqlite3")

# What is left free on a disk: the end of a file, its summary, needs room too.
_LEFT_FREE_BYTES = 16_000_000
_LEFT_FREE_PART = 1 / 10

# Writes the file of this path.
OpenWriter = Callable[[Path], RecordingWriter]

# Takes an item that a file cannot hold, and why.
Refuse = Callable[[Item, InvalidArgumentException], None]


@dataclass(frozen=True)
class WrittenPart:
    """A file that is whole: its length is from its first item to its last, by log times."""

    path: Path
    seconds: float
    size: int


class DiskFullError(OSError):
    """The disk is nearly full: nothing further is written, so that what is written is whole."""


def default_name() -> str:
    """`tfbus_2026_11_22-10_25_48.mcap`, as rosbag2 names recordings, in local time."""
    return time.strftime(f"tfbus_%Y_%m_%d-%H_%M_%S{ENDING}")


def path_of_recording(given: str | None) -> Path:
    """The first file of a recording: `run`, `run.mcap`, or a folder, in which it has the default
    name. Raises InvalidArgumentException for the ending of another format.
    """
    if not given:
        return Path(default_name())
    path = Path(given)
    if is_folder(given):
        return path / default_name()
    if path.suffix in _OF_OTHERS:
        raise InvalidArgumentException(
            f"'{printable(given)}': recordings are written as {ENDING} files: give a name "
            f"that ends with {ENDING}, or without an ending"
        )
    return path if path.suffix == ENDING else path.with_name(f"{path.name}{ENDING}")


def is_folder(given: str) -> bool:
    """Whether a path that is given for a recording is that of a folder, there or not."""
    return given.endswith(os.sep) or Path(given).is_dir()


def part_paths(first: Path) -> Iterator[Path]:
    """`run.mcap`, `run_1.mcap`, `run_2.mcap` and so on."""
    yield first
    number = 1
    while True:
        yield first.with_name(f"{first.stem}_{number}{ENDING}")
        number += 1


def existing_parts(first: Path) -> list[Path]:
    """The files that are there and have a name that this recording may want."""
    part = re.compile(rf"{re.escape(first.stem)}(_\d+)?{re.escape(ENDING)}")
    folder = first.parent
    return sorted(each for each in folder.glob(f"*{ENDING}") if part.fullmatch(each.name))


class PartsWritten:
    """Writes a recording, one file after the other; for one thread.

    `open_writer(path)` opens a file. `paths` are all files, `written` those that have ended. With
    `most_files` the oldest are deleted. Raises OSError, and DiskFullError before a disk is full.
    """

    def __init__(
        self, first: Path, open_writer: OpenWriter, *, most_files: int | None = None
    ) -> None:
        self.paths: list[Path] = []
        self.written: list[WrittenPart] = []
        self.deleted = 0
        self._most_files = most_files
        # The log times of the first and the last item of the file that is open.
        self._span_ns: tuple[int, int] | None = None
        self._first = first
        self._open_writer = open_writer
        self._names = part_paths(first)
        self._writer: RecordingWriter | None = None
        self._bytes_before = self._flushed_bytes = 0
        self._synced = True

    @property
    def is_open(self) -> bool:
        """Whether a file is open."""
        return self._writer is not None

    @property
    def part_bytes(self) -> int:
        """The size of the file that is open."""
        return 0 if self._writer is None else self._writer.size

    @property
    def written_bytes(self) -> int:
        """The size of all files when they were last flushed."""
        return self._bytes_before + self._flushed_bytes

    @property
    def free_bytes(self) -> int:
        """How much can still be written."""
        usage = shutil.disk_usage(self._first.parent)
        return max(0, usage.free - int(min(_LEFT_FREE_BYTES, usage.total * _LEFT_FREE_PART)))

    def open(self, items: Iterable[Item] = (), refuse: Refuse = lambda item, error: None) -> Path:
        """Open the next file, that begins with these items; its path. Those that it cannot hold go
        to `refuse`.
        """
        self.close()
        while True:
            path = next(self._names)
            # One of that name came meanwhile: it is not ours.
            with suppress(FileExistsError):
                self._writer = self._open_writer(path)
                break
        self.paths.append(path)
        _sync(path.parent)
        for item in items:
            try:
                self.write(item)
            except InvalidArgumentException as error:
                refuse(item, error)
        self._delete_oldest()
        # From now on it is a recording, if a short one.
        self._writer.flush()
        return path

    def write(self, item: Item) -> None:
        """Write an item. Raises InvalidArgumentException if it cannot be expressed."""
        assert self._writer is not None
        self._writer.write(item)
        self._synced = False
        log_ns = item.log_ns
        if self._span_ns is None:
            self._span_ns = log_ns, log_ns
        elif log_ns > self._span_ns[1]:
            self._span_ns = self._span_ns[0], log_ns

    def flush(self) -> None:
        """Have all that was written on the disk: it outlives a power cut."""
        if self._writer is not None and not self._synced:
            self._synced = True
            self._writer.flush()
            self._flushed_bytes = self._writer.size
            _sync(self.paths[-1])
            if not self.free_bytes:
                raise DiskFullError("the disk is full")

    def close(self) -> None:
        """End the file that is open; twice is fine."""
        writer, self._writer = self._writer, None
        if writer is not None:
            try:
                writer.close()
            finally:
                self._bytes_before += writer.size
                self._flushed_bytes = 0
                first_ns, last_ns = self._span_ns or (0, 0)
                self._span_ns = None
                self.written.append(
                    WrittenPart(self.paths[-1], (last_ns - first_ns) / 1e9, writer.size)
                )
            _sync(self.paths[-1])

    def _delete_oldest(self) -> None:
        while self._most_files is not None and len(self.paths) > self._most_files:
            self.paths.pop(0).unlink(missing_ok=True)
            self._bytes_before -= self.written.pop(0).size
            self.deleted += 1


def _sync(path: Path) -> None:
    """Have what the system holds of a file, or folder, written to the disk."""
    file = os.open(path, os.O_RDONLY)
    try:
        os.fsync(file)
    finally:
        os.close(file)
