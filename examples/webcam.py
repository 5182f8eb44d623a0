"""Publishes the images of a webcam, or of a film, as JPEG, by OpenCV (v4l2 on Linux).

    pip install opencv-python-headless
    python examples/webcam.py
    python examples/webcam.py 2
    python examples/webcam.py film.mp4

The view shows them (--topic camera/image/compressed). The third one plays a file, or a stream by
its address. Ctrl-C ends it.
"""

import math
import sys

import cv2
import numpy as np

from tfbus import Node, StaticTransformBroadcaster, Transform, TransformStamped
from tfbus.messages import CameraInfo, CompressedImage


def main() -> None:
    """Publish until Ctrl-C."""
    name = sys.argv[1] if len(sys.argv) > 1 else "0"
    camera = cv2.VideoCapture(int(name) if name.isdigit() else name)
    if not camera.isOpened():
        raise SystemExit(f"Error: there is no camera {name}")
    # A camera waits for its next image, a file does not.
    pause_s = 0.0 if name.isdigit() else 1 / (camera.get(cv2.CAP_PROP_FPS) or 25.0)
    with Node("webcam") as node:
        # A metre above the ground, looking along x; images are seen from their frame.
        place = Transform.from_rpy(-math.pi / 2, 0, -math.pi / 2, xyz=(0, 0, 1))
        StaticTransformBroadcaster(node).send_transform(
            TransformStamped(0, "world", "camera", place)
        )
        images = node.create_publisher(CompressedImage, "camera/image/compressed")
        infos = node.create_publisher(CameraInfo, "camera/camera_info")
        while node.ok:
            is_read, pixels = camera.read()
            if not is_read:
                raise SystemExit(f"Error: camera {name} sends nothing more")
            stamp_ns = node.now_ns()
            _, jpeg = cv2.imencode(".jpg", pixels)
            images.publish(
                CompressedImage(stamp_ns, "camera", "jpeg", np.asarray(jpeg).reshape(-1))
            )
            height, width, _ = pixels.shape
            # About that of a webcam; a calibration, as by cv2.calibrateCamera, has the true one.
            k = (width, 0, width / 2, 0, width, height / 2, 0, 0, 1)
            infos.publish(CameraInfo(stamp_ns, "camera", height, width, k=k))
            node.wait(pause_s)


if __name__ == "__main__":
    main()
