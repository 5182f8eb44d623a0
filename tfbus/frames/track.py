"""Motion along a trajectory: its gaps, turns and speeds, to be plotted."""

from __future__ import annotations

from typing import TypeAlias

from tfbus.base import lazy_numpy as np
from tfbus.base.lazy_numpy import NDArray
from tfbus.buffer.buffer import Buffer
from tfbus.geometry.trajectory import Trajectory, check_count, of_checked

Floats: TypeAlias = "NDArray[np.float64]"

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


def seconds_of(track: Trajectory) -> Floats:
    """(N,) seconds since the first pose."""
    if not len(track):
        return np.zeros(0)
    since: Floats = (track.stamps_ns - track.stamps_ns[0]) / 1e9
    return since


def gaps_of(track: Trajectory) -> NDArray[np.bool_]:
    """(N - 1,) whether nothing is known from one pose to the next: these are far apart."""
    return gaps_in(np.diff(track.stamps_ns))


def rpy_rad(track: Trajectory) -> Floats:
    """(N, 3) roll, pitch and yaw in radians, as of `Transform.as_rpy` without jumps of a turn."""
    angles: Floats = np.unwrap(track.transforms.as_rpy(), axis=0)
    return angles


def linear_speed(track: Trajectory) -> Floats:
    """(N - 1,) metres per second from one pose to the next."""
    moved = np.linalg.norm(np.diff(track.xyz, axis=0), axis=1)
    speed: Floats = moved / np.diff(seconds_of(track))
    return speed


def angular_speed(track: Trajectory) -> Floats:
    """(N - 1,) radians per second from one pose to the next, the short way round."""
    before, after = track.quat_xyzw[:-1], track.quat_xyzw[1:]
    # The norms of difference and sum are 2 sin and 2 cos of a quarter of the angle: exact for
    # small angles too, whose cosine would round to 1.
    apart, along = (np.linalg.norm(after + sign * before, axis=1) for sign in (-1.0, 1.0))
    angle = 4.0 * np.arctan2(np.minimum(apart, along), np.maximum(apart, along))
    speed: Floats = angle / np.diff(seconds_of(track))
    return speed


def track_from_buffer(
    buffer: Buffer, target: str, source: str, from_ns: int, to_ns: int, rate_hz: float
) -> Trajectory:
    """The known poses of `source` in `target` between two times (ns), sampled at `rate_hz`.

    Raises LookupException for an unknown frame, ConnectivityException for unconnected ones, and
    TfbusError for more than 20 million.
    """
    step_ns = max(round(1e9 / rate_hz), 1)
    check_count((to_ns - from_ns) // step_ns)
    stamps_ns = np.arange(from_ns, to_ns + 1, step_ns, dtype=np.int64)
    poses, known = buffer.lookup_known_transforms(target, source, stamps_ns)
    found = poses[known]
    # A frame seen from itself may be plotted too.
    return of_checked(target, source, stamps_ns[known], found.xyz, found.quat_xyzw)
