"""Lookups of many stamps in one call, along one path if it is the same for all of them.

Compiled if there is a C compiler (`lookup_many.pxd` has the C types).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from tfbus.buffer.lookup import Lookup
from tfbus.buffer.store import Store
from tfbus.geometry.batch_lookup import by_time, fill
from tfbus.geometry.kernel import Path
from tfbus.geometry.sampling import Sampling
from tfbus.geometry.transform import TransformStamped
from tfbus.geometry.transform_array import TransformArray, make_array

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
else:
    from tfbus.base import lazy_numpy as np

try:
    import cython
except ImportError:
    from tfbus.base import cython_stub as cython

# Stamps for which the lock is held at a time: some microseconds.
_CHUNK = 256


def lookup_many(
    store: Store,
    target_frame: str,
    source_frame: str,
    stamps: NDArray[np.int64],
    sampling: Sampling,
) -> tuple[TransformArray, NDArray[np.bool_]]:
    """The transforms at N stamps, and which of them (N,) are known; the others are NaN.

    Raises LookupException or ConnectivityException if none of them can be known.
    """
    if store.path(target_frame, source_frame) is None:
        _check_connected(store, target_frame, source_frame, stamps)
    xyz, quat_xyzw = np.empty((len(stamps), 3)), np.empty((len(stamps), 4))
    known = np.empty(len(stamps), dtype=np.bool_)
    if len(stamps):
        _fill_chunks(
            store,
            target_frame,
            source_frame,
            stamps.data,
            by_time(stamps).data,
            xyz.reshape(-1).data,
            quat_xyzw.reshape(-1).data,
            known.view(np.uint8).data,
            sampling,
        )
    return make_array(xyz, quat_xyzw), known


def _fill_chunks(
    store: Store,
    target_frame: str,
    source_frame: str,
    stamps: Any,
    rows: Any,
    xyz: Any,
    quat: Any,
    known: Any,
    sampling: Sampling,
) -> None:
    count = len(stamps)
    strict = (
        sampling.interpolation != "nearest"
        and not sampling.extrapolation_s
        and sampling.max_gap_s is None
    )
    screw = sampling.interpolation == "screw"
    start = 0
    while start < count:
        path = store.path(target_frame, source_frame)
        before = start
        if strict and path is not None:
            # Python's other threads run meanwhile.
            with store.lock, cython.nogil:
                start = _fill_along(store, path, stamps, rows, start, xyz, quat, known, screw)
        if start == before:
            stop = min(start + _CHUNK, count)
            with store.lock:
                for j in range(start, stop):
                    i = rows[j] if len(rows) else j
                    answer = store.tree.answer(target_frame, source_frame, stamps[i], sampling)
                    _write_row(answer, i, xyz, quat, known)
            start = stop


def _fill_along(
    store: Store,
    path: Path,
    stamps: Any,
    rows: Any,
    start: int,
    xyz: Any,
    quat: Any,
    known: Any,
    screw: bool,
) -> int:
    """With the lock held: fill the rows from `start` on while the path is one for all times; the
    row it got to.
    """
    count = len(stamps)
    while start < count and path.topology == store.tree.topology and not path.is_mixed():
        stop = min(start + _CHUNK, count)
        fill(path, stamps, rows, start, stop, xyz, quat, known, screw)
        start = stop
        store.lock.let_others()
    return start


def _check_connected(
    store: Store, target_frame: str, source_frame: str, stamps: NDArray[np.int64]
) -> None:
    """Raise if no path joins the frames, neither now nor at one of the stamps."""
    for stamp in stamps.tolist():
        if Lookup(store, ((target_frame, source_frame, stamp),)).answers() is not None:
            return
    raise Lookup(store, ((target_frame, source_frame, None),)).error()


def _write_row(answer: TransformStamped | None, i: int, xyz: Any, quat: Any, known: Any) -> None:
    known[i] = answer is not None
    pose = (math.nan,) * 7 if answer is None else answer.transform.as_pose()
    for k in range(3):
        xyz[3 * i + k] = pose[k]
    for k in range(4):
        quat[4 * i + k] = pose[3 + k]
