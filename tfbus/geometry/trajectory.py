"""The poses of one frame over time: as arrays, and in the files of SLAM systems and tables."""

from __future__ import annotations

import csv
import io
import json
import math
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from decimal import Decimal, InvalidOperation
from typing import Any, TypeAlias, overload

from tfbus.base import lazy_numpy as np
from tfbus.base.errors import DecodeError, InvalidArgumentException, TfbusError
from tfbus.base.lazy_numpy import ArrayLike, NDArray
from tfbus.base.stamps import stamp_ns
from tfbus.base.whole_file import replacing
from tfbus.base.wording import counted, listed, printable, stamp_text
from tfbus.geometry.kernel import LONGEST_NS, QUATERNION_TOLERANCE, UNIT_TO_THE_LAST_BIT
from tfbus.geometry.transform import Transform, TransformStamped, check_frame_id
from tfbus.geometry.transform_array import TransformArray

Floats: TypeAlias = "NDArray[np.float64]"

FilePath = str | os.PathLike[str]

# The columns of a pose in CSV, as `tfbus echo --format csv` writes them.
FRAME_COLUMNS = ("frame_id", "child_frame_id")
POSE_COLUMNS = ("x", "y", "z", "qx", "qy", "qz", "qw")
CSV_COLUMNS = ("stamp_ns", *FRAME_COLUMNS, *POSE_COLUMNS, "roll", "pitch", "yaw")

# Of as many poses, all at once, a machine has the memory: some 4 GB. At 100 Hz they are 55 hours.
_MOST_POSES = 20_000_000


def check_count(count: int) -> None:
    """Raise TfbusError if a span has too many poses at a rate: a single wrong stamp can make it
    a century long.
    """
    if count > _MOST_POSES:
        raise TfbusError(
            f"at this rate the span has {count:,} poses, at most {_MOST_POSES:,} are made: give a "
            "lower --rate, or a part of it by --from and --to"
        )


