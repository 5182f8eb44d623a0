"""Velocities: the twist of one frame against another, estimated from poses over a window."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, TypeAlias

from tfbus.base import lazy_numpy as np
from tfbus.base.lazy_numpy import NDArray
from tfbus.geometry.transform import take
from tfbus.geometry.transform_array import TransformArray

Floats: TypeAlias = "NDArray[np.float64]"


# More poses than this make the estimate slower, not better.
_MOST_POSES = 256


@dataclass(frozen=True, eq=False)
class TwistStamped:
    """The velocity of a frame against another at one time.

    `linear` (3,) in m/s is the velocity of the origin of `child_frame_id` as seen from
    `reference_frame`; `angular` (3,) in rad/s is how the child turns against it. Both are written
    in the axes of `frame_id`. They hold at `stamp_ns`, estimated from the window from `start_ns`
    to `end_ns`.
    """

    stamp_ns: int
    frame_id: str
    child_frame_id: str
    reference_frame: str
    linear: Floats
    angular: Floats
    start_ns: int
    end_ns: int

    def __post_init__(self) -> None:
        for name in ("linear", "angular"):
            array = np.array(getattr(self, name), dtype=np.float64)
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    def to_dict(self) -> dict[str, Any]:
        """The fields by name, `linear` and `angular` as lists, for JSON, YAML or msgpack;
        `from_dict` reads it back.
        """
        return {**vars(self), "linear": self.linear.tolist(), "angular": self.angular.tolist()}

    @staticmethod
    def from_dict(values: Mapping[str, Any]) -> "TwistStamped":
        """From a map as `to_dict` returns it; other keys are not read.

        Raises InvalidArgumentException if a key is missing.
        """
        return TwistStamped(*take(values, *(field.name for field in fields(TwistStamped))))


def pick_stamps(stamps_ns: Sequence[int], start_ns: int, end_ns: int) -> list[int]:
    """The stamps to estimate from: the samples' in the window, or its ends without two."""
    stamps = sorted({stamp for stamp in stamps_ns if start_ns <= stamp <= end_ns})
    if len(stamps) < 2:
        return [start_ns, end_ns]
    stride = -(-len(stamps) // _MOST_POSES)
    return stamps[::stride]


def fit_twist(stamps_ns: Sequence[int], poses: TransformArray) -> tuple[Floats, Floats]:
    """Linear (3,) and angular (3,) velocity in the axes of the moving frame itself.

    The least-squares slope of the poses' logarithms, seen from the middle one, over time. It is
    exact for a motion at constant twist: lines, circles and screws. Over the window the frame
    turns by less than half a turn on each side.
    """
    middle = poses[len(poses) // 2]
    logs = (~middle @ poses).log()
    seconds = (np.array(stamps_ns) - stamps_ns[0]) / 1e9
    seconds -= seconds.mean()
    slope = seconds @ logs / (seconds @ seconds)
    return slope[:3], slope[3:]
