"""Recordings as files of numbers: all transforms, or the messages of a topic, in CSV and npz."""

import csv
import io
import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from tfbus.recording.items import Item, TopicItem, TransformItem
from tfbus.runtime.whole_file import replacing
from tfbus.trajectory.csv_columns import FRAME_COLUMNS, POSE_COLUMNS

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
else:
    from tfbus.core import lazy_numpy as np

TRANSFORM_COLUMNS = ("log_ns", "stream", "static", "stamp_ns", *FRAME_COLUMNS, *POSE_COLUMNS)

_LOG_TIME = "log_ns"


def write_transforms_csv(items: Iterable[Item], path: Path) -> int:
    """Write all transforms as rows of CSV, in order of log time; how many there are.

    The columns are TRANSFORM_COLUMNS, of which `buffer.read_csv` reads those that it needs. Raises
    OSError.
    """
    count = 0
    with replacing(path) as file, _text(file) as text:
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
    frames: dict[str, int] = {}
    streams: dict[str, int] = {}
    columns: dict[str, list[NDArray[Any]]] = {
        name: [] for name in ("log_ns", "stamp_ns", "parent", "child", "pose", "static", "stream")
    }
    for item in _transforms(items):
        batch = item.rows.as_batch()
        count = len(batch)
        number_of = np.array(
            [frames.setdefault(name, len(frames)) for name in batch.frames], np.int32
        )
        stream = streams.setdefault(item.stream.name, len(streams))
        columns["log_ns"].append(np.full(count, item.log_ns, np.int64))
        columns["stamp_ns"].append(batch.stamps_ns)
        columns["parent"].append(number_of[batch.edges[:, 0]])
        columns["child"].append(number_of[batch.edges[:, 1]])
        columns["pose"].append(batch.poses)
        columns["static"].append(np.full(count, item.static))
        columns["stream"].append(np.full(count, stream, np.int32))
    empty = {
        "pose": np.empty((0, 7)),
        "static": np.empty(0, bool),
        "log_ns": np.empty(0, np.int64),
        "stamp_ns": np.empty(0, np.int64),
    }
    arrays = {
        name: np.concatenate([empty.get(name, np.empty(0, np.int32)), *parts])
        for name, parts in columns.items()
    }
    poses = arrays.pop("pose")
    with replacing(path) as file:
        np.savez_compressed(
            file,
            **arrays,
            xyz=poses[:, :3],
            quat_xyzw=poses[:, 3:],
            frames=np.array(list(frames), dtype=str),
            streams=np.array(list(streams), dtype=str),
        )
    return len(poses)


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
    with replacing(path) as file, _text(file) as text:
        rows = csv.DictWriter(text, list(header), restval="", lineterminator="\n")
        rows.writeheader()
        for item in _messages(messages()):
            rows.writerow({**_flat(item.values), _LOG_TIME: item.log_ns})
            count += 1
    return count


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


class _text(io.TextIOWrapper):
    """UTF-8 into a file of bytes, which stays open behind it."""

    def __init__(self, file: BinaryIO) -> None:
        super().__init__(file, encoding="utf-8", newline="")

    def __exit__(self, *_: object) -> None:
        self.detach()