class Trajectory:
    """N poses of `child_frame_id` in `frame_id`, at rising stamps.

    `stamps_ns` (N,) are nanoseconds since the Unix epoch, or numpy's datetime64; `xyz` (N, 3) are
    metres, `quat_xyzw` (N, 4) unit quaternions x, y, z, w. Without quaternions nothing is turned.
    The poses take points of the child into the parent. The arrays are read-only copies.

    It is a sequence: an index gives a TransformStamped, a slice or a mask a Trajectory. `==`
    compares frames and numbers exactly. Files that cannot be read raise OSError, and DecodeError,
    which names the line.

    Raises InvalidArgumentException for wrong shapes, invalid names, numbers that are not finite,
    quaternions whose norm is not 1, and stamps that do not rise.
    """

    __slots__ = ("child_frame_id", "frame_id", "quat_xyzw", "stamps_ns", "xyz")

    frame_id: str
    child_frame_id: str
    stamps_ns: NDArray[np.int64]
    xyz: Floats
    quat_xyzw: Floats

    def __init__(
        self,
        frame_id: str,
        child_frame_id: str,
        stamps_ns: ArrayLike,
        xyz: ArrayLike,
        quat_xyzw: ArrayLike | None = None,
    ) -> None:
        self.frame_id = check_frame_id(frame_id, "frame_id")
        self.child_frame_id = check_frame_id(child_frame_id, "child_frame_id")
        if frame_id == child_frame_id:
            raise InvalidArgumentException(f"frame {frame_id!r} cannot move in itself")
        self.stamps_ns = _stamps(stamps_ns)
        count = len(self.stamps_ns)
        self.xyz = _numbers(xyz, (count, 3), "xyz")
        if quat_xyzw is None:
            quat_xyzw = np.tile((0.0, 0.0, 0.0, 1.0), (count, 1))
        self.quat_xyzw = _units(_numbers(quat_xyzw, (count, 4), "quat_xyzw"))
        for column in (self.stamps_ns, self.xyz, self.quat_xyzw):
            column.flags.writeable = False

    # Reading and writing files

    @staticmethod
    def read_csv(path: FilePath) -> "Trajectory":
        """The poses of a CSV file with a header, as `write_csv` and `tfbus echo --format csv` write
        it: stamp_ns, frame_id, child_frame_id, x, y, z, qx, qy, qz, qw.

        Further columns do not count; of equal stamps the last one does. Several pairs of frames are
        an error.
        """
        return read_one(path)

    def write_csv(self, path: FilePath) -> None:
        """Write a CSV file with the columns of `tfbus echo --format csv` and all digits.

        As every `write_` it replaces a file in one step, and raises OSError.
        """
        write_table(self, path)

    @staticmethod
    def read_tum(path: FilePath, frame_id: str, child_frame_id: str) -> "Trajectory":
        """The poses of a file in TUM's format: lines of `timestamp tx ty tz qx qy qz qw`, with
        timestamps in seconds, which are read to the nanosecond; `#` begins a comment.
        """
        return read_tum(path, frame_id, child_frame_id)

    def write_tum(self, path: FilePath) -> None:
        """Write a file in TUM's format, which evo and most SLAM tools read."""
        write_tum(self, path)

    @staticmethod
    def read_kitti(
        path: FilePath, stamps_ns: ArrayLike, frame_id: str, child_frame_id: str
    ) -> "Trajectory":
        """The poses of a file in KITTI's format: lines of 12 numbers, the upper three rows of a
        matrix. It has no times: `stamps_ns` (N,) has one for each line.
        """
        return read_kitti(path, stamps_ns, frame_id, child_frame_id)

    def write_kitti(self, path: FilePath) -> None:
        """Write a file in KITTI's format, which has no times."""
        write_kitti(self, path)

    @staticmethod
    def read_euroc(path: FilePath, frame_id: str, child_frame_id: str) -> "Trajectory":
        """The poses of a ground truth in EuRoC's format: lines of a timestamp in nanoseconds, then
        x, y, z, qw, qx, qy, qz, with commas; further columns do not count.
        """
        return read_euroc(path, frame_id, child_frame_id)

    # Reading it

    @property
    def transforms(self) -> TransformArray:
        """The N poses, with the arithmetic of a TransformArray."""
        return TransformArray(self.xyz, self.quat_xyzw)

    @property
    def span_s(self) -> float:
        """How many seconds it covers."""
        return float(self.stamps_ns[-1] - self.stamps_ns[0]) / 1e9 if len(self) else 0.0

    def as_columns(self) -> dict[str, NDArray[Any]]:
        """The columns of `write_csv` by name, each (N,), for pandas.DataFrame and its like.

        Roll, pitch and yaw are in radians.
        """
        return columns(self)

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def __iter__(self) -> Iterator[TransformStamped]:
        for at in range(len(self)):
            yield self[at]

    @overload
    def __getitem__(self, at: int) -> TransformStamped: ...
    @overload
    def __getitem__(self, at: slice | NDArray[Any]) -> "Trajectory": ...
    def __getitem__(self, at: int | slice | NDArray[Any]) -> "TransformStamped | Trajectory":
        if isinstance(at, slice | np.ndarray | list):
            return Trajectory(
                self.frame_id,
                self.child_frame_id,
                self.stamps_ns[at],
                self.xyz[at],
                self.quat_xyzw[at],
            )
        pose = Transform(self.xyz[at], self.quat_xyzw[at])
        return TransformStamped(int(self.stamps_ns[at]), self.frame_id, self.child_frame_id, pose)

    def __eq__(self, other: object) -> bool:
        """Whether the frames, and all numbers exactly, are the same."""
        if not isinstance(other, Trajectory):
            return NotImplemented
        return (
            (self.frame_id, self.child_frame_id) == (other.frame_id, other.child_frame_id)
            and np.array_equal(self.stamps_ns, other.stamps_ns)
            and np.array_equal(self.xyz, other.xyz)
            and np.array_equal(self.quat_xyzw, other.quat_xyzw)
        )

    # As of a TransformArray.
    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        named = f"{self.child_frame_id!r} in {self.frame_id!r}"
        if not len(self):
            return f"<Trajectory of {named}, empty>"
        return (
            f"<Trajectory of {named}, {counted(len(self), 'pose')} over {self.span_s:g} s "
            f"from {stamp_text(int(self.stamps_ns[0]))} s>"
        )


