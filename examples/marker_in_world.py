"""Finds an AprilTag in a picture, and says where it is in the world.

    pip install opencv-python-headless
    python examples/marker_in_world.py
    python examples/marker_in_world.py --view

The program draws the picture itself, as a camera on a mast sees the tag, so that it can compare
what it finds with what is true. With a camera of your own take its picture, and put the numbers of
its calibration into CAMERA. With --view a page shows the camera, its picture and the tag until
Ctrl-C; it needs `pip install 'tfbus[view]'`.
"""

import sys

import cv2
import numpy as np
from numpy.typing import NDArray

from tfbus import Buffer, Transform, TransformStamped
from tfbus.buffer import formats

SIZE_M = 0.2  # of the tag's black square
TAG = 7
TAGS = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
PIXELS, MARGIN = 400, 50  # of the tag on its paper
CAMERA = np.array([[600.0, 0.0, 320.0], [0.0, 600.0, 240.0], [0.0, 0.0, 1.0]])
NO_DISTORTION = np.zeros(5)
# Of the tag: x to the right, y up, z out of it. The detector gives them in this order.
CORNERS = SIZE_M / 2 * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]], float)

Image = NDArray[np.uint8]


def paper() -> Image:
    """The tag on white paper that is larger by a quarter."""
    tag = cv2.aruco.generateImageMarker(TAGS, TAG, PIXELS)
    return np.pad(tag, MARGIN, constant_values=255)


def draw(camera_from_tag: Transform) -> Image:
    """The picture of the paper with the tag, before a grey wall."""
    corners, _ = cv2.projectPoints(
        camera_from_tag.apply(CORNERS), np.zeros(3), np.zeros(3), CAMERA, NO_DISTORTION
    )
    # Of the paper, whose pixels have their centres at whole numbers.
    low, high = MARGIN - 0.5, MARGIN + PIXELS - 0.5
    square = np.array([[low, low], [high, low], [high, high], [low, high]], np.float32)
    warp = cv2.getPerspectiveTransform(square, corners.reshape(4, 2).astype(np.float32))
    wall = np.full((480, 640), 128, np.uint8)
    return cv2.warpPerspective(paper(), warp, (640, 480), wall, borderMode=cv2.BORDER_TRANSPARENT)


def find(image: Image) -> dict[int, Transform]:
    """Where the tags are in the camera's optical frame: z ahead, x to the right, y down."""
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    corners, tags, _ = cv2.aruco.ArucoDetector(TAGS, settings).detectMarkers(image)
    found = {}
    for tag, seen in zip([] if tags is None else tags.ravel(), corners, strict=True):
        flag = cv2.SOLVEPNP_IPPE_SQUARE
        _, rotvec, xyz = cv2.solvePnP(CORNERS, seen, CAMERA, NO_DISTORTION, flags=flag)
        found[int(tag)] = Transform.from_rotvec(rotvec.ravel(), xyz.ravel())
    return found


def main() -> None:
    stamp_ns = 1_700_000_000_000_000_000
    camera = Transform.look_at((0, 0, 1.5), (2, 0, 1), convention="camera")
    buffer = Buffer()
    buffer.set_transform(TransformStamped(0, "world", "camera", camera), static=True)

    true = Transform.from_rpy(90, 0, -70, degrees=True, xyz=(1.6, 0.2, 1.1))
    image = draw(camera.inverse() @ true)
    found = find(image)
    if TAG not in found:
        raise SystemExit(f"no tag {TAG} in the picture")
    buffer.set_transform(TransformStamped(stamp_ns, "camera", "tag", found[TAG]))
    formats.show(buffer, "world", "tag")
    seen = buffer.lookup_transform("world", "tag", stamp_ns).transform
    away_mm = 1000 * seen.distance(true)
    print(f"off by {away_mm:.1f} mm and {seen.angle(true, degrees=True):.1f} degrees")
    if "--view" in sys.argv:
        show(buffer, image)


def show(buffer: Buffer, image: Image) -> None:
    """What was found, in a browser, until Ctrl-C."""
    from tfbus.view import show

    with show(buffer) as view:
        view.add_camera("picture", "camera", camera_matrix=CAMERA, image=image, depth_m=0.5)
        view.add_image("paper", "tag", paper(), SIZE_M * (PIXELS + 2 * MARGIN) / PIXELS)
        print(f"View: {view.url}", flush=True)
        view.wait()


if __name__ == "__main__":
    main()
