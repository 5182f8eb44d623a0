"""Poses of a recording: at its samples, at a rate, at a moment."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.recordings import at, described, gone, publisher, sent, statics, steadily, write
from tfbus import NodeSettings, Recording
from tfbus.base.errors import TfbusError
from tfbus.command.recordings import BagChoice
from tfbus.command.types import parse_moment
from tfbus.frames.recorded_poses import recorded_track, recorded_transform, recorded_transforms
from tfbus.geometry.trajectory import Trajectory

SETTINGS = NodeSettings("echo")
SIM, ARM = publisher("sim"), publisher("arm")


@pytest.fixture
def bag(tmp_path: Path) -> BagChoice:
    """10 s: base at 10 Hz moves by 1 m/s, arm at 5 Hz in it too, tool is fixed to arm, late comes
    at 6 s.
    """
    late = publisher("late")
    return BagChoice(
        (
            write(
                tmp_path / "run.mcap",
                described(SIM, 0.0, ("world", "base", False)),
                steadily(SIM, 0.0, 10.0, ("world", "base")),
                described(ARM, 0.0, ("base", "arm", False), ("arm", "tool", True)),
                steadily(ARM, 0.0, 10.0, ("base", "arm"), rate_hz=5.0),
                statics(ARM, 0.0, ("arm", "tool", 0.5)),
                described(late, 6.0, ("base", "late", False)),
                steadily(late, 6.0, 10.0, ("base", "late")),
            ),
        )
    )


def poses(bag: BagChoice, source: str, rate_hz: float | None = None) -> dict[float, float]:
    """The x of the source in the world, by seconds from the beginning."""
    found = recorded_transforms(bag, SETTINGS, None, "world", source, rate_hz)
    return {(each.stamp_ns - at(0.0)) / 1e9: round(each.transform.x, 6) for each in found}


def test_a_pose_comes_for_each_sample_of_the_source(bag: BagChoice) -> None:
    """The source is the first dynamic frame on the way; between samples of other frames it
    interpolates.
    """
    found = poses(bag, "tool")
    assert list(found) == [pytest.approx(number / 5) for number in range(50)]
    assert found[4.2] == pytest.approx(8.9)


def test_a_rate_samples_the_span(bag: BagChoice) -> None:
    """From the first stamp that came in the span to the last, as `tfbus bag export` does."""
    span = replace(bag, begin=parse_moment("+2.005s"), end=parse_moment("+4.1s"))
    assert list(poses(span, "base", 4.0)) == [
        pytest.approx(2.0 + number / 4) for number in range(9)
    ]


def test_a_span_has_what_came_in_it(bag: BagChoice) -> None:
    """Samples that came before or after the span are left out."""
    span = replace(bag, begin=parse_moment("+2.05s"), end=parse_moment("+3.05s"))
    assert list(poses(span, "base")) == [pytest.approx(2.1 + number / 10) for number in range(10)]


def test_a_static_pose_comes_once(bag: BagChoice) -> None:
    """A path without a dynamic edge has one pose."""
    found = recorded_transforms(bag, SETTINGS, None, "arm", "tool")
    assert [(each.stamp_ns, each.transform.x) for each in found] == [(0, 0.5)]


def test_a_moment_is_interpolated_between_what_came_before_and_after(bag: BagChoice) -> None:
    """A lookup at a moment is by its stamp, with all that was recorded."""
    moment = replace(bag, at=parse_moment("+4.25s"))
    found = recorded_transform(moment, SETTINGS, None, "world", "tool")
    assert found.stamp_ns == pytest.approx(at(4.255), abs=10_000_000)
    seconds = (found.stamp_ns - at(0.0)) / 1e9
    assert found.transform.x == pytest.approx(2 * seconds + 0.5)


def test_a_fixed_frame_spans_from_the_moment_to_the_end(bag: BagChoice) -> None:
    """Where the source was at the moment, seen from where the target is at the end."""
    moment = replace(bag, at=parse_moment("+4s"))
    found = recorded_transform(moment, SETTINGS, None, "base", "base", "world")
    assert found.transform.x == pytest.approx(4.0 - 9.9, abs=0.01)


def test_a_frame_that_comes_later_is_named_with_its_time(bag: BagChoice) -> None:
    """So is one that does not come at all, with a near name."""
    moment = replace(bag, at=parse_moment("+4s"))
    with pytest.raises(TfbusError, match=r"'late' comes at \+6\.000s"):
        recorded_transform(moment, SETTINGS, None, "world", "late")
    with pytest.raises(TfbusError, match="did you mean 'tool'"):
        list(recorded_transforms(bag, SETTINGS, None, "world", "tol"))


def test_a_track_has_all_poses(bag: BagChoice) -> None:
    """For a plot, as arrays."""
    track = recorded_track(bag, SETTINGS, None, "world", "base")
    assert len(track) == 100
    assert track.xyz[:, 0] == pytest.approx((track.stamps_ns - track.stamps_ns[0]) / 1e9)


def test_the_poses_are_those_of_the_recording(bag: BagChoice) -> None:
    """The same stamps and poses, bit by bit, as tfbus.Recording gives."""
    with Recording(*bag.paths) as recording:
        path = recording.trajectory("world", "tool")
    track = recorded_track(bag, SETTINGS, None, "world", "tool")
    assert track.stamps_ns.tolist() == path.stamps_ns.tolist()
    assert track.xyz.tolist() == path.xyz.tolist()
    assert track.quat_xyzw.tolist() == path.quat_xyzw.tolist()


def test_a_restart_takes_none_of_the_poses_before_it(tmp_path: Path) -> None:
    """Nor is anything interpolated between the two epochs."""
    again = publisher("sim", 4.95)
    path = write(
        tmp_path / "restarted.mcap",
        described(SIM, 0.0, ("world", "base", False)),
        steadily(SIM, 0.0, 4.85, ("world", "base")),
        gone(SIM, 4.9),
        described(again, 5.0, ("world", "base", False)),
        steadily(again, 5.05, 8.0, ("world", "base")),
    )
    seconds = sorted(poses(BagChoice((path,)), "base"))
    before, behind = ([each for each in seconds if (each > 4.9) is late] for late in (False, True))
    assert (len(before), len(behind)) == (48, 30)


def test_a_static_set_holds_while_nothing_comes_until_it_is_replaced(tmp_path: Path) -> None:
    """A node that has crashed starts again 4 s later, with its sensor under another name."""
    again = publisher("sim", 6.9)
    path = write(
        tmp_path / "crashed.mcap",
        steadily(SIM, 0.0, 3.0, ("world", "base")),
        statics(SIM, 0.0, ("base", "lidar", 0.5)),
        steadily(again, 7.0, 9.0, ("world", "base")),
        statics(again, 7.0, ("base", "scanner", 0.7)),
    )
    with Recording(path) as recording:
        for known_s in (2.0, 3.5, 6.5):
            found = recording.lookup_transform("base", "lidar", at(known_s))
            assert found.transform.x == 0.5
        assert recording.lookup_transform("base", "scanner", at(7.5)).transform.x == 0.7


def test_stamps_that_are_years_apart_are_found_soon(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A transform from before a clock was set costs a few looks, not one for each ten minutes."""
    parts: list[tuple[int, int]] = []
    trajectory = Recording.trajectory

    def counted(recording: Recording, *span: Any, **sampling: Any) -> Trajectory:
        assert len(parts) < 100
        parts.append(span[2:])
        return trajectory(recording, *span, **sampling)

    monkeypatch.setattr(Recording, "trajectory", counted)
    bag = write(
        tmp_path / "run.mcap",
        described(SIM, 0.0, ("world", "base", False)),
        sent(SIM, 0.0, ("world", "base", -1.0), stamp_ns=5, seq=0),
        steadily(SIM, 1.0, 3.0, ("world", "base")),
    )
    found = recorded_transforms(BagChoice((bag,)), SETTINGS, None, "world", "base")
    assert [round(each.transform.x, 6) for each in found] == [
        -1.0,
        *(1.0 + number / 10 for number in range(20)),
    ]
