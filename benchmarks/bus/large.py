"""Point clouds of 1 kB to 16 MB from one process to another on this host: how long they take, and
the CPU of both ends; tfbus beside bare Zenoh, each also with Zenoh's shared memory, rclpy with Fast
DDS, and the logging of rerun and of Foxglove.

    python -m benchmarks.bus.large [--write] [--runs N] [WORD ...]

`--write` makes the pages about speed anew. rclpy is that of the environment that
TFBUS_ROS2_KILTED names, made by tests/ros/bridge/ros2_environment.sh.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks.bus.place import Place, Process, free_port, place, say

SIZES = (1_000, 10_000, 100_000, 1_000_000, 4_000_000, 16_000_000)
TFBUS, BARE = "tfbus", "bare Zenoh"
SHARED, BARE_SHARED = "tfbus, shared memory", "bare Zenoh, shared memory"
RCLPY, RERUN, FOXGLOVE = "rclpy, Fast DDS", "rerun", "foxglove-sdk"
_RCLPY_IS_IN = "TFBUS_ROS2_KILTED"
_BESIDE_ROS = {"ROS_DOMAIN_ID": "78", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
# Its Python is another one, with packages of its own.
_ROS = {**_BESIDE_ROS, "PYTHONPATH": ""}

# Of x, y, z and an intensity.
_POINT = 16
_BYTES_A_SECOND = 60e6
_MOST_HZ, _LEAST_HZ = 200.0, 4.0
_TURN_S, _FEWEST = 1.0, 12
# A turn begins with messages that meet memory which has not been used yet.
_WARM_UP = 3
_UNTIL_ALL_CAME_S = 0.5
_KEY = "points"
# Zenoh's defaults, with room for several of the largest messages.
_SHARED_MEMORY = "{enabled: true, transport_optimization: {pool_size: 134217728}}"


class Missing(Exception):
    """A peer is not there."""


@dataclass(frozen=True)
class Turn:
    """Messages of one size: how long those that came took, how many were sent, and the CPU of both
    ends for one of them. A peer whose receiver tells no times has none that came.
    """

    took_us: list[float]
    sent: int
    sender_us: float
    receiver_us: float


@dataclass(frozen=True)
class Carried:
    """The median turn of one peer with messages of one size; latency in us, None where the receiver
    does not tell it.
    """

    p50_us: float | None
    p99_us: float | None
    came: float
    sender_us: float
    receiver_us: float

    @property
    def cpu_us(self) -> float:
        """The CPU of both ends."""
        return self.sender_us + self.receiver_us


class Pair:
    """The two processes of a peer, which wait for their turns."""

    def __init__(self, peer: str, at: Place, stack: ExitStack) -> None:
        how = dict[str, Any]()
        here, there = at.listening(), at.connecting()
        functions = {BARE: "bare", RCLPY: "rclpy", RERUN: "rerun", FOXGLOVE: "foxglove"}
        name = functions.get(peer.removesuffix(", shared memory"), "tfbus")
        if name in ("tfbus", "bare"):
            shared = _SHARED_MEMORY if peer in (SHARED, BARE_SHARED) else "{enabled: false}"
            here, there = (_with_shared_memory(at, env, shared) for env in (here, there))
        elif peer == RCLPY:
            how["python"] = _python_of_rclpy()
            here, there = here | _ROS, there | _ROS
        elif peer in (RERUN, FOXGLOVE):
            module = {RERUN: "rerun", FOXGLOVE: "foxglove"}[peer]
            if find_spec(module) is None:
                raise Missing(f"pip install {module}-sdk")
            here = there = at.env | {"PORT": str(free_port())}
        # That which the other connects to comes first.
        order = ("send", "receive") if peer == FOXGLOVE else ("receive", "send")
        ends = {}
        for end in order:
            env = here if end == order[0] else there
            ends[end] = stack.enter_context(Process(at, f"large:{end}_{name}", env, **how))
            ends[end].hear()
        self._sender, self._receiver = ends["send"], ends["receive"]

    def turn(self, size: int) -> Turn:
        """Let it send messages of one size."""
        hz = min(max(_BYTES_A_SECOND / size, _LEAST_HZ), _MOST_HZ)
        count = max(_FEWEST, round(_TURN_S * hz))
        self._receiver.tell("begin")
        self._receiver.hear()
        self._sender.tell(json.dumps([size, hz, count]))
        sender_s = self._sender.hear()
        self._receiver.tell("end")
        receiver_s, took_us = self._receiver.hear()
        sent = count + _WARM_UP
        return Turn(took_us[_WARM_UP:], count, 1e6 * sender_s / sent, 1e6 * receiver_s / sent)


def measure(peers: list[str], runs: int) -> tuple[dict[tuple[str, int], Carried], dict[str, str]]:
    """Each peer with each size, which take turns; and why peers were left out."""
    found, left_out = {}, {}
    with ExitStack() as stack:
        pairs = {}
        for peer in peers:
            try:
                pairs[peer] = Pair(peer, stack.enter_context(place()), stack)
            except (Missing, RuntimeError) as error:
                left_out[peer] = str(error).strip().splitlines()[-1]
        time.sleep(2.0)  # until each has met the other
        for pair in pairs.values():
            pair.turn(SIZES[0])  # both import what they need
        for size in SIZES:
            turns: dict[str, list[Turn]] = {peer: [] for peer in pairs}
            for _ in range(runs):
                for peer, pair in pairs.items():
                    turns[peer].append(pair.turn(size))
            for peer, each in turns.items():
                found[peer, size] = _carried(each)
                print(f"{peer}, {_size(size)}: {found[peer, size]}", file=sys.stderr, flush=True)
    return found, left_out


def _carried(turns: list[Turn]) -> Carried:
    took_us = sorted(each for turn in turns for each in turn.took_us)
    return Carried(
        took_us[len(took_us) // 2] if took_us else None,
        took_us[len(took_us) * 99 // 100] if took_us else None,
        len(took_us) / sum(turn.sent for turn in turns),
        median(turn.sender_us for turn in turns),
        median(turn.receiver_us for turn in turns),
    )


def _python_of_rclpy() -> str:
    folder = os.environ.get(_RCLPY_IS_IN)
    if not folder:
        raise Missing(f"{_RCLPY_IS_IN} is not set: tests/ros/bridge/ros2_environment.sh makes it")
    return str(Path(folder, "bin", "python"))


def _with_shared_memory(at: Place, env: dict[str, str], shared: str) -> dict[str, str]:
    """The environment with Zenoh's settings of shared memory, which is on unless it is told."""
    path = at.folder / "shared.json5"
    former = Path(env["TFBUS_CONFIG"]).read_text().rstrip().removesuffix("}")
    path.write_text(f"{former}, transport: {{shared_memory: {shared}}}}}")
    return {**env, "TFBUS_CONFIG": str(path)}


