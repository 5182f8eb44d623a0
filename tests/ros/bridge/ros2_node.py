"""A node of the real ROS 2: broadcasts, listens, and prints received messages and nodes, in JSON.

python ros2_node.py NAME [--tf CHILD] [--static CHILD] [--best-effort]

It runs in an environment with ROS, without tfbus.
"""

import argparse
import contextlib
import json
from typing import Any

import rclpy
from geometry_msgs.msg import TransformStamped
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from tf2_msgs.msg import TFMessage

DYNAMIC = QoSProfile(depth=100)
LATE = DurabilityPolicy.TRANSIENT_LOCAL
TOPICS = ("/tf", "/tf_static")


def message(child: str) -> TFMessage:
    """One transform."""
    transform = TransformStamped()
    transform.header.frame_id = "map"
    transform.child_frame_id = child
    transform.transform.translation.x = 1.5
    return TFMessage(transforms=[transform])


class Reporter(Node):
    """Says what it hears, and what of the graph has changed."""

    def __init__(self, options: argparse.Namespace) -> None:
        super().__init__(options.name)
        self._seen: Any = None
        for topic, qos in (
            ("/tf", DYNAMIC),
            ("/tf_static", QoSProfile(depth=100, durability=LATE)),
        ):
            self.create_subscription(TFMessage, topic, self._hears(topic), qos)
        if options.static:
            self._static = self.create_publisher(
                TFMessage, "/tf_static", QoSProfile(depth=1, durability=LATE)
            )
            self._static.publish(message(options.static))
        if options.tf:
            best_effort = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
            qos = best_effort if options.best_effort else DYNAMIC
            self._tf = self.create_publisher(TFMessage, "/tf", qos)
            self.create_timer(0.1, lambda: self._tf.publish(message(options.tf)))
        self.create_timer(0.1, self._look)

    def _hears(self, topic: str) -> Any:
        def hear(heard: TFMessage) -> None:
            say(heard=topic, children=[each.child_frame_id for each in heard.transforms])

        return hear

    def _look(self) -> None:
        endpoints = [
            {
                "topic": topic,
                "gid": bytes(each.endpoint_gid)[:16].hex(),
                "node": f"{each.node_namespace.rstrip('/')}/{each.node_name}",
                "type": each.topic_type,
                "hash": str(each.topic_type_hash),
                "reliable": each.qos_profile.reliability == ReliabilityPolicy.RELIABLE,
                "retained": each.qos_profile.durability == LATE,
            }
            for topic in TOPICS
            for each in self.get_publishers_info_by_topic(topic)
        ]
        published = {}
        for name, namespace in self.get_node_names_and_namespaces():
            try:
                topics = self.get_publisher_names_and_types_by_node(name, namespace)
            except rclpy._rclpy_pybind11.NodeNameNonExistentError:
                continue
            published[f"{namespace.rstrip('/')}/{name}"] = [
                topic for topic, _ in topics if topic in TOPICS
            ]
        seen = {"endpoints": endpoints, "published": published}
        if seen != self._seen:
            self._seen = seen
            say(**seen)


def say(**values: Any) -> None:
    """Print one line."""
    print(json.dumps(values), flush=True)


def main() -> None:
    """Run until a signal."""
    parser = argparse.ArgumentParser()
    parser.add_argument("name")
    parser.add_argument("--tf")
    parser.add_argument("--static")
    parser.add_argument("--best-effort", action="store_true")
    options = parser.parse_args()
    rclpy.init()
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(Reporter(options))


if __name__ == "__main__":
    main()
