"""Publishes the static frames of a robot, and keeps them there until Ctrl-C.

    python examples/static_frames.py

Processes that start later have them too. `tfbus frames` shows the tree. For a few frames
without a program there is `tfbus static world dock --x 1`.
"""

import math

from tfbus import Node, StaticTransformBroadcaster, Transform, TransformStamped

# Where each sensor is in base_link: metres, and roll, pitch, yaw in radians.
SENSORS = {
    "lidar": Transform((0.0, 0.0, 0.3)),
    "front_camera": Transform((0.2, 0.0, 0.1)),
    "rear_camera": Transform.from_rpy(0.0, 0.0, math.pi, xyz=(-0.2, 0.0, 0.1)),
}


def main() -> None:
    with Node.from_args("sensors") as node:
        now_ns = node.now_ns()
        StaticTransformBroadcaster(node).send_transform(
            [
                TransformStamped(now_ns, "base_link", sensor, base_from_sensor)
                for sensor, base_from_sensor in SENSORS.items()
            ]
        )
        node.spin()


if __name__ == "__main__":
    main()
