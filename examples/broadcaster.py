"""Sends a dynamic transform: a camera that turns on a mast, fifty times a second.

    python examples/broadcaster.py
    python examples/broadcaster.py --param speed=2.0

listener.py, or `tfbus echo world camera`, shows where the camera is. Ctrl-C ends it.
"""

import math

from tfbus import Node, Transform, TransformBroadcaster, TransformStamped


def main() -> None:
    with Node.from_args("mast") as node:
        speed = node.declare_parameter("speed", 0.5, description="Of the turn, in rad/s.")
        broadcaster = TransformBroadcaster(node)

        def send() -> None:
            now_ns = node.now_ns()
            yaw = math.remainder(speed.value * now_ns / 1e9, 2 * math.pi)
            world_from_camera = Transform.from_rpy(0.0, 0.0, yaw, xyz=(1.0, 0.0, 1.5))
            broadcaster.send_transform(
                TransformStamped(now_ns, "world", "camera", world_from_camera)
            )

        node.create_timer(0.02, send)
        node.spin()


if __name__ == "__main__":
    main()
