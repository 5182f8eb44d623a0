"""Says where the base sees what a camera on an arm sees, without a bus.

    python examples/camera_on_arm.py

The camera's frame is the optical one: z ahead, x to the right, y down.
"""

import math

from tfbus import Buffer, Transform, TransformStamped
from tfbus.buffer.formats import show

SECOND = 1_000_000_000


def main() -> None:
    buffer = Buffer()
    for tick in range(11):  # the arm turns to the left by 90 degrees in a second
        pose = Transform.from_rpy(0, 0, math.pi / 2 * tick / 10, xyz=(0, 0, 0.6))
        buffer.set_transform(TransformStamped(tick * SECOND // 10, "base", "arm", pose))
    optical = Transform.from_rpy(-math.pi / 2, 0, -math.pi / 2, xyz=(0.4, 0, 0.1))
    buffer.set_transform(TransformStamped(0, "arm", "camera", optical), static=True)

    show(buffer, "base", "camera")
    two_metres_ahead = (0.0, 0.0, 2.0)
    for tenth in (0, 5, 10):
        into_base = buffer.lookup_transform("base", "camera", tenth * SECOND // 10).transform
        print(f"at {tenth / 10} s:", into_base.apply(two_metres_ahead).round(3) + 0.0)


if __name__ == "__main__":
    main()
