"""The poses of one frame, seen from another, over time, and the gaps between samples."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tfbus.buffer.buffer import Buffer
from tfbus.errors import DecodeError
from tfbus.geometry.transform_array import TransformArray
from tfbus.trajectory.csv_columns import POSE_COLUMNS
from tfbus.trajectory.trajectory import check_count

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
else:
    from tfbus.core import lazy_numpy as np

# A time without a sample is a gap if it is longer than this many periods, and than this.
_PERIODS, _LEAST_S = 5.0, 0.25


def least_gap_s(period_s: float) -> float:
    """The time in seconds beyond which there is a gap between samples of this period."""
    return max(_LEAST_S, _PERIODS * period_s)


def least_gap_between(between_ns: NDArray[np.int64]) -> float:
    """The time in ns beyond which there is a gap, by the times between samples (N,)."""
    period_ns = float(np.median(between_ns)) if len(between_ns) else 0.0
    return least_gap_s(period_ns / 1e9) * 1e9


def gaps_in(between_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which of the times between samples (N,) are gaps (N,)."""
    return between_ns > least_gap_between(between_ns)


@dataclass(frozen=True)
class Track:
    """N poses of `source` in `target`, and their `stamps_ns` (N,), in rising order."""

    target: str
    source: str
    stamps_ns: NDArray[np.int64]
    poses: TransformArray

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def seconds(self) -> Floats:
        """(N,) seconds since the first pose."""
        if not len(self):
            return np.zeros(0)
        since: Floats = (self.stamps_ns - self.stamps_ns[0]) / 1e9
        return since

    def gaps(self) -> NDArray[np.bool_]:
        """(N - 1,) whether nothing is known from one pose to the next: these are far apart."""
        return gaps_in(np.diff(self.stamps_ns))

    def rpy_rad(self) -> Floats:
        """(N, 3) roll, pitch and yaw in radians, those of `Transform.as_rpy` without jumps by whole
        turns.
        """
        angles: Floats = np.unwrap(self.poses.as_rpy(), axis=0)
        return angles

    def linear_speed(self) -> Floats:
        """(N - 1,) metres per second from one pose to the next."""
        moved = np.linalg.norm(np.diff(self.poses.xyz, axis=0), axis=1)
        speed: Floats = moved / np.diff(self.seconds)
        return speed

    def angular_speed(self) -> Floats:
        """(N - 1,) radians per second from one pose to the next, the short way round."""
        before, after = self.poses.quat_xyzw[:-1], self.poses.quat_xyzw[1:]
        # The norms of difference and sum are 2 sin and 2 cos of a quarter of the angle: exact for
        # small angles too, whose cosine would round to 1.
        apart, along = (np.linalg.norm(after + sign * before, axis=1) for sign in (-1.0, 1.0))
        angle = 4.0 * np.arctan2(np.minimum(apart, along), np.maximum(apart, along))
        speed: Floats = angle / np.diff(self.seconds)
        return speed


def track_from_buffer(
    buffer: Buffer, target: str, source: str, from_ns: int, to_ns: int, rate_hz: float
) -> Track:
    """The known poses between two times (ns), sampled at `rate_hz`.

    Raises LookupException for an unknown frame, ConnectivityException for unconnected ones, and
    TfbusError for more than 20 million.
    """
    step_ns = max(round(1e9 / rate_hz), 1)
    check_count((to_ns - from_ns) // step_ns)
    stamps_ns = np.arange(from_ns, to_ns + 1, step_ns, dtype=np.int64)
    poses, known = buffer.lookup_known_transforms(target, source, stamps_ns)
    return Track(target, source, stamps_ns[known], poses[known])


def track_from_file(path: Path) -> Track:
    """The poses in a file written by `tfbus echo --format csv` or `json`.

    Raises DecodeError, which names the line, if the file is neither.
    """
    with path.open(newline="") as lines:
        is_json = lines.read(1) == "{"
        lines.seek(0)
        rows = list(_json_rows(lines) if is_json else _csv_rows(lines))
    if not rows:
        raise DecodeError(f"{path} contains no pose")
    rows.sort(key=lambda row: row[0])
    # As in a buffer, the last pose with a stamp counts.
    latest = {row[0]: row for row in rows}
    numbers = np.array([row[3] for row in latest.values()])
    return Track(
        rows[0][1],
        rows[0][2],
        np.array(list(latest), dtype=np.int64),
        TransformArray(numbers[:, :3], numbers[:, 3:]),
    )


_Row = tuple[int, str, str, list[float]]


def _json_rows(lines: Iterable[str]) -> Iterable[_Row]:
    for number, line in enumerate(lines, start=1):
        try:
            row = json.loads(line)
            pose = [float(value) for value in (*row["xyz"], *row["quat_xyzw"])]
            yield int(row["stamp_ns"]), row["frame_id"], row["child_frame_id"], pose
        except (ValueError, KeyError, TypeError) as error:
            raise _not_a_pose(number, error) from error


def _csv_rows(lines: Iterable[str]) -> Iterable[_Row]:
    for number, row in enumerate(csv.DictReader(lines), start=2):
        try:
            pose = [float(row[column]) for column in POSE_COLUMNS]
            yield int(row["stamp_ns"]), row["frame_id"], row["child_frame_id"], pose
        except (ValueError, KeyError, TypeError) as error:
            raise _not_a_pose(number, error) from error


def _not_a_pose(number: int, error: Exception) -> DecodeError:
    return DecodeError(
        f"line {number} is not a pose as written by `tfbus echo --format csv` or json "
        f"({type(error).__name__}: {error})"
    )
