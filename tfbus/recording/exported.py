"""Recordings as files of numbers: all transforms, or the messages of a topic, in CSV and npz."""

from __future__ import annotations

import csv
import io
import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO, TypeAlias

from tfbus.base import lazy_numpy as np
from tfbus.base.json_text import json_text
from tfbus.base.lazy_numpy import NDArray
from tfbus.base.whole_file import replacing
from tfbus.geometry.batch import TransformBatch
from tfbus.geometry.trajectory import FRAME_COLUMNS, POSE_COLUMNS
from tfbus.recording.items import Item, TopicItem, TransformItem

TRANSFORM_COLUMNS = ("log_ns", "stream", "static", "stamp_ns", *FRAME_COLUMNS, *POSE_COLUMNS)

_LOG_TIME = "log_ns"

# A field of a message, with the fields that it is in.
_Field: TypeAlias = tuple[str, ...]


def write_transforms_csv(items: Iterable[Item], path: Path) -> int:
    """Write all transforms as rows of CSV, in order of log time; how many there are.

    The columns are TRANSFORM_COLUMNS; `Trajectory.read_csv` reads the ones that it needs. Raises
    OSError.
    """
    count = 0
    with replacing(path) as file, _TextInto(file) as text:
        rows = csv.writer(text, lineterminator="\n")
        rows.writerow(TRANSFORM_COLUMNS)
        for item in _transforms(items):
            batch = item.rows.as_batch()
            # Adding 0.0 turns -0.0 into 0.0, as `tfbus echo` does.
            for (parent, child), stamp_ns, pose in zip(
                batch.edges.tolist(),
                batch.stamps_ns.tolist(),
                (batch.poses + 0.0).tolist(),
                strict=True,
            ):
                frames = batch.frames[parent], batch.frames[child]
                static = int(item.static)
                rows.writerow((item.log_ns, item.stream.name, static, stamp_ns, *frames, *pose))
            count += len(batch)
    return count


def write_transforms_npz(items: Iterable[Item], path: Path) -> int:
    """Write all transforms as arrays of numpy, in order of log time; how many there are.

    `stamp_ns` and `log_ns` (N,) int64 are nanoseconds since the Unix epoch, `xyz` (N, 3) metres,
    `quat_xyzw` (N, 4), `static` (N,) bool; `parent` and `child` (N,) are indices in `frames`,
    `stream` (N,) in `streams`. Raises OSError.
    """
    table = _TransformTable()
    for item in _transforms(items):
        table.append(item)
    arrays: dict[str, Any] = table.arrays()
    with replacing(path) as file:
        np.savez_compressed(file, **arrays)
    return len(arrays["stamp_ns"])


def write_topic_csv(messages: Callable[[], Iterable[Item]], path: Path) -> int:
    """Write the messages of one topic as rows of CSV; how many there are.

    The columns are the log time `log_ns` and the fields, `linear.x` of maps in maps, `log_ns_2` for
    a name that is there already; lists are JSON. `messages` gives the items, and is called twice:
    the fields of all are the header. Raises OSError.
    """
    fields: dict[_Field, None] = {}
    for item in _messages(messages()):
        fields |= dict.fromkeys(_flat(item.with_arrays))
    count = 0
    with replacing(path) as file, _TextInto(file) as text:
        rows = csv.writer(text, lineterminator="\n")
        rows.writerow(_apart([_LOG_TIME, *map(".".join, fields)]))
        for item in _messages(messages()):
            values = _flat(item.with_arrays)
            rows.writerow([item.log_ns, *(values.get(field, "") for field in fields)])
            count += 1
    return count


def _apart(names: Iterable[str]) -> Iterator[str]:
    """The names, each once: one that is there already has a number at its end."""
    given: set[str] = set()
    for name in names:
        numbered = (f"{name}_{number}" for number in itertools.count(2))
        apart = next(each for each in itertools.chain([name], numbered) if each not in given)
        given.add(apart)
        yield apart


class _TransformTable:
    """Collects transforms as columns."""

    def __init__(self) -> None:
        self._frames: dict[str, int] = {}
        self._streams: dict[str, int] = {}
        self._batches: list[TransformBatch] = []
        self._edges: list[NDArray[np.int32]] = []
        # Of each message: log time, whether static, stream.
        self._facts: list[tuple[int, bool, int]] = []

    def append(self, item: TransformItem) -> None:
        batch = item.rows.as_batch()
        numbers = [self._frames.setdefault(name, len(self._frames)) for name in batch.frames]
        stream = self._streams.setdefault(item.stream.name, len(self._streams))
        self._batches.append(batch)
        self._edges.append(np.array(numbers, np.int32)[batch.edges.astype(np.intp)])
        self._facts.append((item.log_ns, item.static, stream))

    def arrays(self) -> dict[str, NDArray[Any]]:
        counts = [len(batch) for batch in self._batches]
        log_ns, static, stream = zip(*self._facts, strict=True) if self._facts else ((), (), ())
        edges = np.concatenate([np.empty((0, 2), np.int32), *self._edges])
        poses = np.concatenate([np.empty((0, 7)), *(batch.poses for batch in self._batches)])
        stamps = [np.empty(0, np.int64), *(batch.stamps_ns for batch in self._batches)]
        return {
            "stamp_ns": np.concatenate(stamps),
            "log_ns": np.repeat(np.array(log_ns, np.int64), counts),
            "parent": edges[:, 0],
            "child": edges[:, 1],
            "xyz": poses[:, :3],
            "quat_xyzw": poses[:, 3:],
            "static": np.repeat(np.array(static, bool), counts),
            "stream": np.repeat(np.array(stream, np.int32), counts),
            "frames": np.array(list(self._frames), dtype=str),
            "streams": np.array(list(self._streams), dtype=str),
        }


def _transforms(items: Iterable[Item]) -> Iterator[TransformItem]:
    return (item for item in items if isinstance(item, TransformItem))


def _messages(items: Iterable[Item]) -> Iterator[TopicItem]:
    return (item for item in items if isinstance(item, TopicItem))


def _flat(values: Mapping[Any, Any], above: _Field = ()) -> dict[_Field, Any]:
    fields: dict[_Field, Any] = {}
    for name, value in values.items():
        # The names in a stranger's nested map may be bytes or numbers.
        field = (*above, name.hex() if isinstance(name, bytes) else str(name))
        if isinstance(value, Mapping):
            fields |= _flat(value, field)
        elif isinstance(value, list | tuple | bytes | memoryview) or hasattr(value, "dtype"):
            fields[field] = json_text(value)
        else:
            fields[field] = value
    return fields


class _TextInto(io.TextIOWrapper):
    """UTF-8 into a file of bytes, which stays open behind it."""

    def __init__(self, file: BinaryIO) -> None:
        super().__init__(file, encoding="utf-8", newline="")

    def __exit__(self, *_: object) -> None:
        self.detach()
