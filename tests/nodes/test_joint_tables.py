"""Joint states of CSV files: their columns, and the sentences on mistakes."""

from pathlib import Path

import pytest

from tests.nodes.robots import arm
from tfbus.nodes.robot.motions import Row, TableError, rows_of_csv


def rows(folder: Path, text: str, rate_hz: float = 10.0) -> list[Row]:
    path = folder / "t.csv"
    path.write_text(text)
    return rows_of_csv(path, arm(), rate_hz)


def test_columns_are_joints_and_a_time(tmp_path: Path) -> None:
    """Each row has its seconds and the positions of the joints that head its columns."""
    found = rows(tmp_path, "time, elbow ,grip_right\n0,1,2\n\n0.5,-1e-3,4\n")
    assert found == [
        Row(0.0, {"elbow": 1.0, "grip_right": 2.0}),
        Row(0.5, {"elbow": -0.001, "grip_right": 4.0}),
    ]


def test_nanoseconds_are_a_time_too(tmp_path: Path) -> None:
    """A column of nanoseconds counts as seconds."""
    found = rows(tmp_path, "elbow,stamp_ns\n1,1700000000000000000\n1,1700000000250000000\n")
    assert found[1].seconds - found[0].seconds == pytest.approx(0.25)


def test_without_a_time_rows_come_at_the_rate(tmp_path: Path) -> None:
    """Rows without a time are one period apart."""
    assert [row.seconds for row in rows(tmp_path, "elbow\n1\n2\n3\n")] == [0.0, 0.1, 0.2]


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "t.csv:1: no column of a joint"),
        ("time\n1\n", "t.csv:1: no column of a joint"),
        ("elbow\n", "has no rows of numbers"),
        ("elbo\n1\n", "t.csv:1: the robot has no joint 'elbo'; did you mean 'elbow'"),
        ("mount\n1\n", "t.csv:1: joint 'mount' has no position of one number"),
        ("elbow,elbow\n1,1\n", "t.csv:1: joint 'elbow' has two columns"),
        ("elbow,grip\n1\n", "t.csv:2: 1 value under 2 columns"),
        ("elbow\n1\nx\n", "t.csv:3: 'x' in column 'elbow' is no finite number"),
        ("elbow\nnan\n", "t.csv:2: 'nan' in column 'elbow' is no finite number"),
        ("t,elbow\n1,1\n0,1\n", "t.csv:3: the time goes back, to 0 s"),
    ],
)
def test_a_mistake_has_its_line(tmp_path: Path, text: str, complaint: str) -> None:
    """A table that cannot be played is refused with the line and what is wrong."""
    with pytest.raises(TableError, match=complaint.replace("(", r"\(")):
        rows(tmp_path, text)


def test_a_file_that_is_none_is_named(tmp_path: Path) -> None:
    """A file that is missing or no text is one sentence."""
    with pytest.raises(TableError, match=r"none\.csv: No such"):
        rows_of_csv(tmp_path / "none.csv", arm(), 1.0)
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(TableError, match=r"binary\.csv is .*CSV"):
        rows_of_csv(tmp_path / "binary.csv", arm(), 1.0)
