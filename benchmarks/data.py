"""What all peers are given: chains of frames, their samples, and the times to ask for.

All of it is computed, in Python here and in C++ in peers/tf2_cpp.cpp, to the same numbers. This
file and worker.py need nothing but Python 3.11, as they also run under Debian's own.
"""

from collections.abc import Callable, Iterable
from math import cos, sin
from typing import Any

START_NS = 1_700_000_000_000_000_000
PERIOD_NS = 10_000_000  # 100 Hz
SAMPLES = 1_000  # of each edge: ten seconds, all that tf2 keeps by default
RECENT = 10  # periods, in which a robot mostly asks
COLUMNS = 50  # edges of one message
BATCH = 50_000  # stamps in one call
# Transforms to insert are made this many at a time. If their number grew with a peer's speed, those
# of a faster one would leave the processor's cache, where one that has just arrived still is.
INSERTS_AT_ONCE = 5_000

Pose = tuple[float, float, float, float, float, float, float]


def frame(index: int) -> str:
    """The name of a frame; of a chain, 0 is the root, and each is the parent of the next."""
    return f"frame_{index}"


def stamp_ns(sample: int) -> int:
    """When a sample is taken."""
    return START_NS + sample * PERIOD_NS


def pose(child: int, sample: int) -> Pose:
    """Where a child is in its parent: x y z qx qy qz qw, a swing about one of the axes."""
    phase = 0.05 * sample + child
    half = 0.25 * sin(phase)
    qx, qy, qz = (sin(half) if child % 3 == axis else 0.0 for axis in range(3))
    return cos(phase), sin(phase), 0.1, qx, qy, qz, cos(half)


def scattered(start: int, span: int, count: int) -> list[int]:
    """Whole numbers in a span, one like another, in no order to speak of."""
    return [start + i * 7_919_000_017 % span for i in range(count)]


def recent(count: int) -> list[int]:
    """Stamps between samples, in the last tenth of a second of a chain."""
    return scattered(stamp_ns(SAMPLES - 1 - RECENT), RECENT * PERIOD_NS, count)


def anywhere(count: int, samples: int = SAMPLES) -> list[int]:
    """Stamps between samples, in all the time of a chain."""
    return scattered(START_NS, (samples - 1) * PERIOD_NS, count)


def tree(frames: int) -> list[tuple[int, int]]:
    """The edges (parent, child) of a tree in which every frame has ten children."""
    return [((child - 1) // 10, child) for child in range(1, frames)]


def pairs(frames: int, count: int) -> list[tuple[str, str]]:
    """Any two frames, a target and a source."""
    names = [frame(index) for index in scattered(0, frames, 2 * count)]
    return list(zip(names[::2], names[1::2], strict=True))


def rows(edges: int, samples: Iterable[int]) -> Iterable[tuple[int, int]]:
    """(sample, child) of a chain in the order of time."""
    return ((sample, child) for sample in samples for child in range(1, edges + 1))


def calls(stamps: Callable[[int], Any], count: int) -> list[Any]:
    """`count` stamps as a peer gets them: in calls of BATCH each, all of the same stamps."""
    return [stamps(min(count, BATCH))] * max(1, count // BATCH)
