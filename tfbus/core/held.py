"""All that a buffer holds, as values."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tfbus.core.sampling import Sampling
from tfbus.runtime.structs import Struct, field

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


Pose = tuple[float, float, float, float, float, float, float]


class Held(Struct, eq=False):
    """A frame, its static pose if it is static, and its samples, oldest first.

    `stamps_ns` (N,) int64 rise; `poses` (N, 7) are x y z qx qy qz qw. `parents` are those of the
    samples, None in it for one that was removed; it is None if all have the `parent` of the
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
