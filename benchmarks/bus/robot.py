"""Joint states of 30 joints a thousand times a second through `tfbus robot_state`: how long they
take until a lookup in another process answers with them, and the CPU of robot_state; beside bare
Zenoh over the same two hops, with messages of the same sizes.

    python -m benchmarks.bus.robot
"""

import os
import subprocess
import sys
import time
from dataclasses import dataclass
from typing import Any

from benchmarks.bus.latency import (
    PERIOD_S,
    Latency,
    Times,
    bare_config,
    latency_of,
    say_ready,
    say_what_came,
    say_what_was_sent,
)
from benchmarks.bus.place import Place, Process, place, say

JOINTS = 30
MESSAGES = 3_000
_WARM_UP = 200
_TIP = f"l{JOINTS}"
_FIRST, _SECOND = "bare/states", "bare/frames"


@dataclass(frozen=True)
class Cost:
    """The latency, and the CPU of the process in the middle as a share of a core."""

    latency: Latency
    cpu_percent: float


def measure(runs: int) -> tuple[Cost, Cost]:
    """Of tfbus and of bare Zenoh, each the run with the median latency."""
    ours, bare = [], []
    for _ in range(runs):
        with place() as at:
            ours.append(_ours(at))
        with place() as at:
            bare.append(_bare(at))
    return _median(ours), _median(bare)


