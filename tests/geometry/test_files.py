"""Trajectories in files: a written one is read again, and another file is refused."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests import needs
from tests.builders import S, examples, transforms
from tests.needs import module
from tfbus import DecodeError, InvalidArgumentException, Trajectory, TransformArray
from tfbus.frames.document import CSV_HEADER, Numbers, csv_line

# Not a whole number of the steps of a float of this size, which are 238 ns.
STAMP = 1_403_636_579_763_555_585


@st.composite
def trajectories(draw: st.DrawFn) -> Trajectory:
    """Any trajectory of up to five poses."""
    stamps = sorted(draw(st.sets(st.integers(-(2**62) + 1, 2**62 - 1), max_size=5)))
    poses = TransformArray.of([draw(transforms()) for _ in stamps])
    return Trajectory("map", "base link, 1", stamps, poses.xyz, poses.quat_xyzw)


def equal(one: Trajectory, other: Trajectory) -> bool:
    """Whether two are the same to the last bit, but for the sign of a zero."""
    return (
        (one.frame_id, one.child_frame_id) == (other.frame_id, other.child_frame_id)
        and np.array_equal(one.stamps_ns, other.stamps_ns)
        and np.array_equal(one.xyz, other.xyz)
        and np.array_equal(one.quat_xyzw, other.quat_xyzw)
    )


@given(trajectories().filter(len))
@settings(
    max_examples=examples(50),
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
def test_what_is_written_is_read_again_exactly(tmp_path: Path, trajectory: Trajectory) -> None:
    """CSV and TUM keep each stamp to the nanosecond and each number to the last bit."""
    path = tmp_path / "trajectory"
    trajectory.write_csv(path)
    assert equal(Trajectory.read_csv(path), trajectory)
    trajectory.write_tum(path)
    assert equal(Trajectory.read_tum(path, "map", "base link, 1"), trajectory)


def test_csv_has_the_columns_of_echo(tmp_path: Path) -> None:
    """A row of a trajectory is the row that `tfbus echo --format csv` prints."""
    trajectory = Trajectory("map", "base", [STAMP], [(1.5, -2, 0)], [(0, 0, 0.6, 0.8)])
    trajectory.write_csv(tmp_path / "a.csv")
    lines = (tmp_path / "a.csv").read_text().splitlines()
    assert lines == [CSV_HEADER, csv_line(trajectory[0], Numbers())]


def test_tum_has_seconds_with_nine_digits(tmp_path: Path) -> None:
    """A stamp is not rounded by way of a float, and a comment names the columns."""
    Trajectory("map", "base", [STAMP], [(1.5, -2, 0)]).write_tum(tmp_path / "a.txt")
    assert (tmp_path / "a.txt").read_text() == (
        "# timestamp tx ty tz qx qy qz qw\n1403636579.763555585 1.5 -2.0 0.0 0.0 0.0 0.0 1.0\n"
    )


@pytest.mark.parametrize(
    ("text", "stamp_ns"),
    [
        ("1403636579.763555585", STAMP),
        ("1.403636579763555585e+09", STAMP),
        ("1403636579.7635555851", STAMP),
        ("12", 12 * S),
        ("-0.5", -S // 2),
    ],
)
def test_tum_stamps_are_read_to_the_nanosecond(tmp_path: Path, text: str, stamp_ns: int) -> None:
    """With an exponent as evo writes them, too."""
    (tmp_path / "a.txt").write_text(f"# from a SLAM system\n\n{text} 1 2 3 0 0 0 1\n")
    read = Trajectory.read_tum(tmp_path / "a.txt", "map", "base")
    assert read.stamps_ns.tolist() == [stamp_ns]
    assert read.xyz.tolist() == [[1, 2, 3]]


def test_rows_in_any_order_are_sorted(tmp_path: Path) -> None:
    """Of equal stamps the last row counts, as in a buffer."""
    (tmp_path / "a.txt").write_text("2 1 0 0 0 0 0 1\n1 2 0 0 0 0 0 1\n2 3 0 0 0 0 0 1\n")
    read = Trajectory.read_tum(tmp_path / "a.txt", "map", "base")
    assert read.stamps_ns.tolist() == [1 * S, 2 * S]
    assert read.xyz[:, 0].tolist() == [2, 3]


def test_kitti_is_read_with_stamps_of_its_own(tmp_path: Path) -> None:
    """The matrices come back; a wrong number of stamps is refused."""
    written = Trajectory("map", "base", [1, 2], [(1, 2, 3), (4, 5, 6)], [(0, 0, 0.6, 0.8)] * 2)
    written.write_kitti(tmp_path / "a.txt")
    read = Trajectory.read_kitti(tmp_path / "a.txt", [1, 2], "map", "base")
    assert read.xyz.tolist() == written.xyz.tolist()
    assert np.allclose(read.quat_xyzw, written.quat_xyzw, atol=1e-15)
    with pytest.raises(InvalidArgumentException, match="has 2 poses"):
        Trajectory.read_kitti(tmp_path / "a.txt", [1], "map", "base")


@pytest.mark.parametrize("stamp", ["1700000000.5", "1700000000.", "1.7e+09"])
def test_a_table_with_seconds_is_asked_about(tmp_path: Path, stamp: str) -> None:
    """As a TUM file with nanoseconds is."""
    (tmp_path / "a.csv").write_text(
        f"stamp_ns,frame_id,child_frame_id,x,y,z,qx,qy,qz,qw\n{stamp},map,base,0,0,0,0,0,0,1\n"
    )
    with pytest.raises(DecodeError, match=r"line 2: .*in seconds\?$"):
        Trajectory.read_csv(tmp_path / "a.csv")


def test_euroc_has_nanoseconds_and_w_first(tmp_path: Path) -> None:
    """Columns behind the quaternion, such as velocities, do not count."""
    (tmp_path / "data.csv").write_text(
        f"#timestamp, p_RS_R_x [m], ...\n{STAMP}, 1, 2, 3, 0.8, 0, 0, 0.6, 9, 9, 9\n"
    )
    read = Trajectory.read_euroc(tmp_path / "data.csv", "world", "imu")
    assert (read.stamps_ns.tolist(), read.xyz.tolist()) == ([STAMP], [[1, 2, 3]])
    assert read.quat_xyzw[0].tolist() == pytest.approx([0, 0, 0.6, 0.8])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1 2 3\n", "line 1: expected 8 numbers, timestamp tx ty tz qx qy qz qw, got 3"),
        ("#\n1 2 3 4 0 0 0 x\n", "line 2: expected a finite number, got 'x'"),
        ("1 nan 3 4 0 0 0 1\n", "got 'nan'"),
        ("1 2 3 4 0 0 0 7\n", "norm 1"),
        ("1e999999999 2 3 4 0 0 0 1\n", "within 146 years"),
        (f"{STAMP} 2 3 4 0 0 0 1\n", "is it in nanoseconds?"),
        ("# nothing\n", "contains no pose"),
        ("\0\0\0", "line 1: not a text file"),
        ("1 2 \x1b[31m 4 0 0 0 1\n", "\\x1b[31m"),
    ],
)
def test_what_is_no_tum_file_is_refused(tmp_path: Path, text: str, said: str) -> None:
    """The sentence names the file, the line and what is wrong, and shows nothing raw."""
    (tmp_path / "a.txt").write_text(text)
    with pytest.raises(DecodeError) as raised:
        Trajectory.read_tum(tmp_path / "a.txt", "map", "base")
    assert said in str(raised.value)
    assert str(raised.value).isprintable()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "has no column stamp_ns"),
        ("a,b\n1,2\n", "its first line must name the columns"),
        (f"{CSV_HEADER}\n", "contains no pose"),
        (f"{CSV_HEADER}\n1,map,base,1\n", "line 2: expected 13 fields, got 4"),
        (f"{CSV_HEADER}\n1.5,map,base,0,0,0,0,0,0,1,0,0,0\n", "whole nanoseconds"),
        (f"{CSV_HEADER}\n1,/map,base,0,0,0,0,0,0,1,0,0,0\n", "slash"),
        (
            f"{CSV_HEADER}\n1,map,a,0,0,0,0,0,0,1,0,0,0\n1,map,b,0,0,0,0,0,0,1,0,0,0\n",
            "2 pairs of frames (a in map, b in map)",
        ),
    ],
)
def test_what_is_no_table_is_refused(tmp_path: Path, text: str, said: str) -> None:
    """The sentence names the file, the line and what is wrong."""
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(DecodeError) as raised:
        Trajectory.read_csv(tmp_path / "a.csv")
    assert said in str(raised.value)


def test_bytes_that_are_no_text_are_refused(tmp_path: Path) -> None:
    """A picture that is taken for a table is a DecodeError, not one of Unicode."""
    (tmp_path / "a.csv").write_bytes(b"\x89PNG\r\n\xff\xfe")
    for read in (Trajectory.read_csv, lambda path: Trajectory.read_tum(path, "a", "b")):
        with pytest.raises(DecodeError):
            read(tmp_path / "a.csv")


def test_evo_reads_what_is_written(tmp_path: Path) -> None:
    """The stamps and poses in evo are those that were written."""
    evo = module("evo.tools.file_interface")
    written = Trajectory("map", "base", [1 * S, 2 * S], [(1, 2, 3)] * 2, [(0, 0, 0.6, 0.8)] * 2)
    written.write_tum(tmp_path / "a.txt")
    read = evo.read_tum_trajectory_file(str(tmp_path / "a.txt"))
    assert read.timestamps.tolist() == [1.0, 2.0]
    assert read.positions_xyz.tolist() == written.xyz.tolist()
    assert read.orientations_quat_wxyz[0].tolist() == pytest.approx([0.8, 0, 0, 0.6])
    evo.write_tum_trajectory_file(str(tmp_path / "b.txt"), read)
    assert equal(Trajectory.read_tum(tmp_path / "b.txt", "map", "base"), written)


def test_pandas_takes_the_columns() -> None:
    """A DataFrame has a row for each pose."""
    pandas = needs.module("pandas")
    table = pandas.DataFrame(Trajectory("map", "base", [S], [(1, 2, 3)]).as_columns())
    assert table.loc[0, ["stamp_ns", "frame_id", "z"]].tolist() == [S, "map", 3.0]
    assert math.isclose(table["qw"].sum(), 1.0)
