"""A trajectory: its arrays, its rows, and refused values."""

import math
from typing import Any

import numpy as np
import pytest

from tests.builders import S
from tfbus import InvalidArgumentException, Trajectory, Transform, TransformStamped

QUARTER = (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))


def drive() -> Trajectory:
    """Three poses, the last one turned to the left."""
    xyz = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 2.0, 0.0)]
    return Trajectory(
        "map", "base", [1 * S, 2 * S, 4 * S], xyz, [(0, 0, 0, 1), (0, 0, 0, 1), QUARTER]
    )


def test_it_is_a_sequence_of_transforms() -> None:
    """Its length, an index, a negative index and a loop are those of its poses."""
    poses = list(drive())
    assert len(poses) == len(drive()) == 3
    assert poses[1] == drive()[1] == TransformStamped(2 * S, "map", "base", Transform((1, 0, 0)))
    assert drive()[-1].transform.quat_xyzw.tolist() == pytest.approx(QUARTER)


def test_a_slice_and_a_mask_are_trajectories() -> None:
    """Both keep the frames, and the rows that they choose."""
    assert drive()[1:].stamps_ns.tolist() == [2 * S, 4 * S]
    turned = drive()[drive().quat_xyzw[:, 2] > 0]
    assert (turned.frame_id, turned.child_frame_id, len(turned)) == ("map", "base", 1)


def test_equality_is_of_frames_and_numbers() -> None:
    """Two of the same values are equal; another frame, stamp or number makes a difference."""
    whole = drive()
    assert whole == drive() and whole != drive()[:2] and whole != list(drive())
    others = [
        Trajectory("odom", "base", whole.stamps_ns, whole.xyz, whole.quat_xyzw),
        Trajectory("map", "base", whole.stamps_ns + 1, whole.xyz, whole.quat_xyzw),
        Trajectory("map", "base", whole.stamps_ns, whole.xyz + 1e-9, whole.quat_xyzw),
        Trajectory("map", "base", whole.stamps_ns, whole.xyz),
    ]
    assert all(whole != other for other in others)
    with pytest.raises(TypeError, match="unhashable"):
        hash(whole)


def test_it_says_in_a_line_what_it_is() -> None:
    """Its repr is short, however long it is."""
    assert repr(drive()) == "<Trajectory of 'base' in 'map', 3 poses over 3 s from 1.000000000 s>"


def test_its_columns_are_those_of_a_table() -> None:
    """Each column has N rows, so that pandas takes them as they are."""
    columns = drive().as_columns()
    assert [len(column) for column in columns.values()] == [3] * 13
    assert columns["stamp_ns"].tolist() == [1 * S, 2 * S, 4 * S]
    assert columns["child_frame_id"].tolist() == ["base"] * 3
    assert columns["yaw"].tolist() == pytest.approx([0.0, 0.0, math.pi / 2])


def test_without_quaternions_nothing_is_turned() -> None:
    """Positions alone, as GPS has them, are poses without rotation."""
    assert Trajectory("map", "gps", [S], [(1, 2, 3)]).quat_xyzw.tolist() == [[0, 0, 0, 1]]


def test_stamps_may_be_times_of_numpy() -> None:
    """As a column of pandas has them; NaT is refused."""
    times = np.array(["1970-01-01T00:00:01", "1970-01-01T00:00:02"], dtype="datetime64[s]")
    assert Trajectory("map", "base", times, np.zeros((2, 3))).stamps_ns.tolist() == [S, 2 * S]
    with pytest.raises(InvalidArgumentException):
        Trajectory("map", "base", np.array(["NaT"], dtype="datetime64[ns]"), [(0, 0, 0)])
    # In 64 bits of nanoseconds it would be 1830.
    with pytest.raises(InvalidArgumentException, match="146 years"):
        Trajectory("map", "base", np.array(["3000-01-01"], dtype="datetime64[D]"), [(0, 0, 0)])
    with pytest.raises(InvalidArgumentException, match="expected integers"):
        Trajectory("map", "base", np.array([1], dtype="timedelta64[s]"), [(0, 0, 0)])


def test_its_arrays_are_its_own() -> None:
    """What was given may change afterwards; what it has cannot."""
    xyz = np.zeros((1, 3))
    given = Trajectory("map", "base", [S], xyz)
    xyz[0, 0] = 5.0
    assert given.xyz.tolist() == [[0, 0, 0]]
    with pytest.raises(ValueError, match="read-only"):
        given.xyz[0, 0] = 1.0


@pytest.mark.parametrize(
    ("stamps", "xyz", "quat", "said"),
    [
        ([2, 1], [(0, 0, 0)] * 2, None, "must rise, but number 1 is 1, after 2"),
        ([1, 1], [(0, 0, 0)] * 2, None, "must rise"),
        ([0.5], [(0, 0, 0)], None, "expected integers"),
        ([2**63 - 1], [(0, 0, 0)], None, "146 years"),
        ([1], [(0, 0)], None, "expected shape (1, 3)"),
        ([1], [(0, math.nan, 0)], None, "xyz[0] must be finite"),
        ([1], [(0, 0, 0)], [(0, 0, 0, 2)], "quat_xyzw[0] must have norm 1"),
        ([1], ["far"], None, "expected numbers"),
    ],
)
def test_what_is_no_trajectory_is_refused(stamps: Any, xyz: Any, quat: Any, said: str) -> None:
    """The sentence names the array, and the row where there is one."""
    with pytest.raises(InvalidArgumentException) as raised:
        Trajectory("map", "base", stamps, xyz, quat)
    assert said in str(raised.value)


def test_a_frame_is_not_moved_in_itself() -> None:
    """The two frames differ, and their names are those of frames."""
    for parent, child in (("map", "map"), ("/map", "base"), ("map", "")):
        with pytest.raises(InvalidArgumentException):
            Trajectory(parent, child, [], [])
