"""The marks of a timeline: the events of a recording, and its silences."""

from collections.abc import Iterable, Sequence
from itertools import accumulate
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.builders import S, examples
from tests.view.recordings import END_S, EVENTS, SIM, START_NS, at, base_at, described, gone, record
from tfbus import NodeSettings
from tfbus.doctor.examination import examine_recorded
from tfbus.frames.recorded import RecordedFrames
from tfbus.geometry.columns import Columns
from tfbus.recording.items import EventItem, RecordedStream, TransformItem
from tfbus.recording.reader import RecordingReader
from tfbus.view.timeline import (
    Mark,
    Timeline,
    cut_to,
    in_order,
    known_timeline,
    marks_of_events,
    whole_timeline,
)

pytest.importorskip("mcap", reason="needs mcap: the extra bag")
from tfbus.recording.writer import RecordingWriter

Told = tuple[str, float, float, str]

IN_ORDER: list[Told] = [
    ("gone", 5.0, 6.0, "'sim' gone: /sim on robot, pid 7"),
    ("back", 6.0, 6.0, "'sim' back after 1.0 s, restarted"),
    ("conflict", 8.0, 9.0, "'base' published by 'sim' and 'twin'"),
    ("gone", 9.0, 12.0, "'twin' gone: /twin on robot, pid 7"),
]


def told(marks: Iterable[Mark]) -> list[Told]:
    """Kind, start and end in seconds, and text of marks."""
    return [
        (mark.kind, (mark.start_ns - START_NS) / S, (mark.end_ns - START_NS) / S, mark.text)
        for mark in marks
    ]


def told_of(*events: EventItem) -> list[Told]:
    """What the timeline of these events says."""
    return told(in_order(marks_of_events(events, at(END_S))))


def recorded_with(folder: Path, events: Sequence[EventItem], times_s: Sequence[float]) -> Path:
    """A recording of these events, and of the base, which `sim` sends at these times."""
    sim = RecordedStream(SIM, epoch_ns=at(-1.0))
    sent = [
        TransformItem(at(each), sim, Columns.of_transforms([base_at(each)]), seq=number)
        for number, each in enumerate(times_s)
    ]
    with RecordingWriter(folder / "run.mcap") as writer:
        for item in sorted([*events, *sent], key=lambda item: item.log_ns):
            writer.write(item)
    return folder / "run.mcap"


def timeline_of(path: Path) -> Timeline:
    """The timeline of a whole recording."""
    with RecordingReader(path) as reader:
        known = known_timeline(reader, reader.start_ns, reader.end_ns)
        whole = whole_timeline(reader, known, lambda: False)
    assert whole is not None
    return whole


def test_streams_that_leave_and_come_back_and_conflicts_are_marked() -> None:
    """With their publishers, and for as long as they lasted."""
    assert told_of(*EVENTS) == IN_ORDER


def test_a_restart_without_a_loss_is_marked() -> None:
    """By the larger epoch; another description of the same epoch is nothing."""
    frame = ("map", "base", False)
    assert told_of(
        described(0.0, SIM, 0.0, frame),
        described(1.0, SIM, 0.0, frame, ("base", "arm", False)),
        described(2.0, SIM, 2.0, frame),
    ) == [("restart", 2.0, 2.0, "'sim' restarted: /sim on robot, pid 7")]


def test_a_stream_that_lists_another_frame_begins_another_conflict() -> None:
    """The former ends there."""
    base, arm = ("map", "base", False), ("base", "arm", False)
    assert told_of(
        described(0.0, "a", 0.0, base, arm),
        described(1.0, "b", 0.0, base),
        described(2.0, "b", 0.0, base, arm),
        described(3.0, "b", 0.0),
    ) == [
        ("conflict", 1.0, 2.0, "'base' published by 'a' and 'b'"),
        ("conflict", 2.0, 3.0, "'arm', 'base' published by 'a' and 'b'"),
    ]


def test_what_the_recorder_missed_is_marked() -> None:
    """Its pauses, also to the end, and what it dropped."""
    assert told_of(
        EventItem(at(1.0), "paused"),
        EventItem(at(3.0), "resumed"),
        EventItem(at(4.0), "dropped", facts={"messages": 7}),
        EventItem(at(10.0), "paused"),
    ) == [
        ("paused", 1.0, 3.0, "recording paused for 2.0 s"),
        ("dropped", 4.0, 4.0, "7 messages not recorded: the recorder was too slow"),
        ("paused", 10.0, 12.0, "recording paused for 2.0 s"),
    ]


@pytest.mark.parametrize(
    "facts",
    [
        {},
        {"frames": 3, "epoch": "x"},
        {"frames": [3, ["a"], ["a", 3, False], ["a", "b\x1b[2J", True]], "node": 3, "pid": "\n"},
    ],
)
def test_facts_that_are_no_facts_are_passed_over(facts: dict[str, object]) -> None:
    """They come from a file; nothing of them reaches the page that cannot be printed."""
    marks = told_of(
        EventItem(at(0.0), "stream", "x\x1b", facts),
        EventItem(at(0.0), "stream", "y", facts),
        gone(1.0, "x\x1b"),
        gone(1.0, "never there"),
    )
    assert [mark[0] for mark in marks if mark[0] == "gone"] == ["gone"]
    assert all(text.isprintable() for _, _, _, text in marks)


