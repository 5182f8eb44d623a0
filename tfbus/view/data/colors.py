"""Colours of numbers: of the columns of clouds, and of the cells of maps."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Rgb = NDArray[np.uint8]

# From low to high: dark blue, cyan, green, yellow, red. They differ in brightness too.
_STOPS = np.array(
    [(48, 18, 120), (40, 110, 235), (30, 200, 190), (120, 220, 70), (240, 200, 40), (220, 50, 20)],
    np.float64,
)
_TABLE = np.stack(
    [np.interp(np.linspace(0, 5, 256), np.arange(6), channel) for channel in _STOPS.T], axis=1
).astype(np.uint8)

FLAT = np.array((230, 120, 20), np.uint8)


def colored(numbers: NDArray[Any]) -> Rgb:
    """Colours (N, 3) of numbers (N,), from the lowest to the highest but for a hundredth of them.

    Numbers that are not finite are grey.
    """
    values = numbers.astype(np.float64)
    finite = np.isfinite(values)
    colors = np.full((len(values), 3), 128, np.uint8)
    if not finite.any():
        return colors
    low, high = np.percentile(values[finite], (1.0, 99.0))
    with np.errstate(over="ignore", invalid="ignore"):
        parts = (values[finite] - low) / max(high - low, 1e-9)
    steps = np.nan_to_num(np.clip(parts, 0.0, 1.0) * 255.0).astype(np.uint8)
    colors[finite] = _TABLE[steps]
    return colors


def unpacked(column: NDArray[Any]) -> Rgb:
    """Colours (N, 3) of a column `rgb` or `rgba` of PCL's: 0xAARRGGBB, also as a float32."""
    packed = np.ascontiguousarray(column)
    if packed.dtype.kind == "f":
        packed = packed.astype(np.float32).view(np.uint32)
    bits = packed.astype(np.uint32)
    return np.stack([(bits >> shift) & 0xFF for shift in (16, 8, 0)], axis=1).astype(np.uint8)


def of_cells(cells: NDArray[np.int8]) -> NDArray[np.uint8]:
    """Colours with opacity (H, W, 4) of a map: free is white, occupied black, unknown faint."""
    known = (cells >= 0) & (cells <= 100)
    level = (255 - np.clip(cells, 0, 100).astype(np.float64) * 2.55).astype(np.uint8)
    rgba = np.empty((*cells.shape, 4), np.uint8)
    rgba[..., :3] = np.where(known, level, 120)[..., None]
    rgba[..., 3] = np.where(known, 230, 90)
    return rgba
