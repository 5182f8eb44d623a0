"""Which rows a buffer would store."""

import math
from collections.abc import Sequence

from tfbus.core import lazy_numpy as np
from tfbus.core import packed
from tfbus.core.kernel import QUATERNION_TOLERANCE
from tfbus.core.packed import POSE_SIZE
from tfbus.geometry.columns import Columns

# Below this number of rows Python is faster than numpy.
_FEW = 4


def invalid_rows(rows: Columns) -> Sequence[int]:
    """The rows with a number that is not finite, or a quaternion whose norm is not 1."""
    if rows.count < _FEW:
        return [at for at in range(rows.count) if not is_pose(rows.poses, _place(rows, at))]
    poses = np.frombuffer(rows.poses, np.float64, 7 * rows.count, rows.poses_at).reshape(-1, 7)
    turned = poses[:, 3:]
    off = np.abs(np.einsum("ij,ij->i", turned, turned) - 1.0)
    # NaN is not below anything, and neither is a sum with one.
    if off.max() < QUATERNION_TOLERANCE and math.isfinite(poses.sum()):
        return ()
    is_valid = (off < QUATERNION_TOLERANCE) & np.isfinite(poses).all(axis=1)
    found: list[int] = np.flatnonzero(~is_valid).tolist()
    return found


def is_pose(data: bytes, at: int = 0) -> bool:
    """Whether a buffer would store the pose at this place, in the byte order of this machine."""
    x, y, z, qx, qy, qz, qw = packed.pose_at(data, at)
    off = abs(qx * qx + qy * qy + qz * qz + qw * qw - 1.0)
    return off < QUATERNION_TOLERANCE and math.isfinite(x + y + z)


def _place(rows: Columns, at: int) -> int:
    return rows.poses_at + POSE_SIZE * at
