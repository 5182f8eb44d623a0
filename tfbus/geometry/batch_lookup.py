# cython: boundscheck=False, wraparound=False
"""Lookups of many stamps along one path, edge by edge, in about the order of their times.

Compiled if there is a C compiler (`batch_lookup.pxd` has the C types). Nothing here locks: the
buffer holds its lock around every call of `fill`.

A block of rows takes each edge in turn. The common part of all times between two samples is
computed once while the stamps stay between them, and the processor works at several rows at a time,
since none waits for another; each row's numbers equal a single lookup's, to the bit. So rows
are put into the order of their times first; a few out of order cost little, and the order may be
rough. How rough depends on how evenly the times are spread.
"""

from __future__ import annotations

import math
from collections.abc import MutableSequence, Sequence
from typing import Any

from tfbus.base import lazy_numpy as np
from tfbus.base.lazy_numpy import NDArray
from tfbus.geometry.kernel import Path, Pose, Samples, invert, sclerp

try:
    import cython
except ImportError:
    from tfbus.base import cython_stub as cython

if not cython.compiled:
    # Compiled, they are functions of C.
    from tfbus.geometry.kernel import locate, pose_at, sample

# Rows of a block: their numbers fit into the processor's nearest cache.
_ROWS = 64
# As in `lerp_slerp`: below this four terms of the series of slerp's weights are exact to 1e-14.
_SERIES_BELOW = 1e-3
# The numbers of a row without a pose; all results of them are NaN, too.
_NOTHING = float("nan")

# Ordering fewer rows gains too little; the numbers of more would not fit 32 bits.
_LEAST_ORDERED = 1024
_MOST_ORDERED = 2**31 - 1
# Rows of a bucket, on average; more buckets would not fit into the nearest cache.
_ROWS_OF_BUCKET = 8
_MOST_BUCKETS = 4096


class Block:
    """Some rows while their poses are composed; compiled, a struct of C.

    `stamps_ns` are their times, and `row` their rows in the answer. x y z qx qy qz qw is the pose
    so far, and with `step_` before it the pose of the next edge, at `ratio` of the way between two
    samples. `known` is 0 if there is none.
    """

    def __init__(self) -> None:
        self.stamps_ns = [0] * _ROWS
        self.row = [0] * _ROWS
        self.x, self.y, self.z, self.qx, self.qy, self.qz, self.qw = _columns()
        self.step_x, self.step_y, self.step_z, *quat = _columns()
        self.step_qx, self.step_qy, self.step_qz, self.step_qw = quat
        self.ratio = [0.0] * _ROWS
        self.known = [0] * _ROWS


def _columns() -> list[list[float]]:
    return [[0.0] * _ROWS for _ in range(7)]


def fill(
    path: Path,
    stamps: Sequence[int],
    rows: Sequence[int],
    start: int,
    stop: int,
    xyz: MutableSequence[float],
    quat: MutableSequence[float],
    known: MutableSequence[int],
    screw: bool,
) -> None:
    """Write the poses at the stamps of rows [start, stop) into `xyz` (three numbers a row) and
    `quat` (four), as of `path.follow`, and NaN if it has none; there `known` is 0. With
    `rows` from `by_time`, row `rows[i]` is the i-th of [start, stop).
    """
    if cython.compiled:  # noqa: SIM108  # in C the two are of different types
        block = cython.address(space)  # type: ignore[name-defined]  # noqa: F821  # a struct of C
    else:
        block = Block()
    while start < stop:
        count = min(_ROWS, stop - start)
        _begin(block, stamps, rows, start, count)
        for i in range(path.count):
            if i == path.turn:
                _invert(block, count)
            if screw:
                _step_screw(block, path.steps[i], count)
            else:
                _step(block, path.steps[i], count)
            if i == 0:
                _take(block, count)
            else:
                _compose(block, count)
        if path.turn == path.count:
            _invert(block, count)
        _write(block, count, xyz, quat, known)
        start += count


def _begin(
    block: Block, stamps: Sequence[int], rows: Sequence[int], start: int, count: int
) -> None:
    """All rows at the source."""
    is_ordered = len(rows) > 0
    for j in range(count):
        block.row[j] = rows[start + j] if is_ordered else start + j
        block.stamps_ns[j] = stamps[block.row[j]]
    for j in range(count):
        block.known[j] = 1
        block.x[j] = block.y[j] = block.z[j] = 0.0
        block.qx[j] = block.qy[j] = block.qz[j] = 0.0
        block.qw[j] = 1.0


