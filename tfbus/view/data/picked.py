"""A drawn point of a cloud or scan that was chosen: its places, and its row of the message."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from tfbus import messages
from tfbus.geometry.transform import Transform
from tfbus.view.data.shapes import Points, unpacked

Place = tuple[float, float, float]

# And of a column with several numbers a row.
_MOST_COLUMNS = 50
_MOST_NUMBERS = 8


@dataclass(frozen=True)
class PickedPoint:
    """The point `index` of a message of a topic: its places in m by the names of frames, the fixed
    frame last, and the other columns of its row as texts, by their names.
    """

    topic: str
    index: int
    places: Mapping[str, Place]
    columns: Mapping[str, str]


def picked(
    topic: str, points: Points, row: int, message: Any, fixed_frame: str, pose: Transform
) -> PickedPoint:
    """The point of a row of drawn points, which are at `pose` in the fixed frame.

    `message` is the one that they are of, with the frame's name as it is shown; None if it is not
    kept any more: then only the place in the fixed frame is known.
    """
    index = int(points.rows[row])
    at_fixed = {fixed_frame: _place(pose.apply(points.xyz[row].astype(np.float64)))}
    if message is None:
        return PickedPoint(topic, index, at_fixed, {})
    own = {message.frame_id: _place(message.xyz()[index])}
    return PickedPoint(topic, index, own | at_fixed, columns_at(message, index))


def columns_at(message: Any, index: int) -> dict[str, str]:
    """The columns of a point of a cloud or scan but x, y and z, as texts."""
    if isinstance(message, messages.LaserScan):
        has_intensities = index < len(message.intensities)
        return {
            "range": _number(message.ranges[index]),
            "angle": f"{np.degrees(message.angles()[index]):.6g}°",
        } | ({"intensity": _number(message.intensities[index])} if has_intensities else {})
    names = dict.fromkeys(each.name for each in message.fields if each.name)
    others = [name for name in names if name not in ("x", "y", "z")][:_MOST_COLUMNS]
    return {name: _text(name, message[name][index : index + 1]) for name in others}


def _text(name: str, one: Any) -> str:
    """The only row of a column, as a text."""
    if one.ndim == 1 and name in ("rgb", "rgba") and one.dtype.itemsize == 4:
        return f"#{unpacked(one)[0].tobytes().hex()}"
    numbers = [_number(each) for each in one.reshape(-1)[:_MOST_NUMBERS]]
    return ", ".join(numbers) + (", …" if one.size > _MOST_NUMBERS else "")


def _number(number: Any) -> str:
    return f"{number:.6g}" if isinstance(number, np.floating) else f"{number}"


def _place(xyz: Any) -> Place:
    x, y, z = map(float, xyz)
    return x, y, z
