"""Recordings for tests: items in a few words, and files of them."""

import math
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tests.builders import Row, S, moved
from tests.needs import module
from tfbus.geometry.columns import Columns
from tfbus.recording.items import EventItem, Item, RecordedStream, TopicItem, TransformItem

# Log times begin here.
T0 = 1_790_000_000 * S

# How long a message is on its way.
LATE_NS = 5_000_000


def at(seconds: float) -> int:
    """A log time, `seconds` after the beginning."""
    return T0 + round(seconds * S)


def publisher(name: str, epoch_s: float = -1.0, *, split: bool = False) -> RecordedStream:
    """A stream of its own node, in the epoch that began then: `robot7/sim` in robot7."""
    namespace = name.rpartition("/")[0]
    return RecordedStream(name, f"/{name}", namespace, at(epoch_s), split)


def sent(
    stream: RecordedStream,
    seconds: float,
    *edges: tuple[str, str, float],
    stamp_ns: int | None = None,
    seq: int | None = None,
) -> TransformItem:
    """A message with these edges of parent, child and x; stamped at that time, received 5 ms later,
    or stamped otherwise, received at that time.
    """
    stamped = at(seconds) if stamp_ns is None else stamp_ns
    rows = Columns.of_transforms(moved(stamped, *edge) for edge in edges)
    log_ns = at(seconds) + (LATE_NS if stamp_ns is None else 0)
    return TransformItem(log_ns, stream, rows, False, seq)


def statics(
    stream: RecordedStream, seconds: float, *edges: tuple[str, str, float], seq: int = 0
) -> TransformItem:
    """The static set of a stream."""
    rows = Columns.of_transforms(moved(at(seconds), *edge) for edge in edges)
    return TransformItem(at(seconds), stream, rows, True, seq)


def described(stream: RecordedStream, seconds: float, *rows: Row, pid: int = 7) -> EventItem:
    """The stream is there, with these rows of parent, child and whether it is static."""
    facts: dict[str, Any] = {
        "v": 1,
        "node": stream.node,
        "epoch": stream.epoch_ns,
        "frames": [list(row) for row in rows],
        "host": "robot",
        "pid": pid,
        "session": f"{stream.name}{stream.epoch_ns}",
        "priority": 0,
        "split": stream.split,
        "history_s": 10.0,
        "started_ns": stream.epoch_ns,
    }
    return EventItem(at(seconds), "stream", stream.name, facts)


def gone(stream: RecordedStream, seconds: float) -> EventItem:
    """The publisher of the stream is lost."""
    return EventItem(at(seconds), "stream gone", stream.name)


def node(name: str, seconds: float = 0.0, **more: Any) -> EventItem:
    """A node is there."""
    facts: dict[str, Any] = {
        "name": name,
        "host": "robot",
        "pid": 7,
        "version": "1",
        "session": name,
        "started_ns": T0,
        "streams": [],
        "parameters": [],
        "publishes": {},
        "subscribes": {},
        "serves": {},
        "calls": {},
    }
    return EventItem(at(seconds), "node", name, facts | more)


def steadily(
    stream: RecordedStream,
    from_s: float,
    to_s: float,
    *edges: tuple[str, str],
    rate_hz: float = 10.0,
    pause: tuple[float, float] = (0.0, 0.0),
) -> list[Item]:
    """Messages with these edges, x growing by 1 m/s; none in the pause."""
    count = round((to_s - from_s) * rate_hz)
    times = [from_s + number / rate_hz for number in range(count)]
    return [
        sent(stream, time_s, *((*edge, time_s) for edge in edges), seq=number)
        for number, time_s in enumerate(times)
        if not pause[0] <= time_s < pause[1]
    ]


def write(path: Path, *items: Item | Iterable[Item], new_chunk_s: float = math.inf) -> Path:
    """A recording of these items, which may come in any order; items from `new_chunk_s` on are in
    a chunk of their own.
    """
    module("mcap")
    from tfbus.recording.writer import RecordingWriter

    flat: list[Item] = []
    for each in items:
        flat += [each] if isinstance(each, Item) else list(each)
    with RecordingWriter(path) as writer:
        is_new = False
        for item in sorted(flat, key=lambda item: item.log_ns):
            if not is_new and item.log_ns >= T0 + new_chunk_s * S:
                writer.flush()
                is_new = True
            writer.write(item)
    return path


def write_robot(path: Path) -> Path:
    """The recording that the docs look into: a minute of a robot.

    odometry pauses from 42 to 44.1 s; arm is gone at 30 s; from 20 to 24 s a second node sends the
    frame of localization.
    """
    path.write_bytes(_robot())
    return path


@cache
def _robot() -> bytes:
    """Its bytes: many tests have one."""
    localization, odometry = publisher("localization"), publisher("odometry")
    model, arm, test = publisher("model"), publisher("arm"), publisher("old_localization", 20.0)
    items = (
        *(node(each.node, streams=[each.name]) for each in (localization, odometry, model, arm)),
        described(localization, 0.0, ("map", "odom", False), pid=211),
        steadily(localization, 0.0, 60.0, ("map", "odom")),
        described(odometry, 0.0, ("odom", "base_link", False), pid=212),
        steadily(odometry, 0.0, 60.0, ("odom", "base_link"), rate_hz=50.0, pause=(42.0, 44.1)),
        described(model, 0.0, ("base_link", "laser", True), pid=213),
        statics(model, 0.0, ("base_link", "laser", 0.2)),
        described(arm, 0.0, ("base_link", "gripper", False), pid=214),
        steadily(arm, 0.0, 30.0, ("base_link", "gripper"), rate_hz=20.0),
        gone(arm, 30.0),
        described(test, 20.0, ("map", "odom", False), pid=305),
        steadily(test, 20.05, 24.0, ("map", "odom"), rate_hz=5.0),
        gone(test, 24.0),
        [
            TopicItem(at(each), "battery", "Battery", {"percent": 80 - each / 10, "volts": 24.1})
            for each in range(60)
        ],
    )
    with TemporaryDirectory() as folder:
        return write(Path(folder, "run.mcap"), *items).read_bytes()