def of_checked(
    frame_id: str,
    child_frame_id: str,
    stamps_ns: NDArray[np.int64],
    xyz: Floats,
    quat_xyzw: Floats,
) -> Trajectory:
    """The trajectory of columns of its own that were checked before, to the last bit."""
    trajectory = object.__new__(Trajectory)
    trajectory.frame_id, trajectory.child_frame_id = frame_id, child_frame_id
    trajectory.stamps_ns, trajectory.xyz, trajectory.quat_xyzw = stamps_ns, xyz, quat_xyzw
    for column in (stamps_ns, xyz, quat_xyzw):
        column.flags.writeable = False
    return trajectory


def in_order(
    frame_id: str, child_frame_id: str, stamps_ns: ArrayLike, xyz: ArrayLike, quat_xyzw: ArrayLike
) -> Trajectory:
    """The trajectory of rows in any order; of equal stamps the last one counts, as in a buffer."""
    stamps = np.asarray(stamps_ns, dtype=np.int64)
    # From the last row on, so that of equal stamps the last is the first.
    unique, last = np.unique(stamps[::-1], return_index=True)
    rows = len(stamps) - 1 - last
    return Trajectory(
        frame_id, child_frame_id, unique, np.asarray(xyz)[rows], np.asarray(quat_xyzw)[rows]
    )


def _stamps(stamps_ns: ArrayLike) -> NDArray[np.int64]:
    given = np.asarray(stamps_ns)
    if given.dtype.kind == "M" and given.ndim == 1:
        given = stamp_ns(given)
    if given.ndim != 1 or (given.size and given.dtype.kind not in "iu"):
        raise InvalidArgumentException(
            "stamps_ns: expected integers of shape (N,), nanoseconds since the Unix epoch, got "
            f"{given.dtype} of shape {given.shape}"
        )
    if given.size and (int(given.min()) <= -LONGEST_NS or int(given.max()) >= LONGEST_NS):
        raise InvalidArgumentException(
            "stamps_ns: not within 146 years of 1970: they must count nanoseconds"
        )
    stamps = np.array(given, dtype=np.int64)
    falls = np.flatnonzero(np.diff(stamps) <= 0)
    if len(falls):
        at = int(falls[0]) + 1
        raise InvalidArgumentException(
            f"stamps_ns must rise, but number {at} is {stamps[at]}, after {stamps[at - 1]}: sort "
            "the poses, and keep one of each stamp"
        )
    return stamps


def _numbers(values: ArrayLike, shape: tuple[int, int], what: str) -> Floats:
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InvalidArgumentException(f"{what}: expected numbers of shape {shape}") from None
    if array.size == 0 and shape[0] == 0:
        return array.reshape(shape)
    if array.shape != shape:
        raise InvalidArgumentException(
            f"{what}: expected shape {shape}, as there are {shape[0]} stamps, got {array.shape}"
        )
    wrong = ~np.isfinite(array).all(axis=1)
    if wrong.any():
        at = int(np.argmax(wrong))
        raise InvalidArgumentException(f"{what}[{at}] must be finite, got {array[at].tolist()}")
    return array


