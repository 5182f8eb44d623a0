"""The CPU of a listener for messages of one transform that come one by one, not in a row; beside a
bare subscriber of Zenoh's with a callback in Python.
"""

import os
import sys
import threading
import time
from statistics import median
from typing import Any

from benchmarks.bus.intake import count, during
from benchmarks.bus.place import Place, Process, place, say

RATE = 7_000
SECONDS = 3.0
_KINDS = ("ours", "bare")


def measure(runs: int) -> dict[str, float]:
    """Seconds of CPU for a message, by kind of listener: medians of runs that take turns."""
    taken: dict[str, list[float]] = {kind: [] for kind in _KINDS}
    for _ in range(runs):
        for kind in _KINDS:
            with place() as at:
                taken[kind].append(cpu_of_a_message(at, kind))
    return {kind: median(some) for kind, some in taken.items()}


def cpu_of_a_message(at: Place, kind: str = "ours") -> float:
    """Seconds of CPU of the listener for a message."""
    listener = Process(at, f"paced:listen_{kind}", at.listening())
    with listener, Process(at, "paced:send", at.connecting()):
        report = listener.hear()
    seconds: float = report["cpu_s"] / report["messages"]
    return seconds


def listen_ours() -> None:
    """The process with a TransformListener."""
    import tfbus

    with tfbus.Node("listener") as node:
        listener = tfbus.TransformListener(tfbus.Buffer(1.0), node)
        _report(lambda: count(listener))


def listen_bare() -> None:
    """The process with a subscriber of Zenoh's, whose callback takes the payload."""
    import zenoh

    from tfbus.wire.keys import transforms_key

    came = [0]

    def take(sample: zenoh.Sample) -> None:
        if sample.payload.to_bytes():
            came[0] += 1

    with zenoh.open(_bare_config()) as session:
        handler = zenoh.handlers.Callback(take, None, indirect=False)
        session.declare_subscriber(transforms_key("sender"), handler)
        _report(lambda: (came[0], came[0]))


def _bare_config() -> Any:
    """tfbus's own settings, so that the two differ in nothing else."""
    from tfbus import NodeSettings
    from tfbus.bus.zenoh_config import zenoh_config

    return zenoh_config(NodeSettings("bare"))


def _report(counted: Any) -> None:
    while not counted()[0]:
        time.sleep(0.01)
    time.sleep(0.5)
    say(during(SECONDS, counted))
    sys.stdin.readline()


def send() -> None:
    """The process that sends transforms at an even pace."""
    import tfbus

    ended = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.readline(), ended.set()), daemon=True).start()
    with tfbus.Node("sender") as node:
        broadcaster = tfbus.TransformBroadcaster(node)
        transform = tfbus.Transform((1.0, 2.0, 3.0), (0.0, 0.0, 0.6, 0.8))
        due_s = time.monotonic()
        while not ended.is_set():
            stamp_ns = time.time_ns()
            broadcaster.send_transform(
                tfbus.TransformStamped(stamp_ns, "base_link", "frame_0", transform)
            )
            due_s += 1.0 / RATE
            time.sleep(max(0.0, due_s - time.monotonic()))
        os._exit(0)
