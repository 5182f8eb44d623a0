"""A span of a recording, measured."""

from pathlib import Path

import pytest

from tests.recordings import (
    LATE_NS,
    at,
    described,
    publisher,
    sent,
    statics,
    steadily,
    write,
)
from tfbus.frames.meter import measured
from tfbus.frames.recorded import RecordedFrames
from tfbus.frames.report import EdgeFlow, PairWatch, Report
from tfbus.recording.items import EventItem
from tfbus.recording.reader import RecordingReader

SIM, ARM = publisher("sim"), publisher("arm")


def report(
    path: Path, from_s: float = 0.0, to_s: float | None = None, pair: PairWatch | None = None
) -> Report:
    with RecordingReader(path) as reader:
        to_ns = reader.end_ns if to_s is None else at(to_s)
        return measured(RecordedFrames(reader), at(from_s), to_ns, pair)


def flows(measured: Report) -> list[EdgeFlow]:
    """How the samples of the dynamic edges came."""
    return [row.flow for row in measured.rows() if not row.frame.static]


def test_rate_delay_and_gap_of_an_edge(tmp_path: Path) -> None:
    """Rate and jitter leave out the gap, which is reported with its length and its beginning."""
    path = write(
        tmp_path / "run.mcap",
        steadily(SIM, 0.0, 10.0, ("world", "base"), pause=(4.0, 7.0)),
    )
    (flow,) = flows(report(path))
    assert (flow.stream, flow.parent, flow.child) == ("sim", "world", "base")
    assert flow.rate_hz == pytest.approx(10.0)
    assert flow.jitter_s == pytest.approx(0.0, abs=1e-6)
    assert flow.delays_s and flow.delays_s.p99 == pytest.approx(LATE_NS / 1e9)
    assert (flow.gaps, flow.gap_from_ns) == (1, at(3.9) + LATE_NS)
    assert flow.longest_gap_s == pytest.approx(3.1)


def test_only_the_span_is_measured(tmp_path: Path) -> None:
    """What was missed or paused before the span does not count."""
    path = write(
        tmp_path / "run.mcap",
        described(SIM, 0.0, ("world", "base", False)),
        steadily(SIM, 0.0, 10.0, ("world", "base"), pause=(2.0, 3.0)),
    )
    whole, part = report(path), report(path, 5.0, 8.0)
    assert whole.tree.streams["sim"].missed == 10
    assert part.tree.streams["sim"].missed == 0
    assert [flow.gaps for flow in flows(part)] == [0]
    assert part.meter.stream("sim").messages_hz == pytest.approx(10.0, abs=0.5)


def test_out_of_order_and_zero_stamps_are_counted(tmp_path: Path) -> None:
    """As `tfbus monitor` counts them on a bus."""
    path = write(
        tmp_path / "run.mcap",
        [
            sent(SIM, 1.0 + number / 10, ("world", "base", 0.0), stamp_ns=stamp_ns)
            for number, stamp_ns in enumerate((at(1.0), at(0.5), 0, at(1.3)))
        ],
    )
    (flow,) = flows(report(path))
    assert (flow.out_of_order, flow.at_zero) == (2, 1)


def test_a_publisher_that_began_again_earlier_was_not_out_of_order(tmp_path: Path) -> None:
    """Only its samples that are older than one before of the same epoch count."""
    path = write(
        tmp_path / "run.mcap",
        [
            sent(publisher("sim", epoch_s), log_s, ("world", "base", 0.0), stamp_ns=at(stamp_s))
            for epoch_s, log_s, stamp_s in ((0, 1, 1), (0, 2, 3), (0, 3, 2), (3, 4, 1), (3, 5, 2))
        ],
    )
    (flow,) = flows(report(path))
    assert flow.out_of_order == 1


def test_a_pause_of_the_recorder_is_no_gap(tmp_path: Path) -> None:
    """Nothing is known of the time in which it was paused."""
    path = write(
        tmp_path / "run.mcap",
        steadily(SIM, 0.0, 10.0, ("world", "base"), pause=(4.0, 7.0)),
        EventItem(at(4.0), "paused"),
        EventItem(at(7.0), "resumed"),
    )
    (flow,) = flows(report(path))
    assert flow.gaps == 0
    assert flow.rate_hz == pytest.approx(10.0)


def test_both_publishers_of_a_frame_are_measured(tmp_path: Path) -> None:
    """Each has a row, also one whose samples were the last to come for a while only."""
    path = write(
        tmp_path / "run.mcap",
        steadily(SIM, 0.0, 10.0, ("world", "base")),
        steadily(ARM, 3.0, 5.0, ("world", "base"), rate_hz=20.0),
    )
    rates = {flow.stream: round(flow.rate_hz or 0.0) for flow in flows(report(path))}
    assert rates == {"sim": 10, "arm": 20}


def test_restarts_of_a_stream_are_counted(tmp_path: Path) -> None:
    """Each further epoch in the span is one."""
    path = write(
        tmp_path / "run.mcap",
        *(steadily(publisher("sim", each), each, each + 1.0, ("world", "base")) for each in (1, 4)),
    )
    assert report(path).meter.stream("sim").restarts == 1


def test_the_delay_of_a_pair_is_that_of_its_slowest_edge(tmp_path: Path) -> None:
    """It is looked up all the time, also while nothing comes."""
    path = write(
        tmp_path / "run.mcap",
        steadily(SIM, 0.0, 10.0, ("world", "base"), rate_hz=50.0),
        steadily(ARM, 0.0, 10.0, ("base", "arm"), rate_hz=50.0, pause=(5.0, 7.0)),
        statics(ARM, 0.0, ("arm", "tool", 1.0)),
    )
    pair = report(path, pair=PairWatch("world", "tool", 1000)).pair
    assert pair is not None and pair.net_delay_s is not None
    assert pair.chain == ("world", "base", "arm", "tool")
    assert pair.net_delay_s.max == pytest.approx(2.0, abs=0.1)
    assert pair.net_delay_s.p50 < 0.03
