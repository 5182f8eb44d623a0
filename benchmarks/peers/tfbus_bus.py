"""All of tfbus that a message passes, for `gate.py`: sending, receiving, recording, beside some of
what the buffer alone does.

There is no network: what a session sends it receives itself, in the same call.
"""

import itertools
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks.bus.intake import Template
from benchmarks.peers.tfbus import insert, insert_columns, lookup, lookup_anywhere
from benchmarks.worker import Loop
from tfbus import (
    Buffer,
    Node,
    NodeSettings,
    Transform,
    TransformBatch,
    TransformBroadcaster,
    TransformListener,
    TransformStamped,
)
from tfbus.bag.raw_queue import TransformSource
from tfbus.geometry.packed import STAMP_SIZE
from tfbus.messages import Vector3
from tfbus.recording.writer import RecordingWriter
from tfbus.wire.descriptions import COMPACT
from tfbus.wire.keys import transforms_key
from tfbus.wire.numbered import IDENTITY
from tfbus.wire.transforms import NumberedEncoder, TransformReader

__all__ = [
    "calibrate",
    "insert",
    "insert_columns",
    "lookup",
    "lookup_anywhere",
    "receive",
    "receive_compact",
    "receive_unlisted",
    "record",
    "send",
    "subscribe",
]

_ALONE = "{scouting: {multicast: {enabled: false}}, timestamping: {enabled: true}}"
_CACHED_S = 0.1
# As many messages wait for a callback.
_BURST = 10
_PERIOD_NS = 1_000_000

# The same each time, as how well a recording is compressed depends on it.
_START_NS = 1_700_000_000 * 10**9
_samples = itertools.count()


def send(rows: int) -> Loop:
    """A message of `rows` transforms, which none subscribes to."""
    broadcaster = TransformBroadcaster(_node())
    batch = Template(rows).batch

    def items(count: int) -> list[TransformBatch]:
        return [_at(batch, stamp_ns) for stamp_ns in _stamps(count)]

    def run(batches: Sequence[TransformBatch]) -> None:
        for each in batches:
            broadcaster.send_transform(each)

    return Loop(items, run)


def receive(rows: int) -> Loop:
    """A message of `rows` transforms of a stream that lists their frames, into a buffer."""
    node = _node()
    listener = TransformListener(Buffer(_CACHED_S), node)
    template = Template(rows, node.started_ns)
    TransformBroadcaster(node).send_transform(template.batch)
    while not any(len(stream.frames) == rows for stream in listener.streams()):
        time.sleep(0.01)
    return _receive(node, node.name, template.next)


def receive_compact(rows: int) -> Loop:
    """The same of a stream whose frames have numbers, and have all moved and turned."""
    node = _node()
    listener = TransformListener(Buffer(_CACHED_S), node)
    frames = [f"frame_{row}" for row in range(rows)]
    TransformBroadcaster(node, poses=COMPACT).send_transform(
        [TransformStamped(_START_NS, "base_link", frame, Transform()) for frame in frames]
    )
    while not any(len(stream.frames) == rows for stream in listener.streams()):
        time.sleep(0.01)
    encoder = NumberedEncoder(node.started_ns, range(rows), IDENTITY * rows, is_short=False)
    poses = Template(rows).batch.poses.tobytes()
    # The numbers of messages, of which the first was sent above.
    sent = itertools.count(1)
    return _receive(
        node,
        node.name,
        lambda stamp_ns: encoder.encode(
            next(sent), stamp_ns.to_bytes(STAMP_SIZE, "little") * rows, poses
        ),
    )


def receive_unlisted(rows: int) -> Loop:
    """The same of a stream that says nothing of itself."""
    node = _node()
    TransformListener(Buffer(_CACHED_S), node)
    return _receive(node, "other", Template(rows).next)


def subscribe(_: int) -> Loop:
    """A message of a topic, from its publisher into the queue of a subscription.

    In bursts, of which the last message is waited for: how threads wake each other is not the same
    each time, and only the instructions of this one are counted.
    """
    node = _node()
    came = threading.Semaphore(0)
    publisher = node.create_publisher(Vector3, "topic")
    node.create_subscription(Vector3, "topic", lambda message: came.release())

    def run(messages: Sequence[Vector3]) -> None:
        for first in range(0, len(messages), _BURST):
            burst = messages[first : first + _BURST]
            for message in burst:
                publisher.publish(message)
            for _ in burst:
                came.acquire()

    return Loop(lambda count: [Vector3()] * count, run)


def record(rows: int) -> Loop:
    """A message of `rows` transforms into a recording, which is not compressed: how long that takes
    depends on where the memory is.
    """
    template = Template(rows, _START_NS)
    source = TransformSource("sender", "", {}, TransformReader(), static=False)
    folder = TemporaryDirectory(prefix="tfbus-bench-")
    log_ns = itertools.count(_START_NS, _PERIOD_NS)
    writer = RecordingWriter(str(Path(folder.name) / "written.mcap"), compression="none")

    def run(payloads: Sequence[bytes]) -> None:
        for payload in payloads:
            writer.write(source.item(next(log_ns), payload))

    return Loop(lambda count: [template.next(at) for at in _stamps(count)], run)


def calibrate(_: int) -> Loop:
    """What Python does without tfbus: calls, attributes, dicts, bytes."""

    def run(values: Sequence[int]) -> None:
        thing = _Thing()
        for value in values:
            thing.take(value, value.to_bytes(8, "little") * 10)

    return Loop(lambda count: list(range(count)), run)


class _Thing:
    def __init__(self) -> None:
        self.sum = 0
        self.last: dict[str, float] = {}

    def take(self, value: int, data: bytes) -> None:
        self.sum += len(data)
        for name in ("a", "b", "c"):
            self.last[name] = value * 0.5 + self.last.get(name, 0.0)
        if bytes(data[8:16]) != data[:8]:
            raise ValueError(f"{value}: {data!r}")


def _receive(node: Node, stream: str, message_at: Callable[[int], bytes]) -> Loop:
    publisher = node.session.publisher(transforms_key(stream), urgent=True)

    def run(payloads: Sequence[bytes]) -> None:
        for payload in payloads:
            publisher.put(payload)

    return Loop(lambda count: [message_at(at) for at in _stamps(count)], run)


def _stamps(count: int) -> list[int]:
    """The next stamps, none of which is in the future."""
    return [_START_NS + next(_samples) * _PERIOD_NS for _ in range(count)]


def _at(batch: TransformBatch, stamp_ns: int) -> TransformBatch:
    stamps: Any = batch.stamps_ns.copy()
    stamps[:] = stamp_ns
    return TransformBatch(batch.frames, batch.edges, stamps, batch.poses)


def _node() -> Node:
    config = Path("alone.json5").absolute()
    config.write_text(_ALONE)
    node = Node("sender", settings=NodeSettings("sender", config=str(config), log_level="warning"))
    return node
