"""How long a transform takes from its sending to a lookup that answers with it, in another
process; beside a bare message of Zenoh of the same size.
"""

import sys
import time
from dataclasses import dataclass
from typing import Any

from benchmarks.bus.intake import Template
from benchmarks.bus.place import Place, Process, place, say

PERIOD_S = 0.001
# Sent in turns of so many, lest one has the quiet hour.
TURN = 50
_BARE_KEY = "bare"


@dataclass(frozen=True)
class Latency:
    """Of all messages that came, in microseconds."""

    p50_us: float
    p99_us: float
    count: int


def measure(messages: int, runs: int) -> tuple[Latency, Latency]:
    """Of tfbus and of bare Zenoh, each sent so many messages a run."""
    ours: list[float] = []
    bare: list[float] = []
    for _ in range(runs):
        with place() as at:
            heard = _once(at, messages)
        ours += heard["ours"]
        bare += heard["bare"]
    return _latency(ours), _latency(bare)


def _once(at: Place, messages: int) -> dict[str, list[float]]:
    with Process(at, "latency:listen", at.listening()) as listener:
        listener.hear()
        with Process(at, "latency:send", at.connecting(), messages=messages) as sender:
            sender.hear()
            listener.tell()
            heard: dict[str, list[float]] = listener.hear()
            return heard


def _latency(taken_us: list[float]) -> Latency:
    taken_us.sort()
    return Latency(taken_us[len(taken_us) // 2], taken_us[len(taken_us) * 99 // 100], len(taken_us))


def listen() -> None:
    """The process that hears both."""
    import zenoh

    import tfbus

    ours: list[float] = []
    bare: list[float] = []

    class Timed(tfbus.Buffer):
        """Notes when a lookup answers with what has just come."""

        def set_transforms(self, batch: Any, **how: Any) -> int:
            taken = super().set_transforms(batch, **how)
            sent_ns = self.lookup_transform("base_link", "frame_0").stamp_ns
            ours.append((time.time_ns() - sent_ns) / 1000.0)
            return taken

    def on_bare(sample: zenoh.Sample) -> None:
        payload = sample.payload.to_bytes()
        bare.append((time.time_ns() - int.from_bytes(payload[:8], "little")) / 1000.0)

    with tfbus.Node("listener") as node:
        handler: Any = zenoh.handlers.Callback(on_bare, None, indirect=False)
        node.session.zenoh.declare_subscriber(_BARE_KEY, handler)
        tfbus.TransformListener(Timed(), node)
        say("ready")
        sys.stdin.readline()
        say({"ours": ours[TURN:], "bare": bare[TURN:]})
        sys.stdin.readline()


def send(messages: int) -> None:
    """The process that sends both."""
    import zenoh

    import tfbus

    with tfbus.Node("sender") as node:
        broadcaster = tfbus.TransformBroadcaster(node)
        bare = node.session.zenoh.declare_publisher(
            _BARE_KEY, congestion_control=zenoh.CongestionControl.DROP
        )
        filling = bytes(Template(1).size - 8)
        transform = tfbus.Transform((1.0, 2.0, 3.0), (0.0, 0.0, 0.6, 0.8))
        time.sleep(1.0)
        due = time.monotonic()
        for number in range(2 * messages):
            due += PERIOD_S
            time.sleep(max(0.0, due - time.monotonic()))
            now_ns = time.time_ns()
            if number // TURN % 2:
                broadcaster.send_transform(
                    tfbus.TransformStamped(now_ns, "base_link", "frame_0", transform)
                )
            else:
                bare.put(now_ns.to_bytes(8, "little") + filling)
        time.sleep(0.5)
        say("sent")
        sys.stdin.readline()
