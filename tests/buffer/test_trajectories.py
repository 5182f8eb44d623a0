"""Trajectories into a buffer and out of it."""

import math
from pathlib import Path

import numpy as np
import pytest

from tests.builders import S, moved
from tfbus import (
    Buffer,
    ExtrapolationException,
    InvalidArgumentException,
    LookupException,
    LoopException,
    Trajectory,
)
from tfbus.buffer import trajectories


def minutes(count: int) -> Trajectory:
    """A base that drives 60 m a minute along x, with a pose each second."""
    seconds = np.arange(60 * count + 1)
    xyz = np.column_stack((seconds, 0 * seconds, 0 * seconds))
    return Trajectory("map", "base", seconds * S + S, xyz)


def mounted() -> Buffer:
    """That base with a camera, and with an odometry that begins and ends half a second later."""
    buffer = Buffer(math.inf)
    trajectories.insert(buffer, minutes(1)[:5], authority="slam")
    buffer.set_transform(moved(S, "base", "camera", 0.5), static=True)
    for second in range(1, 6):
        buffer.set_transform(moved(second * S + S // 2, "world", "map", 100.0))
    return buffer


def test_what_goes_in_comes_out() -> None:
    """The samples of a frame are those of the trajectory that was set."""
    samples = trajectories.samples(mounted(), "base")
    assert (samples.frame_id, samples.child_frame_id) == ("map", "base")
    assert samples.stamps_ns.tolist() == [1 * S, 2 * S, 3 * S, 4 * S, 5 * S]
    assert samples.xyz[:, 0].tolist() == [0, 1, 2, 3, 4]


def test_a_static_frame_has_one_sample() -> None:
    """With the stamp of its transform."""
    assert [pose.stamp_ns for pose in trajectories.samples(mounted(), "camera")] == [S]


def test_the_samples_of_a_former_parent_are_there_by_its_name() -> None:
    """A frame that changed its parent has a trajectory in each."""
    buffer = Buffer()
    buffer.set_transform(moved(1 * S, "odom", "base", 1.0))
    buffer.set_transform(moved(2 * S, "map", "base", 2.0))
    assert trajectories.samples(buffer, "base").xyz[:, 0].tolist() == [2.0]
    assert trajectories.samples(buffer, "base", parent="odom").xyz[:, 0].tolist() == [1.0]
    assert len(trajectories.samples(buffer, "base", parent="nowhere")) == 0


def test_a_frame_without_samples_is_named() -> None:
    """An unknown frame is a LookupException, a root an invalid argument."""
    with pytest.raises(LookupException):
        trajectories.samples(mounted(), "bass")
    with pytest.raises(InvalidArgumentException, match="'world' is a root"):
        trajectories.samples(mounted(), "world")


def test_a_trajectory_follows_the_samples_of_the_source() -> None:
    """Of a camera on a base those of the base; where an edge between has no data, none."""
    trajectory = trajectories.trajectory(mounted(), "world", "camera")
    assert trajectory.stamps_ns.tolist() == [2 * S, 3 * S, 4 * S, 5 * S]
    assert trajectory.xyz[:, 0].tolist() == [101.5, 102.5, 103.5, 104.5]


def test_a_trajectory_is_sampled_at_given_stamps() -> None:
    """Each must have an answer."""
    assert trajectories.trajectory(mounted(), "map", "base", [3 * S // 2]).xyz.tolist() == [
        [0.5, 0, 0]
    ]
    with pytest.raises(ExtrapolationException):
        trajectories.trajectory(mounted(), "map", "base", [9 * S])


def test_between_static_frames_stamps_must_be_given() -> None:
    """There is no motion to follow."""
    with pytest.raises(InvalidArgumentException, match=r"is static: .*stamps_ns"):
        trajectories.trajectory(mounted(), "base", "camera")
    assert len(trajectories.trajectory(mounted(), "base", "camera", [1, 2])) == 2


def test_a_trajectory_that_a_buffer_does_not_keep_is_refused_whole() -> None:
    """The sentence names the remedy, and nothing is stored."""
    buffer = Buffer()
    with pytest.raises(InvalidArgumentException, match=r"lasts 60.0 s, .* the last 10 s: .*inf"):
        trajectories.insert(buffer, minutes(1))
    assert buffer.frames() == []
    buffer.set_transform(moved(100 * S, "map", "base"))
    with pytest.raises(InvalidArgumentException, match="what the buffer holds"):
        trajectories.insert(buffer, minutes(1)[:5])


def test_an_unlimited_buffer_keeps_an_hour() -> None:
    """All poses are there, from the first to the last."""
    buffer = Buffer(math.inf)
    trajectories.insert(buffer, minutes(60))
    assert len(trajectories.samples(buffer, "base")) == 3601
    assert buffer.lookup_transform("map", "base", 1 * S).transform.x == 0.0
    assert buffer.lookup_transform("map", "base").transform.x == 3600.0


def test_a_trajectory_that_would_close_a_loop_is_refused() -> None:
    """As with one transform."""
    with pytest.raises(LoopException):
        trajectories.insert(mounted(), Trajectory("camera", "world", [9 * S], [(0, 0, 0)]))


def test_a_buffer_reads_files_in_one_line(tmp_path: Path) -> None:
    """TUM between two named frames, CSV with the frames in the file."""
    minutes(1)[:5].write_tum(tmp_path / "a.txt")
    buffer = Buffer()
    assert (
        len(trajectories.insert_tum(buffer, tmp_path / "a.txt", "map", "base", authority="slam"))
        == 5
    )
    assert buffer.frame("base").authority == "slam"
    trajectories.trajectory(mounted(), "world", "camera").write_csv(tmp_path / "a.csv")
    (read,) = trajectories.insert_csv(Buffer(), tmp_path / "a.csv")
    assert (read.frame_id, read.child_frame_id, len(read)) == ("world", "camera", 4)