def _units(quat_xyzw: Floats) -> Floats:
    """The quaternions with norm 1; any that has it to the last bit stays as it is."""
    with np.errstate(over="ignore"):
        x, y, z, w = quat_xyzw.T
        # As the buffer computes it, to the last bit.
        error = x * x + y * y + z * z + w * w - 1.0
    wrong = ~(np.abs(error) < QUATERNION_TOLERANCE)
    if wrong.any():
        at = int(np.argmax(wrong))
        raise InvalidArgumentException(
            f"quat_xyzw[{at}] must have norm 1, got {quat_xyzw[at].tolist()}"
        )
    off = np.abs(error) > UNIT_TO_THE_LAST_BIT
    quat_xyzw[off] *= (1.0 / np.sqrt(1.0 + error[off]))[:, None]
    return quat_xyzw


# Longer lines are not of such a file: another kind of file may have no line break at all.
_LONGEST_LINE = 100_000

_NS_DIGITS = 9

# Seconds as people write them.
_DECIMAL = re.compile(r"-?\d{1,10}\.\d*|-?\d\.\d+e\+?0?9", re.ASCII)


def _lines_of(path: FilePath, *, comments: bool = True) -> Iterator[tuple[int, str]]:
    """The lines of a UTF-8 file with their numbers; with `comments` without lines that are empty or
    begin with `#`.

    Raises DecodeError for a file that is not text, and OSError.
    """
    number = 0
    with open(path, encoding="utf-8-sig", newline="" if not comments else None) as file:
        try:
            while line := file.readline(_LONGEST_LINE):
                number += 1
                if len(line) == _LONGEST_LINE or "\0" in line:
                    raise DecodeError(f"{path}, line {number}: not a text file of poses")
                if not comments or (line.strip() and not line.lstrip().startswith("#")):
                    yield number, line
        except UnicodeDecodeError as error:
            raise DecodeError(f"{path}, line {number + 1}: not UTF-8 text") from error


def _finite(text: str, where: str) -> float:
    """The number of a text. Raises DecodeError for another text, infinity and NaN."""
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise DecodeError(f"{where}: expected a finite number, got {printable(text, 40)!r}")
    return number


def _pose_of(fields: Iterable[str], where: str) -> list[float]:
    """The seven numbers x, y, z, qx, qy, qz, qw of a pose. Raises DecodeError."""
    pose = [_finite(field, where) for field in fields]
    if not abs(sum([part * part for part in pose[3:]]) - 1.0) < QUATERNION_TOLERANCE:
        raise DecodeError(f"{where}: expected a quaternion qx qy qz qw with norm 1, got {pose[3:]}")
    return pose


def _whole_stamp(text: str, where: str) -> int:
    """A stamp in nanoseconds. Raises DecodeError if it is none."""
    try:
        stamp_ns = int(text)
    except ValueError:
        stamp_ns = LONGEST_NS
    if not -LONGEST_NS < stamp_ns < LONGEST_NS:
        what = "; is it in seconds?" if _DECIMAL.fullmatch(text.strip()) else ""
        raise DecodeError(
            f"{where}: expected a stamp in whole nanoseconds since 1970, within 146 years of it, "
            f"got {printable(text, 40)!r}{what}"
        )
    return stamp_ns


def _decimal_stamp(text: str, where: str) -> int:
    """A stamp in seconds, in nanoseconds: not by way of a float, which rounds to 0.2 us.

    Raises DecodeError if it is none.
    """
    try:
        seconds = Decimal(text)
        # Before the digits are written out: 1e999999999 is a short text.
        is_near = seconds.is_finite() and seconds.adjusted() < len(str(LONGEST_NS))
    except InvalidOperation:
        is_near = False
    stamp_ns = int(seconds.scaleb(_NS_DIGITS).to_integral_value()) if is_near else LONGEST_NS
    if not -LONGEST_NS < stamp_ns < LONGEST_NS:
        what = "; is it in nanoseconds?" if text.isdecimal() else ""
        raise DecodeError(
            f"{where}: expected a timestamp in seconds since 1970, within 146 years of it, got "
            f"{printable(text, 40)!r}{what}"
        )
    return stamp_ns


# Tables

