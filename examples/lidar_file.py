"""Publishes the points (N, 3) of a file of numpy ten times a second, with the frame lidar.

    python examples/lidar_file.py scan.npy

The view shows it, in its tab Data. Points are in m. `tfbus topic pub --file` reads PCD too.
"""

import sys

import numpy as np

from tfbus import Node
from tfbus.messages import PointCloud


def main() -> None:
    """Publish until Ctrl-C; without a file, a ring of points."""
    angles = np.linspace(0, 2 * np.pi, 360)
    ring = np.column_stack((5 * np.cos(angles), 5 * np.sin(angles), 0 * angles))
    xyz = np.load(sys.argv[1]) if len(sys.argv) > 1 else ring
    with Node("lidar_file") as node:
        clouds = node.create_publisher(PointCloud, "points")
        node.create_timer(
            0.1, lambda: clouds.publish(PointCloud.from_xyz(node.now_ns(), "lidar", xyz))
        )
        node.spin()


if __name__ == "__main__":
    main()
