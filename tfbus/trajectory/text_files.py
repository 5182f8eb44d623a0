"""Trajectories in the text formats of SLAM data sets: TUM, KITTI and EuRoC."""

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tfbus.errors import DecodeError, InvalidArgumentException
from tfbus.geometry.transform_array import TransformArray
from tfbus.runtime.whole_file import replacing
from tfbus.trajectory.lines import decimal_stamp, finite, lines_of, pose_of, whole_stamp
from tfbus.trajectory.trajectory import FilePath, Trajectory, in_order
from tfbus.wording import counted, stamp_text

Floats = NDArray[np.float64]

_TUM = ("timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw")
_EUROC = ("timestamp", "x", "y", "z", "qw", "qx", "qy", "qz")

# Rotations are written with few digits; further off it is no rotation.
_ROTATION_WITHIN = 1e-3


def read_tum(path: FilePath, frame_id: str, child_frame_id: str) -> Trajectory:
    """As `Trajectory.read_tum`."""
    stamps, poses = [], []
    for number, line in lines_of(path):
        where = f"{path}, line {number}"
        fields = line.replace(",", " ").split()
        _check_count(fields, _TUM, where)
        stamps.append(decimal_stamp(fields[0], where))
        poses.append(pose_of(fields[1:], where))
    return _trajectory(path, frame_id, child_frame_id, stamps, poses)


def write_tum(trajectory: Trajectory, path: FilePath) -> None:
    """As `Trajectory.write_tum`."""
    rows = np.hstack((trajectory.xyz, trajectory.quat_xyzw)).tolist()
    lines = [
        f"{stamp_text(stamp_ns)} {_joined(row)}\n"
        for stamp_ns, row in zip(trajectory.stamps_ns.tolist(), rows, strict=True)
    ]
    _write(path, f"# {' '.join(_TUM)}\n", lines)


def read_kitti(
    path: FilePath, stamps_ns: ArrayLike, frame_id: str, child_frame_id: str
) -> Trajectory:
    """As `Trajectory.read_kitti`."""
    rows = []
    for number, line in lines_of(path):
        where = f"{path}, line {number}"
        fields = line.split()
        if len(fields) != 12:
            raise DecodeError(
                f"{where}: expected 12 numbers, three rows of a matrix, got {len(fields)}"
            )
        rows.append([finite(field, where) for field in fields])
    matrices = np.zeros((len(rows), 4, 4))
    matrices[:, :3] = np.array(rows).reshape(-1, 3, 4)
    matrices[:, 3, 3] = 1.0
    stamps = np.asarray(stamps_ns)
    if stamps.shape != (len(rows),):
        raise InvalidArgumentException(
            f"stamps_ns: expected shape ({len(rows)},), as {path} has "
            f"{counted(len(rows), 'pose')}, got {stamps.shape}"
        )
    try:
        poses = TransformArray.from_matrix(_orthogonal(matrices))
    except InvalidArgumentException as error:
        raise DecodeError(f"{path}: {error}") from error
    return Trajectory(frame_id, child_frame_id, stamps, poses.xyz, poses.quat_xyzw)


def write_kitti(trajectory: Trajectory, path: FilePath) -> None:
    """As `Trajectory.write_kitti`."""
    rows = trajectory.transforms.as_matrix()[:, :3].reshape(-1, 12).tolist()
    _write(path, "", [f"{_joined(row)}\n" for row in rows])


def read_euroc(path: FilePath, frame_id: str, child_frame_id: str) -> Trajectory:
    """As `Trajectory.read_euroc`."""
    stamps, poses = [], []
    for number, line in lines_of(path):
        where = f"{path}, line {number}"
        fields = [field.strip() for field in line.split(",")]
        _check_count(fields[: len(_EUROC)], _EUROC, where)
        stamps.append(whole_stamp(fields[0], where))
        poses.append(pose_of([*fields[1:4], *fields[5:8], fields[4]], where))
    return _trajectory(path, frame_id, child_frame_id, stamps, poses)


def _trajectory(
    path: FilePath,
    frame_id: str,
    child_frame_id: str,
    stamps: Sequence[int],
    poses: Sequence[Sequence[float]],
) -> Trajectory:
    if not stamps:
        raise DecodeError(f"{path} contains no pose")
    numbers = np.array(poses)
    try:
        return in_order(frame_id, child_frame_id, stamps, numbers[:, :3], numbers[:, 3:])
    except InvalidArgumentException as error:
        raise DecodeError(f"{path}: {error}") from error


def _orthogonal(matrices: Floats) -> Floats:
    """The matrices with the rotations next to theirs, if they are off by rounding only."""
    left, scale, right = np.linalg.svd(matrices[:, :3, :3])
    near = np.abs(scale - 1.0).max(axis=1, initial=0.0) < _ROTATION_WITHIN
    matrices[near, :3, :3] = (left @ right)[near]
    return matrices


def _check_count(fields: Sequence[str], names: Sequence[str], where: str) -> None:
    if len(fields) != len(names):
        raise DecodeError(
            f"{where}: expected {len(names)} numbers, {' '.join(names)}, got {len(fields)}"
        )


def _joined(numbers: Iterable[float]) -> str:
    return " ".join(map(repr, numbers))


def _write(path: FilePath, header: str, lines: Iterable[str]) -> None:
    with replacing(path) as file:
        file.write(header.encode())
        file.writelines(line.encode() for line in lines)
