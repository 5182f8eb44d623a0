"""Publishes the points of a file ten times a second, with the frame lidar.

    python examples/lidar_file.py
    python examples/lidar_file.py scan.ply

The first one is a ring. Files are PLY, PCD, or of numpy (.npy, .npz: an array (N, 3) in m, or a
structured one). The view shows the points, in its tab Data. `tfbus topic pub --file` does the same.
"""

import argparse
from dataclasses import replace

import numpy as np

from tfbus import Node, TfbusError
from tfbus.messages import PointCloud
from tfbus.sensor_files import read_cloud


def main() -> None:
    """Publish until Ctrl-C; without a file, a ring of points."""
    parser = argparse.ArgumentParser(description="Publishes the points of a file.")
    parser.add_argument("file", nargs="?")
    path = parser.parse_args().file
    angles = np.linspace(0, 2 * np.pi, 360)
    ring = np.column_stack((5 * np.cos(angles), 5 * np.sin(angles), 0 * angles))
    try:
        cloud = read_cloud(path) if path else PointCloud.from_xyz(0, "", ring)
    except OSError as error:
        parser.error(f"{path} cannot be read: {error.strerror}")
    except TfbusError as error:
        parser.error(str(error))
    with Node("lidar_file") as node:
        clouds = node.create_publisher(PointCloud, "points")
        node.create_timer(
            0.1, lambda: clouds.publish(replace(cloud, stamp_ns=node.now_ns(), frame_id="lidar"))
        )
        node.spin()


if __name__ == "__main__":
    main()
