"""How a frame is doing: fresh, static, stale, gone, in conflict, or a root."""

from dataclasses import dataclass
from enum import Enum

from tfbus import FrameInfo

# A frame is stale after so many of its own periods without a sample, but not before some time
# that a busy machine may need.
STALE_AFTER_PERIODS = 3.0
STALE_AFTER_AT_LEAST_S = 1.0
# Of one sample no rate is known.
STALE_WITHOUT_RATE_S = 3.0

# What has become stale fades, over twice as long again, to this opacity.
FADED = 0.25


class Status(Enum):
    """What a frame's badge says."""

    FRESH = "fresh"
    STATIC = "static"
    STALE = "stale"
    GONE = "gone"
    CONFLICT = "conflict"
    ROOT = "root"


# One sign a status, told apart by their shapes alone.
SIGNS = {
    Status.FRESH: "●",
    Status.STATIC: "■",
    Status.STALE: "◐",
    Status.GONE: "✖",
    Status.CONFLICT: "▲",
    Status.ROOT: "○",
}


@dataclass(frozen=True)
class FrameState:
    """A frame as the view shows it.

    `silent_s` is how long no new sample of it has come, `opacity` how much is left of it where it
    fades, from FADED to 1. `publishers` are the streams that send it, in conflict several;
    `depth` is how many frames are above it. `unplaced` says why it cannot be drawn, "" where it
    can.
    """

    info: FrameInfo
    status: Status
    silent_s: float
    opacity: float
    publishers: tuple[str, ...]
    root: str
    depth: int
    unplaced: str = ""

    @property
    def name(self) -> str:
        """The frame's name."""
        return self.info.name


def stale_after_s(rate_hz: float | None) -> float:
    """How long a frame of this rate may be silent before it is stale."""
    if not rate_hz:
        return STALE_WITHOUT_RATE_S
    return max(STALE_AFTER_PERIODS / rate_hz, STALE_AFTER_AT_LEAST_S)


def judge(info: FrameInfo, silent_s: float, publishers: int) -> Status:
    """The status of a frame that has been silent so long, and that so many living streams send."""
    if info.parent is None:
        return Status.ROOT
    if info.gone:
        return Status.GONE
    if publishers > 1:
        return Status.CONFLICT
    if info.static:
        return Status.STATIC
    return Status.STALE if silent_s > stale_after_s(info.rate_hz) else Status.FRESH


def opacity_of(status: Status, silent_s: float, rate_hz: float | None) -> float:
    """How much is left of a frame: all, or less the longer it is stale."""
    if status is Status.GONE:
        return FADED
    if status is not Status.STALE:
        return 1.0
    limit_s = stale_after_s(rate_hz)
    faded = min((silent_s - limit_s) / (2.0 * limit_s), 1.0)
    return 1.0 - (1.0 - FADED) * faded
