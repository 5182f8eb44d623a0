"""ROS's rclpy.wait_for_message."""

import threading
from typing import Any

from tfbus.compat.bus_types import bus_type_of
from tfbus.compat.rclpy.node import Node
from tfbus.compat.rclpy.qos import applied

__all__ = ["wait_for_message"]


def wait_for_message(
    msg_type: type,
    node: Node,
    topic: str,
    *,
    qos_profile: Any = 1,
    time_to_wait: float = -1,
) -> tuple[bool, Any]:
    """Whether a message of the topic came within that many seconds (-1: however long it takes), and
    the first one, or None. Nothing has to be spun meanwhile.
    """
    got: list[Any] = []
    came = threading.Event()
    on_bus = bus_type_of(msg_type, topic, node.tfbus_node.clock)

    def take(message: Any) -> None:
        got.append(on_bus.from_bus(message))
        came.set()

    retained = applied(qos_profile, topic, node.say_once)[1]
    subscription = node.tfbus_node.create_subscription(on_bus.type, topic, take, retained=retained)
    try:
        came.wait(None if time_to_wait < 0 else time_to_wait)
    finally:
        subscription.close()
    return (True, got[0]) if got else (False, None)
