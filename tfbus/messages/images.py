"""Messages of cameras: images, compressed or not, and how a camera sees."""

import re
from dataclasses import dataclass, field
from typing import Any, ClassVar

from tfbus.base import lazy_numpy as np
from tfbus.base.lazy_numpy import NDArray
from tfbus.messages.fields import (
    Float64Array,
    UInt8Array,
    WithArrays,
    check_byte,
    check_count,
    check_size,
    check_stamp,
    check_unsigned,
    no_numbers,
)

# How many times as many rows as the image they have, in one plane behind the other.
_PLANAR = {"nv12": 1.5, "nv21": 1.5, "nv24": 3.0}

# The names of encodings in ROS: the numbers of a pixel, and how many there are. Of encodings with
# planes this is the first one, of brightness.
_ENCODINGS = {
    **{f"{order}8": ("u1", len(order)) for order in ("rgb", "rgba", "bgr", "bgra")},
    **{f"{order}16": ("u2", len(order)) for order in ("rgb", "rgba", "bgr", "bgra")},
    "mono8": ("u1", 1),
    "mono16": ("u2", 1),
    **{f"bayer_{order}8": ("u1", 1) for order in ("rggb", "bggr", "gbrg", "grbg")},
    **{f"bayer_{order}16": ("u2", 1) for order in ("rggb", "bggr", "gbrg", "grbg")},
    **dict.fromkeys(("yuv422", "uyvy", "yuv422_yuy2", "yuyv"), ("u1", 2)),
    **dict.fromkeys(_PLANAR, ("u1", 1)),
}
_OF_OPENCV = re.compile(r"(8|16|32|64)([USF])C?([1-9]\d{0,2})?")
_KINDS = {"U": "u", "S": "i", "F": "f"}


def _pixel(encoding: str) -> tuple[str, int]:
    """The type of numpy of a pixel's numbers, without byte order, and how many there are.

    Raises ValueError for an encoding that ROS does not have.
    """
    if encoding in _ENCODINGS:
        return _ENCODINGS[encoding]
    found = _OF_OPENCV.fullmatch(encoding)
    if found is not None:
        kind = f"{_KINDS[found[2]]}{int(found[1]) // 8}"
        if kind in ("u1", "i1", "u2", "i2", "i4", "f4", "f8"):
            return kind, int(found[3] or 1)
    raise ValueError(
        f"encoding must be one of ROS's, such as rgb8, bgr8, mono8, mono16, bayer_rggb8, 16UC1 or "
        f"32FC1, not {encoding[:60]!r}"
    )


@dataclass(frozen=True, slots=True, eq=False)
class Image(WithArrays):
    """An image of the camera whose optical frame is `frame_id` (x right, y down, z ahead), at
    stamp_ns.

    `data` has `height` rows of `step` bytes, the uppermost first, with `width` pixels in each;
    `encoding` says what a pixel is, by ROS's names: rgb8, bgr8, mono8, 16UC1 (depth in mm), 32FC1
    (depth in m). Make one by `from_pixels`, and read it by `pixels`.
    """

    __msgtype__: ClassVar[str] = "sensor_msgs/msg/Image"
    __changes__: ClassVar[str] = "data"

    stamp_ns: int
    frame_id: str
    height: int = 0
    width: int = 0
    encoding: str = "rgb8"
    is_bigendian: int = 0
    step: int = 0
    data: UInt8Array = field(default_factory=no_numbers)

    def __post_init__(self) -> None:
        check_stamp("stamp_ns", self.stamp_ns)
        for name in ("height", "width", "step"):
            check_unsigned(name, getattr(self, name))
        check_byte("is_bigendian", self.is_bigendian)
        self._make_arrays()
        kind, count = _pixel(self.encoding)
        least = self.width * count * int(kind[1])
        if self.height and self.step < least:
            raise ValueError(
                f"step must be at least {least} bytes, of {self.width} pixels of {self.encoding}, "
                f"not {self.step}"
            )
        rows = self.height
        if self.encoding in _PLANAR and len(self.data) > rows * self.step:
            rows = int(rows * _PLANAR[self.encoding])
        check_size("data", self.data, rows, self.step, of="height times step")

    @classmethod
    def from_pixels(
        cls, stamp_ns: int, frame_id: str, pixels: "NDArray[Any]", encoding: str = ""
    ) -> "Image":
        """The image of pixels (height, width) or (height, width, channels).

        It shares their memory, if that is contiguous. Without an `encoding` it is mono8 or rgb8 and
        rgba8 of uint8, 16UC1 of uint16, 32FC1 of float32, and so on: say bgr8 for images of OpenCV.
        Raises ValueError for pixels that the encoding does not have.
        """
        pixels = np.ascontiguousarray(pixels)
        if pixels.ndim not in (2, 3):
            raise ValueError(
                f"pixels must have the shape (height, width) or (height, width, channels), not "
                f"{pixels.shape}"
            )
        if not pixels.dtype.isnative:
            pixels = pixels.astype(pixels.dtype.newbyteorder("="))
        count = pixels.shape[2] if pixels.ndim == 3 else 1
        kind = f"{pixels.dtype.kind}{pixels.dtype.itemsize}"
        encoding = encoding or _encoding_of(kind, count)
        if _pixel(encoding) != (kind, count):
            wanted, channels = _pixel(encoding)
            raise ValueError(
                f"pixels of {encoding} must be {np.dtype(wanted)} with {channels} channels, not "
                f"{pixels.dtype} with {count}"
            )
        height, width = pixels.shape[:2]
        step = width * count * pixels.dtype.itemsize
        data = pixels.reshape(-1).view(np.uint8)
        is_bigendian = int(not np.little_endian)
        return cls(stamp_ns, frame_id, height, width, encoding, is_bigendian, step, data)

    def pixels(self) -> "NDArray[Any]":
        """The pixels (height, width), or (height, width, channels) of several: a view of `data`,
        which cannot be written to.
        """
        kind, count = _pixel(self.encoding)
        dtype = np.dtype(f"{'>' if self.is_bigendian else '<'}{kind}")
        shape: tuple[int, ...] = (self.height, self.width)
        steps: tuple[int, ...] = (self.step, count * dtype.itemsize)
        if count > 1:
            shape, steps = (*shape, count), (*steps, dtype.itemsize)
        if not self.height * self.width:
            return np.empty(shape, dtype)
        return np.ndarray(shape, dtype, self.data, 0, steps)


