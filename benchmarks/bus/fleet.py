"""The processes of `benchmarks.fleet`: robots, and a listener of some of them or all."""

import json
import os
import socket
import struct
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from benchmarks.bus.place import say

if TYPE_CHECKING:
    import tfbus

FRAMES, STATICS = 50, 20
# From when a listener has joined until its cost is measured, and for how long that is.
SETTLE_S, SECONDS = 2.0, 8.0
WITHIN_S = 60.0

# A static frame of each robot: the whole set has come with it.
_STATIC = f"fixed{STATICS - 1}"
# Linux's tcp_info from this place on: bytes acknowledged and received, packets out and in.
_TCP_COUNTS, _COUNTS_AT = struct.Struct("=QQII"), 120

Reads = Literal["everything", "needed"]


@dataclass(frozen=True)
class Joined:
    """A listener: how many robots it should read and how many it reads, the seconds until it had
    the statics of the last one (None: not within a minute), CPU seconds until then, afterwards its
    share of a core, and MB.
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


def _traffic() -> list[int]:
    """Bytes and packets that this process has sent and received by TCP."""
    counts = [0, 0, 0, 0]
    for entry in os.scandir("/proc/self/fd"):
        with suppress(OSError):
            if os.readlink(entry.path).startswith("socket:"):
                with socket.socket(fileno=os.dup(int(entry.name))) as each:
                    info = each.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, 256)
                found = _TCP_COUNTS.unpack_from(info, _COUNTS_AT)
                counts = [sum(pair) for pair in zip(counts, found, strict=True)]
    return counts


def publish(first: int, count: int, hz: float) -> None:
    """A process with `count` robots, whose messages are spread over time. It says when it began,
    and for each line of its standard input what it has sent and received.
    """
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
    began_s, robots = time.monotonic(), []
    for number in range(first, first + count):
        node = tfbus.Node(settings=tfbus.NodeSettings("driver", namespace=f"robot{number}"))
        tfbus.StaticTransformBroadcaster(node).send_transform(statics)
        robots.append(tfbus.TransformBroadcaster(node, history_s=0.0))
    say(began_s)
    ended = threading.Event()

    def answer() -> None:
        for _ in sys.stdin:
            say(_traffic())
        ended.set()

    threading.Thread(target=answer, daemon=True).start()
    due_s = time.monotonic()
    while not ended.is_set():
        for robot in robots:
            due_s = max(due_s + 1.0 / hz / count, time.monotonic() - 1.0 / hz)
            time.sleep(max(0.0, due_s - time.monotonic()))
            stamps = np.full(dynamic, time.time_ns())
            robot.send_transform(tfbus.TransformBatch(frames, edges, stamps, poses))
    os._exit(0)


def listen(robots: int, wanted: int, reads: Reads) -> None:
    """A process that reads `wanted` of the robots. It says how it joined, then answers each line of
    its standard input: `Awaited` as JSON.
    """
    import tfbus

    with tfbus.Node("base_station") as node:
        began_s, cpu_s = time.monotonic(), time.process_time()
        buffer = tfbus.Buffer()
        fleet = tfbus.Fleet(shared_frames=("map",))
        listener = tfbus.TransformListener(buffer, node, reads=reads, fleet=fleet)
        # Spread over the sites.
        read = {f"robot{number * robots // wanted}" for number in range(wanted)}
        pairs = [(f"{robot}/{_STATIC}", "map") for robot in read]
        for frame, root in pairs:
            listener.need(root, frame)
        left = read
        while left and time.monotonic() < began_s + WITHIN_S:
            left = {robot for robot in left if not _has_statics(buffer, robot)}
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
        mb = memory_mb(os.getpid())
        say(asdict(Joined(wanted, wanted - len(left), joined_s, join_cpu_s, cpu_percent, mb)))
        for line in sys.stdin:
            awaited = Awaited(**json.loads(line))
            say(awaited.wait(listener, read if reads == "needed" else None))


@dataclass(frozen=True)
class Awaited:
    """Robots that a listener is to know: gone, or there with a message since `since_ns`, if it
    reads them.
    """

    robots: list[str]
    gone: bool = False
    since_ns: int = 0

    def wait(self, listener: "tfbus.TransformListener", read: set[str] | None) -> tuple[float, int]:
        """When it knew the last of them, by the monotonic clock, and how many it does not know
        after a minute. `read` are those that it reads, None for all.
        """
        end_s, left = time.monotonic() + WITHIN_S, set(self.robots)
        while left and time.monotonic() < end_s:
            looked_s = time.monotonic()
            there = {*self._there(listener, read)}
            left = set(self.robots) & there if self.gone else set(self.robots) - there
            # To look at a thousand takes a while, in which the listener does nothing else.
            time.sleep(max(0.05, 4.0 * (time.monotonic() - looked_s)) if left else 0.0)
        return time.monotonic(), len(left)

    def _there(self, listener: "tfbus.TransformListener", read: set[str] | None) -> Iterator[str]:
        for stream in listener.streams():
            robot = stream.namespace
            is_read = read is None or robot in read
            is_heard = (stream.last_heard_ns or 0) >= self.since_ns
            if stream.alive and (
                not is_read or (is_heard and _has_statics(listener.buffer, robot))
            ):
                yield robot


def _has_statics(buffer: "tfbus.Buffer", robot: str) -> bool:
    return buffer.can_transform(f"{robot}/base", f"{robot}/{_STATIC}")
