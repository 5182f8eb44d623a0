"""A pause of the recorder is neither a gap of the robot, nor is anything interpolated across it."""

from pathlib import Path

import pytest

from tests.recordings import at, described, publisher, statics, steadily, write
from tfbus import ExtrapolationException, Recording
from tfbus.frames.recorded_poses import poses_at, stamps_at_rate
from tfbus.recording.edit import Span, cut
from tfbus.recording.items import EventItem, Item, Pause, pauses_of, recorded_ns
from tfbus.recording.reader import RecordingReader
from tfbus.recording.summary import summary_of
from tfbus.recording.writer import RecordingWriter

SIM, ARM = publisher("sim"), publisher("arm")
WHY = r"the recorder was paused from \+10.000s to \+20.000s"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """30 s, paused from 10 to 20 s: base at 10 Hz, arm at 2 Hz, a laser fixed to base."""
    return write(
        tmp_path / "run.mcap",
        described(SIM, 0.0, ("world", "base", False), ("base", "laser", True)),
        statics(SIM, 0.001, ("base", "laser", 0.2)),
        _sent(),
        EventItem(at(10.0), "paused"),
        EventItem(at(20.0), "resumed"),
    )


def _sent() -> list[Item]:
    return [
        *steadily(SIM, 0.0, 30.0, ("world", "base"), pause=(9.95, 20.0)),
        *steadily(ARM, 0.0, 30.0, ("base", "arm"), rate_hz=2.0, pause=(9.95, 20.0)),
    ]


def x(recording: Recording, source: str, seconds: float) -> float:
    return float(recording.lookup_transform("world", source, at(seconds)).transform.x)


def test_a_lookup_in_a_pause_has_no_answer(path: Path) -> None:
    """Not even between the last sample of a slow frame and the pause."""
    with Recording(path) as recording:
        assert x(recording, "base", 9.85) == pytest.approx(9.85)
        assert x(recording, "base", 20.05) == pytest.approx(20.05)
        for source, seconds in (("base", 9.95), ("base", 15.0), ("arm", 9.7), ("laser", 19.95)):
            with pytest.raises(ExtrapolationException, match=WHY):
                x(recording, source, seconds)
        with pytest.raises(ExtrapolationException, match=WHY):
            recording.lookup_transforms("world", "base", [at(5.0), at(15.0)])


def test_a_static_path_has_an_answer_in_a_pause(path: Path) -> None:
    """It does not change."""
    with Recording(path) as recording:
        assert recording.can_transform("base", "laser", at(15.0))


def test_a_pause_within_a_chunk_is_seen(tmp_path: Path) -> None:
    """One of 0.3 s, where the messages before and after it are stored together."""
    path = write(
        tmp_path / "short.mcap",
        steadily(SIM, 0.0, 1.0, ("world", "base"), pause=(0.35, 0.7)),
        EventItem(at(0.4), "paused"),
        EventItem(at(0.65), "resumed"),
    )
    with Recording(path) as recording:
        assert x(recording, "base", 0.25) == pytest.approx(0.25)
        assert not recording.can_transform("world", "base", at(0.5))
        assert x(recording, "base", 0.85) == pytest.approx(0.85)


def test_the_buffer_of_a_recording_has_both_sides_of_a_pause(path: Path) -> None:
    """And no answer in it."""
    with Recording(path) as recording:
        buffer = recording.buffer()
    assert buffer.can_transform("world", "arm", at(5.0))
    assert buffer.can_transform("world", "arm", at(25.0))
    with pytest.raises(ExtrapolationException, match=WHY):
        buffer.lookup_transform("world", "arm", at(15.0))


def test_a_trajectory_at_a_rate_leaves_out_a_pause(path: Path) -> None:
    """As does one at the samples of a frame."""
    with Recording(path) as recording:
        stamps = stamps_at_rate(at(0.0), at(29.0), 10.0)
        stamps_s = (poses_at(recording, "world", "base", stamps).stamps_ns - at(0.0)) / 1e9
        assert not ((stamps_s > 9.9) & (stamps_s < 20.0)).any()
        assert len(stamps_s) == 100 + 91
        assert len(recording.trajectory("world", "arm")) == len(recording.samples("arm"))


def test_rates_and_gaps_do_not_count_a_pause(path: Path) -> None:
    """The summary lists the pauses instead."""
    with RecordingReader(path) as reader:
        summary = summary_of(reader)
    flows = {each.name: each.flow for each in summary.streams}
    assert flows["sim"].rate == pytest.approx(10.0)
    assert flows["arm"].rate == pytest.approx(2.0)
    assert (flows["arm"].longest_gap_s or 0.0) <= 0.51
    assert summary.pauses == (Pause(at(10.0), at(20.0)),)
    assert summary.recorded_s == pytest.approx(summary.duration_s - 10.0)


def test_a_silence_beside_a_pause_is_a_gap(tmp_path: Path) -> None:
    """From the last message to the pause, or from its end to the next one."""
    path = write(
        tmp_path / "silent.mcap",
        steadily(SIM, 0.0, 30.0, ("world", "base"), pause=(5.0, 24.0)),
        EventItem(at(10.0), "paused"),
        EventItem(at(20.0), "resumed"),
    )
    with RecordingReader(path) as reader:
        flow = summary_of(reader).streams[0].flow
    assert flow.longest_gap_s == pytest.approx(5.1, abs=0.05)


def test_what_was_cut_out_is_a_pause(path: Path, tmp_path: Path) -> None:
    """With another reason."""
    target = tmp_path / "cut.mcap"
    with RecordingReader(path) as reader, RecordingWriter(target) as writer:
        for item in cut(reader, [Span(at(1.0), at(3.0)), Span(at(5.0), at(8.0))]):
            writer.write(item)
    with Recording(target) as recording:
        assert [each.why for each in recording.pauses] == ["cut out"]
        with pytest.raises(ExtrapolationException, match="was cut out"):
            x(recording, "base", 4.0)


@pytest.mark.parametrize(("second", "pauses"), [("b", 1), ("a", 0), ("", 0)])
def test_between_two_recordings_the_recorder_was_stopped(
    tmp_path: Path, second: str, pauses: int
) -> None:
    """The files of one recording say that they are of one; foreign ones say nothing."""
    for name, recording, from_s in (("1", "a", 0.0), ("2", second, 60.0)):
        about = {"recording": recording} if recording else {}
        with RecordingWriter(tmp_path / f"{name}.mcap", about=about) as writer:
            for item in steadily(SIM, from_s, from_s + 5.0, ("world", "base")):
                writer.write(item)
    with Recording(tmp_path / "1.mcap", tmp_path / "2.mcap") as recording_of_two:
        assert [each.why for each in recording_of_two.pauses] == ["stopped"] * pauses
        assert recording_of_two.can_transform("world", "base", at(30.0)) is not bool(pauses)


def test_a_pause_without_an_end_lasts_to_the_end() -> None:
    """And one that begins twice is one."""
    events = [EventItem(at(each), "paused") for each in (5.0, 6.0)]
    assert pauses_of(events, at(9.0)) == (Pause(at(5.0), at(9.0)),)


def test_recorded_time_is_that_outside_of_pauses() -> None:
    """Of a pause only the part inside of the span counts."""
    pauses = [Pause(2, 4), Pause(8, 20)]
    assert recorded_ns(pauses, 0, 10) == 6
    assert recorded_ns(pauses, 3, 5) == 1