_Pair = tuple[str, str]
# Frames, stamp and pose.
_Row = tuple[_Pair, int, list[float]]
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
    return _trajectories(path, _rows(path))


def read_one(path: FilePath) -> Trajectory:
    """The only trajectory of a file of CSV."""
    return _only(path, read_tables(path))


def read_echo(path: FilePath) -> Trajectory:
    """The only trajectory of a file that `tfbus echo --format csv` or json wrote."""
    with open(path, "rb") as file:
        is_json = file.read(1) == b"{"
    return _only(path, _trajectories(path, _json_rows(path) if is_json else _rows(path)))


def _trajectories(path: FilePath, rows: Iterable[_Row]) -> list[Trajectory]:
    found: _Rows = {}
    for pair, at_ns, pose in rows:
        stamps, poses = found.setdefault(pair, ([], []))
        stamps.append(at_ns)
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


def _only(path: FilePath, found: Sequence[Trajectory]) -> Trajectory:
    if len(found) == 1:
        return found[0]
    if not found:
        raise DecodeError(f"{path} contains no pose")
    pairs = listed([f"{each.child_frame_id} in {each.frame_id}" for each in found], most=3)
    raise DecodeError(
        f"{path} has the poses of {len(found)} pairs of frames ({pairs}): read them into a buffer, "
        "with tfbus.buffer.trajectories.insert_csv"
    )


def _json_rows(path: FilePath) -> Iterator[_Row]:
    for number, line in _lines_of(path):
        where = f"{path}, line {number}"
        try:
            row = json.loads(line)
            numbers = [str(value) for value in (*row["xyz"], *row["quat_xyzw"])]
            stamp, pair = str(row["stamp_ns"]), (str(row["frame_id"]), str(row["child_frame_id"]))
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            raise DecodeError(
                f"{where}: not a pose as `tfbus echo --format json` writes it "
                f"({type(error).__name__}: {error})"
            ) from error
        if len(numbers) != len(POSE_COLUMNS):
            raise DecodeError(f"{where}: expected 7 numbers of a pose, got {len(numbers)}")
        yield pair, _whole_stamp(stamp, where), _pose_of(numbers, where)


def _rows(path: FilePath) -> Iterator[_Row]:
    lines = csv.reader((line for _, line in _lines_of(path, comments=False)), strict=True)
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
                stamp_ns = _whole_stamp(row[places["stamp_ns"]], where)
                pair = row[places["frame_id"]], row[places["child_frame_id"]]
                pose = _pose_of([row[places[name]] for name in POSE_COLUMNS], where)
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


# The formats of SLAM data sets

_TUM = ("timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw")
_EUROC = ("timestamp", "x", "y", "z", "qw", "qx", "qy", "qz")

# Rotations are written with few digits; further off it is no rotation.
_ROTATION_WITHIN = 1e-3


def read_tum(path: FilePath, frame_id: str, child_frame_id: str) -> Trajectory:
    """As `Trajectory.read_tum`."""
    stamps, poses = [], []
    for number, line in _lines_of(path):
        where = f"{path}, line {number}"
        fields = line.replace(",", " ").split()
        _check_count(fields, _TUM, where)
        stamps.append(_decimal_stamp(fields[0], where))
        poses.append(_pose_of(fields[1:], where))
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
    for number, line in _lines_of(path):
        where = f"{path}, line {number}"
        fields = line.split()
        if len(fields) != 12:
            raise DecodeError(
                f"{where}: expected 12 numbers, three rows of a matrix, got {len(fields)}"
            )
        rows.append([_finite(field, where) for field in fields])
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
    for number, line in _lines_of(path):
        where = f"{path}, line {number}"
        fields = [field.strip() for field in line.split(",")]
        _check_count(fields[: len(_EUROC)], _EUROC, where)
        stamps.append(_whole_stamp(fields[0], where))
        poses.append(_pose_of([*fields[1:4], *fields[5:8], fields[4]], where))
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
