"""Recordings as files of numbers: all transforms, or the messages of a topic, in CSV and npz."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from tfbus.core.sampling import TF2, Sampling
from tfbus.errors import InvalidArgumentException, TransformException
from tfbus.geometry.batch import TransformBatch
from tfbus.recording.items import Item, TopicItem, TransformItem
from tfbus.recording.reader import RecordingReader
from tfbus.recording.recording import Recording
from tfbus.runtime.whole_file import replacing
from tfbus.trajectory.csv_columns import FRAME_COLUMNS, POSE_COLUMNS
from tfbus.trajectory.trajectory import Trajectory, check_count

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
else:
    from tfbus.core import lazy_numpy as np

TRANSFORM_COLUMNS = ("log_ns", "stream", "static", "stamp_ns", *FRAME_COLUMNS, *POSE_COLUMNS)

_LOG_TIME = "log_ns"

# For the last transforms before a moment, so much of the recording is read at first.
_LOOKED_BACK_NS = 2_000_000_000


def write_transforms_csv(items: Iterable[Item], path: Path) -> int:
    """Write all transforms as rows of CSV, in order of log time; how many there are.

    The columns are TRANSFORM_COLUMNS; `buffer.read_csv` reads those that it needs. Raises
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
    table = _Table()
    for item in _transforms(items):
        table.take(item)
    arrays: dict[str, Any] = table.arrays()
    with replacing(path) as file:
        np.savez_compressed(file, **arrays)
    return len(arrays["stamp_ns"])


def write_topic_csv(messages: Callable[[], Iterable[Item]], path: Path) -> int:
    """Write the messages of one topic as rows of CSV; how many there are.

    The columns are the log time and the fields, `linear.x` of maps in maps; lists are JSON.
    `messages` gives the items, and is called twice: the fields of all are the header. Raises
    OSError.
    """
    header = {_LOG_TIME: None}
    for item in _messages(messages()):
        header |= dict.fromkeys(_flat(item.values))
    count = 0
    with replacing(path) as file, _TextInto(file) as text:
        rows = csv.DictWriter(text, list(header), restval="", lineterminator="\n")
        rows.writeheader()
        for item in _messages(messages()):
            rows.writerow({**_flat(item.values), _LOG_TIME: item.log_ns})
            count += 1
    return count


class _Table:
    """Collects transforms as columns."""

    def __init__(self) -> None:
        self._frames: dict[str, int] = {}
        self._streams: dict[str, int] = {}
        self._batches: list[TransformBatch] = []
        self._edges: list[NDArray[np.int32]] = []
        # Of each message: log time, whether static, stream.
        self._facts: list[tuple[int, bool, int]] = []

    def take(self, item: TransformItem) -> None:
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


def stamps_at_rate(first_ns: int, last_ns: int, rate_hz: float) -> NDArray[np.int64]:
    """Stamps from the first on, at most to the last, this many a second; each rounded. Raises
    TfbusError for more than 20 million.
    """
    count = int((last_ns - first_ns) * rate_hz / 1e9) + 1
    check_count(count)
    since: NDArray[np.int64] = np.round(np.arange(count) * (1e9 / rate_hz)).astype(np.int64)
    return first_ns + since[since <= last_ns - first_ns]


def poses_at(
    recording: Recording,
    target: str,
    source: str,
    stamps_ns: NDArray[np.int64],
    sampling: Sampling = TF2,
) -> Trajectory:
    """Where the source was, seen from the target, at those of the stamps at which that is known.

    Raises as `Recording.lookup_transform` where it is known at none.
    """
    try:
        poses = recording.lookup_transforms(target, source, stamps_ns, sampling=sampling)
        return Trajectory(target, source, stamps_ns, poses.xyz, poses.quat_xyzw)
    except InvalidArgumentException:
        raise
    except TransformException as error:
        reason = error
    # Within a gap: the others one by one.
    found = []
    for stamp_ns in stamps_ns.tolist():
        try:
            found.append(recording.lookup_transform(target, source, stamp_ns, sampling=sampling))
        except TransformException as error:
            reason = error
    if not found:
        raise reason
    numbers = np.array([each.transform.as_pose() for each in found])
    stamps = [each.stamp_ns for each in found]
    return Trajectory(target, source, stamps, numbers[:, :3], numbers[:, 3:])


def stamps_received(
    reader: RecordingReader, from_ns: int, to_ns: int
) -> tuple[int | None, int | None]:
    """The first stamp of the dynamic transforms that were received from one log time to another,
    and the last; None where there are none.
    """
    first = next(_stamps(reader, from_ns, to_ns), None)
    last = None
    window_ns = _LOOKED_BACK_NS
    while last is None and first is not None:
        begin_ns = max(from_ns, to_ns - window_ns)
        last = max(map(max, _stamps(reader, begin_ns, to_ns)), default=None)
        window_ns *= 4
    return (min(first) if first else None), last


def _stamps(reader: RecordingReader, from_ns: int, to_ns: int) -> Iterator[list[int]]:
    for item in _transforms(reader.items(from_ns, to_ns)):
        if not item.static and item.rows.count:
            yield item.rows.stamps_as_ints()


def _transforms(items: Iterable[Item]) -> Iterator[TransformItem]:
    return (item for item in items if isinstance(item, TransformItem))


def _messages(items: Iterable[Item]) -> Iterator[TopicItem]:
    return (item for item in items if isinstance(item, TopicItem))


def _flat(values: Mapping[str, Any], above: str = "") -> dict[str, Any]:
    fields: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, Mapping):
            fields |= _flat(value, f"{above}{name}.")
        elif isinstance(value, (list, tuple, bytes)):
            fields[above + name] = json.dumps(value, default=_as_json)
        else:
            fields[above + name] = value
    return fields


def _as_json(value: Any) -> Any:
    return value.hex() if isinstance(value, bytes) else str(value)


class _TextInto(io.TextIOWrapper):
    """UTF-8 into a file of bytes, which stays open behind it."""

    def __init__(self, file: BinaryIO) -> None:
        super().__init__(file, encoding="utf-8", newline="")

    def __exit__(self, *_: object) -> None:
        self.detach()
