"""Images as pictures for browsers: red, green and blue, of a bounded size."""

import io
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tfbus.messages import CompressedImage, Image

Picture = NDArray[np.uint8]

# More pixels are left out, and larger files are not opened.
_MOST_SIDE = 1280
_MOST_PIXELS = 50_000_000

_CHANNELS = {"rgb": (0, 1, 2), "bgr": (2, 1, 0)}


def picture_of(image: Image | CompressedImage) -> Picture:
    """The picture (H, W, 3) of an image, at most 1280 wide and high.

    Depths and other numbers are from dark to bright, of those in the image. Raises ValueError for
    an image that cannot be read.
    """
    if isinstance(image, CompressedImage):
        return _opened(image)
    pixels = image.pixels()
    if not pixels.size:
        raise ValueError("the image has no pixels")
    step = -(-max(pixels.shape[:2]) // _MOST_SIDE)
    encoding = image.encoding
    if encoding.startswith("bayer_"):
        return _of_bayer(pixels, encoding, max(1, -(-step // 2)))
    if encoding in ("yuv422", "uyvy", "yuv422_yuy2", "yuyv"):
        return _of_yuv422(pixels, is_y_first=encoding in ("yuyv", "yuv422_yuy2"), step=step)
    pixels = pixels[::step, ::step]
    if pixels.ndim == 2:
        return np.repeat(_bytes(pixels, encoding == "mono16")[:, :, None], 3, axis=2)
    channels = pixels.shape[2]
    if channels < 3:
        return np.repeat(_bytes(pixels[:, :, 0], False)[:, :, None], 3, axis=2)
    # Of OpenCV's names those with three channels are blue first.
    order = _CHANNELS["rgb" if encoding.startswith("rgb") else "bgr"]
    return np.ascontiguousarray(_bytes(pixels[:, :, order], encoding.endswith("16")))


def _bytes(numbers: NDArray[Any], is_16_bit: bool) -> Picture:
    if numbers.dtype == np.uint8:
        return np.ascontiguousarray(numbers)
    if is_16_bit:
        return (numbers >> 8).astype(np.uint8)
    values = numbers.astype(np.float64)
    # 0 stands for no depth, as NaN does.
    is_known = np.isfinite(values) & (values != 0.0)
    shown = np.zeros(values.shape, np.uint8)
    if is_known.any():
        low, high = np.percentile(values[is_known], (1.0, 99.0))
        with np.errstate(over="ignore", invalid="ignore"):
            parts = np.clip((values[is_known] - low) / max(high - low, 1e-9), 0.0, 1.0)
        shown[is_known] = np.nan_to_num(30.0 + 225.0 * parts).astype(np.uint8)
    return shown


def _of_bayer(pixels: NDArray[Any], encoding: str, step: int) -> Picture:
    """A pixel for each four."""
    height, width = (side - side % 2 for side in pixels.shape)
    if not height * width:
        raise ValueError("an image of colour filters needs 2 by 2 pixels")
    levels = pixels if pixels.dtype == np.uint8 else (pixels >> 8).astype(np.uint8)
    four = [levels[y:height:2, x:width:2][::step, ::step] for y in (0, 1) for x in (0, 1)]
    order = encoding[6:10]
    greens = [four[at].astype(np.uint16) for at in range(4) if order[at] == "g"]
    green = ((greens[0] + greens[1]) >> 1).astype(np.uint8)
    return np.stack((four[order.index("r")], green, four[order.index("b")]), axis=2)


def _of_yuv422(pixels: NDArray[Any], *, is_y_first: bool, step: int) -> Picture:
    width = pixels.shape[1] - pixels.shape[1] % 2
    if not width:
        raise ValueError("an image of yuv422 needs 2 columns")
    at_y, at_uv = (0, 1) if is_y_first else (1, 0)
    rows = pixels[::step, :width]
    y = rows[:, ::step, at_y].astype(np.float32)
    # Both columns of a pair have the colour of the pair.
    of_column = np.arange(0, width, step) // 2 * 2
    u, v = (rows[:, of_column + at, at_uv].astype(np.float32) - 128.0 for at in (0, 1))
    rgb = np.stack((y + 1.402 * v, y - 0.344 * u - 0.714 * v, y + 1.772 * u), axis=2)
    picture: Picture = np.clip(rgb, 0.0, 255.0).astype(np.uint8)
    return picture


def _opened(image: CompressedImage) -> Picture:
    from PIL import Image as Opener
    from PIL import UnidentifiedImageError

    try:
        # Formats that may run programs or read files, such as EPS, are not among these.
        opened = Opener.open(io.BytesIO(image.data.tobytes()), formats=("JPEG", "PNG", "WEBP"))
        if opened.width * opened.height > _MOST_PIXELS:
            raise ValueError(f"it has {opened.width} by {opened.height} pixels, too many to show")
        # JPEG is made smaller while it is read.
        opened.draft("RGB", (_MOST_SIDE, _MOST_SIDE))
        opened.thumbnail((_MOST_SIDE, _MOST_SIDE))
        return np.asarray(opened.convert("RGB"))
    except (OSError, SyntaxError, UnidentifiedImageError, Opener.DecompressionBombError) as error:
        raise ValueError(f"{image.format[:60]!r} cannot be read: {error}") from error
