"""The lines of `tfbus bag record` while it records."""

from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest

from tfbus.bag.keeping import WrittenPart
from tfbus.cli.bag.record_status import (
    LogPace,
    Rates,
    Rating,
    RecordCounts,
    clock_text,
    log_text,
    status_parts,
    summary,
)

LOOK = RecordCounts(10.0, 500, 25_000, 1_500_000, 60_000_000_000, 0)
RATES = Rates(50.0, 2500.0, 250_000.0)


def test_the_line_has_time_rates_size_disk_and_losses_in_80_columns() -> None:
    """How long the disk lasts follows from how fast the file grows."""
    assert list(status_parts(LOOK, RATES, 725.9)) == [
        "rec 0:12:05",
        "50 msg/s",
        "2500 tf/s",
        "1.5 MB +250 kB/s",
        "free 60 GB, 3 days",
        "dropped 0",
    ]
    assert len(" ".join(status_parts(LOOK, RATES, 725.9))) < 80


def test_a_disk_that_lasts_long_needs_no_word() -> None:
    """Nor does one onto which nothing is written."""
    for rates in (Rates(1.0, 1.0, 10.0), Rates()):
        assert "free 60 GB" in status_parts(LOOK, rates, 0.0)


def test_a_pause_and_losses_show() -> None:
    """The first word and the last are the ones to look at."""
    paused = RecordCounts(10.0, 0, 0, 0, 1_000, 7, is_paused=True)
    parts = status_parts(paused, Rates(), 3.0)
    assert (parts[0], parts[-1]) == ("paused 0:00:03", "dropped 7")
    assert log_text(paused, Rates()).startswith("Paused: 0 messages/s")


def test_what_never_came_was_not_dropped_here() -> None:
    """Its count is apart: the disk is not to blame, and a gap that is filled may bring it."""
    look = replace(LOOK, missing=9)
    assert status_parts(look, RATES, 3.0)[-2:] == ["missing 9", "dropped 0"]
    assert log_text(look, RATES).endswith(", 0 dropped, 9 missing")


def test_what_a_snapshot_would_have() -> None:
    """Where nothing is written, the line says what is held."""
    held = RecordCounts(10.0, 500, 0, 0, 1_000, 0, held=(86_300, 29.6), files=2)
    parts = status_parts(held, RATES, 60.0)
    assert (parts[0], *parts[2:4]) == ("hold 0:01:00", "last 30 s: 86.3 kB", "2 snapshots")
    assert "the last 30 s held, 86.3 kB" in log_text(held, RATES)


def test_rates_are_those_of_the_last_seconds() -> None:
    """What was long ago does not count."""
    rating = Rating(over_s=3.0)
    rates = Rates()
    for second, messages in enumerate((0, 1000, 1000, 1000, 1000, 1050)):
        rates = rating.add(RecordCounts(float(second), messages, 2 * messages, 0, 0, 0))
    assert rates.messages == pytest.approx(50 / 3) and rates.transforms == pytest.approx(100 / 3)


def test_the_log_says_the_same_in_words() -> None:
    """A line without abbreviations."""
    assert log_text(LOOK, RATES).split(", ") == [
        "50 messages/s",
        "2500 transforms/s",
        "1.5 MB",
        "250 kB/s",
        "60 GB free for 3 days",
        "0 dropped",
    ]


def test_the_log_says_it_ever_more_rarely() -> None:
    """A day of a black box has some 150 lines; while a gap is filled it has one every 10 s."""
    pace = LogPace(0.0)
    looks = [replace(LOOK, at_s=second / 2.0) for second in range(2 * 86_400)]
    logged = [look.at_s for look in looks if pace.is_due(look)]
    assert logged[:4] == [10.0, 30.0, 70.0, 150.0] and len(logged) < 160
    filling = [replace(LOOK, at_s=86_400.0 + s, filling=("robot7 10 %",)) for s in range(100)]
    assert sum(map(pace.is_due, filling)) >= 9


def test_hours_and_days_go_on() -> None:
    """The clock counts hours."""
    assert clock_text(90_061) == "25:01:01"


def test_the_sum_fits_a_screen_and_names_what_is_missing() -> None:
    """Of many files the first and the last are named; what was lost is said in words."""
    parts = [WrittenPart(Path(f"run_{number}.mcap"), 1.625, 1_000) for number in range(40)]
    streams = Counter({f"stream{number}": 10 for number in range(30)})
    topics = Counter({"pose": 5})
    lost = Counter({"transforms": 3, "missing": 2})
    lines = summary(parts, 1200, 2, streams, topics, lost)
    assert len(lines) < 20
    assert lines[:2] == ["Recorded 65.0 s to 40 files", "  run_0.mcap  1.6 s, 1 kB"]
    sent = next(line for line in lines if line.startswith("30 streams (stream0, stream1"))
    assert "and 24 more): 300 messages with 1,200 dynamic transforms, and 2 static" in sent
    assert "1 topic (pose): 5 messages" in lines
    assert any(line.startswith("Not recorded: 3 messages ") for line in lines)


def test_all_files_that_are_left_are_named() -> None:
    """Also if the first of them were deleted."""
    parts = [WrittenPart(Path(f"my_run_{number}.mcap"), 1.0, 100) for number in range(8, 12)]
    lines = summary(parts, 1, 0, Counter(sim=1), Counter(), Counter(), deleted=8)
    assert lines[-1] == "Look into it: tfbus bag info my_run_*.mcap"


def test_a_file_with_a_space_is_named_as_a_shell_takes_it() -> None:
    """The command that looks into it can be copied, also for all parts of a recording."""
    nothing: Counter[str] = Counter()
    parts = [WrittenPart(Path(f"left arm{number}.mcap"), 1.0, 1_000) for number in ("", "_1")]
    one = summary(parts[:1], 0, 0, nothing, nothing, nothing)
    assert one[-1].endswith(" info 'left arm.mcap'")
    many = summary(parts * 2, 0, 0, nothing, nothing, nothing)
    assert many[-1].endswith(" info 'left arm'*.mcap")


def test_without_a_snapshot_there_is_nothing_to_sum_up() -> None:
    """The end of a recorder that was never asked."""
    empty: Counter[str] = Counter()
    [line] = summary([], 0, 0, empty, empty, empty)
    assert line.startswith("Recorded nothing: ")


def test_the_length_is_that_of_the_files() -> None:
    """What a snapshot lacks, the time before it, does not count; nor do deleted files."""
    empty: Counter[str] = Counter()
    parts = [WrittenPart(Path("a.mcap"), 4.0, 2_000), WrittenPart(Path("b.mcap"), 0.0, 1_000)]
    total, *files = summary(parts, 0, 0, empty, empty, empty, deleted=3)[:3]
    assert "4.0 s to 2 files" in total and "deleted 3 older" in total
    assert files == ["  a.mcap  4.0 s, 2 kB", "  b.mcap  0 s, 1 kB"]
