"""The processes of `benchmarks.fleet`: robots, and a listener of some of them or all."""

import os
import sys
import threading
import time
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

from benchmarks.bus.place import say

FRAMES, STATICS = 50, 20
# From when a listener has joined until its cost is measured, and for how long that is.
SETTLE_S, SECONDS = 2.0, 8.0
JOIN_WITHIN_S = 60.0

Reads = Literal["everything", "needed"]


@dataclass(frozen=True)
class Joined:
    """A listener: how many robots it should read and does, the seconds until it had the last one
    (None: not within a minute), CPU seconds until then, afterwards its share of a core, and MB.
    """

    wanted: int
    read: int
    join_s: float | None
    join_cpu_s: float
    cpu_percent: float
    memory_mb: float


def memory_mb(pid: int) -> float:
    """The memory that a process shares with no other."""
    text = Path(f"/proc/{pid}/smaps_rollup").read_text()
    return sum(int(line.split()[1]) for line in text.splitlines() if line[:8] == "Private_") / 1e3


def publish(first: int, count: int, hz: float) -> None:
    """A process with `count` robots; their messages are spread over time."""
    import numpy as np

    import tfbus

    dynamic = FRAMES - STATICS
    frames = ("map", "base", *(f"moving{number}" for number in range(dynamic - 1)))
    edges = np.array([(0, 1), *((1, row) for row in range(2, dynamic + 1))], dtype=np.uint32)
    poses = np.tile([1.0, 2.0, 3.0, 0.0, 0.0, 0.6, 0.8], (dynamic, 1))
    pose = tfbus.Transform((1.0, 2.0, 3.0))
    statics = [
        tfbus.TransformStamped(0, "base", f"fixed{number}", pose) for number in range(STATICS)
    ]
    robots = []
    for number in range(first, first + count):
        node = tfbus.Node(settings=tfbus.NodeSettings("driver", namespace=f"robot{number}"))
        tfbus.StaticTransformBroadcaster(node).send_transform(statics)
        robots.append(tfbus.TransformBroadcaster(node, history_s=0.0))
    say("ready")
    ended = threading.Event()

    def wait_for_end() -> None:
        sys.stdin.readline()
        ended.set()

    threading.Thread(target=wait_for_end, daemon=True).start()
    due_s = time.monotonic()
    while not ended.is_set():
        for robot in robots:
            due_s = max(due_s + 1.0 / hz / count, time.monotonic() - 1.0 / hz)
            time.sleep(max(0.0, due_s - time.monotonic()))
            stamps = np.full(dynamic, time.time_ns())
            robot.send_transform(tfbus.TransformBatch(frames, edges, stamps, poses))
    os._exit(0)


def listen(robots: int, wanted: int, reads: Reads) -> None:
    """The process that reads `wanted` of the robots, from its start on."""
    import tfbus

    with tfbus.Node("base_station") as node:
        began_s, cpu_s = time.monotonic(), time.process_time()
        buffer = tfbus.Buffer()
        fleet = tfbus.Fleet(shared_frames=("map",))
        listener = tfbus.TransformListener(buffer, node, reads=reads, fleet=fleet)
        # Spread over the sites.
        left = {f"robot{number * robots // wanted}" for number in range(wanted)}
        pairs = [(f"{robot}/fixed{STATICS - 1}", "map") for robot in left]
        for frame, root in pairs:
            listener.need(root, frame)
        end_s = began_s + JOIN_WITHIN_S
        while left and time.monotonic() < end_s:
            left = {robot for robot in left if not _is_read(buffer, robot)}
            time.sleep(0.05)
        join_s, join_cpu_s = time.monotonic() - began_s, time.process_time() - cpu_s
        time.sleep(SETTLE_S)
        before_s, since_s = time.process_time(), time.monotonic()
        while time.monotonic() < since_s + SECONDS:
            for frame, root in pairs:
                with suppress(tfbus.TransformException):
                    buffer.lookup_transform(root, frame)
            time.sleep(1.0)
        passed_s = time.monotonic() - since_s
        cpu_percent = 100.0 * (time.process_time() - before_s) / passed_s
        joined_s = None if left else join_s
        read, mb = wanted - len(left), memory_mb(os.getpid())
        say(asdict(Joined(wanted, read, joined_s, join_cpu_s, cpu_percent, mb)))


def _is_read(buffer: object, robot: str) -> bool:
    import tfbus

    assert isinstance(buffer, tfbus.Buffer)
    return buffer.can_transform("map", f"{robot}/fixed{STATICS - 1}")
