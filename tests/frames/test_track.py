"""The poses of a frame over time: speeds and angles of known motions, and files of `tfbus echo`."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tfbus import Buffer, DecodeError, Trajectory, Transform, TransformStamped
from tfbus.frames import picture
from tfbus.frames.document import CSV_HEADER, Numbers, csv_line, json_line
from tfbus.frames.track import (
    angular_speed,
    gaps_of,
    linear_speed,
    rpy_rad,
    seconds_of,
    track_from_buffer,
)
from tfbus.geometry.trajectory import read_echo
from tfbus.geometry.transform_array import TransformArray

NS = 1_000_000_000
START_NS = 1_670_400_300 * NS


def circling(radius_m: float, rad_per_s: float, seconds: float) -> Buffer:
    """world -> turtle on a circle, looking ahead, 100 times a second."""
    buffer = Buffer(cache_time_s=1_000.0)
    for step in range(round(seconds * 100) + 1):
        angle = rad_per_s * step / 100
        xyz = [radius_m * math.cos(angle), radius_m * math.sin(angle), 0.0]
        pose = Transform.from_rpy(0.0, 0.0, angle + math.pi / 2, xyz)
        buffer.set_transform(TransformStamped(START_NS + step * NS // 100, "world", "turtle", pose))
    return buffer


def track_of(buffer: Buffer, seconds: float, rate_hz: float = 100.0) -> Trajectory:
    until_ns = START_NS + round(seconds * NS)
    return track_from_buffer(buffer, "world", "turtle", START_NS, until_ns, rate_hz)


@given(
    radius_m=st.floats(min_value=0.1, max_value=10.0),
    rad_per_s=st.floats(min_value=0.1, max_value=6.0),
)
def test_a_circle_has_its_speeds(radius_m: float, rad_per_s: float) -> None:
    """On a circle the linear speed is radius times angular speed, and yaw never jumps."""
    track = track_of(circling(radius_m, rad_per_s, 3.0), 3.0)
    chord = 2 * math.sin(rad_per_s / 200) * radius_m * 100  # the straight way from pose to pose
    assert linear_speed(track) == pytest.approx(chord, rel=1e-6)
    assert angular_speed(track) == pytest.approx(rad_per_s, rel=1e-6)
    roll, pitch, yaw = rpy_rad(track).T
    assert np.abs(roll).max() < 1e-9
    assert np.abs(pitch).max() < 1e-9
    assert yaw == pytest.approx(math.pi / 2 + rad_per_s * seconds_of(track), abs=1e-6)


@pytest.mark.parametrize("pitch", [-90.0, -89.9999999, -30.0, 0.0, 60.0, 89.99999, 90.0])
def test_a_plot_has_the_orientation_that_echo_prints(pitch: float) -> None:
    """At every pitch: at 90 degrees, too, the angles make the rotation."""
    turns = [Transform.from_rpy(roll, pitch, 50.0, degrees=True) for roll in (12.5, 20.0, -170.0)]
    stamps_ns = START_NS + NS * np.arange(3)
    poses = TransformArray.of(turns)
    track = Trajectory("world", "turtle", stamps_ns, poses.xyz, poses.quat_xyzw)
    for angles, turn in zip(rpy_rad(track), turns, strict=True):
        differences = angles - np.array(turn.as_rpy())
        assert np.abs(np.sin(differences / 2)).max() < 1e-9


def test_a_track_has_known_times_only() -> None:
    """Times before the first and after the last sample are left out."""
    buffer = circling(1.0, 1.0, 1.0)
    track = track_from_buffer(buffer, "world", "turtle", START_NS - 5 * NS, START_NS + 5 * NS, 10.0)
    assert len(track) == 11
    assert (track.stamps_ns[0], track.stamps_ns[-1]) == (START_NS, START_NS + NS)


@pytest.mark.parametrize("form", ["csv", "json"])
def test_output_of_echo_is_read(form: str, tmp_path: Path) -> None:
    """The rows of `tfbus echo --format csv` or json are read, in the order of their stamps."""
    buffer = circling(2.0, 0.5, 1.0)
    numbers = Numbers(3, raw_zeros=False)
    write = {"csv": csv_line, "json": json_line}[form]
    stamps = [START_NS + tenth * NS // 10 for tenth in (1, 0, 2)]
    lines = [write(buffer.lookup_transform("world", "turtle", at), numbers) for at in stamps]
    file = tmp_path / "turtle"
    file.write_text("\n".join(([CSV_HEADER] if form == "csv" else []) + lines) + "\n")
    track = read_echo(file)
    assert (track.frame_id, track.child_frame_id) == ("world", "turtle")
    assert track.stamps_ns.tolist() == sorted(stamps)
    expected = track_of(buffer, 0.2, rate_hz=10.0)
    assert track.xyz == pytest.approx(expected.xyz)
    assert track.quat_xyzw == pytest.approx(expected.quat_xyzw)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "no column"),
        ("x,y\n1,2\n", "first line"),
        ("stamp_ns,frame_id,child_frame_id,x,y,z,qx,qy,qz,qw\n", "no pose"),
        ("stamp_ns,frame_id,child_frame_id,x,y,z,qx,qy,qz,qw\n1,a,b,0,0,0,0,0,0,x\n", "line 2"),
        ('{"stamp_ns": 1}\n', "line 1"),
        ("{\n", "line 1"),
        ('{"xyz": ' + "[" * 100_000, "line 1"),
        (
            '{"stamp_ns": 1, "frame_id": "a", "child_frame_id": "b", "xyz": [0, 0, 0], '
            '"quat_xyzw": [0, 0, 0, 1]}\n[]\n',
            "line 2",
        ),
    ],
)
def test_another_file_is_refused(text: str, reason: str, tmp_path: Path) -> None:
    """The error names the first wrong line."""
    file = tmp_path / "file"
    file.write_text(text)
    with pytest.raises(DecodeError, match=reason):
        read_echo(file)


@pytest.mark.parametrize("form", ["csv", "json"])
def test_two_pairs_of_frames_are_refused(form: str, tmp_path: Path) -> None:
    """A file with the poses of two pairs of frames is no trajectory, and the error names them."""
    numbers = Numbers(3, raw_zeros=False)
    write = {"csv": csv_line, "json": json_line}[form]
    lines = [
        write(TransformStamped(NS, "world", child, Transform.identity()), numbers)
        for child in ("turtle", "drone")
    ]
    file = tmp_path / "two"
    file.write_text("\n".join(([CSV_HEADER] if form == "csv" else []) + lines) + "\n")
    with pytest.raises(DecodeError, match="drone"):
        read_echo(file)


def test_a_gap_is_between_poses_that_are_far_apart() -> None:
    """Five periods and a quarter of a second: a line is not drawn across it."""
    seconds = [0.0, 0.1, 0.2, 3.2, 3.3, 3.4]
    stamps = np.array([round(each * NS) for each in seconds])
    track = Trajectory("world", "drone", stamps, np.zeros((6, 3)))
    assert gaps_of(track).tolist() == [False, False, True, False, False]
    seconds_drawn = picture.broken(track, seconds_of(track))
    assert len(seconds_drawn) == 7 and np.isnan(seconds_drawn[3])
