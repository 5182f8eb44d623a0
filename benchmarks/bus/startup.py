"""How long a process takes from its start to its first lookup that answers, what of, and what
memory it holds then; beside a process of bare Zenoh that receives its first message.
"""

import json
import os
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from statistics import median

from benchmarks.bus.place import Place, Process, free_port, place, say

PHASES = {
    "python": "the interpreter",
    "imports": "imports: tfbus and Zenoh",
    "node": "the node: Zenoh's session, which finds the others",
    "listener": "the buffer and the listener",
    "lookup": "until the first message makes the lookup answer (one is sent each 20 ms)",
}


BARE = "bare Zenoh, at a given endpoint"


def measure(runs: int, *, scouting: bool, bare: bool = False) -> dict[str, float]:
    """Seconds by phase, and "memory" in bytes, medians; the others are found by scouting, or at an
    endpoint given. With `bare` of a process without tfbus.
    """
    function = "startup:receive_bare" if bare else "startup:look_up"
    with place() as at:
        env = _scouting(at) if scouting else at.connecting()
        return measure_at(at, runs, function, env, env if scouting else at.listening())


def measure_at(
    at: Place, runs: int, function: str, env: dict[str, str], others: dict[str, str]
) -> dict[str, float]:
    """As `measure`, of a function of this module in an environment, beside the publisher in that of
    `others`.
    """
    taken: list[dict[str, float]] = []
    with Process(at, "startup:publish", others) as publisher:
        publisher.hear()
        for _ in range(runs):
            started_ns = time.time_ns()
            with Process(at, function, env) as process:
                report = process.hear()
            taken.append(_phases(started_ns, report))
    return {phase: median(one[phase] for one in taken) for phase in taken[0]}


def _phases(started_ns: int, report: Mapping[str, int]) -> dict[str, float]:
    phases = {}
    before = started_ns
    for phase in PHASES:
        phases[phase] = (report[phase] - before) / 1e9
        before = report[phase]
    return phases | {"all": (before - started_ns) / 1e9, "memory": 1e3 * report["resident_kb"]}


def _scouting(at: Place) -> dict[str, str]:
    """Processes that find each other by multicast, apart from any other on this network."""
    config = at.folder / "scouting.json5"
    address = f"224.0.0.224:{free_port()}"
    config.write_text(f"{{scouting: {{multicast: {{address: '{address}'}}}}}}")
    return {**at.env, "TFBUS_CONFIG": str(config)}


def publish() -> None:
    """The process that is there already, and sends one transform each 20 ms."""
    import tfbus

    with tfbus.Node("publisher") as node:
        broadcaster = tfbus.TransformBroadcaster(node)
        transform = tfbus.Transform((1.0, 2.0, 3.0), (0.0, 0.0, 0.6, 0.8))

        def send() -> None:
            stamped = tfbus.TransformStamped(node.now_ns(), "base_link", "frame_0", transform)
            broadcaster.send_transform(stamped)

        node.create_timer(0.02, send)
        say("ready")
        sys.stdin.readline()


def look_up() -> None:
    """The process that is started; says when it had come how far."""
    report = {"python": time.time_ns()}
    from tfbus import Buffer, Node, TransformListener

    report["imports"] = time.time_ns()
    with Node("starter") as node:
        report["node"] = time.time_ns()
        buffer = Buffer()
        with TransformListener(buffer, node):
            report["listener"] = time.time_ns()
            buffer.lookup_transform("base_link", "frame_0", timeout_s=20.0)
            report["lookup"] = time.time_ns()
            report["resident_kb"] = _resident_kb()
    say(report)


def receive_bare() -> None:
    """The process without tfbus: until a callback in Python has the first message."""
    report = {"python": time.time_ns()}
    import threading

    import zenoh

    report["imports"] = time.time_ns()
    config = zenoh.Config.from_file(os.environ["TFBUS_CONFIG"])
    config.insert_json5("connect/endpoints", json.dumps([os.environ["TFBUS_CONNECT"]]))
    with zenoh.open(config) as session:
        report["node"] = time.time_ns()
        came = threading.Event()
        handler = zenoh.handlers.Callback(lambda sample: came.set(), None, indirect=False)
        session.declare_subscriber("tf/publisher", handler)
        report["listener"] = time.time_ns()
        came.wait(20.0)
        report["lookup"] = time.time_ns()
        report["resident_kb"] = _resident_kb()
    say(report)


def _resident_kb() -> int:
    status = Path("/proc/self/status").read_text()
    return int(status.split("VmRSS:")[1].split()[0])
