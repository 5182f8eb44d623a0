"""How a listener's cost grows with publishers and with frames."""

import os
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from resource import getpagesize

from benchmarks.bus.intake import Intake, count, during
from benchmarks.bus.place import Place, Process, place, say

PUBLISHERS = (1, 10, 100, 1_000)
FRAMES = (10, 100, 1_000, 10_000, 100_000)
SECONDS = 3.0
# Transforms a second, all publishers and frames together.
RATE = 10_000
# Of one message at most.
_MOST_ROWS = 1_000


@dataclass(frozen=True)
class Size:
    """A listener with `size` publishers or frames: seconds until it had a transform of each,
    bytes that its process grew by, and the cost of receiving.
    """

    size: int
    met_s: float
    memory: int
    intake: Intake

    @property
    def cpu_percent(self) -> float:
        """Of one core, for RATE transforms a second."""
        return 100.0 * self.intake.cpu_ns * RATE / 1e9


def of_publishers() -> list[Size]:
    """With ever more streams, each of one frame, that send single transforms in turn."""
    return [_measure(streams=size, rows=1) for size in PUBLISHERS]


def of_frames() -> list[Size]:
    """With ever more frames of one stream, a thousand to a message at most."""
    return [_measure(streams=1, rows=size) for size in FRAMES]


def _measure(streams: int, rows: int) -> Size:
    with place() as at:
        return _once(at, streams, rows)


def _once(at: Place, streams: int, rows: int) -> Size:
    frames = max(streams, rows)
    with Process(at, "growth:listen", at.listening(), frames=frames) as listener:
        listener.hear()
        with Process(at, "growth:publish", at.connecting(), streams=streams, rows=rows) as sender:
            sender.hear()
            report = listener.hear()
    return Size(frames, report["met_s"], report["memory"], Intake(**report["intake"]))


def listen(frames: int) -> None:
    """The process that listens."""
    import tfbus

    with tfbus.Node("listener") as node:
        buffer = tfbus.Buffer(1.0)
        listener = tfbus.TransformListener(buffer, node)
        memory = _memory()
        say("ready")
        while not count(listener)[0]:
            time.sleep(0.001)
        started = time.perf_counter()
        while len(buffer.frames()) <= frames:
            time.sleep(0.02)
        met_s = time.perf_counter() - started
        time.sleep(2.0)
        intake = during(SECONDS, lambda: count(listener))
        say({"met_s": met_s, "memory": _memory() - memory, "intake": intake})
        sys.stdin.readline()


def publish(streams: int, rows: int) -> None:
    """The process that sends: each stream its frames in turn, RATE transforms a second in all."""
    import numpy as np

    import tfbus

    ended = threading.Event()
    with tfbus.Node("sender") as node:
        broadcasters = [
            tfbus.TransformBroadcaster(node, stream=f"stream_{number}", history_s=0.0)
            for number in range(streams)
        ]
        parts = [
            _batch(tfbus, np, stream, range(start, min(start + _MOST_ROWS, rows)))
            for stream in range(streams)
            for start in range(0, rows, _MOST_ROWS)
        ]
        say("ready")
        threading.Thread(target=lambda: (sys.stdin.readline(), ended.set()), daemon=True).start()
        due = time.monotonic()
        while not ended.is_set():
            for number, (frames, edges, poses) in enumerate(parts):
                due += len(edges) / RATE
                time.sleep(max(0.0, due - time.monotonic()))
                stamps = np.full(len(edges), time.time_ns())
                batch = tfbus.TransformBatch(frames, edges, stamps, poses)
                broadcasters[number % streams].send_transform(batch)
    os._exit(0)


def _batch(tfbus, np, stream: int, rows: range):  # type: ignore[no-untyped-def]  # modules
    frames = ("base_link", *(f"frame_{stream}_{row}" for row in rows))
    edges = np.array([(0, 1 + row) for row in range(len(rows))], dtype=np.uint32)
    poses = np.tile([1.0, 2.0, 3.0, 0.0, 0.0, 0.6, 0.8], (len(rows), 1))
    return frames, edges, poses


def _memory() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * getpagesize()
