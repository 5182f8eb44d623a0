"""A trajectory: where one frame was in another, at many times."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, TypeAlias, overload

from tfbus.core import lazy_numpy as np
from tfbus.core.kernel import LONGEST_NS, QUATERNION_TOLERANCE, UNIT_TO_THE_LAST_BIT
from tfbus.core.lazy_numpy import NDArray
from tfbus.errors import InvalidArgumentException, TfbusError
from tfbus.geometry.transform import Transform, TransformStamped, check_frame_id
from tfbus.geometry.transform_array import TransformArray
from tfbus.wording import counted, stamp_text

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

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
        from tfbus.trajectory.files import read_one

        return read_one(path)

    def write_csv(self, path: FilePath) -> None:
        """Write a CSV file with the columns of `tfbus echo --format csv` and all digits.

        As every `write_` it replaces a file in one step, and raises OSError.
        """
        from tfbus.trajectory.files import write_table

        write_table(self, path)

    @staticmethod
    def read_tum(path: FilePath, frame_id: str, child_frame_id: str) -> "Trajectory":
        """The poses of a file in TUM's format: lines of `timestamp tx ty tz qx qy qz qw`, with
        timestamps in seconds, which are read to the nanosecond; `#` begins a comment.
        """
        from tfbus.trajectory.files import read_tum

        return read_tum(path, frame_id, child_frame_id)

    def write_tum(self, path: FilePath) -> None:
        """Write a file in TUM's format, which evo and most SLAM tools read."""
        from tfbus.trajectory.files import write_tum

        write_tum(self, path)

    @staticmethod
    def read_kitti(
        path: FilePath, stamps_ns: ArrayLike, frame_id: str, child_frame_id: str
    ) -> "Trajectory":
        """The poses of a file in KITTI's format: lines of 12 numbers, the upper three rows of a
        matrix. It has no times: `stamps_ns` (N,) has one for each line.
        """
        from tfbus.trajectory.files import read_kitti

        return read_kitti(path, stamps_ns, frame_id, child_frame_id)

    def write_kitti(self, path: FilePath) -> None:
        """Write a file in KITTI's format, which has no times."""
        from tfbus.trajectory.files import write_kitti

        write_kitti(self, path)

    @staticmethod
    def read_euroc(path: FilePath, frame_id: str, child_frame_id: str) -> "Trajectory":
        """The poses of a ground truth in EuRoC's format: lines of a timestamp in nanoseconds, then
        x, y, z, qw, qx, qy, qz, with commas; further columns do not count.
        """
        from tfbus.trajectory.files import read_euroc

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
        from tfbus.trajectory.files import columns

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
    if given.dtype.kind == "M":
        given = given.astype("datetime64[ns]").astype(np.int64)
    if given.ndim != 1 or (given.size and not np.issubdtype(given.dtype, np.integer)):
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
    """The quaternions with norm 1; those that have it to the last bit stay as they are."""
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
