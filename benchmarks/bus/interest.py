"""A listener that reads everything beside one that reads what its lookups need.

python -m benchmarks.bus.interest

Two hundred publishers, each a session of its own, send through a router; a third process looks up
one path.
"""

import os
import sys
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict, dataclass

from benchmarks.bus.place import Place, Process, place, say

PUBLISHERS = 200
_PROCESSES = 4
# Each publisher sends FRAMES frames in one message, HZ times a second.
FRAMES = 50
HZ = 10.0
SECONDS = 10.0
LOOKUPS_HZ = 2.0
NOTHING, EVERYTHING = "nothing: a session alone", "everything"
NEEDED = "needed, a path over one publisher"
NEEDED_OF_TWO = "needed, a path over two publishers"
# What is read, and how many publishers the path leads over that is looked up: 1 is a frame of one
# in the frame that all share.
_KINDS = {
    NOTHING: ("", 0),
    EVERYTHING: ("everything", 2),
    NEEDED: ("needed", 1),
    NEEDED_OF_TWO: ("needed", 2),
}
_SETTLE_S = 3.0


@dataclass(frozen=True)
class Cost:
    """What one process received in a second, and its CPU in percent of a core."""

    messages: float
    transforms: float
    bytes: float
    cpu_percent: float


def measure(runs: int) -> dict[str, Cost]:
    """Of a session that listens to nothing, a listener that reads everything, and listeners that
    read what a path over one or two publishers needs; each the run with the median CPU.
    """
    with place() as at, ExitStack() as stack:
        client = {**at.connecting(), "TFBUS_MODE": "client"}
        router = {**at.listening(), "TFBUS_MODE": "router"}
        stack.enter_context(Process(at, "interest:route", router)).hear()
        share = PUBLISHERS // _PROCESSES
        for first in range(0, PUBLISHERS, share):
            sender = Process(at, "interest:publish", client, first=first, count=share)
            stack.enter_context(sender).hear()
        costs: dict[str, list[Cost]] = {kind: [] for kind in _KINDS}
        for _ in range(runs):
            for kind, (reads, path) in _KINDS.items():
                costs[kind].append(_once(at, client, reads=reads, path=path))
        return {
            kind: sorted(taken, key=lambda cost: cost.cpu_percent)[len(taken) // 2]
            for kind, taken in costs.items()
        }


def _once(at: Place, env: dict[str, str], *, reads: str, path: int) -> Cost:
    with Process(at, "interest:listen", env, reads=reads, path=path) as listener:
        return Cost(**listener.hear())


def share(costs: dict[str, Cost], kind: str) -> float:
    """The CPU of who reads so, of that of who reads everything."""
    return costs[kind].cpu_percent / costs[EVERYTHING].cpu_percent


def route() -> None:
    """The process in the middle."""
    import tfbus

    with tfbus.Node("router"):
        say("ready")
        sys.stdin.readline()


def listen(reads: str, path: int) -> None:
    """The process that looks up one path, over and over."""
    import tfbus

    with tfbus.Node("listener") as node:
        buffer = tfbus.Buffer()
        if not reads:
            time.sleep(_SETTLE_S)
            say(asdict(_during(lambda: (0, 0, 0), lambda: None)))
            return
        listener = tfbus.TransformListener(buffer, node, reads=reads)
        while sum(bool(info.frames) for info in listener.streams()) < PUBLISHERS:
            time.sleep(0.05)
        source, target = _frame(0, FRAMES - 1), "map" if path == 1 else _frame(1, FRAMES - 1)
        buffer.lookup_transform(target, source, timeout_s=20.0)
        time.sleep(_SETTLE_S)

        def counted() -> tuple[int, int, int]:
            infos = listener.streams()
            return (
                sum(info.messages for info in infos),
                sum(info.transforms for info in infos),
                sum(info.bytes for info in infos),
            )

        def look() -> None:
            buffer.lookup_transform(target, source, timeout_s=1.0)

        say(asdict(_during(counted, look)))


def _during(counted: Callable[[], tuple[int, int, int]], look: Callable[[], object]) -> Cost:
    before, cpu, wall = counted(), time.process_time(), time.perf_counter()
    while time.perf_counter() - wall < SECONDS:
        look()
        time.sleep(1.0 / LOOKUPS_HZ)
    cpu_s, wall_s = time.process_time() - cpu, time.perf_counter() - wall
    rates = [(now - then) / wall_s for now, then in zip(counted(), before, strict=True)]
    return Cost(*rates, 100.0 * cpu_s / wall_s)


def publish(first: int, count: int) -> None:
    """A process with `count` of the publishers; their messages are spread over time."""
    import numpy as np

    import tfbus

    ended = threading.Event()
    edges = np.array([(0, 1), *((1, 1 + row) for row in range(1, FRAMES))], dtype=np.uint32)
    poses = np.tile([1.0, 2.0, 3.0, 0.0, 0.0, 0.6, 0.8], (FRAMES, 1))
    publishers = []
    for number in range(first, first + count):
        frames = ("map", *(_frame(number, row) for row in range(FRAMES)))
        broadcaster = tfbus.TransformBroadcaster(tfbus.Node(f"p{number}"), history_s=0.0)
        publishers.append((broadcaster, frames))
    say("ready")
    threading.Thread(target=lambda: (sys.stdin.readline(), ended.set()), daemon=True).start()
    due = time.monotonic()
    while not ended.is_set():
        for broadcaster, frames in publishers:
            due = max(due + 1.0 / HZ / count, time.monotonic() - 1.0 / HZ)
            time.sleep(max(0.0, due - time.monotonic()))
            stamps = np.full(FRAMES, time.time_ns())
            broadcaster.send_transform(tfbus.TransformBatch(frames, edges, stamps, poses))
    os._exit(0)


def _frame(publisher: int, row: int) -> str:
    return f"p{publisher}_{row}"


def table(costs: dict[str, Cost]) -> str:
    """The costs as rows of a table, of which docs/guide/scaling.md has the main columns."""
    everything = costs[EVERYTHING]
    rows = [
        f"| {name} | {cost.messages:,.0f} | {cost.transforms:,.0f} | {cost.bytes:,.0f} "
        f"| {cost.cpu_percent:.2f} % | {100.0 * cost.bytes / everything.bytes:.1f} % "
        f"| {100.0 * cost.cpu_percent / everything.cpu_percent:.1f} % |"
        for name, cost in costs.items()
    ]
    return "\n".join(rows)


if __name__ == "__main__":
    print(table(measure(3)))
