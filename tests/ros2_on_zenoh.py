"""ROS 2's messages on a Zenoh network, by rmw_zenoh and by zenoh-bridge-ros2dds, without ROS.

    python -m tests.ros2_on_zenoh [--connect tcp/127.0.0.1:7447] [--rate 50]

Keys, tokens, attachments and payloads are as the two have them.
"""

import argparse
import itertools
import struct
import time
import uuid
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import zenoh
from zenoh import ext

from tests.builders import at
from tfbus import NodeSettings
from tfbus.bus import zenoh_library
from tfbus.geometry.columns import Columns
from tfbus.ros.tf_message import TFMessageWriter

TF_TYPE = (
    "tf2_msgs::msg::dds_::TFMessage_",
    "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
)
# What Humble writes for a hash, and a topic and a service of other types below `tf`.
HUMBLE = "TypeHashNotSupported"
STRING = "std_msgs::msg::dds_::String_"
SERVICE = "rcl_interfaces::srv::dds_::GetParameters_"

_STATIC_QOS, _DYNAMIC_QOS = ":1:,1:,:,:,,", "::,100:,:,:,,"

# A text in CDR, and rosgraph_msgs/msg/Clock.
TEXT = b"\0\1\0\0\7\0\0\0<robot\0\0"
CLOCK = b"\0\1\0\0" + struct.pack("<iI", 5, 0)


def tf_message(parent: str, child: str, x: float = 0.0) -> bytes:
    """A message of one transform in CDR."""
    rows = Columns.of_transforms([at(x, child, time.time_ns(), parent=parent)])
    return TFMessageWriter().write(rows)


class Ros2:
    """Two nodes of rmw_zenoh, and a bridge of zenoh-bridge-ros2dds, until `close()`."""

    def __init__(self, endpoint: str, *, domain: int = 0) -> None:
        self._session = _open(endpoint)
        self._domain = domain
        self._gid = uuid.uuid4().bytes
        self._numbers = itertools.count(1)
        self._kept: list[object] = []
        self._send: list[Callable[[], None]] = []

    def rmw_zenoh(self) -> None:
        """Be the nodes /talker and /robot1/talker, which send frames from now on."""
        for number, namespace in enumerate(("", "robot1")):
            self._token(number, 0, "NN", namespace)
            frame = f"{namespace}/" if namespace else ""
            lead = f"{self._domain}/{frame}"
            data_type = "/".join(TF_TYPE)
            self._dynamic(f"{lead}tf/{data_type}", "odom", f"{frame}base")
            self._retained(f"{lead}tf_static/{data_type}", tf_message("base", f"{frame}laser"))
            self._token(number, 1, "MP", namespace, "tf", _DYNAMIC_QOS)
            self._token(number, 2, "MP", namespace, "tf_static", _STATIC_QOS)
        self._dynamic(f"{self._domain}/tf/{TF_TYPE[0]}/{HUMBLE}", "odom", "humble")
        self._message(f"{self._domain}/tf/state/{STRING}/{TF_TYPE[1]}", TEXT)
        self._message(f"{self._domain}/clock/rosgraph_msgs::msg::dds_::Clock_/RIHS01_a", CLOCK)
        self._message(f"{self._domain}/robot_description/{STRING}/RIHS01_b", TEXT)

    def bridge(self) -> None:
        """Be zenoh-bridge-ros2dds, in no namespace and in bot1, from now on."""
        zid = str(self._session.zid())
        for lead in ("", "bot1/"):
            self._dynamic(f"{lead}tf", "odom", "base")
            self._retained(f"{lead}tf_static", tf_message("base", "laser"))
            self._retained(f"{lead}robot_description", TEXT)
            for topic in ("clock", "joint_states", "turtle1/pose", "turtle1/cmd_vel"):
                self._message(f"{lead}{topic}", CLOCK)
        self._message("tf/image", TEXT)  # of a node that is called tf
        # As its older sibling for DDS has them.
        self._dynamic("rt/tf", "odom", "base")
        self._alive(f"@/{zid}/@ros2_lv")
        self._alive(f"@/{zid}/@ros2_lv/MP/tf/tf2_msgs§msg§TFMessage/:::1,100")

    def send(self) -> None:
        """Send one message of each publisher."""
        for send in self._send:
            send()

    def close(self) -> None:
        """Leave the network. Twice is fine."""
        with suppress(zenoh.ZError):
            self._session.close()

    def _dynamic(self, key: str, parent: str, child: str) -> None:
        self._publish(key, lambda: tf_message(parent, child))

    def _message(self, key: str, payload: bytes) -> None:
        self._publish(key, lambda: payload)

    def _publish(self, key: str, payload: Callable[[], bytes]) -> None:
        publisher = self._session.declare_publisher(key)
        self._send.append(lambda: publisher.put(payload(), attachment=self._attachment()))

    def _retained(self, key: str, payload: bytes) -> None:
        network = zenoh_library.simulated() or ext
        publisher = network.declare_advanced_publisher(
            self._session,
            key,
            cache=ext.CacheConfig(max_samples=1),
            sample_miss_detection=ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=0.5),
            publisher_detection=True,
        )
        publisher.put(payload, attachment=self._attachment())
        self._kept.append(publisher)

    def _attachment(self) -> bytes:
        return struct.pack("<qqB", next(self._numbers), time.time_ns(), 16) + self._gid

    def _token(
        self, node: int, number: int, kind: str, namespace: str, topic: str = "", qos: str = ""
    ) -> None:
        around = f"%{namespace}" if namespace else "%"
        parts = [self._domain, self._session.zid(), node, node if kind == "NN" else number, kind]
        parts += ["%", around, "talker"]
        if topic:
            parts += [f"{around.rstrip('%')}%{topic}", *TF_TYPE, qos]
        self._alive("/".join(["@ros2_lv", *map(str, parts)]))

    def _alive(self, key: str) -> None:
        self._kept.append(self._session.liveliness().declare_token(key))


def _open(endpoint: str) -> Any:
    """A session that is none of tfbus's; on a simulated network without an endpoint."""
    if not endpoint:
        return zenoh_library.simulated().open_session(NodeSettings("ros2"))
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", f'["{endpoint}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("timestamping/enabled", "true")
    return zenoh.open(config)


def main() -> None:
    """Be both, until Ctrl-C."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--connect", default="tcp/127.0.0.1:7447")
    parser.add_argument("--rate", type=float, default=50.0)
    arguments = parser.parse_args()
    ros2 = Ros2(arguments.connect)
    ros2.rmw_zenoh()
    ros2.bridge()
    print("ready", flush=True)
    with suppress(KeyboardInterrupt):
        while True:
            ros2.send()
            time.sleep(1 / arguments.rate)
    ros2.close()


if __name__ == "__main__":
    main()
