"""Finds an AprilTag in a picture, and says where it is in the world.

    pip install opencv-python-headless
    python examples/marker_in_world.py
    python examples/marker_in_world.py tag.png

The program draws the picture itself, as a camera on a mast sees the tag, so that it can compare
what it finds with what is true. With a name of a file it writes the picture, and in it the axes
of the tag (x red, y green, z blue). With a camera of your own take its picture, and put the numbers
of its calibration into CAMERA.
"""

import sys

import cv2
import numpy as np
from numpy.typing import NDArray

from tfbus import Buffer, Transform, TransformStamped

SIZE_M = 0.2  # of the tag's black square
TAG = 7
TAGS = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
CAMERA = np.array([[600.0, 0.0, 320.0], [0.0, 600.0, 240.0], [0.0, 0.0, 1.0]])
NO_DISTORTION = np.zeros(5)
# Of the tag: x to the right, y up, z out of it. The detector gives them in this order.
CORNERS = SIZE_M / 2 * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]], float)

Image = NDArray[np.uint8]


def draw(camera_from_tag: Transform) -> Image:
    """The picture of the tag, on white paper that is larger by a quarter, before a grey wall."""
    pixels, margin = 400, 50
    paper = np.full((pixels + 2 * margin, pixels + 2 * margin), 255, np.uint8)
    paper[margin:-margin, margin:-margin] = cv2.aruco.generateImageMarker(TAGS, TAG, pixels)
    corners, _ = cv2.projectPoints(
        camera_from_tag.apply(CORNERS), np.zeros(3), np.zeros(3), CAMERA, NO_DISTORTION
    )
    # Of the paper, whose pixels have their centres at whole numbers.
    low, high = margin - 0.5, margin + pixels - 0.5
    square = np.array([[low, low], [high, low], [high, high], [low, high]], np.float32)
    warp = cv2.getPerspectiveTransform(square, corners.reshape(4, 2).astype(np.float32))
    wall = np.full((480, 640), 128, np.uint8)
    return cv2.warpPerspective(paper, warp, (640, 480), wall, borderMode=cv2.BORDER_TRANSPARENT)


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


def write(path: str, image: Image, camera_from_tag: Transform) -> None:
    """The picture, with the axes of what was found."""
    marked = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    turn, xyz = camera_from_tag.as_rotvec(), camera_from_tag.xyz
    cv2.drawFrameAxes(marked, CAMERA, NO_DISTORTION, turn, xyz, SIZE_M)
    try:
        written = cv2.imwrite(path, marked)
    except cv2.error:  # no kind of picture that it knows
        written = False
    if not written:
        raise SystemExit(f"cannot write {path}: is the folder there, and is it a .png or .jpg?")


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
    for path in sys.argv[1:]:
        write(path, image, found[TAG])
    buffer.set_transform(TransformStamped(stamp_ns, "camera", "tag", found[TAG]))
    buffer.show("world", "tag")
    seen = buffer.lookup_transform("world", "tag", stamp_ns).transform
    away_mm = 1000 * seen.distance(true)
    print(f"off by {away_mm:.1f} mm and {seen.angle(true, degrees=True):.1f} degrees")


if __name__ == "__main__":
    main()
