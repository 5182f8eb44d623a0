"""Undistorts a lidar scan: each point was measured at its own time while the robot drove.

    python examples/undistort_scan.py
    python examples/undistort_scan.py --view

A lidar turns once in 0.1 s in a hall, on a robot that drives at 2 m/s and turns to the left. So its
raw points lie beside the walls; `transform_points` takes each into the lidar as it was at the end
of the scan. With --view a page shows both, raw in red and undistorted in blue, until Ctrl-C; it
needs `pip install 'tfbus[view]'`.
"""

import sys

import numpy as np
from numpy.typing import NDArray

from tfbus import Buffer, Transform, TransformStamped

START_NS = 1_700_000_000_000_000_000
SCAN_S = 0.1
SPEED_M_S, TURN_RAD_S = 2.0, 1.5
# Two corners of the hall, in odom.
LOW, HIGH = np.array([-4.0, -3.0, 0.0]), np.array([6.0, 4.0, 3.0])

Points = NDArray[np.float64]


def pose(at_s: float) -> Transform:
    """Where the lidar is in odom: on a circle, 1 m above the floor."""
    radius_m, angle = SPEED_M_S / TURN_RAD_S, TURN_RAD_S * at_s
    x, y = radius_m * np.sin(angle), radius_m * (1 - np.cos(angle))
    return Transform.from_rpy(0, 0, angle, xyz=(x, y, 1.0))


def scan(times_s: Points) -> Points:
    """What it measures: points (N, 3), each in the lidar's axes at its time; 16 rays at a time."""
    points = []
    for at_s in times_s:
        up = np.radians(np.linspace(-15, 15, 16))
        ahead = 2 * np.pi * at_s / SCAN_S
        rays = np.column_stack((np.cos(up) * np.cos(ahead), np.cos(up) * np.sin(ahead), np.sin(up)))
        place = pose(at_s)
        along = place.apply(rays) - place.xyz
        with np.errstate(divide="ignore"):
            ranges = np.maximum((LOW - place.xyz) / along, (HIGH - place.xyz) / along).min(axis=1)
        points.append(rays * ranges[:, None])
    return np.concatenate(points)


def off_walls_m(points: Points) -> float:
    """How far the worst of these points, measured from where the scan ended, is from a wall."""
    in_odom = pose(SCAN_S).apply(points)
    away = np.minimum(np.abs(in_odom - LOW), np.abs(in_odom - HIGH)).min(axis=1)
    return float(away.max())


def main() -> None:
    buffer = Buffer()
    for at_s in np.linspace(0.0, SCAN_S, 11):  # the odometry, each 10 ms
        stamp_ns = START_NS + round(at_s * 1e9)
        buffer.set_transform(TransformStamped(stamp_ns, "odom", "lidar", pose(at_s)))

    times_s = np.linspace(0.0, SCAN_S, 900)
    raw = scan(times_s)
    stamps_ns = START_NS + np.round(np.repeat(times_s, 16) * 1e9).astype(np.int64)
    straight = buffer.transform_points(
        raw, "lidar", "lidar", stamps_ns, target_stamp_ns=int(stamps_ns[-1]), fixed_frame="odom"
    )
    print(f"raw: up to {off_walls_m(raw):.3f} m off the walls")
    print(f"undistorted: up to {off_walls_m(straight):.3f} m")
    if "--view" in sys.argv:
        show(buffer, raw, straight)


def show(buffer: Buffer, raw: Points, straight: Points) -> None:
    """Both scans in a browser, until Ctrl-C."""
    from tfbus.view import show

    with show(buffer) as view:
        view.add_points("raw", "lidar", raw, color=(220, 50, 40), size_m=0.02)
        view.add_points("undistorted", "lidar", straight, color=(40, 90, 220), size_m=0.02)
        print(f"View: {view.url}", flush=True)
        view.wait()


if __name__ == "__main__":
    main()