def _encoding_of(kind: str, count: int) -> str:
    if kind == "u1":
        return {1: "mono8", 3: "rgb8", 4: "rgba8"}.get(count, f"8UC{count}")
    letter = {"u": "U", "i": "S", "f": "F"}.get(kind[0], "?")
    return f"{8 * int(kind[1:])}{letter}C{count}"


@dataclass(frozen=True, slots=True, eq=False)
class CompressedImage(WithArrays):
    """An image in a format such as JPEG, of the camera whose optical frame is `frame_id`.

    `data` is a file of the `format`, which begins with `jpeg`, `png` or another name; of ROS it
    may say more, `rgb8; jpeg compressed bgr8`.
    """

    __msgtype__: ClassVar[str] = "sensor_msgs/msg/CompressedImage"

    stamp_ns: int
    frame_id: str
    format: str = ""
    data: UInt8Array = field(default_factory=no_numbers)

    def __post_init__(self) -> None:
        check_stamp("stamp_ns", self.stamp_ns)
        self._make_arrays()


@dataclass(frozen=True, slots=True)
class RegionOfInterest:
    """A part of an image, in pixels of the whole; of no size it is all of it."""

    __msgtype__: ClassVar[str] = "sensor_msgs/msg/RegionOfInterest"

    x_offset: int = 0
    y_offset: int = 0
    height: int = 0
    width: int = 0
    do_rectify: bool = False

    def __post_init__(self) -> None:
        for name in ("x_offset", "y_offset", "height", "width"):
            check_unsigned(name, getattr(self, name))


@dataclass(frozen=True, slots=True, eq=False)
class CameraInfo(WithArrays):
    """How the camera of an image sees, whose optical frame is `frame_id`: x right, y down, z ahead.

    `k` (3 by 3) projects points of that frame to pixels of `width` by `height`, after the
    distortion by the model and its parameters `d`; `r` (3 by 3) turns into the rectified frame, and
    `p` (3 by 4) projects from there. All are row by row; k[0] is 0 for a camera that is not
    calibrated.
    """

    __msgtype__: ClassVar[str] = "sensor_msgs/msg/CameraInfo"

    stamp_ns: int
    frame_id: str
    height: int = 0
    width: int = 0
    distortion_model: str = ""
    d: Float64Array = field(default_factory=no_numbers)
    k: tuple[float, ...] = (0.0,) * 9
    r: tuple[float, ...] = (0.0,) * 9
    p: tuple[float, ...] = (0.0,) * 12
    binning_x: int = 0
    binning_y: int = 0
    roi: RegionOfInterest = field(default_factory=RegionOfInterest)

    def __post_init__(self) -> None:
        check_stamp("stamp_ns", self.stamp_ns)
        for name in ("height", "width", "binning_x", "binning_y"):
            check_unsigned(name, getattr(self, name))
        self._make_arrays()
        check_count("k", self.k, 9)
        check_count("r", self.r, 9)
        check_count("p", self.p, 12)

    def matrix(self) -> "NDArray[np.float64]":
        """`k` as a matrix (3, 3)."""
        return np.array(self.k, np.float64).reshape(3, 3)

    def projection(self) -> "NDArray[np.float64]":
        """`p` as a matrix (3, 4)."""
        return np.array(self.p, np.float64).reshape(3, 4)
