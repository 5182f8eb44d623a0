"""Trajectories as CSV, with the columns of `tfbus echo --format csv`."""

import csv
import io
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tfbus.errors import DecodeError, InvalidArgumentException
from tfbus.runtime.whole_file import replacing
from tfbus.trajectory.csv_columns import CSV_COLUMNS, FRAME_COLUMNS, POSE_COLUMNS
from tfbus.trajectory.lines import lines_of, pose_of, whole_stamp
from tfbus.trajectory.trajectory import FilePath, Trajectory, in_order
from tfbus.wording import listed, printable

_Pair = tuple[str, str]
_Rows = dict[_Pair, tuple[list[int], list[list[float]]]]


def columns(trajectory: Trajectory) -> dict[str, NDArray[Any]]:
    """The columns of a trajectory by name."""
    count = len(trajectory)
    numbers = np.hstack((trajectory.xyz, trajectory.quat_xyzw, trajectory.transforms.as_rpy()))
    values = [
        trajectory.stamps_ns,
        np.full(count, trajectory.frame_id, dtype=object),
        np.full(count, trajectory.child_frame_id, dtype=object),
        # Adding 0.0 turns -0.0 into 0.0, as `tfbus echo` does.
        *(numbers.T + 0.0),
    ]
    return dict(zip(CSV_COLUMNS, values, strict=True))


def write_table(trajectory: Trajectory, path: FilePath) -> None:
    """Write the columns under a header."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(CSV_COLUMNS)
    rows.writerows(zip(*(each.tolist() for each in columns(trajectory).values()), strict=True))
    with replacing(path) as file:
        file.write(text.getvalue().encode())


def read_tables(path: FilePath) -> list[Trajectory]:
    """The trajectories of all pairs of frames in a file, in the order of their first lines."""
    found: _Rows = {}
    for pair, stamp_ns, pose in _rows(path):
        stamps, poses = found.setdefault(pair, ([], []))
        stamps.append(stamp_ns)
        poses.append(pose)
    trajectories = []
    for (frame_id, child_frame_id), (stamps, poses) in found.items():
        numbers = np.array(poses)
        try:
            trajectories.append(
                in_order(frame_id, child_frame_id, stamps, numbers[:, :3], numbers[:, 3:])
            )
        except InvalidArgumentException as error:
            raise DecodeError(f"{path}: {error}") from error
    return trajectories


def read_one(path: FilePath) -> Trajectory:
    """The only trajectory of a file."""
    found = read_tables(path)
    if len(found) == 1:
        return found[0]
    if not found:
        raise DecodeError(f"{path} contains no pose")
    pairs = listed([f"{each.child_frame_id} in {each.frame_id}" for each in found], most=3)
    raise DecodeError(
        f"{path} has the poses of {len(found)} pairs of frames ({pairs}): read them into a buffer, "
        "with tfbus.buffer.trajectories.insert_csv"
    )


def _rows(path: FilePath) -> Iterator[tuple[_Pair, int, list[float]]]:
    lines = csv.reader((line for _, line in lines_of(path, comments=False)), strict=True)
    header: list[str] = []
    try:
        header = [name.strip() for name in next(lines, [])]
        places = _places(header, path)
        for row in lines:
            if row:
                number = lines.line_num
                if len(row) < len(header):
                    raise DecodeError(
                        f"{path}, line {number}: expected {len(header)} fields, got {len(row)}"
                    )
                where = f"{path}, line {number}"
                stamp_ns = whole_stamp(row[places["stamp_ns"]], where)
                pair = row[places["frame_id"]], row[places["child_frame_id"]]
                pose = pose_of([row[places[name]] for name in POSE_COLUMNS], where)
                yield pair, stamp_ns, pose
    except csv.Error as error:
        raise DecodeError(f"{path}, line {lines.line_num}: not CSV ({error})") from error


def _places(header: list[str], path: FilePath) -> dict[str, int]:
    """The place of each column."""
    wanted = ("stamp_ns", *FRAME_COLUMNS, *POSE_COLUMNS)
    missing = [name for name in wanted if name not in header]
    if missing:
        raise DecodeError(
            f"{path} has no column {listed(missing)}: its first line must name the columns "
            f"{', '.join(wanted)}, got {printable(','.join(header), 80)!r}"
        )
    return {name: header.index(name) for name in wanted}
