"""Publishes the images of a webcam as JPEG, by OpenCV (v4l2 on Linux), in the frame camera.

    pip install opencv-python-headless
    python examples/webcam.py
    python examples/webcam.py 2

The view shows them, in its tab Data. Ctrl-C ends it.
"""

import sys

import cv2
import numpy as np

from tfbus import Node
from tfbus.messages import CompressedImage


def main() -> None:
    """Publish until Ctrl-C."""
    number = int(sys.argv[1]) if len(sys.argv) > 1 else 0
    camera = cv2.VideoCapture(number)
    if not camera.isOpened():
        raise SystemExit(f"Error: there is no camera {number}")
    with Node("webcam") as node:
        images = node.create_publisher(CompressedImage, "camera/image/compressed")
        while node.ok:
            is_read, pixels = camera.read()  # waits for the next image
            if not is_read:
                raise SystemExit("Error: the camera sends nothing more")
            stamp_ns = node.now_ns()
            _, jpeg = cv2.imencode(".jpg", pixels)
            images.publish(
                CompressedImage(stamp_ns, "camera", "jpeg", np.asarray(jpeg).reshape(-1))
            )


if __name__ == "__main__":
    main()
