"""The same with the library rosbags."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from statistics import median
from typing import Any

from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from benchmarks.bus.place import say
from benchmarks.recordings import robot
from benchmarks.recordings.cost import cpu_s, say_cost
from benchmarks.recordings.lists import arrays
from tfbus.ros.definitions import TF_MESSAGE

_TYPES = get_typestore(Stores.ROS2_JAZZY)


def write(folder: str, count: int, compression: str) -> None:
    """Messages, made before, into a file: with its own serialisation."""
    few, all_of_them = _messages(10), _messages(count)
    say_cost(
        lambda: _write(f"{folder}/all", all_of_them, compression),
        lambda: _write(f"{folder}/few", few, compression),
    )


def _messages(count: int) -> list[tuple[int, Any]]:
    return [
        (log_ns, _TYPES.deserialize_cdr(data, TF_MESSAGE.name))
        for log_ns, data in robot.messages(count)
    ]


def _write(folder: str, messages: Iterable[tuple[int, Any]], compression: str) -> None:
    writer = Writer(Path(folder), version=9, storage_plugin=StoragePlugin.MCAP)
    if compression == "zstd":
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/tf", TF_MESSAGE.name, typestore=_TYPES)
        for log_ns, message in messages:
            data = _TYPES.serialize_cdr(message, TF_MESSAGE.name)
            writer.write(connection, log_ns, data)


def read(path: str) -> None:
    """All transforms as arrays."""
    say_cost(lambda: _read(path, None, None), lambda: _read(path, None, robot.log_ns(10)))


def _read(path: str, from_ns: int | None, to_ns: int | None) -> int:
    with AnyReader([Path(path)]) as reader:
        return arrays(_decoded(reader, from_ns, to_ns))


def _decoded(reader: AnyReader, from_ns: int | None, to_ns: int | None) -> Iterator[Any]:
    for connection, _, data in reader.messages(start=from_ns, stop=to_ns):
        yield reader.deserialize(data, connection.msgtype)


def open_it(path: str) -> None:
    """Open a file, and say how long it is and which topics it has."""

    def job() -> None:
        with AnyReader([Path(path)]) as reader:
            assert reader.duration > 0
            assert reader.topics

    say_cost(job)


def seek(path: str) -> None:
    """A tenth of a second in the middle as arrays, in a file that is open: the median of many."""
    middle_ns = robot.log_ns(robot.HOUR // 2)
    with AnyReader([Path(path)]) as reader:
        costs = []
        for step in range(20):
            from_ns = middle_ns + step * 1_000_000_000

            def job(from_ns: int = from_ns) -> None:
                found = _decoded(reader, from_ns, from_ns + 100_000_000)
                assert arrays(found) >= 5 * robot.FRAMES

            costs.append(cpu_s(job))
    say(median(costs))
