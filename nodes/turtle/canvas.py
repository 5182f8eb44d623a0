"""The layer that the turtles draw on: a picture of fixed size, however long they draw."""

from dataclasses import dataclass
from math import ceil, floor

import numpy as np
from numpy.typing import NDArray

from tfbus.messages import Color

PEN_COLOR = Color(179, 184, 255)


@dataclass(frozen=True, slots=True)
class Pen:
    """A colour and a width in pixels; down on the paper or lifted."""

    color: Color = PEN_COLOR
    width: int = 3
    down: bool = True


class Canvas:
    """A square of ink, `size` pixels a side, transparent at first; x goes right and y goes down.

    Strokes have round ends and smooth edges. `version` changes with every stroke and clearing.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self.version = 0
        self._ink: NDArray[np.uint8] = np.zeros((size, size, 4), np.uint8)

    def clear(self) -> None:
        """Take all ink off."""
        self._ink[:] = 0
        self.version += 1

    def stroke(self, start: tuple[float, float], end: tuple[float, float], pen: Pen) -> None:
        """Draw a straight line between two points in pixels, clipped to the canvas."""
        start, end = _near(start), _near(end)
        reach = pen.width / 2 + 0.5
        columns = self._span(start[0], end[0], reach)
        rows = self._span(start[1], end[1], reach)
        if columns.start >= columns.stop or rows.start >= rows.stop:
            return
        distance = _distance_to_line(columns, rows, start, end)
        _blend(self._ink[rows, columns], np.clip(reach - distance, 0.0, 1.0), pen.color)
        self.version += 1

    def color_at(self, x: float, y: float, background: Color) -> Color:
        """The colour of the pixel at a point: its ink if that covers at least half of it."""
        column, row = (min(max(round(value), 0), self.size - 1) for value in (x, y))
        r, g, b, alpha = (int(part) for part in self._ink[row, column])
        return Color(r, g, b) if alpha >= 128 else background

    def copy(self) -> NDArray[np.uint8]:
        """The ink as (size, size, 4) bytes, rows from the top, red green blue alpha; read-only."""
        ink = self._ink.copy()
        ink.flags.writeable = False
        return ink

    def _span(self, a: float, b: float, reach: float) -> slice:
        low, high = min(a, b) - reach, max(a, b) + reach
        return slice(max(floor(low), 0), min(ceil(high) + 1, self.size))


def _near(point: tuple[float, float]) -> tuple[float, float]:
    """The point, clamped so that its square is finite."""
    x, y = (min(max(value, -1e6), 1e6) for value in point)
    return x, y


def _distance_to_line(
    columns: slice, rows: slice, start: tuple[float, float], end: tuple[float, float]
) -> NDArray[np.float64]:
    """The distance of each pixel of a rectangle to the nearest point between start and end."""
    x = np.arange(columns.start, columns.stop) - start[0]
    y = np.arange(rows.start, rows.stop)[:, np.newaxis] - start[1]
    along_x, along_y = end[0] - start[0], end[1] - start[1]
    length_squared = along_x**2 + along_y**2
    if length_squared == 0.0:
        return np.hypot(x, y)
    part = np.clip((x * along_x + y * along_y) / length_squared, 0.0, 1.0)
    return np.hypot(x - part * along_x, y - part * along_y)


def _blend(ink: NDArray[np.uint8], coverage: NDArray[np.float64], color: Color) -> None:
    """Blend a colour over part of the canvas, by the coverage (0 to 1) of each pixel.

    The opacity is the larger of old and new, not their sum: else the overlapping round ends of a
    trail's many short strokes would thicken it.
    """
    bare = ink[..., 3] == 0
    weight = np.where(bare, 1.0, coverage)[..., np.newaxis]
    mixed = ink[..., :3] + (np.array([color.r, color.g, color.b]) - ink[..., :3]) * weight
    touched = coverage > 0.0
    ink[touched, :3] = np.rint(mixed[touched])
    ink[..., 3] = np.maximum(ink[..., 3], np.rint(coverage * 255))
