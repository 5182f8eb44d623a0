"""What is worth saying about one edge, short enough for a line."""

from typing import Literal

from tfbus.buffer.info import FrameInfo
from tfbus.frames.snapshot import FrameTree
from tfbus.wording import duration

State = Literal["root", "static", "dynamic", "stale", "gone", "conflict"]

# A frame is stale when it is this many of its own periods old, and at least this many seconds:
# one that comes at 0.5 Hz is fresh for six seconds.
_STALE_PERIODS = 3.0
_STALE_S = 1.0

# Whose stamps are further away than this goes by another clock.
_YEAR_S = 365.25 * 86_400

ASK_IF_SIMULATED = "is its time simulated? try --sim-time"


def state(tree: FrameTree, frame: FrameInfo, conflicts: set[str]) -> State:
    """What a frame is above all, `conflicts` being those that several publish."""
    if frame.parent is None:
        return "root"
    if frame.name in conflicts:
        return "conflict"
    if frame.gone:
        return "gone"
    if frame.static:
        return "static"
    return "stale" if is_stale(tree, frame) else "dynamic"


def is_stale(tree: FrameTree, frame: FrameInfo) -> bool:
    """Whether a frame that moves has not been heard of for longer than its rate allows."""
    age_s = tree.age_s(frame)
    period_s = 1.0 / frame.rate_hz if frame.rate_hz else 0.0
    return age_s is not None and age_s > max(_STALE_S, _STALE_PERIODS * period_s)


def is_another_time(age_s: float | None) -> bool:
    """Whether an age is more than a year, before us or behind: by clocks that are set it is not."""
    return age_s is not None and abs(age_s) > _YEAR_S


def facts(tree: FrameTree, frame: FrameInfo, conflicts: set[str]) -> list[str]:
    """What to say of an edge, what matters most first; nothing of a root."""
    if frame.parent is None:
        return []
    told = state(tree, frame, conflicts)
    words = {"gone": ["GONE"], "stale": ["STALE"], "conflict": ["CONFLICT"]}.get(told, [])
    if frame.static:
        words.append("static")
    else:
        words.append(duration(tree.age_s(frame)) + " old")
        words += [ASK_IF_SIMULATED] * (told == "stale" and is_another_time(tree.age_s(frame)))
        if frame.rate_hz is not None:
            words.append(f"{frame.rate_hz:.1f} Hz over {duration(tree.kept_s(frame))}")
    words.append(f"by {frame.authority}")
    return words
