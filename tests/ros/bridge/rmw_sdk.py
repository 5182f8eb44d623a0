"""A node of zenoh-ros2-sdk, an implementation of rmw_zenoh's wire: it publishes /tf, hears /tf and
the transforms of /tf_static from before it came.

Run by the Python of its environment: rmw_sdk.py PORT HASH; the definition of the message is on its
standard input. It prints received messages. Its process does not end by itself.
"""

import sys
import time
from typing import Any

from zenoh_ros2_sdk import ROS2Publisher, ROS2Subscriber
from zenoh_ros2_sdk.qos import QosDurability, QosProfile

TYPE = "tf2_msgs/msg/TFMessage"

port, type_hash = int(sys.argv[1]), sys.argv[2]
common = {
    "msg_type": TYPE,
    "msg_definition": sys.stdin.read(),
    "type_hash": type_hash,
    "node_name": "sdk_node",
    "router_port": port,
}


def heard(topic: str, message: Any) -> None:
    """Print the frames of a message."""
    for each in message.transforms:
        if each.child_frame_id != "sdk_arm":
            # In one piece: the topics have a thread each.
            x = each.transform.translation.x
            print(f"heard {topic} {each.child_frame_id} {x}\n", end="", flush=True)


late = QosProfile(durability=QosDurability.TRANSIENT_LOCAL, history_depth=100)
statics = ROS2Subscriber(
    "/tf_static", callback=lambda got: heard("/tf_static", got), qos=late, **common
)
dynamics = ROS2Subscriber("/tf", callback=lambda got: heard("/tf", got), **common)
publisher = ROS2Publisher("/tf", **common)
types = publisher.session_mgr.store.types
transform = types["geometry_msgs/msg/TransformStamped"](
    header=types["std_msgs/msg/Header"](
        stamp=types["builtin_interfaces/msg/Time"](sec=12, nanosec=34), frame_id="base"
    ),
    child_frame_id="sdk_arm",
    transform=types["geometry_msgs/msg/Transform"](
        translation=types["geometry_msgs/msg/Vector3"](x=1.5, y=0.0, z=0.0),
        rotation=types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
    ),
)
print("ready\n", end="", flush=True)
while True:
    publisher.publish(transforms=[transform])
    time.sleep(0.1)
