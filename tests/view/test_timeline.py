"""The marks of a timeline: what the events of a recording say, and its silences."""

from collections.abc import Iterable
from pathlib import Path

import pytest

from tests.builders import S
from tests.view.recordings import END_S, EVENTS, SIM, START_NS, at, described, gone, record
from tfbus.recording.items import EventItem
from tfbus.view.model.timeline import (
    Mark,
    Timeline,
    cut_to,
    in_order,
    known_timeline,
    marks_of_events,
    whole_timeline,
)

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
    """Those that last into it, too."""
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
    from tfbus.recording.reader import RecordingReader

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
