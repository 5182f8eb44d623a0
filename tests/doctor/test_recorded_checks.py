"""The checks of a recording: each finds its trouble, and nothing in a healthy one."""

from collections.abc import Iterable
from pathlib import Path

import pytest

from tests.recordings import (
    at,
    described,
    gone,
    publisher,
    sent,
    statics,
    steadily,
    write,
)
from tfbus import NodeSettings
from tfbus.doctor.examination import OF_A_BUS, Finding, examine_recorded, examined
from tfbus.frames.recorded import RecordedFrames
from tfbus.recording.items import EventItem, Item
from tfbus.recording.reader import RecordingReader

SIM, BAD = publisher("sim"), publisher("bad")
HEALTHY: list[Item] = [
    described(SIM, 0.0, ("world", "base", False), ("base", "laser", True)),
    statics(SIM, 0.0, ("base", "laser", 0.2)),
    *steadily(SIM, 0.0, 20.0, ("world", "base")),
]
CLOCK_JUMPED = [
    sent(SIM, number / 10, ("world", "base", 0.0), stamp_ns=at(number / 10 - (number > 100)))
    for number in range(200)
]

TWIN = publisher("sim", 5.0)

TROUBLE: dict[str, tuple[list[Item], str]] = {
    "complete": (
        [*HEALTHY, EventItem(at(5.0), "dropped", "", {"messages": 7})],
        "the recorder dropped 7 messages",
    ),
    "conflicts": (
        [
            *HEALTHY,
            described(BAD, 5.0, ("world", "base", False)),
            *steadily(BAD, 5.0, 8.0, ("world", "base")),
            gone(BAD, 8.0),
        ],
        "from +5.000s to +8.000s, 'base' is published by several at once",
    ),
    "node-names": (
        [
            *HEALTHY,
            described(TWIN, 5.0, ("world", "base", False), ("base", "laser", True), pid=8),
            *steadily(TWIN, 5.0, 12.0, ("world", "base")),
        ],
        "from +5.005s to +11.905s, 2 nodes are called /sim: on robot, pid 7; on robot, pid 8",
    ),
    "loops": (
        [*HEALTHY, described(BAD, 5.0, ("laser", "world", False)), gone(BAD, 9.0)],
        "from +5.000s to +9.000s, ",
    ),
    "gone": ([*HEALTHY, gone(SIM, 20.0)], "from +20.000s on, the publisher of 'base', 'laser'"),
    "restarts": (
        [*HEALTHY, *steadily(publisher("sim", 21.0), 21.0, 25.0, ("world", "base"))],
        "/sim on robot, pid 7 began again at +21.005s",
    ),
    "clock-jumps": (CLOCK_JUMPED, "stamps of stream 'sim' jump back by 1.0 s at +10.1"),
    "rates": (
        [*HEALTHY, *steadily(SIM, 20.0, 25.0, ("world", "base"), rate_hz=50.0)],
        "'base' comes at",
    ),
    "gaps": (
        [*steadily(SIM, 0.0, 20.0, ("world", "base"), pause=(5.0, 8.0))],
        "'base' paused from +4.900s to +8.000s, for 3.1 s: lookups",
    ),
    "silent": ([described(BAD, 0.0, ("world", "cup", False)), *HEALTHY], "no transform of 'cup'"),
    "stale": (
        [
            *HEALTHY,
            described(BAD, 0.0, ("base", "cup", False)),
            *steadily(BAD, 0.0, 3.0, ("base", "cup")),
        ],
        "no sample of 'cup' for 17",
    ),
    "disconnected": (
        [*HEALTHY, *steadily(BAD, 0.0, 20.0, ("odom", "cup"))],
        "'odom' and 1 frame below it are a separate tree",
    ),
}


def findings(tmp_path: Path, items: Iterable[Item], from_s: float = 0.0) -> dict[str, Finding]:
    with RecordingReader(write(tmp_path / "run.mcap", items)) as reader:
        seen = examine_recorded(
            RecordedFrames(reader),
            NodeSettings("doctor"),
            max(reader.start_ns, at(from_s)),
            reader.end_ns,
        )
    return examined(seen)


def test_a_healthy_recording_has_no_finding(tmp_path: Path) -> None:
    """All checks are fine, or do not apply."""
    verdicts = {name: each.verdict for name, each in findings(tmp_path, HEALTHY).items()}
    assert set(verdicts.values()) <= {"ok", "skipped"}, verdicts
    assert verdicts["gaps"] == verdicts["complete"] == "ok"