def _step(block: Block, samples: Samples, count: int) -> None:
    """The pose of an edge for each row, as `lerp_slerp` has it."""
    start = 0
    while start < count:
        ratio = locate(samples, block.stamps_ns[start])
        before, after = samples.before, samples.after
        is_between = ratio >= 0.0 and not samples.is_static and after > before
        stop = start + 1
        while is_between and stop < count and before <= block.stamps_ns[stop] < after:
            stop += 1
        if stop > start + 1:
            _interpolate(block, samples, start, stop)
        elif ratio < 0.0:
            _set_step(block, start, _missing(block, start))
        else:
            _set_step(block, start, pose_at(samples, ratio))
        start = stop


def _interpolate(block: Block, samples: Samples, start: int, stop: int) -> None:
    """The poses of rows [start, stop), all between the two samples at the cursor, in loops of which
    the processor does several rows at a time.
    """
    ax, ay, az, apx, apy, apz, apw = sample(samples, samples.here)
    bx, by, bz, bpx, bpy, bpz, bpw = sample(samples, samples.following)
    before = samples.before
    period = samples.after - before
    cosine = apx * bpx + apy * bpy + apz * bpz + apw * bpw
    if cosine < 0.0:
        cosine, bpx, bpy, bpz, bpw = -cosine, -bpx, -bpy, -bpz, -bpw
    short = 1.0 - cosine
    if short >= _SERIES_BELOW:
        angle = math.acos(cosine)
        scale = 1.0 / math.sin(angle)
    for j in range(start, stop):
        elapsed = block.stamps_ns[j] - before
        block.ratio[j] = elapsed
    for j in range(start, stop):
        ratio = block.ratio[j] / period
        rest = 1.0 - ratio
        block.ratio[j] = ratio
        block.step_x[j] = rest * ax + ratio * bx
        block.step_y[j] = rest * ay + ratio * by
        block.step_z[j] = rest * az + ratio * bz
    if short < _SERIES_BELOW:
        for j in range(start, stop):
            ratio = block.ratio[j]
            rest = 1.0 - ratio
            u = rest * _weight(short, rest * rest)
            v = ratio * _weight(short, ratio * ratio)
            block.step_qx[j] = u * apx + v * bpx
            block.step_qy[j] = u * apy + v * bpy
            block.step_qz[j] = u * apz + v * bpz
            block.step_qw[j] = u * apw + v * bpw
        return
    for j in range(start, stop):
        ratio = block.ratio[j]
        u, v = 1.0, 0.0  # the sample itself, as `pose_at` has it
        if ratio != 0.0:
            u = math.sin((1.0 - ratio) * angle) * scale
            v = math.sin(ratio * angle) * scale
        block.step_qx[j] = u * apx + v * bpx
        block.step_qy[j] = u * apy + v * bpy
        block.step_qz[j] = u * apz + v * bpz
        block.step_qw[j] = u * apw + v * bpw


def _weight(short: float, square: float) -> float:
    """As in `lerp_slerp`, whose series it is."""
    third = 1.0 + short * (9.0 - square) * (1.0 / 21.0)
    second = 1.0 + short * (4.0 - square) * (1.0 / 10.0) * third
    return 1.0 + short * (1.0 - square) * (1.0 / 3.0) * second


def _step_screw(block: Block, samples: Samples, count: int) -> None:
    """The pose of an edge for each row, as `screw_at` has it."""
    for j in range(count):
        ratio = locate(samples, block.stamps_ns[j])
        if ratio < 0.0:
            _set_step(block, j, _missing(block, j))
        elif ratio == 0.0:
            _set_step(block, j, pose_at(samples, 0.0))
        else:
            a, b = sample(samples, samples.here), sample(samples, samples.following)
            _set_step(block, j, sclerp(a, b, ratio))


def _missing(block: Block, j: int) -> Pose:
    """The pose of a row without one, which is noted."""
    block.known[j] = 0
    return _NOTHING, _NOTHING, _NOTHING, _NOTHING, _NOTHING, _NOTHING, _NOTHING


def _set_step(block: Block, j: int, pose: Pose) -> None:
    x, y, z, qx, qy, qz, qw = pose
    block.step_x[j], block.step_y[j], block.step_z[j] = x, y, z
    block.step_qx[j], block.step_qy[j], block.step_qz[j], block.step_qw[j] = qx, qy, qz, qw


def _take(block: Block, count: int) -> None:
    """Start with the first step."""
    for j in range(count):
        block.x[j] = block.step_x[j]
        block.y[j] = block.step_y[j]
        block.z[j] = block.step_z[j]
        block.qx[j] = block.step_qx[j]
        block.qy[j] = block.step_qy[j]
        block.qz[j] = block.step_qz[j]
        block.qw[j] = block.step_qw[j]


