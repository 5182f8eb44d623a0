"""The CPU of `tfbus ros2 --via zenoh` for a message of one transform, with all of Zenoh's part;
beside a relay in Python on bare Zenoh, which puts the payload of each message that comes.

By itself: python -m benchmarks.bus.bridge_relay
"""

import json
import os
import struct
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median
from typing import Any

from benchmarks.bus.intake import Template, during
from benchmarks.bus.latency import bare_config
from benchmarks.bus.place import Place, Process, free_port, place, say

SECONDS = 3.0
WAYS = ("to ROS", "from ROS")
_KINDS = ("ours", "bare")

_ATTACHMENT = bytes(33)
_BUS_KEY = "tf/sender"


@dataclass(frozen=True)
class Relayed:
    """CPU of the process in the middle for a message, of tfbus and of the relay, in us."""

    ours_us: float
    bare_us: float


def measure(runs: int) -> dict[str, Relayed]:
    """Of each way, with as much as the link carries: medians of runs that take turns."""
    found = {}
    for way in WAYS:
        taken: dict[str, list[float]] = {kind: [] for kind in _KINDS}
        for _ in range(runs):
            for kind in _KINDS:
                with place() as at:
                    taken[kind].append(_cpu_us(at, way, kind))
        found[way] = Relayed(median(taken["ours"]), median(taken["bare"]))
    return found


def _cpu_us(at: Place, way: str, kind: str) -> float:
    ros = f"tcp/127.0.0.1:{free_port()}"
    router = Process(
        at, "bridge_relay:ros", {**at.env, "TFBUS_LISTEN": ros}, sends=way == "from ROS"
    )
    with router:
        router.hear()
        middle = Process(at, f"bridge_relay:{kind}", at.listening(), ros=ros, way=way)
        bus = Process(at, "bridge_relay:bus", at.connecting(), sends=way == "to ROS")
        with bus, middle:
            report = middle.hear()
    return 1e6 * float(report["cpu_s"]) / int(report["messages"])


# The two ends, which are bare Zenoh


def ros(sends: bool) -> None:
    """ROS: its router, and a node that publishes /tf as rmw_zenoh does, or subscribes to it."""
    import zenoh

    from tfbus.geometry.columns import columns_of_batch
    from tfbus.ros.rmw_zenoh import gid_of
    from tfbus.ros.tf_message import TFMessageWriter

    config = bare_config("listen")
    config.insert_json5("mode", json.dumps("router"))
    with zenoh.open(config) as session:
        key = _ros_key()
        if not sends:
            session.declare_subscriber(key, _quietly(lambda sample: None))
            say("ready")
            sys.stdin.readline()
            return
        _, _, topic, type_name, type_hash = f"/{key}".split("/")
        place_of = f"{session.zid()}/0/1/MP/%/%/ros_node/%{topic}/{type_name}/{type_hash}"
        name = f"@ros2_lv/0/{place_of}/::,100:,:,:,,"
        token, gid = session.liveliness().declare_token(name), gid_of(name)
        payload = TFMessageWriter().write(columns_of_batch(_one()))
        stamp = struct.pack("<i", int(time.time()))
        head, _, tail = payload.partition(stamp)
        head, tail = head + stamp, tail[4:]
        sequence = 0

        def put(publisher: Any) -> None:
            nonlocal sequence
            sequence += 1
            nanoseconds = struct.pack("<I", sequence % 1_000_000_000)
            attachment = struct.pack("<qqB16s", sequence, time.time_ns(), 16, gid)
            publisher.put(head + nanoseconds + tail, attachment=attachment)

        say("ready")
        _flood(session, key, put)
        token.undeclare()


def bus(sends: bool) -> None:
    """The bus: a stream of one frame, or a subscriber to all streams."""
    import tfbus

    with tfbus.Node("sender") as node:
        session = node.session.zenoh
        if not sends:
            session.declare_subscriber("tf/**", _quietly(lambda sample: None))
            sys.stdin.readline()
            return
        # So that its stream is described.
        broadcaster = tfbus.TransformBroadcaster(node)
        for each in _one():
            broadcaster.send_transform(each)
        time.sleep(0.5)
        epoch_ns = broadcaster._sender._epoch_ns
        message = Template(1, epoch_ns)
        _flood(session, _BUS_KEY, lambda publisher: publisher.put(message.next(time.time_ns())))


