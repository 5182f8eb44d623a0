"""A robot that drives in a circle, with a lidar, a scanner and a camera: all are seen in the view.

    python examples/sensors.py
    tfbus view --topic points --topic scan --topic camera/image

Ctrl-C ends it.
"""

import math

import numpy as np

from tfbus import (
    Node,
    StaticTransformBroadcaster,
    Transform,
    TransformBroadcaster,
    TransformStamped,
)
from tfbus.messages import CameraInfo, Image, LaserScan, PointCloud

ROOM_M = 5.0
WIDTH, HEIGHT, FOCAL = 320, 240, 240.0


def robot_at(seconds: float) -> Transform:
    """The pose of the robot in the room after so many seconds."""
    angle = 0.3 * seconds
    return Transform.from_rpy(
        0, 0, angle + math.pi / 2, xyz=(2 * math.cos(angle), 2 * math.sin(angle), 0)
    )


def distances(origin: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """How far it is to the walls of the room, along each of the directions (N, 2)."""
    with np.errstate(divide="ignore"):
        to_walls = (np.copysign(ROOM_M, directions) - origin) / directions
    return to_walls.min(axis=1)


def scan_of(pose: Transform, angles: np.ndarray) -> np.ndarray:
    """The ranges of a scanner at a pose."""
    yaw = pose.as_rpy()[2]
    directions = np.stack((np.cos(angles + yaw), np.sin(angles + yaw)), axis=1)
    return distances(pose.xyz[:2], directions)


def main() -> None:
    """Publish until Ctrl-C."""
    with Node("sensors") as node:
        static = StaticTransformBroadcaster(node)
        broadcaster = TransformBroadcaster(node)
        lidar = Transform((0, 0, 0.8))
        camera = Transform.from_rpy(-math.pi / 2, 0, -math.pi / 2, xyz=(0.3, 0, 0.5))
        static.send_transform(
            [
                TransformStamped(0, "base", "lidar", lidar),
                TransformStamped(0, "base", "camera", camera),
            ]
        )
        points = node.create_publisher(PointCloud, "points")
        scans = node.create_publisher(LaserScan, "scan")
        images = node.create_publisher(Image, "camera/image")
        infos = node.create_publisher(CameraInfo, "camera/camera_info")
        start_ns = node.now_ns()
        angles = np.linspace(-math.pi, math.pi, 360, endpoint=False)
        heights = np.linspace(-0.8, 1.7, 16)

        def drive() -> None:
            now_ns = node.now_ns()
            pose = robot_at((now_ns - start_ns) / 1e9)
            broadcaster.send_transform(TransformStamped(now_ns, "room", "base", pose))

        def measure() -> None:
            now_ns = node.now_ns()
            pose = robot_at((now_ns - start_ns) / 1e9)
            ranges = scan_of(pose, angles)
            step = 2 * math.pi / len(angles)
            scans.publish(
                LaserScan(now_ns, "base", -math.pi, math.pi, step, 0, 0, 0.1, 30.0, ranges)
            )
            ring = np.stack((ranges * np.cos(angles), ranges * np.sin(angles)), axis=1)
            flat = np.tile(ring, (len(heights), 1))
            xyz = np.column_stack((flat, np.repeat(heights, len(angles))))
            intensity = np.tile(1.0 / ranges, len(heights)).astype(np.float32)
            points.publish(PointCloud.from_xyz(now_ns, "lidar", xyz, intensity=intensity))

        def look() -> None:
            now_ns = node.now_ns()
            pose = robot_at((now_ns - start_ns) / 1e9)
            bearings = -np.arctan((np.arange(WIDTH) - WIDTH / 2) / FOCAL)
            # A wall is as high in the image as it is near.
            half = HEIGHT / scan_of(pose, bearings)
            rows = np.abs(np.arange(HEIGHT) - HEIGHT / 2)[:, None]
            pixels = np.full((HEIGHT, WIDTH, 3), (90, 140, 200), np.uint8)
            pixels[HEIGHT // 2 :] = (90, 80, 70)
            pixels[rows < half] = (200, 180, 150)
            images.publish(Image.from_pixels(now_ns, "camera", pixels))
            k = (FOCAL, 0, WIDTH / 2, 0, FOCAL, HEIGHT / 2, 0, 0, 1)
            infos.publish(CameraInfo(now_ns, "camera", HEIGHT, WIDTH, k=k))

        node.create_timer(0.02, drive)
        node.create_timer(0.1, measure)
        node.create_timer(0.1, look)
        node.spin()


if __name__ == "__main__":
    main()
