"""How much a listener takes off the bus: messages and transforms a second, CPU for each."""

import os
import sys
import time
from dataclasses import dataclass
from typing import Any

from benchmarks.bus.place import Place, Process, place, say

SECONDS = 3.0
# Thousands of samples an edge, at the rate that the link bears.
_FRAMES_CACHED_S = 0.1


@dataclass(frozen=True)
class Intake:
    """What one process received in a while, and the CPU of all its threads meanwhile."""

    messages: int
    transforms: int
    wall_s: float
    cpu_s: float

    @property
    def messages_per_s(self) -> float:
        """Messages a second by the clock."""
        return self.messages / self.wall_s

    @property
    def transforms_per_s(self) -> float:
        """Transforms a second by the clock."""
        return self.transforms / self.wall_s

    @property
    def cpu_ns(self) -> float:
        """CPU for one transform."""
        return 1e9 * self.cpu_s / self.transforms


def measure(rows: int, runs: int) -> Intake:
    """What a listener takes where one publisher sends as much as the link bears; the run with
    the median CPU for a transform.
    """
    taken = []
    for _ in range(runs):
        with place() as at:
            taken.append(_once(at, rows))
    return sorted(taken, key=lambda intake: intake.cpu_ns)[len(taken) // 2]


def _once(at: Place, rows: int) -> Intake:
    listener = Process(at, "intake:listen", at.listening(), seconds=SECONDS)
    with listener, Process(at, "intake:flood", at.connecting(), rows=rows):
        return Intake(**listener.hear())


def listen(seconds: float) -> None:
    """The process that listens; reports what it received within `seconds`."""
    import tfbus

    with tfbus.Node("listener") as node:
        buffer = tfbus.Buffer(_FRAMES_CACHED_S)
        listener = tfbus.TransformListener(buffer, node)
        while not count(listener)[0]:
            time.sleep(0.01)
        time.sleep(0.5)
        say(during(seconds, lambda: count(listener)))
        sys.stdin.readline()


def during(seconds: float, counted: Any) -> dict[str, float]:
    """Messages and transforms counted within `seconds`, and the time that took."""
    before, cpu, wall = counted(), time.process_time(), time.perf_counter()
    time.sleep(seconds)
    after, cpu_s, wall_s = counted(), time.process_time() - cpu, time.perf_counter() - wall
    return {
        "messages": after[0] - before[0],
        "transforms": after[1] - before[1],
        "wall_s": wall_s,
        "cpu_s": cpu_s,
    }


def count(listener: Any) -> tuple[int, int]:
    """Messages and transforms that a listener has received."""
    streams = listener.streams()
    return sum(s.messages for s in streams), sum(s.transforms for s in streams)


def flood(rows: int) -> None:
    """The process that sends as much as the link carries, and blocks when it is full."""
    import threading

    import zenoh

    import tfbus
    from tfbus.wire.keys import transforms_key

    ended = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.readline(), ended.set()), daemon=True).start()
    with tfbus.Node("sender") as node:
        publisher = node.session.zenoh.declare_publisher(
            transforms_key("sender"), congestion_control=zenoh.CongestionControl.BLOCK
        )
        message = Template(rows)
        while not ended.is_set():
            for _ in range(100):
                publisher.put(message.next(time.time_ns()))
        os._exit(0)


class Template:
    """Messages of `rows` transforms below one frame, equal except for their stamps."""

    def __init__(self, rows: int, epoch_ns: int = 0) -> None:
        import numpy as np

        from tfbus import TransformBatch
        from tfbus.wire.transforms import TransformMessage, encode_transforms

        stamp = 0x0102030405060708
        edges = [(0, 1 + row) for row in range(rows)]
        batch = TransformBatch(
            ("base_link", *(f"frame_{row}" for row in range(rows))),
            np.array(edges, dtype=np.uint32),
            np.full(rows, stamp),
            np.tile([1.0, 2.0, 3.0, 0.0, 0.0, 0.6, 0.8], (rows, 1)),
        )
        stamps = stamp.to_bytes(8, "little") * rows
        payload = encode_transforms(TransformMessage(batch, epoch_ns or time.time_ns()))
        self.batch = batch
        self.size = len(payload)
        self._rows = rows
        self._head, _, self._tail = payload.partition(stamps)

    def next(self, stamp_ns: int) -> bytes:
        """The message of this time."""
        return b"".join((self._head, stamp_ns.to_bytes(8, "little") * self._rows, self._tail))
