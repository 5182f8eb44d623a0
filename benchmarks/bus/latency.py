"""How long a transform takes from its sending to a lookup that answers with it, in another
process; beside a bare message of Zenoh of the same size, between two processes without tfbus.
"""

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from benchmarks.bus.place import Place, Process, place, say

PERIOD_S = 0.001
# The two take turns of TURN messages, so that both meet the same load of the machine.
TURN = 250
# The first messages meet memory and code that have not been used yet.
_WARM_UP = 100
_BARE_KEY = "bare"
_KINDS = ("ours", "bare")

# Of each message by its number: when it was sent, or when it was there, in nanoseconds.
Times = list[tuple[int, int]]


@dataclass(frozen=True)
class Latency:
    """Of all messages that came, in microseconds."""

    p50_us: float
    p99_us: float
    count: int


def measure(messages: int, runs: int) -> tuple[Latency, Latency]:
    """Of tfbus and of bare Zenoh, each with this many messages a run."""
    taken: dict[str, list[float]] = {kind: [] for kind in _KINDS}
    for _ in range(runs):
        with place() as ours, place() as bare:
            for kind, some_us in _once({"ours": ours, "bare": bare}, messages).items():
                taken[kind] += some_us
    return latency_of(taken["ours"]), latency_of(taken["bare"])


def latency_at(at: Place, messages: int) -> Latency:
    """Of tfbus at one place, by itself."""
    with Process(at, "latency:listen_ours", at.listening()) as listener:
        listener.hear()
        sender = Process(at, "latency:send_ours", at.connecting(), messages=messages, size=_size())
        with sender:
            sender.hear()
            sender.tell(str(time.monotonic() + 0.5))
            sent = dict(sender.hear())
            listener.tell()
            came: Times = listener.hear()
    return latency_of([(at_ns - sent[number]) / 1e3 for number, at_ns in came[_WARM_UP:]])


def _once(places: dict[str, Place], messages: int) -> dict[str, list[float]]:
    size = _size()
    listeners = {
        kind: Process(at, f"latency:listen_{kind}", at.listening()) for kind, at in places.items()
    }
    with listeners["ours"], listeners["bare"]:
        for listener in listeners.values():
            listener.hear()
        senders = {
            kind: Process(at, f"latency:send_{kind}", at.connecting(), messages=messages, size=size)
            for kind, at in places.items()
        }
        with senders["ours"], senders["bare"]:
            for sender in senders.values():
                sender.hear()
            starts_s = time.monotonic() + 0.5
            for turn, kind in enumerate(_KINDS):
                senders[kind].tell(str(starts_s + turn * TURN * PERIOD_S))
            sent = {kind: dict(senders[kind].hear()) for kind in _KINDS}
            for listener in listeners.values():
                listener.tell()
            came: dict[str, Times] = {kind: listeners[kind].hear() for kind in _KINDS}
    return {
        kind: [(at_ns - sent[kind][number]) / 1e3 for number, at_ns in came[kind][_WARM_UP:]]
        for kind in _KINDS
    }


def latency_of(taken_us: list[float]) -> Latency:
    """The latency of messages that took these microseconds."""
    taken_us.sort()
    return Latency(taken_us[len(taken_us) // 2], taken_us[len(taken_us) * 99 // 100], len(taken_us))


def _size() -> int:
    """How many bytes a message of one transform is."""
    from tfbus import Transform, TransformBatch, TransformStamped
    from tfbus.wire.transforms import TransformMessage, encode_transforms

    one = TransformStamped(0, "base_link", "frame_0", Transform.identity())
    batch = TransformBatch.from_transforms([one])
    return len(encode_transforms(TransformMessage(batch, time.time_ns(), 0)))


def _due(messages: int) -> Iterator[int]:
    """The number of each message, yielded when it is due; the start is read from stdin."""
    starts_s = float(sys.stdin.readline())
    for number in range(messages):
        turn, step = divmod(number, TURN)
        due_s = starts_s + (2 * turn * TURN + step) * PERIOD_S
        time.sleep(max(0.0, due_s - time.monotonic()))
        yield number


def listen_ours() -> None:
    """The process that looks up, as soon as something has been put into its buffer."""
    import tfbus

    came: Times = []

    class Timed(tfbus.Buffer):
        """Notes when a lookup answers with what has just come."""

        def set_transforms(self, batch: Any, **how: Any) -> int:
            taken = super().set_transforms(batch, **how)
            number = self.lookup_transform("base_link", "frame_0").stamp_ns
            came.append((number, time.time_ns()))
            return taken

    with tfbus.Node("listener") as node:
        tfbus.TransformListener(Timed(), node)
        say_what_came(came)


def send_ours(messages: int, size: int) -> None:
    """The process that sends transforms, whose stamps are their numbers."""
    import tfbus

    sent: Times = []
    with tfbus.Node("sender") as node:
        broadcaster = tfbus.TransformBroadcaster(node)
        pose = tfbus.Transform((1.0, 2.0, 3.0), (0.0, 0.0, 0.6, 0.8))
        say_ready()
        for number in _due(messages):
            transform = tfbus.TransformStamped(number, "base_link", "frame_0", pose)
            sent.append((number, time.time_ns()))
            broadcaster.send_transform(transform)
        say_what_was_sent(sent)


def listen_bare() -> None:
    """The process with a callback on Zenoh's own thread, which is the fastest that it has."""
    import zenoh

    came: Times = []

    def on_sample(sample: zenoh.Sample) -> None:
        payload = sample.payload.to_bytes()
        came.append((int.from_bytes(payload[:8], "little"), time.time_ns()))

    with zenoh.open(bare_config("listen")) as session:
        handler: Any = zenoh.handlers.Callback(on_sample, None, indirect=False)
        session.declare_subscriber(_BARE_KEY, handler)
        say_what_came(came)


def send_bare(messages: int, size: int) -> None:
    """The process that puts, with the options that tfbus has for transforms."""
    import zenoh

    sent: Times = []
    with zenoh.open(bare_config("connect")) as session:
        publisher = session.declare_publisher(
            _BARE_KEY,
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.INTERACTIVE_HIGH,
        )
        filling = bytes(size - 8)
        say_ready()
        for number in _due(messages):
            payload = number.to_bytes(8, "little") + filling
            sent.append((number, time.time_ns()))
            publisher.put(payload)
        say_what_was_sent(sent)


def bare_config(what: str) -> Any:
    """Zenoh's configuration of a process that listens, or connects."""
    import json
    import os

    import zenoh

    config = zenoh.Config.from_file(os.environ["TFBUS_CONFIG"])
    endpoint = os.environ[f"TFBUS_{what.upper()}"]
    config.insert_json5(f"{what}/endpoints", json.dumps([endpoint]))
    return config


def say_what_came(came: Times) -> None:
    """Wait until the benchmark asks what came, and say it."""
    say("ready")
    sys.stdin.readline()
    say(came)
    sys.stdin.readline()


def say_ready() -> None:
    """Say that all is there."""
    # Until what is listened to is known here.
    time.sleep(1.0)
    say("ready")


def say_what_was_sent(sent: Times) -> None:
    """Say what was sent, once it has arrived."""
    time.sleep(0.5)
    say(sent)
    sys.stdin.readline()