# The ends


def _turns(send: Callable[[Any], None], make: Callable[[int], Any]) -> None:
    """The sender: `make(size)` is what it sends of a size."""
    say("ready")
    for line in sys.stdin:
        size, hz, count = json.loads(line)
        what = make(size)
        time.sleep(0.2)
        begun_s = time.process_time()
        due_s = time.monotonic()
        for _ in range(_WARM_UP + int(count)):
            time.sleep(max(0.0, due_s - time.monotonic()))
            due_s = max(due_s, time.monotonic() - 1.0 / hz) + 1.0 / hz
            send(what)
        time.sleep(_UNTIL_ALL_CAME_S)
        say(time.process_time() - begun_s)


def _told(came: list[tuple[int, int]], cpu_s: Callable[[], float] = time.process_time) -> None:
    """The receiver: `came` are when a message was sent, and when it was there, in nanoseconds."""
    say("ready")
    begun_s = 0.0
    for line in sys.stdin:
        if line.strip() == "begin":
            came.clear()
            begun_s = cpu_s()
            say("begun")
        else:
            say([cpu_s() - begun_s, [(at_ns - sent_ns) / 1e3 for sent_ns, at_ns in came]])


def _points(size: int) -> Any:
    """The memory of a cloud of about this size."""
    import numpy as np

    return np.random.default_rng(1).random((size // _POINT, 4), np.float32)


def send_tfbus(topic: str = _KEY) -> None:
    """A node that publishes a new cloud on the same array each time."""
    import numpy as np

    import tfbus
    from tfbus.messages import PointCloud, PointField

    columns = tuple(PointField(name, 4 * at, 7, 1) for at, name in enumerate("xyzi"))

    with tfbus.Node("lidar") as node:
        publisher = node.create_publisher(PointCloud, topic)

        def send(data: Any) -> None:
            width = len(data) // _POINT
            step = width * _POINT
            stamp_ns = time.time_ns()
            publisher.publish(
                PointCloud(
                    stamp_ns, "lidar", 1, width, columns, False, _POINT, step, data, is_dense=True
                )
            )

        _turns(send, lambda size: _points(size).reshape(-1).view(np.uint8))


def receive_tfbus(topic: str = _KEY) -> None:
    """A node with a subscription."""
    import tfbus
    from tfbus.messages import PointCloud

    came: list[tuple[int, int]] = []

    def on_points(cloud: PointCloud) -> None:
        came.append((cloud.stamp_ns, time.time_ns()))

    with tfbus.Node("mapper") as node:
        node.create_subscription(PointCloud, topic, on_points)
        _told(came)


def send_bare() -> None:
    """A program of Zenoh's that puts a time and the bytes of an array, as options tfbus's."""
    import zenoh

    from benchmarks.bus.latency import bare_config

    with zenoh.open(bare_config("connect")) as session:
        publisher = session.declare_publisher(
            _KEY, congestion_control=zenoh.CongestionControl.DROP, priority=zenoh.Priority.DATA
        )

        def send(data: memoryview) -> None:
            publisher.put(b"".join((time.time_ns().to_bytes(8, "little"), data)))

        _turns(send, lambda size: memoryview(_points(size)).cast("B"))


def receive_bare() -> None:
    """A program of Zenoh's whose callback has the bytes as an array."""
    import numpy as np
    import zenoh

    from benchmarks.bus.latency import bare_config

    came: list[tuple[int, int]] = []

    def on_sample(sample: zenoh.Sample) -> None:
        payload = sample.payload.to_bytes()
        np.frombuffer(payload, np.float32, offset=8)
        came.append((int.from_bytes(payload[:8], "little"), time.time_ns()))

    with zenoh.open(bare_config("listen")) as session:
        handler: Any = zenoh.handlers.Callback(on_sample, None, indirect=False)
        session.declare_subscriber(_KEY, handler)
        _told(came)


def send_rclpy(topic: str = _KEY) -> None:
    """A node of ROS 2; the array is of the kind that rclpy copies at once."""
    from array import array

    import rclpy
    from sensor_msgs.msg import PointCloud2, PointField

    rclpy.init()
    node = rclpy.create_node("lidar")
    publisher = node.create_publisher(PointCloud2, topic, 10)

    def make(size: int) -> Any:
        data = _points(size)
        cloud = PointCloud2(height=1, width=len(data), point_step=_POINT, is_dense=True)
        cloud.header.frame_id = "lidar"
        cloud.row_step = data.nbytes
        cloud.fields = [
            PointField(name=name, offset=4 * at, datatype=7, count=1)
            for at, name in enumerate("xyzi")
        ]
        cloud.data = array("B", data.tobytes())
        return cloud

    def send(cloud: Any) -> None:
        stamp = cloud.header.stamp
        stamp.sec, stamp.nanosec = divmod(time.time_ns(), 1_000_000_000)
        publisher.publish(cloud)

    _turns(send, make)
    os._exit(0)


def receive_rclpy(topic: str = _KEY) -> None:
    """A node of ROS 2 with a subscription."""
    import threading

    import numpy as np
    import rclpy
    from sensor_msgs.msg import PointCloud2

    came: list[tuple[int, int]] = []

    def on_points(cloud: Any) -> None:
        np.frombuffer(cloud.data, np.float32)
        stamp = cloud.header.stamp
        came.append((stamp.sec * 1_000_000_000 + stamp.nanosec, time.time_ns()))

    rclpy.init()
    node = rclpy.create_node("mapper")
    node.create_subscription(PointCloud2, topic, on_points, 10)
    threading.Thread(target=rclpy.spin, args=(node,), daemon=True).start()
    _told(came)
    os._exit(0)


def send_rerun() -> None:
    """A program that logs points to rerun's server."""
    import rerun as rr

    rr.init("large")
    rr.connect_grpc(f"rerun+http://127.0.0.1:{os.environ['PORT']}/proxy")

    def send(points: Any) -> None:
        rr.set_time("sent", timestamp=time.time())
        rr.log("points", rr.Points3D(points))

    # Points3D has three numbers a point.
    _turns(send, lambda size: _points(size * 4 // 3)[:, :3].copy())
    os._exit(0)


def receive_rerun() -> None:
    """Rerun's server, which keeps what is logged for its viewer, and tells no time."""
    from benchmarks.bus.robot import _cpu_s

    command = [sys.executable, "-m", "rerun", "--serve-grpc", "--port", os.environ["PORT"]]
    command += ["--server-memory-limit", "200MB"]
    server = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        time.sleep(2.0)
        _told([], lambda: sum(map(_cpu_s, _with_children(server.pid))))
    finally:
        for pid in reversed(list(_with_children(server.pid))):
            with suppress(ProcessLookupError):
                os.kill(pid, 9)
        server.wait()


def _with_children(pid: int) -> Iterator[int]:
    yield pid
    for task in Path(f"/proc/{pid}/task").iterdir():
        for child in (task / "children").read_text().split():
            yield from _with_children(int(child))


def send_foxglove() -> None:
    """A program that logs clouds to a server of foxglove-sdk's own."""
    import foxglove
    from foxglove import channels, messages

    foxglove.start_server(name="large", host="127.0.0.1", port=int(os.environ["PORT"]))
    channel = channels.PointCloudChannel("/points")
    columns = [
        messages.PackedElementField(
            name=name, offset=4 * at, type=messages.PackedElementFieldNumericType.Float32
        )
        for at, name in enumerate("xyzi")
    ]

    def send(data: bytes) -> None:
        sent_ns = time.time_ns()
        cloud = messages.PointCloud(
            timestamp=messages.Timestamp(*divmod(sent_ns, 1_000_000_000)),
            frame_id="lidar",
            point_stride=_POINT,
            fields=columns,
            data=data,
        )
        channel.log(cloud, log_time=sent_ns)

    _turns(send, lambda size: _points(size).tobytes())
    os._exit(0)


def receive_foxglove() -> None:
    """A client of Foxglove's protocol, which reads the time and takes the message as bytes."""
    import threading

    from websockets.sync.client import connect

    came: list[tuple[int, int]] = []
    # The protocol: a byte, the subscription in 4, the time in 8, then the message.
    sent_at = slice(5, 13)

    def receive() -> None:
        with connect(
            f"ws://127.0.0.1:{os.environ['PORT']}",
            subprotocols=["foxglove.sdk.v1"],  # type: ignore[list-item]
            max_size=None,
            compression=None,
        ) as client:
            for message in client:
                if isinstance(message, bytes):
                    if message[0] == 1:
                        came.append((int.from_bytes(message[sent_at], "little"), time.time_ns()))
                    continue
                for channel in json.loads(message).get("channels", ()):
                    if channel["topic"] == "/points":
                        subscription = {"id": 1, "channelId": channel["id"]}
                        client.send(
                            json.dumps({"op": "subscribe", "subscriptions": [subscription]})
                        )

    threading.Thread(target=receive, daemon=True).start()
    _told(came)
    os._exit(0)


# Through the bridge

_BRIDGED_HZ, _BRIDGED_S = 30.0, 6.0


def bridged() -> Any:
    """The CPU of `tfbus ros2 --via dds` for clouds of 1 MB, with nodes of ROS 2."""
    from benchmarks.bus.robot import _cpu_s
    from benchmarks.parts import Table

    python, rows = _python_of_rclpy(), []
    crossing = ("from_ros", "to_ros")
    command = [sys.executable, "-m", "tfbus", "ros2", "--via", "dds"]
    for topic in crossing:
        command += ["--topic", f"{topic}=sensor_msgs/msg/PointCloud2"]
    with place() as at, ExitStack() as stack:

        def start(function: str, env: dict[str, str], **how: Any) -> Process:
            process = stack.enter_context(Process(at, f"large:{function}", env, **how))
            process.hear()
            return process

        in_ros = {"env": at.env | _ROS, "python": python}
        receivers = {"from_ros": start("receive_tfbus", at.listening(), topic="from_ros")}
        bridge = subprocess.Popen(
            command, env=at.connecting() | _BESIDE_ROS, cwd=at.folder, stderr=subprocess.DEVNULL
        )
        stack.callback(bridge.wait)
        stack.callback(bridge.terminate)
        receivers["to_ros"] = start("receive_rclpy", **in_ros, topic="to_ros")
        senders = {
            "from_ros": start("send_rclpy", **in_ros, topic="from_ros"),
            "to_ros": start("send_tfbus", at.connecting(), topic="to_ros"),
        }
        time.sleep(6.0)  # until ROS and the bridge have met, and the topics cross
        for text, topics in (
            ("both ways", crossing),
            ("from ROS", crossing[:1]),
            ("to ROS", crossing[1:]),
        ):
            for topic in topics:
                receivers[topic].tell("begin")
                receivers[topic].hear()
            before_s = _cpu_s(bridge.pid)
            for topic in topics:
                senders[topic].tell(json.dumps([1_000_000, _BRIDGED_HZ, _BRIDGED_HZ * _BRIDGED_S]))
            for topic in topics:
                senders[topic].hear()
            share = (_cpu_s(bridge.pid) - before_s) / _BRIDGED_S
            came = 0
            for topic in topics:
                receivers[topic].tell("end")
                came += len(receivers[topic].hear()[1])
            sent = len(topics) * (_WARM_UP + _BRIDGED_HZ * _BRIDGED_S)
            rows.append([text, f"{100 * share:.1f} %", f"{100 * came / sent:.0f} %"])
            print(rows[-1], file=sys.stderr, flush=True)
    return Table(["30 clouds of 1 MB a second", "CPU of the bridge", "came"], rows)


# The table


def _size(size: int) -> str:
    return f"{size // 1_000_000} MB" if size >= 1_000_000 else f"{size // 1_000} kB"


def by_size(found: dict[tuple[str, int], Carried]) -> Any:
    """A peer and a size a row; ratios are over bare Zenoh with messages of this size."""
    from benchmarks.parts import Table
    from benchmarks.report import amount

    rows = []
    for size in SIZES:
        bare = found.get((BARE, size))
        for (peer, its_size), each in found.items():
            if its_size != size:
                continue
            latency = ["-", "-"]
            if each.p50_us is not None and each.p99_us is not None:
                latency = [amount(1e3 * each.p50_us), amount(1e3 * each.p99_us)]
            ratio = f"{each.cpu_us / bare.cpu_us:.2f} x" if bare else "-"
            came = "-" if each.p50_us is None else f"{100 * each.came:.0f} %"
            cpu = [amount(1e3 * part) for part in (each.sender_us, each.receiver_us)]
            rows.append([_size(size), peer, *cpu, ratio, *latency, came])
    headings = ["message", "by", "CPU to send", "to receive", "both over bare Zenoh"]
    return Table([*headings, "latency p50", "p99", "came"], rows, words=2)


def _versions() -> dict[str, str]:
    found = {}
    for name in ("eclipse-zenoh", "rerun-sdk", "foxglove-sdk"):
        with suppress(PackageNotFoundError):
            found[name] = f"{name} {version(name)}"
    return found


def main() -> None:
    """Measure, print the table, and write the pages if asked for."""
    from benchmarks import machine
    from benchmarks.links import beside_camera
    from benchmarks.parts import Part

    parser = argparse.ArgumentParser(prog="benchmarks.bus.large", description=__doc__)
    parser.add_argument("words", nargs="*", help="peers with one of these in their names; all")
    parser.add_argument("--runs", type=int, default=3, help="turns of each (3)")
    parser.add_argument("--write", action="store_true", help="write the pages")
    given = parser.parse_args()
    all_peers = (TFBUS, BARE, SHARED, BARE_SHARED, RCLPY, RERUN, FOXGLOVE)
    peers = [
        peer
        for peer in all_peers
        if not given.words or any(word in peer or word == "all" for word in given.words)
    ]
    where = machine.describe()
    found, left_out = measure(peers, given.runs)
    facts = {"left_out": "; ".join(f"{peer}: {why}" for peer, why in left_out.items())}
    tables = {"sizes": by_size(found)}
    if os.geteuid() == 0 and len(peers) == len(all_peers):
        tables["beside"] = beside_camera()
    if RCLPY not in left_out and len(peers) == len(all_peers):
        tables["bridge"] = bridged()
    part = Part(where, tables, _versions(), facts)
    part.show()
    for peer, why in left_out.items():
        print(f"left out: {peer}: {why}")
    if given.write:
        part.keep("large")


if __name__ == "__main__":
    main()
