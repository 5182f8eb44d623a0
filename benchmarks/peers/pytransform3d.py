"""pytransform3d: a graph in Python and scipy, whose series are given whole."""

import sys
from collections.abc import Callable, Sequence
from importlib import metadata
from typing import Any

import numpy as np
from pytransform3d.transform_manager import NumpyTimeseriesTransform, TemporalTransformManager

from benchmarks.data import BATCH, SAMPLES, START_NS, anywhere, calls, frame, pose, recent, stamp_ns
from benchmarks.worker import Loop


def version() -> str:
    """What runs here."""
    return f"pytransform3d {metadata.version('pytransform3d')}, Python {sys.version.split()[0]}"


def lookup(edges: int) -> Loop:
    """From end to end of a chain, at recent stamps."""
    manager = _chain(edges)
    target, source = frame(0), frame(edges)

    def run(times: Sequence[float]) -> None:
        for time in times:
            manager.get_transform_at_time(source, target, time)

    return Loop(lambda count: [_seconds(stamp) for stamp in recent(count)], run)


def batch_sorted(edges: int) -> Loop:
    """Many stamps in one call, in their order."""
    return _batch(edges, sorted)


def batch_random(edges: int) -> Loop:
    """Many stamps in one call, in no order."""
    return _batch(edges, list)


def _batch(edges: int, order: Callable[[list[int]], list[int]]) -> Loop:
    manager = _chain(edges)
    target, source = frame(0), frame(edges)

    def times(count: int) -> Any:
        return _seconds(np.array(order(anywhere(count))))

    def run(batches: Sequence[Any]) -> None:
        for batch in batches:
            manager.get_transform_at_time(source, target, batch)

    return Loop(lambda count: calls(times, count), run, BATCH)


def _chain(edges: int) -> TemporalTransformManager:
    manager = TemporalTransformManager()
    times = np.array([_seconds(stamp_ns(sample)) for sample in range(SAMPLES)])
    for child in range(1, edges + 1):
        poses = np.array([pose(child, sample) for sample in range(SAMPLES)])
        # It wants x y z qw qx qy qz.
        series = NumpyTimeseriesTransform(times, poses[:, [0, 1, 2, 6, 3, 4, 5]])
        manager.add_transform(frame(child), frame(child - 1), series)
    return manager


def _seconds(stamp: Any) -> Any:
    """It counts in seconds as floats, so from the start, lest they be rounded."""
    return (stamp - START_NS) / 1e9
