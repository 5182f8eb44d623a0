"""What is recorded: a robot of 50 frames at 50 Hz, a message a tick, poses that all change."""

from collections.abc import Iterator

import numpy as np

from tfbus.geometry.columns import Columns
from tfbus.recording.items import EventItem, RecordedStream, TransformItem
from tfbus.ros.tf_message import TFMessageWriter

FRAMES = 50
RATE_HZ = 50
START_NS = 1_700_000_000_000_000_000
PERIOD_NS = 1_000_000_000 // RATE_HZ
MINUTE = 60 * RATE_HZ
HOUR = 60 * MINUTE

STREAM = RecordedStream("robot", "robot", epoch_ns=1)

# Chains of five frames, all of them below `base_link`, which is below `map`.
NAMES = ("map", "base_link", *(f"joint_{row}" for row in range(1, FRAMES)))
LAST = NAMES[FRAMES]
_PARENTS = [0, *(1 if row % 5 == 1 else row for row in range(1, FRAMES))]
_EDGES = np.array([(parent, row + 1) for row, parent in enumerate(_PARENTS)], np.uint32).tobytes()

# As many as a message of static transforms of a robot has.
_STATICS = 10


def log_ns(message: int) -> int:
    """When a message is received; its stamps are a millisecond older."""
    return START_NS + message * PERIOD_NS


def items(count: int) -> Iterator[TransformItem]:
    """The static transforms, and this many messages."""
    yield _static()
    for message in range(count):
        yield TransformItem(log_ns(message), STREAM, columns(message), seq=message)


def description() -> EventItem:
    """That the stream is there, as a recorder says at the beginning."""
    return EventItem(START_NS, "stream", STREAM.name, {"node": STREAM.node, "epoch": 1})


def messages(count: int) -> list[tuple[int, bytes]]:
    """The same as log times and bytes of ROS, without the static transforms."""
    return [
        (log_ns(message), TFMessageWriter().write(columns(message))) for message in range(count)
    ]


def columns(message: int) -> Columns:
    """The transforms of a message."""
    stamps = np.full(FRAMES, log_ns(message) - 1_000_000)
    return Columns.of_bytes(NAMES, _EDGES, stamps.tobytes(), _poses(message).tobytes())


def _poses(message: int) -> "np.ndarray[tuple[int, int], np.dtype[np.float64]]":
    phases = 0.01 * message + np.arange(FRAMES)
    half = 0.25 * np.sin(phases)
    poses = np.zeros((FRAMES, 7))
    poses[:, 0], poses[:, 1], poses[:, 2] = np.cos(phases), np.sin(phases), 0.1
    poses[:, 5], poses[:, 6] = np.sin(half), np.cos(half)
    return poses


def _static() -> TransformItem:
    names = ("base_link", *(f"sensor_{row}" for row in range(_STATICS)))
    edges = np.array([(0, row + 1) for row in range(_STATICS)], np.uint32)
    poses = np.tile([0.1, 0.2, 0.3, 0.0, 0.0, 0.6, 0.8], (_STATICS, 1))
    stamps = np.full(_STATICS, START_NS)
    rows = Columns.of_bytes(names, edges.tobytes(), stamps.tobytes(), poses.tobytes())
    return TransformItem(START_NS, STREAM, rows, static=True, seq=0)
