"""Broadcasts where the robot is: it drives in a circle around the origin of the world.

Try it: tfbus my_node --param radius=2.0
"""

import math
from collections.abc import Sequence

import tfbus

RATE_HZ = 20.0
TURN_RATE_RAD_S = 0.5


def pose_at(time_s: float, radius_m: float) -> tfbus.Transform:
    """Where the robot is at a time: it takes points of the robot into the world."""
    angle = TURN_RATE_RAD_S * time_s
    position = (radius_m * math.cos(angle), radius_m * math.sin(angle), 0.0)
    return tfbus.Transform.from_rpy(0.0, 0.0, angle + math.pi / 2, xyz=position)


def start(node: tfbus.Node) -> None:
    """Begin to broadcast."""
    radius = node.declare_parameter("radius", 1.0, description="of the circle, in m", minimum=0.0)
    broadcaster = tfbus.TransformBroadcaster(node)

    def broadcast() -> None:
        now_ns = node.now_ns()
        pose = pose_at(now_ns / 1e9, radius.value)
        broadcaster.send_transform(tfbus.TransformStamped(now_ns, "world", "my_robot", pose))

    node.create_timer(1 / RATE_HZ, broadcast)


def main(argv: Sequence[str] | None = None) -> None:
    """Run the node until Ctrl-C."""
    with tfbus.Node.from_args("my_node", argv) as node:
        start(node)
        node.spin()


if __name__ == "__main__":
    main()
