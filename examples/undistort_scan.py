"""Undistorts a lidar scan: each point was measured at its own time while the robot drove.

    python examples/undistort_scan.py

A wall stands at x = 4 m. The robot drives towards it at 2 m/s, so the raw ranges shrink during
the scan; `transform_points` takes each point into the lidar as it was at the end of the scan.
"""

import numpy as np

from tfbus import Buffer, Transform, TransformStamped

START_NS = 1_700_000_000_000_000_000
SCAN_S = 0.1
SPEED_M_S = 2.0
WALL_X_M = 4.0


def main() -> None:
    buffer = Buffer()
    for at_s in (0.0, SCAN_S):
        stamp_ns = START_NS + round(at_s * 1e9)
        pose = Transform((SPEED_M_S * at_s, 0.0, 0.0))
        buffer.set_transform(TransformStamped(stamp_ns, "odom", "lidar", pose))

    times_s = np.linspace(0.0, SCAN_S, 5)
    stamps_ns = START_NS + np.round(times_s * 1e9).astype(np.int64)
    raw = np.zeros((5, 3))
    raw[:, 0] = WALL_X_M - SPEED_M_S * times_s
    print("raw x:        ", raw[:, 0])

    straight = buffer.transform_points(
        raw, "lidar", "lidar", stamps_ns, target_stamp_ns=int(stamps_ns[-1]), fixed_frame="odom"
    )
    print("undistorted x:", straight[:, 0].round(6))


if __name__ == "__main__":
    main()
