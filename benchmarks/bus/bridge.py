"""What the bridge to ROS takes: transforms a second and CPU in each direction, and how much longer
a transform is on its way, with a ROS that costs nothing.

By itself: python -m benchmarks.bus.bridge
"""

import os
import struct
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from benchmarks.bus import latency
from benchmarks.bus.latency import Latency, Times, latency_of, say_ready, say_what_came
from benchmarks.bus.place import Place, Process, place, say

_MESSAGES = 4_000
_GID = "ab" * 16
_WARM_UP = 100


@dataclass(frozen=True)
class Flow:
    """Of one direction with messages of `rows` transforms, all in one process on one core: CPU for
    a transform, of the bridge with its part of the bus.
    """

    rows: int
    cpu_us: float

    @property
    def per_s(self) -> float:
        """Transforms a second that one core bears."""
        return 1e6 / self.cpu_us


@dataclass(frozen=True)
class Bridged:
    """The bridge to ROS and from it, with messages of one transform and of fifty; and from a send
    in one process to the arrival in another, through the bridge, and of a bare message.
    """

    to_ros: Sequence[Flow]
    from_ros: Sequence[Flow]
    there: Latency
    back: Latency
    bare: Latency


def measure(runs: int) -> Bridged:
    """Measure it; the CPU is the median of the runs."""
    flows: dict[str, list[Flow]] = {"to_ros": [], "from_ros": []}
    for rows in (1, 50):
        taken: dict[str, list[float]] = {way: [] for way in flows}
        for _ in range(runs):
            with place() as at, Process(at, "bridge:flow", at.listening(), rows=rows) as process:
                for way, cpu_us in process.hear().items():
                    taken[way].append(cpu_us)
        for way, all_us in taken.items():
            flows[way].append(Flow(rows, sorted(all_us)[len(all_us) // 2]))
    with place() as at:
        there = _latency(at, "bridge:listen_in_ros", "latency:send_ours", latency._size())
    with place() as at:
        back = _latency(at, "latency:listen_ours", "bridge:send_from_ros", 0)
    with place() as at:
        bare = _latency(at, "latency:listen_bare", "latency:send_bare", latency._size())
    return Bridged(flows["to_ros"], flows["from_ros"], there, back, bare)


def _latency(at: Place, listen: str, send: str, size: int, messages: int = 2000) -> Latency:
    with Process(at, listen, at.listening()) as listener:
        listener.hear()
        with Process(at, send, at.connecting(), messages=messages, size=size) as sender:
            sender.hear()
            sender.tell(str(time.monotonic() + 0.5))
            sent = dict(sender.hear())
            listener.tell()
            came: Times = listener.hear()
    return latency_of([(at_ns - sent[number]) / 1e3 for number, at_ns in came[_WARM_UP:]])


class _Sender:
    """Publishes nowhere; `on_send(payload)` instead."""

    heard = True

    def __init__(self, on_send: Callable[[bytes], object]) -> None:
        self.gid = os.urandom(16).hex()
        self.send = on_send

    def close(self) -> None:
        """Nothing to end."""


class FreeLeg:
    """A ROS with one node that costs nothing: `heard` are the callbacks by topic."""

    name = "nothing"
    tells_publishers = True

    def __init__(self, on_send: Callable[[bytes], object] = lambda payload: None) -> None:
        self.heard: dict[str, Callable[[bytes, str], None]] = {}
        self._on_send = on_send

    def publisher(self, topic: Any) -> _Sender:
        """A publisher."""
        return _Sender(self._on_send if topic.name == "/tf" else lambda payload: None)

    def subscribe(self, topic: Any, on_message: Callable[[bytes, str], None]) -> _Sender:
        """A subscription, which ends as a publisher does."""
        self.heard[topic.name] = on_message
        return _Sender(lambda payload: None)

    def publishers(self, topic: str) -> Sequence[Any]:
        """One."""
        from tfbus.ros.bridge.legs import RosPublisher

        return [RosPublisher(_GID, "/ros_node")]

    def warnings(self) -> Sequence[str]:
        """None."""
        return ()

    def close(self) -> None:
        """Nothing to end."""


def _bridge(node: Any, leg: FreeLeg) -> Any:
    from tfbus.ros.bridge.bridge import Bridge
    from tfbus.ros.bridge.common import BridgeOptions

    return Bridge(node, leg, BridgeOptions(), ros_node="/tfbus_ros2")


def _messages(rows: int, count: int) -> list[Any]:
    """Batches with stamps that grow."""
    import numpy as np

    import tfbus

    frames = ("base_link", *(f"frame_{row}" for row in range(rows)))
    edges = np.array([(0, 1 + row) for row in range(rows)], dtype=np.uint32)
    poses = np.tile([1.0, 2.0, 3.0, 0.0, 0.0, 0.6, 0.8], (rows, 1))
    start_ns = time.time_ns()
    return [
        tfbus.TransformBatch(frames, edges, np.full(rows, start_ns + number * 1_000), poses)
        for number in range(count)
    ]


def flow(rows: int) -> None:
    """The process with the bridge: it gets messages as the leg's and Zenoh's threads bring them."""
    import tfbus
    from tfbus.geometry.columns import columns_of_batch
    from tfbus.ros.tf_message import TFMessageWriter
    from tfbus.wire.transforms import TransformMessage, encode_transforms

    writer = TFMessageWriter()
    leg = FreeLeg()
    there = tfbus.NodeSettings(
        "sender", listen=("tcp/127.0.0.1:0",), connect=(os.environ["TFBUS_LISTEN"],)
    )
    with tfbus.Node("ros2") as node, tfbus.Node.from_settings(there) as sender:
        bridge = _bridge(node, leg)
        payloads = [
            writer.write(columns_of_batch(each).with_frames(_renamed(each.frames)))
            for each in _messages(rows, _MESSAGES)
        ]
        take = leg.heard["/tf"]
        from_ros = _cpu_us(lambda payload: take(payload, _GID), payloads, rows)
        broadcaster = tfbus.TransformBroadcaster(sender)
        listener = bridge._to_ros._listener
        while "sender" not in bridge._to_ros.streams:
            broadcaster.send_transform(_messages(rows, 1)[0])
            time.sleep(0.1)
        epoch_ns = next(each.epoch_ns for each in listener.streams() if each.name == "sender")
        payloads = [
            encode_transforms(TransformMessage(each, epoch_ns, 100_000 + number))
            for number, each in enumerate(_messages(rows, _MESSAGES))
        ]
        to_ros = _cpu_us(lambda payload: listener._on_message("tf/sender", payload), payloads, rows)
        bridge.close()
        say({"from_ros": from_ros, "to_ros": to_ros})


def _renamed(frames: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f"ros_{each}" for each in frames)


def _cpu_us(take: Callable[[bytes], object], payloads: Sequence[bytes], rows: int) -> float:
    """CPU for one transform, of all threads."""
    for payload in payloads[:_WARM_UP]:
        take(payload)
    time.sleep(1.0)  # until what it has met is announced
    begun_s = time.process_time()
    for payload in payloads[_WARM_UP:]:
        take(payload)
    return 1e6 * (time.process_time() - begun_s) / rows / (len(payloads) - _WARM_UP)


def listen_in_ros() -> None:
    """The process with the bridge, as ROS sees it."""
    import tfbus

    came: Times = []
    # After the header, the count of transforms: the seconds and nanoseconds of the first stamp.
    stamp = struct.Struct("<iI")

    def on_send(payload: bytes) -> None:
        seconds, nanoseconds = stamp.unpack_from(payload, 8)
        came.append((seconds * 1_000_000_000 + nanoseconds, time.time_ns()))

    with tfbus.Node("ros2") as node:
        bridge = _bridge(node, FreeLeg(on_send))
        say_what_came(came)
        bridge.close()


def send_from_ros(messages: int, size: int) -> None:
    """The process with the bridge, to which ROS sends."""
    import tfbus
    from tfbus.geometry.columns import Columns
    from tfbus.ros.tf_message import TFMessageWriter

    writer, leg = TFMessageWriter(), FreeLeg()
    pose = tfbus.Transform((1.0, 2.0, 3.0), (0.0, 0.0, 0.6, 0.8))
    sent: Times = []
    with tfbus.Node("ros2") as node:
        bridge = _bridge(node, leg)
        say_ready()
        for number in latency._due(messages):
            one = tfbus.TransformStamped(number, "base_link", "frame_0", pose)
            payload = writer.write(Columns.of_transforms([one]))
            sent.append((number, time.time_ns()))
            leg.heard["/tf"](payload, _GID)
        latency.say_what_was_sent(sent)
        bridge.close()


def main() -> None:
    """Measure, and print it."""
    found = measure(3)
    for way, flows in (("to ROS", found.to_ros), ("from ROS", found.from_ros)):
        for each in flows:
            print(
                f"{way}, messages of {each.rows}: {each.cpu_us:.2f} us of CPU a transform, "
                f"{each.per_s:,.0f} a second on one core"
            )
    for name, each_way in (("to ROS", found.there), ("from ROS", found.back), ("bare", found.bare)):
        print(f"{name}: p50 {each_way.p50_us:.0f} us, p99 {each_way.p99_us:.0f} us")


if __name__ == "__main__":
    sys.exit(main())
