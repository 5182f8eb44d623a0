"""schiebung: a buffer in Rust, with a wheel for Python 3.12 and newer."""

import sys
from collections.abc import Callable, Sequence
from functools import cache
from importlib import metadata
from typing import Any

from schiebung import BufferTree, StampedIsometry, TransformType

from benchmarks.data import (
    COLUMNS,
    INSERTS_AT_ONCE,
    SAMPLES,
    anywhere,
    frame,
    pose,
    recent,
    rows,
    stamp_ns,
)
from benchmarks.worker import Loop


def version() -> str:
    """What runs here."""
    return f"schiebung {metadata.version('schiebung')}, Python {sys.version.split()[0]}"


def lookup(edges: int) -> Loop:
    """From end to end of a chain, at recent stamps."""
    return _lookups(edges, recent)


def lookup_anywhere(edges: int) -> Loop:
    """The same at any stamp of the ten seconds."""
    return _lookups(edges, anywhere)


def latest(edges: int) -> Loop:
    """The newest sample of each edge, which is less than the latest common time."""
    tree = _chain(edges)
    target, source = frame(0), frame(edges)

    def run(times: Sequence[int]) -> None:
        for _ in times:
            tree.lookup_latest_transform(target, source)

    return Loop(range, run)


def insert(edges: int) -> Loop:
    """Transforms one after the other, made before."""
    tree = _chain(edges)

    def run(transforms: Sequence[Any]) -> None:
        for transform in transforms:
            tree.update(*transform)

    return Loop(_further(edges), run, at_once=INSERTS_AT_ONCE)


def insert_columns(edges: int) -> Loop:
    """A list of all edges at once, made before."""
    tree = _chain(edges)
    further = _further(edges)

    def items(count: int) -> list[list[Any]]:
        transforms = further(count)
        return [transforms[at : at + COLUMNS] for at in range(0, count, COLUMNS)]

    def run(batches: Sequence[list[Any]]) -> None:
        for batch in batches:
            tree.update_batch(batch)

    return Loop(items, run, at_once=INSERTS_AT_ONCE)


def memory(samples: int) -> Any:
    """`samples` in total, over 100 edges; its window of 120 s holds 12,000 of each."""
    return _chain(100, samples // 100)


def _lookups(edges: int, stamps: Callable[[int], list[int]]) -> Loop:
    tree = _chain(edges)
    target, source = frame(0), frame(edges)

    def run(times: Sequence[int]) -> None:
        for time in times:
            tree.lookup_transform(target, source, time)

    return Loop(stamps, run)


def _further(edges: int) -> Callable[[int], list[Any]]:
    samples = iter(range(SAMPLES, sys.maxsize))

    def items(count: int) -> list[Any]:
        times = (next(samples) for _ in range(count // edges))
        return [_update(*row) for row in rows(edges, times)]

    return items


def _chain(edges: int, samples: int = SAMPLES) -> BufferTree:
    tree = BufferTree()
    for row in rows(edges, range(samples)):
        tree.update(*_update(*row))
    return tree


def _update(sample: int, child: int) -> tuple[str, str, StampedIsometry, TransformType]:
    numbers = pose(child, sample)
    isometry = StampedIsometry(list(numbers[:3]), list(numbers[3:]), stamp_ns(sample))
    return _name(child - 1), _name(child), isometry, TransformType.Dynamic


@cache
def _name(index: int) -> str:
    """A name, which is the same text each time."""
    return frame(index)
