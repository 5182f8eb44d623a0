"""The contents of a buffer as values, and how a lookup reads a time at which there is no sample."""

from __future__ import annotations

from typing import Literal, SupportsFloat

from tfbus.base import lazy_numpy as np
from tfbus.base.errors import InvalidArgumentException
from tfbus.base.lazy_numpy import NDArray
from tfbus.base.structs import Struct, field

_INTERPOLATIONS = ("linear", "screw", "nearest")


class Sampling(Struct):
    """How the samples of an edge answer for the times between and beyond them.

    The default is tf2's way. `interpolation` is

    - "linear": translation on a straight line, rotation by slerp, each by itself;
    - "screw": along the screw between two samples, which does not depend on a frame's origin;
    - "nearest": the nearest sample unchanged, if it is within `tolerance_s` of the time.

    Across a gap between two samples of more than `max_gap_s` there is no answer. None is any
    distance.

    `extrapolation_s` lets an edge continue beyond its last two samples for at most that many
    seconds, at the twist between them, or back before its first two; the answer has
    `extrapolated_ns`.
    """

    interpolation: Literal["linear", "screw", "nearest"] = "linear"
    tolerance_s: float = 0.0
    extrapolation_s: float = 0.0
    max_gap_s: float | None = None

    def __post_init__(self) -> None:
        if self.interpolation not in _INTERPOLATIONS:
            raise InvalidArgumentException(
                f"interpolation must be one of {', '.join(map(repr, _INTERPOLATIONS))}, "
                f"not {self.interpolation!r}"
            )
        for name in ("tolerance_s", "extrapolation_s", "max_gap_s"):
            value = getattr(self, name)
            if name == "max_gap_s" and value is None:
                continue
            if not isinstance(value, SupportsFloat) or not 0.0 <= float(value) <= 1e6:
                raise InvalidArgumentException(
                    f"{name} must be a number of seconds from 0 to 1e6, not {value!r}"
                )
            object.__setattr__(self, name, float(value))
        if self.tolerance_s and self.interpolation != "nearest":
            raise InvalidArgumentException('tolerance_s is only for interpolation="nearest"')
        if self.extrapolation_s and self.interpolation == "nearest":
            raise InvalidArgumentException(
                "the nearest sample is not extrapolated: omit extrapolation_s"
            )
        if self.max_gap_s is not None and self.interpolation == "nearest":
            raise InvalidArgumentException(
                "the nearest sample is not interpolated: tolerance_s is its limit, omit max_gap_s"
            )


TF2 = Sampling()

Pose = tuple[float, float, float, float, float, float, float]


class Held(Struct, eq=False):
    """A frame, its static pose if it is static, and its samples, oldest first.

    `stamps_ns` (N,) int64 rise; `poses` (N, 7) are x y z qx qy qz qw. `parents` has each sample's
    parent, None in it for one that was removed; it is None if all have the `parent` of the
    frame. They may differ up to `mixed_until_ns`. A static frame may hold samples from before it
    became static. `interruptions` say, by the stamp of a sample, why nothing is known from it to
    the next.
    """

    parent: str | None
    authority: str
    gone: bool
    conflicts: int
    refused: int
    is_static: bool
    static_stamp_ns: int
    static_pose: Pose
    stamps_ns: NDArray[np.int64]
    poses: NDArray[np.float64]
    parents: list[str | None] | None
    mixed_until_ns: int
    ended: bool
    crowded_out: int
    interruptions: dict[int, str] = field(default_factory=dict)


class Contents(Struct, eq=False):
    """The parts of a buffer; `max_samples` is None in a file that does not say it."""

    cache_time_s: float
    max_samples: int | None
    sampling: Sampling
    frames: dict[str, Held]