def _compose(block: Block, count: int) -> None:
    """First the step, then the pose so far, as `compose` has it."""
    for j in range(count):
        apx, apy, apz, apw = block.qx[j], block.qy[j], block.qz[j], block.qw[j]
        bx, by, bz = block.step_x[j], block.step_y[j], block.step_z[j]
        bpx, bpy, bpz = block.step_qx[j], block.step_qy[j], block.step_qz[j]
        bpw = block.step_qw[j]
        tx = 2.0 * (apy * bz - apz * by)
        ty = 2.0 * (apz * bx - apx * bz)
        tz = 2.0 * (apx * by - apy * bx)
        block.x[j] = block.x[j] + bx + apw * tx + apy * tz - apz * ty
        block.y[j] = block.y[j] + by + apw * ty + apz * tx - apx * tz
        block.z[j] = block.z[j] + bz + apw * tz + apx * ty - apy * tx
        block.qx[j] = apw * bpx + apx * bpw + apy * bpz - apz * bpy
        block.qy[j] = apw * bpy - apx * bpz + apy * bpw + apz * bpx
        block.qz[j] = apw * bpz + apx * bpy - apy * bpx + apz * bpw
        block.qw[j] = apw * bpw - apx * bpx - apy * bpy - apz * bpz


def _invert(block: Block, count: int) -> None:
    """Invert the poses so far."""
    for j in range(count):
        pose: Pose = (
            block.x[j],
            block.y[j],
            block.z[j],
            block.qx[j],
            block.qy[j],
            block.qz[j],
            block.qw[j],
        )
        x, y, z, qx, qy, qz, qw = invert(pose)
        block.x[j], block.y[j], block.z[j] = x, y, z
        block.qx[j], block.qy[j], block.qz[j], block.qw[j] = qx, qy, qz, qw


def _write(
    block: Block,
    count: int,
    xyz: MutableSequence[float],
    quat: MutableSequence[float],
    known: MutableSequence[int],
) -> None:
    """Write the poses, their norms corrected for rounding as `normalised` does."""
    for j in range(count):
        i = block.row[j]
        known[i] = block.known[j]
        qx, qy, qz, qw = block.qx[j], block.qy[j], block.qz[j], block.qw[j]
        scale = 1.5 - 0.5 * (qx * qx + qy * qy + qz * qz + qw * qw)
        xyz[3 * i] = block.x[j]
        xyz[3 * i + 1] = block.y[j]
        xyz[3 * i + 2] = block.z[j]
        quat[4 * i] = qx * scale
        quat[4 * i + 1] = qy * scale
        quat[4 * i + 2] = qz * scale
        quat[4 * i + 3] = qw * scale


def by_time(stamps: NDArray[np.int64]) -> NDArray[np.int32]:
    """The rows of the stamps (N,) in about the order of these; empty if they are in order, or
    too few to gain by it.
    """
    count = len(stamps)
    if not _LEAST_ORDERED <= count <= _MOST_ORDERED or _are_sorted(stamps.data):
        return np.empty(0, dtype=np.int32)
    if not cython.compiled:
        return np.argsort(stamps, kind="stable").astype(np.int32)
    rows = np.empty(count, dtype=np.int32)
    buckets = np.empty(count, dtype=np.uint16)
    starts = np.zeros(min(count // _ROWS_OF_BUCKET, _MOST_BUCKETS) + 1, dtype=np.int32)
    _distribute(stamps.data, stamps.min(), stamps.max(), starts.data, buckets.data, rows.data)
    return rows


def _are_sorted(stamps: Any) -> bool:
    for i in range(1, len(stamps)):  # noqa: SIM110  # as C has it
        if stamps[i] < stamps[i - 1]:
            return False
    return True


def _distribute(
    stamps: Any, least: float, most: float, starts: Any, buckets: Any, rows: Any
) -> None:
    """Write the rows of stamps from `least` to `most`, by a counting sort into buckets of equal
    length. `starts` are zeros, one more than buckets; `buckets` is room for each stamp's bucket.
    """
    with cython.nogil:
        last = len(starts) - 2
        pace = last / (most - least)
        for i in range(len(stamps)):
            way = (stamps[i] - least) * pace
            # Rounding may exceed the last bucket; it is NaN if the two are one double; and a
            # thread may write into the stamps meanwhile.
            if way > last:
                way = last
            elif not way >= 0.0:
                way = 0.0
            bucket = cython.cast(cython.Py_ssize_t, way)
            buckets[i] = bucket
            starts[bucket + 1] += 1
        for bucket in range(1, len(starts)):
            starts[bucket] += starts[bucket - 1]
        for i in range(len(stamps)):
            bucket = buckets[i]
            at = starts[bucket]
            starts[bucket] = at + 1
            rows[at] = i
