"""transform-tree: a tree of fixed topology in Rust, filled by one publisher an edge."""

import sys
from collections.abc import Callable, Sequence
from importlib import metadata
from typing import Any

import numpy as np
import tf_tree

from benchmarks.data import (
    BATCH,
    INSERTS_AT_ONCE,
    SAMPLES,
    anywhere,
    calls,
    frame,
    pose,
    recent,
    rows,
    stamp_ns,
)
from benchmarks.worker import Loop


def version() -> str:
    """What runs here."""
    return f"transform-tree {metadata.version('transform-tree')}, Python {sys.version.split()[0]}"


def lookup(edges: int) -> Loop:
    """By names, from end to end of a chain, at recent stamps."""
    return _by_names(edges, recent)


def lookup_anywhere(edges: int) -> Loop:
    """The same at any stamp of the ten seconds."""
    return _by_names(edges, anywhere)


def lookup_by_plan(edges: int) -> Loop:
    """By a plan compiled before, in the layout (a matrix) that it is fastest in."""
    plan = _Chain(edges).tree.plan(frame(0), frame(edges))

    def run(times: Sequence[int]) -> None:
        for time in times:
            plan.at(time)

    return Loop(recent, run)


def latest(edges: int) -> Loop:
    """The latest by a plan; it has none by names."""
    plan = _Chain(edges).tree.plan(frame(0), frame(edges))

    def run(times: Sequence[int]) -> None:
        for _ in times:
            plan.latest()

    return Loop(range, run)


def batch_sorted(edges: int) -> Loop:
    """Many stamps in one call, in their order."""
    return _batch(edges, sorted)


def batch_random(edges: int) -> Loop:
    """Many stamps in one call, in no order."""
    return _batch(edges, list)


def insert(edges: int) -> Loop:
    """Through the publisher of each edge, from lists made before."""
    chain = _Chain(edges)
    samples = iter(range(SAMPLES, sys.maxsize))

    def items(count: int) -> list[Any]:
        times = (next(samples) for _ in range(count // edges))
        return [
            (chain.publishers[child - 1], stamp_ns(sample), _quat7(child, sample))
            for sample, child in rows(edges, times)
        ]

    def run(transforms: Sequence[Any]) -> None:
        for publisher, stamp, quat7 in transforms:
            publisher.push(stamp, quat7)

    return Loop(items, run, at_once=INSERTS_AT_ONCE)


insert_columns = insert  # it has columns of the samples of one edge only


def memory(samples: int) -> Any:
    """`samples` in total, over 100 edges, in a capacity for just as many."""
    return _Chain(100, samples // 100)


class _Chain:
    """A chain and its publishers; tf2's interpolation, as all the others have it."""

    def __init__(self, edges: int, samples: int = SAMPLES):
        names = [(frame(child - 1), frame(child)) for child in range(1, edges + 1)]
        self.tree = tf_tree.build(names, capacity=samples, interp="lerpslerp")
        self.publishers = [self.tree.publisher(child, parent) for parent, child in names]
        for sample, child in rows(edges, range(samples)):
            self.publishers[child - 1].push(stamp_ns(sample), _quat7(child, sample))


def _by_names(edges: int, stamps: Callable[[int], list[int]]) -> Loop:
    tree = _Chain(edges).tree
    target, source = frame(0), frame(edges)

    def run(times: Sequence[int]) -> None:
        for time in times:
            tree.lookup(target, source, time)

    return Loop(stamps, run)


def _batch(edges: int, order: Callable[[list[int]], list[int]]) -> Loop:
    plan = _Chain(edges).tree.plan(frame(0), frame(edges))

    def stamps(count: int) -> Any:
        return np.array(order(anywhere(count)))

    def run(batches: Sequence[Any]) -> None:
        for batch in batches:
            plan.at(batch)

    return Loop(lambda count: calls(stamps, count), run, BATCH)


def _quat7(child: int, sample: int) -> list[float]:
    x, y, z, qx, qy, qz, qw = pose(child, sample)
    return [qw, qx, qy, qz, x, y, z]
