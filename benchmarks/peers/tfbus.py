"""tfbus itself."""

import itertools
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from importlib import metadata
from time import perf_counter, sleep
from typing import Any

import numpy as np

from benchmarks.data import (
    BATCH,
    COLUMNS,
    INSERTS_AT_ONCE,
    PERIOD_NS,
    SAMPLES,
    START_NS,
    anywhere,
    calls,
    frame,
    pairs,
    pose,
    recent,
    rows,
    stamp_ns,
    tree,
)
from benchmarks.worker import Loop
from tfbus import Buffer, Transform, TransformBatch, TransformStamped

INSERTS_PER_S = 100_000


def version() -> str:
    """What runs here."""
    return f"tfbus {metadata.version('tfbus')}, {_kernel()}, Python {sys.version.split()[0]}"


def lookup(edges: int) -> Loop:
    """By names, from end to end of a chain, at recent stamps."""
    return _lookups(_chain(edges), edges, recent)


def lookup_anywhere(edges: int) -> Loop:
    """The same at any stamp of the ten seconds."""
    return _lookups(_chain(edges), edges, anywhere)


def latest(edges: int) -> Loop:
    """At the latest common time."""
    return _lookups(_chain(edges), edges, lambda count: [None] * count)


def batch_sorted(edges: int) -> Loop:
    """Many stamps in one call, in their order."""
    return _batch(edges, sorted)


def batch_random(edges: int) -> Loop:
    """Many stamps in one call, in no order."""
    return _batch(edges, list)


def insert(edges: int) -> Loop:
    """Transforms one after the other, made before."""
    buffer = _chain(edges)
    samples = iter(range(SAMPLES, sys.maxsize))

    def items(count: int) -> list[TransformStamped]:
        times = (next(samples) for _ in range(count // edges))
        return [_stamped(*row) for row in rows(edges, times)]

    def run(transforms: Sequence[TransformStamped]) -> None:
        for transform in transforms:
            buffer.set_transform(transform)

    return Loop(items, run, at_once=INSERTS_AT_ONCE)


def insert_columns(edges: int) -> Loop:
    """A batch of all edges at once, as it comes from the wire."""
    buffer = _chain(edges)
    samples = iter(range(SAMPLES, sys.maxsize))

    def items(count: int) -> list[TransformBatch]:
        return [_columns(edges, next(samples)) for _ in range(count // edges)]

    def run(batches: Sequence[TransformBatch]) -> None:
        for batch in batches:
            buffer.set_transforms(batch)

    return Loop(items, run, at_once=INSERTS_AT_ONCE)


def lookup_beside_inserts(edges: int) -> Loop:
    """As `lookup`, while another thread inserts 100,000 transforms a second into other edges."""
    buffer = _chain(edges)
    alone = _lookups(buffer, edges, recent)
    batches = _endless_columns()
    return Loop(
        alone.items, alone.run, fill_ns=300_000_000, beside=lambda: _inserting(buffer, batches)
    )


def memory(samples: int) -> Any:
    """`samples` in total, over 100 edges."""
    return _chain(100, samples // 100)


def deep(edges: int) -> Loop:
    """From end to end of a chain with a hundred samples an edge."""
    return _lookups(_chain(edges, 100), edges, lambda count: anywhere(count, 100))


def samples(count: int) -> Loop:
    """One edge with `count` samples, at any stamp of them."""
    return _lookups(_chain(1, count), 1, lambda lookups: anywhere(lookups, count))


def frames(count: int) -> Loop:
    """Any two of `count` frames."""
    buffer = Buffer()
    for sample in range(2):
        for parent, child in tree(count):
            transform = _transform(child, sample)
            buffer.set_transform(
                TransformStamped(stamp_ns(sample), frame(parent), frame(child), transform)
            )

    def run(asked: Sequence[tuple[str, str]]) -> None:
        for target, source in asked:
            buffer.lookup_transform(target, source, START_NS + PERIOD_NS // 2)

    return Loop(lambda lookups: pairs(count, lookups), run)


def _lookups(buffer: Buffer, edges: int, stamps: Callable[[int], Sequence[int | None]]) -> Loop:
    target, source = frame(0), frame(edges)

    def run(times: Sequence[int | None]) -> None:
        for time in times:
            buffer.lookup_transform(target, source, time)

    return Loop(stamps, run)


def _batch(edges: int, order: Callable[[list[int]], list[int]]) -> Loop:
    buffer = _chain(edges)
    target, source = frame(0), frame(edges)

    def stamps(count: int) -> Any:
        return np.array(order(anywhere(count)))

    def run(batches: Sequence[Any]) -> None:
        for batch in batches:
            buffer.lookup_transforms(target, source, batch)

    return Loop(lambda count: calls(stamps, count), run, BATCH)


@contextmanager
def _inserting(buffer: Buffer, batches: Iterator[TransformBatch]) -> Iterator[None]:
    """Another thread inserts as many batches as are due, whenever it gets to run."""
    prepared = [next(batches) for _ in range(INSERTS_PER_S // COLUMNS)]  # for a second
    stop = threading.Event()
    late: list[float] = []

    def insert() -> None:
        start, done = perf_counter(), 0
        while not stop.is_set():
            due = int((perf_counter() - start) * INSERTS_PER_S / COLUMNS)
            for batch in prepared[done:due]:
                buffer.set_transforms(batch)
            done = max(done, min(due, len(prepared)))
            sleep(0.001)
        late.append(perf_counter() - start - done * COLUMNS / INSERTS_PER_S)

    thread = threading.Thread(target=insert)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
    if late[0] > 0.05:
        raise RuntimeError(f"the other thread was {late[0]:.2f} s late: not {INSERTS_PER_S}/s")


def _endless_columns() -> Iterator[TransformBatch]:
    """Batches of edges beside the chain, each of a later stamp."""
    first = _columns(COLUMNS, 0)
    names = tuple(f"other_{name}" for name in first.frames)
    for sample in itertools.count():
        stamps = np.full(COLUMNS, stamp_ns(sample))
        yield TransformBatch(names, first.edges, stamps, first.poses)


def _chain(edges: int, samples: int = SAMPLES) -> Buffer:
    buffer = Buffer(cache_time_s=max(10.0, samples / 100))
    for row in rows(edges, range(samples)):
        buffer.set_transform(_stamped(*row))
    return buffer


def _stamped(sample: int, child: int) -> TransformStamped:
    return TransformStamped(
        stamp_ns(sample), frame(child - 1), frame(child), _transform(child, sample)
    )


def _transform(child: int, sample: int) -> Transform:
    numbers = pose(child, sample)
    return Transform(numbers[:3], numbers[3:])


def _columns(edges: int, sample: int) -> TransformBatch:
    return TransformBatch(
        _frames(edges),
        np.array([(child - 1, child) for child in range(1, edges + 1)], np.uint32),
        np.full(edges, stamp_ns(sample)),
        np.array([pose(child, sample) for child in range(1, edges + 1)]),
    )


@cache
def _frames(edges: int) -> tuple[str, ...]:
    """The names of a chain, which are the same texts in all batches, as they are of the wire."""
    return tuple(frame(index) for index in range(edges + 1))


def _kernel() -> str:
    files = (getattr(sys.modules[name], "__file__", "") for name in sys.modules if "tfbus" in name)
    return (
        "compiled" if any(str(file).endswith((".so", ".pyd")) for file in files) else "interpreted"
    )