def _median(costs: list[Cost]) -> Cost:
    return sorted(costs, key=lambda cost: cost.latency.p50_us)[len(costs) // 2]


def _ours(at: Place) -> Cost:
    path = at.folder / "robot.urdf"
    path.write_text(urdf())
    with Process(at, "robot:listen", at.listening()) as listener:
        listener.hear()
        command = [sys.executable, "-m", "tfbus", "robot_state", str(path)]
        middle = subprocess.Popen(
            command, env=at.connecting(), cwd=at.folder, stdin=subprocess.DEVNULL
        )
        try:
            return _through(at, middle.pid, listener, "robot:send")
        finally:
            middle.kill()
            middle.wait()


def _bare(at: Place) -> Cost:
    with Process(at, "robot:listen_bare", at.listening()) as listener:
        listener.hear()
        with Process(at, "robot:relay_bare", at.connecting(), size=_sizes()[1]) as middle:
            pid = middle.hear()
            return _through(at, pid, listener, "robot:send_bare")


def _through(at: Place, pid: int, listener: Process, sends: str) -> Cost:
    with Process(at, sends, at.connecting(), size=_sizes()[0]) as sender:
        sender.hear()
        before_s, began_s = _cpu_s(pid), time.monotonic()
        sender.tell()
        sender.hear()
        used_s, wall_s = _cpu_s(pid) - before_s, time.monotonic() - began_s
        listener.tell()
        came: Times = listener.hear()
    # Both ends are on one machine, and a message is named by the time at which it was sent.
    taken_us = [(at_ns - sent_ns) / 1e3 for sent_ns, at_ns in came[_WARM_UP:]]
    return Cost(latency_of(taken_us), 100.0 * used_s / wall_s)


def _cpu_s(pid: int) -> float:
    with open(f"/proc/{pid}/stat") as file:
        fields = file.read().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def urdf() -> str:
    """A chain of joints that turn."""
    parts = ["<robot name='chain'><link name='l0'/>"]
    for number in range(JOINTS):
        parts.append(
            f"<link name='l{number + 1}'/><joint name='j{number}' type='continuous'>"
            f"<parent link='l{number}'/><child link='l{number + 1}'/>"
            f"<origin xyz='0.1 0 0.2' rpy='0.1 0.2 0.3'/><axis xyz='0 0 1'/></joint>"
        )
    return "".join((*parts, "</robot>"))


def _state(stamp_ns: int, number: int) -> Any:
    from tfbus.messages import JointState

    names = tuple(f"j{joint}" for joint in range(JOINTS))
    return JointState(stamp_ns, names, tuple(0.001 * (number + joint) for joint in range(JOINTS)))


def _sizes() -> tuple[int, int]:
    """How many bytes a message of joint states is, and one of their transforms."""
    from tfbus import Robot, TransformBatch, TransformStamped
    from tfbus.wire.codec import encode_message
    from tfbus.wire.transforms import TransformMessage, encode_transforms

    state = _state(time.time_ns(), 1)
    positions = dict(zip(state.name, state.position, strict=True))
    edges = Robot.from_text(urdf()).joint_transforms(positions)
    batch = TransformBatch.from_transforms(
        [TransformStamped(state.stamp_ns, *edge) for edge in edges]
    )
    frames = TransformMessage(batch, time.time_ns(), 0)
    return len(encode_message(state)), len(encode_transforms(frames))


def listen() -> None:
    """The process that looks up the whole chain when something has come."""
    import tfbus

    came: Times = []

    class Timed(tfbus.Buffer):
        """Notes when a lookup answers with what has just come."""

        def set_transforms(self, batch: Any, **how: Any) -> int:
            taken = super().set_transforms(batch, **how)
            number = self.lookup_transform("l0", _TIP).stamp_ns
            came.append((number, time.time_ns()))
            return taken

    with tfbus.Node("listener") as node:
        tfbus.TransformListener(Timed(1.0), node)
        say_what_came(came)


def send(size: int) -> None:
    """The process that publishes joint states, as a driver does."""
    import tfbus
    from tfbus.messages import JointState

    with tfbus.Node("driver") as node:
        publisher = node.create_publisher(JointState, "joint_states")
        _paced(lambda number: publisher.publish(_state(time.time_ns(), number)))


def _paced(send_one: Any) -> None:
    say_ready()
    sys.stdin.readline()
    starts_s = time.monotonic()
    for number in range(MESSAGES):
        time.sleep(max(0.0, starts_s + number * PERIOD_S - time.monotonic()))
        send_one(number)
    say_what_was_sent([])


def listen_bare() -> None:
    """The process with a callback on Zenoh's own thread."""
    import zenoh

    came: Times = []

    def on_sample(sample: zenoh.Sample) -> None:
        came.append((int.from_bytes(sample.payload.to_bytes()[:8], "little"), time.time_ns()))

    with zenoh.open(bare_config("listen")) as session:
        handler: Any = zenoh.handlers.Callback(on_sample, None, indirect=False)
        session.declare_subscriber(_SECOND, handler)
        say_what_came(came)


def relay_bare(size: int) -> None:
    """The process in the middle: for each message another one, of this size."""
    import zenoh

    with zenoh.open(bare_config("connect")) as session:
        publisher = session.declare_publisher(_SECOND)
        filling = bytes(size - 8)

        def on_sample(sample: zenoh.Sample) -> None:
            publisher.put(sample.payload.to_bytes()[:8] + filling)

        handler: Any = zenoh.handlers.Callback(on_sample, None, indirect=False)
        session.declare_subscriber(_FIRST, handler)
        say(os.getpid())
        sys.stdin.readline()


def send_bare(size: int) -> None:
    """The process that puts messages with the time in them."""
    import zenoh

    with zenoh.open(bare_config("connect")) as session:
        publisher = session.declare_publisher(_FIRST)
        filling = bytes(size - 8)
        _paced(lambda _: publisher.put(time.time_ns().to_bytes(8, "little") + filling))


if __name__ == "__main__":
    for name, cost in zip(("tfbus robot_state", "bare Zenoh"), measure(3), strict=True):
        lasts = cost.latency
        print(
            f"{name}: p50 {lasts.p50_us:.0f} us, p99 {lasts.p99_us:.0f} us, "
            f"{lasts.count} of {MESSAGES - _WARM_UP} messages, CPU {cost.cpu_percent:.1f} %"
        )
