"""Many stamps in one call, along one path where there is one for all of them.

One of the modules that are compiled where there is a C compiler (`filling.pxd` says the C types).
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tfbus.buffer.lookup import Answering
from tfbus.core.batch_lookup import fill
from tfbus.core.kernel import Path
from tfbus.core.sampling import Sampling
from tfbus.core.time_order import by_time
from tfbus.geometry.transform import TransformStamped
from tfbus.geometry.transform_array import TransformArray

try:
    import cython
except ImportError:
    from tfbus.core import cython_stub as cython

# A batch holds the lock for so many stamps at a time, which is some microseconds.
_CHUNK = 256


class Filling(Answering):
    """Answers in arrays."""

    def _fill(
        self,
        target_frame: str,
        source_frame: str,
        stamps: NDArray[np.int64],
        sampling: Sampling | None,
    ) -> tuple[TransformArray, NDArray[np.bool_]]:
        sampling = self.sampling if sampling is None else sampling
        if self._ask_path(target_frame, source_frame) is None:
            self._check_connected(target_frame, source_frame, stamps)
        xyz, quat_xyzw = np.empty((len(stamps), 3)), np.empty((len(stamps), 4))
        known = np.empty(len(stamps), dtype=np.bool_)
        if len(stamps):
            self._fill_chunks(
                target_frame,
                source_frame,
                stamps.data,
                by_time(stamps).data,
                xyz.reshape(-1).data,
                quat_xyzw.reshape(-1).data,
                known.view(np.uint8).data,
                sampling,
            )
        return TransformArray(xyz, quat_xyzw), known

    def _fill_chunks(
        self,
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
        strict = sampling.interpolation != "nearest" and not sampling.extrapolation_s
        screw = sampling.interpolation == "screw"
        start = 0
        while start < count:
            path = self._ask_path(target_frame, source_frame)
            before = start
            if strict and path is not None:
                # Python's other threads go on meanwhile.
                with cython.nogil:
                    start = self._fill_along(path, stamps, rows, start, xyz, quat, known, screw)
            if start == before:
                stop = min(start + _CHUNK, count)
                with self._lock:
                    for j in range(start, stop):
                        i = rows[j] if len(rows) else j
                        answer = self._tree.answer(target_frame, source_frame, stamps[i], sampling)
                        _write_row(answer, i, xyz, quat, known)
                start = stop

    def _fill_along(
        self,
        path: Path,
        stamps: Any,
        rows: Any,
        start: int,
        xyz: Any,
        quat: Any,
        known: Any,
        screw: bool,
    ) -> int:
        """Fill the rows from `start` on while the path is one for all times: to which row."""
        count = len(stamps)
        while start < count:
            with self._lock:
                if path.topology != self._tree.topology or path.is_mixed():
                    return start
                stop = min(start + _CHUNK, count)
                fill(path, stamps, rows, start, stop, xyz, quat, known, screw)
            start = stop
        return start

    def _check_connected(
        self, target_frame: str, source_frame: str, stamps: NDArray[np.int64]
    ) -> None:
        """Raise where no path joins the frames now, nor at one of the times."""
        for stamp in stamps.tolist():
            if self._ask(((target_frame, source_frame, stamp),), None) is not None:
                return
        raise self._why_not((target_frame, source_frame, None), None)


def _write_row(answer: TransformStamped | None, i: int, xyz: Any, quat: Any, known: Any) -> None:
    known[i] = answer is not None
    pose = (math.nan,) * 7 if answer is None else answer.transform.as_pose()
    for k in range(3):
        xyz[3 * i + k] = pose[k]
    for k in range(4):
        quat[4 * i + k] = pose[3 + k]