def test_a_span_has_the_messages_at_both_of_its_ends(tmp_path: Path) -> None:
    """A message exactly at the beginning is counted, one before it is not."""
    times = [0.0, 1.0, 2.0, 3.0]
    sent_then = [sent(SIM, each, ("world", "base", 0.0), stamp_ns=at(each)) for each in times]
    path = write(tmp_path / "run.mcap", described(SIM, 0.0, ("world", "base", False)), sent_then)
    with RecordingReader(path) as reader:
        frames = RecordedFrames(reader)
        seen = examine_recorded(frames, NodeSettings("doctor"), at(1.0), at(2.0))
    assert seen.span is not None
    [samples] = seen.span.samples.values()
    assert samples.log_ns.tolist() == [at(1.0), at(2.0)]


def test_the_counts_of_nodes_are_not_recorded(tmp_path: Path) -> None:
    """Nothing is said of who reads a stream: a recording has what nodes said when they came."""
    found = findings(tmp_path, HEALTHY)
    assert {found[name] for name in ("unread", "buffers", "dropped", "callbacks")} == {OF_A_BUS}


@pytest.mark.parametrize("name", TROUBLE)
def test_a_check_finds_its_trouble_and_when_it_was(tmp_path: Path, name: str) -> None:
    """The evidence names the frame or stream, and for what passes the time as --at takes it."""
    items, text = TROUBLE[name]
    finding = findings(tmp_path, items)[name]
    assert finding.verdict in ("warn", "fail")
    assert text in " ".join(finding.evidence)
    assert finding.remedy


BACK, AGAIN = publisher("sim"), publisher("sim", 12.0)


@pytest.mark.parametrize(
    ("later", "remedy"),
    [
        ([], "or its link was cut"),
        ([described(BACK, 12.0, ("world", "base", False))], "check the link"),
        (
            [
                described(AGAIN, 12.0, ("world", "base", False)),
                *steadily(AGAIN, 12.0, 14.0, ("world", "base")),
            ],
            "see why its node ended",
        ),
    ],
    ids=["for good", "link", "restart"],
)
def test_the_remedy_for_a_publisher_that_left_is_by_what_is_known(
    tmp_path: Path, later: list[Item], remedy: str
) -> None:
    """It did not come back, came back as it was, or in another epoch."""
    items = [
        described(SIM, 0.0, ("world", "base", False)),
        *steadily(SIM, 0.0, 10.0, ("world", "base")),
        gone(SIM, 10.0),
        *later,
        *steadily(publisher("other"), 10.0, 15.0, ("world", "other")),
    ]
    finding = findings(tmp_path, items)["gone"]
    assert finding.verdict == "warn"
    assert remedy in finding.remedy


def test_the_logs_to_look_at_are_named_once(tmp_path: Path) -> None:
    """A publisher that was restarted, and left for good later, has one remedy for both."""
    items = [
        described(SIM, 0.0, ("world", "base", False)),
        *steadily(SIM, 0.0, 10.0, ("world", "base")),
        gone(SIM, 10.0),
        described(AGAIN, 12.0, ("world", "base", False)),
        *steadily(AGAIN, 12.0, 14.0, ("world", "base")),
        gone(AGAIN, 14.0),
        *steadily(publisher("other"), 10.0, 15.0, ("world", "other")),
    ]
    finding = findings(tmp_path, items)["gone"]
    assert len(finding.evidence) == 2
    assert finding.remedy.count("its log") == 1 and "or its link was cut" in finding.remedy


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("gone", "from +3.000s on, the publisher of 'cup' is gone"),
        ("conflicts", "from before +8.000s to +9.000s, 'base' is published by several at once"),
        ("node-names", "from before +8.000s to +11.905s, 2 nodes are called /sim"),
    ],
)
def test_a_trouble_of_before_the_span_does_not_begin_with_it(
    tmp_path: Path, name: str, text: str
) -> None:
    """Its true time is said, or that it was before; and nothing was restarted at the beginning."""
    cup = publisher("cup")
    items = [
        *TROUBLE["node-names"][0],
        described(cup, 0.0, ("base", "cup", False)),
        *steadily(cup, 0.0, 3.0, ("base", "cup")),
        gone(cup, 3.0),
        described(BAD, 6.0, ("world", "base", False)),
        gone(BAD, 9.0),
    ]
    found = findings(tmp_path, items, 8.0)
    assert found[name].evidence[0].startswith(text)
    assert found["restarts"].verdict == "ok"


def test_a_publisher_that_was_away_at_the_beginning_of_the_span_was_restarted(
    tmp_path: Path,
) -> None:
    """Only its later run sent in the span."""
    items = [
        described(SIM, 0.0, ("world", "base", False)),
        *steadily(SIM, 0.0, 5.0, ("world", "base")),
        gone(SIM, 5.0),
        described(AGAIN, 12.0, ("world", "base", False)),
        *steadily(AGAIN, 12.0, 14.0, ("world", "base")),
    ]
    [evidence] = findings(tmp_path, items, 8.0)["restarts"].evidence
    assert evidence.startswith("/sim on robot, pid 7 began again at +12.005s")