def test_what_happens_to_several_streams_at_once_is_one_mark() -> None:
    """As if a machine leaves; half a second is at once."""
    marks = [
        Mark("gone", at(1.0 + number / 10), at(5.0), "gone", (f"arm{number}",), f": pid {number}")
        for number in range(5)
    ]
    later = Mark("gone", at(2.0), at(5.0), "gone", ("leg",), ": pid 9")
    assert told(in_order([later, *marks])) == [
        ("gone", 1.0, 5.0, "'arm0', 'arm1', 'arm2' and 2 more gone"),
        ("gone", 2.0, 5.0, "'leg' gone: pid 9"),
    ]


def test_a_span_keeps_the_marks_that_it_has_something_of() -> None:
    """Marks that last into it are kept, too."""
    marks = in_order(marks_of_events(EVENTS, at(END_S)))
    assert told(cut_to(marks, at(5.5), at(7.0))) == IN_ORDER[:2]


def test_marks_are_found_from_a_time_on() -> None:
    """The next one, and the one before."""
    timeline = Timeline(START_NS, at(END_S), in_order(marks_of_events(EVENTS, at(END_S))))
    after, before = timeline.next_mark(at(5.0)), timeline.mark_before(at(8.0))
    assert after is not None and after.kind == "back"
    assert before is not None and before.kind == "back"
    assert timeline.next_mark(at(9.0)) is None and timeline.mark_before(at(5.0)) is None


def test_silence_is_found_in_the_file_and_how_busy_it_was(tmp_path: Path) -> None:
    """A stream that is gone is not silent as well."""
    path = record(tmp_path / "a.mcap")
    with RecordingReader(path) as reader:
        known = known_timeline(reader, reader.start_ns, reader.end_ns)
        assert told(known.marks) == IN_ORDER
        whole = whole_timeline(reader, known, lambda: False)
        assert whole is not None
        assert told(whole.marks) == [("gap", 2.0, 4.0, "'sim' silent for 2.0 s"), *IN_ORDER]
        bars = len(whole.activity)
        busy = [n for n, count in enumerate(whole.activity) if count]
        assert not [n for n in busy if 2.1 / END_S < n / bars < 3.9 / END_S]
        assert sum(whole.activity) == 41 + 20 + 121
        assert whole_timeline(reader, known, lambda: True) is None


def test_a_stream_that_was_silent_before_it_was_gone_has_both_marks(tmp_path: Path) -> None:
    """A broken link is noticed late: until then the stream is silent, and from then on gone."""
    frame = ("map", "base", False)
    events = [described(0.0, SIM, -1.0, frame), gone(5.0, SIM), described(7.0, SIM, -1.0, frame)]
    path = recorded_with(tmp_path, events, [0.0, 0.1, 0.2, 0.3, 7.1, 7.2, 7.3])
    assert told(timeline_of(path).marks) == [
        ("gap", 0.3, 5.0, "'sim' silent for 4.7 s"),
        ("gone", 5.0, 7.0, "'sim' gone: /sim on robot, pid 7"),
        ("back", 7.0, 7.0, "'sim' back after 2.0 s"),
    ]


def test_two_gaps_of_one_stream_are_two_marks(tmp_path: Path) -> None:
    """Equally long, and less than half a second apart."""
    path = recorded_with(tmp_path, [], [0.0, 0.05, 0.1, 0.15, 0.45, 0.75, 0.8, 0.85, 0.9])
    assert [mark.kind for mark in timeline_of(path).marks] == ["gap", "gap"]


@settings(max_examples=examples(40))
@given(
    st.lists(st.sampled_from([0.01, 0.04, 0.05, 0.06, 0.2, 0.24, 0.26, 0.5, 1.0, 3.0])),
    st.none() | st.tuples(st.floats(0.0, 5.0), st.floats(0.1, 5.0)),
)
def test_the_gaps_are_those_that_the_doctor_finds(
    tmp_path_factory: pytest.TempPathFactory,
    waits_s: list[float],
    pause: tuple[float, float] | None,
) -> None:
    """As many, the longest at the same time, and none in a pause of the recorder."""
    begin_s, length_s = pause or (0.0, 0.0)
    begin_ns, end_ns = at(begin_s), at(begin_s + length_s)
    times = [0.0, *accumulate(waits_s)]
    times = [each for each in times if not begin_ns < at(each) < end_ns]
    events = [EventItem(begin_ns, "paused"), EventItem(end_ns, "resumed")] if pause else []
    path = recorded_with(tmp_path_factory.mktemp("gaps"), events, times)
    # Silence at the end is the view's own.
    marks = [mark for mark in timeline_of(path).marks if mark.start_ns < at(times[-1])]
    gaps = [mark for mark in marks if mark.kind == "gap"]
    with RecordingReader(path) as reader:
        frames = RecordedFrames(reader)
        span = reader.start_ns, reader.end_ns
        [flow] = examine_recorded(frames, NodeSettings("doctor"), *span).flows
    assert len(gaps) == flow.gaps
    longest = max(gaps, key=lambda mark: mark.end_ns - mark.start_ns, default=None)
    assert (longest.start_ns if longest else None) == flow.gap_from_ns