def _flood(session: Any, key: str, put: Callable[[Any], None]) -> None:
    import zenoh

    ended = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.readline(), ended.set()), daemon=True).start()
    publisher = session.declare_publisher(key, congestion_control=zenoh.CongestionControl.BLOCK)
    while not ended.is_set():
        for _ in range(100):
            put(publisher)
    os._exit(0)


def _quietly(callback: Callable[[Any], None]) -> Any:
    import zenoh

    return zenoh.handlers.Callback(callback, None, indirect=False)


def _ros_key() -> str:
    from tfbus.ros.definitions import TF_MESSAGE
    from tfbus.ros.rmw import type_hash
    from tfbus.ros.rmw_zenoh import data_key, dds_type_name

    return data_key(0, "/tf", dds_type_name(TF_MESSAGE.name), type_hash(TF_MESSAGE))


def _one() -> Any:
    import numpy as np

    import tfbus

    edges = np.array([(0, 1)], dtype=np.uint32)
    poses = np.array([[1.0, 2.0, 3.0, 0.0, 0.0, 0.6, 0.8]])
    return tfbus.TransformBatch(("base_link", "frame_0"), edges, np.array([time.time_ns()]), poses)


# The two in the middle


def ours(ros: str, way: str) -> None:
    """The bridge."""
    import tfbus
    from tfbus.ros.bridge.bridge import Bridge
    from tfbus.ros.bridge.common import BridgeOptions
    from tfbus.ros.bridge.legs import LegSettings, OnMessage, RosTopic
    from tfbus.ros.bridge.legs.zenoh import ZenohLeg

    came = [0]

    class Counting(ZenohLeg):
        """Counts what comes from ROS."""

        def subscribe(self, topic: RosTopic, on_message: OnMessage) -> Any:
            def count(payload: bytes, gid: str) -> None:
                came[0] += 1
                on_message(payload, gid)

            return super().subscribe(topic, count)

    with tfbus.Node("ros2") as node:
        settings = LegSettings("tfbus_ros2", connect=(ros,), domain=0)
        leg = Counting(settings, node.log)
        bridge = Bridge(node, leg, BridgeOptions(), ros_node="/tfbus_ros2")

        def count() -> int:
            if way == "from ROS":
                return came[0]
            listener: Any = bridge._to_ros._listener  # type: ignore[union-attr]
            return sum(each.messages for each in listener.streams())

        _report(count)
        bridge.close()


def bare(ros: str, way: str) -> None:
    """The relay: on threads whose state Python keeps, as tfbus has them, and few relays."""
    import zenoh

    from tfbus.bus.callbacks import kept

    config = zenoh.Config()
    config.insert_json5("mode", json.dumps("client"))
    config.insert_json5("connect/endpoints", json.dumps([ros]))
    came = [0]
    with zenoh.open(config) as there, zenoh.open(bare_config("listen")) as here:
        from_ros, source, key, to = way == "from ROS", here, _BUS_KEY, _ros_key()
        if from_ros:
            source, key, to = there, _ros_key(), "tf/ros2/ros_node"
        publisher = (here if from_ros else there).declare_publisher(
            to, congestion_control=zenoh.CongestionControl.DROP
        )

        def take(sample: zenoh.Sample) -> None:
            kept.known = True
            came[0] += 1
            payload = sample.payload.to_bytes()
            if from_ros:
                if sample.attachment is not None:
                    sample.attachment.to_bytes()
                publisher.put(payload)
            else:
                publisher.put(payload, attachment=_ATTACHMENT)

        source.declare_subscriber(key, _quietly(take))
        _report(lambda: came[0])


def _report(count: Callable[[], int]) -> None:
    while not count():
        time.sleep(0.01)
    # Until what is new is met on both sides.
    time.sleep(4.0)
    say(during(SECONDS, lambda: (count(), 0)))
    sys.stdin.readline()


def main() -> None:
    """Measure, and print it."""
    for way, each in measure(3).items():
        print(
            f"{way}: {each.ours_us:.1f} us of CPU a message, a relay on bare Zenoh "
            f"{each.bare_us:.1f} us"
        )


if __name__ == "__main__":
    sys.exit(main())
