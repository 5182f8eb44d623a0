"""The frames at a moment of a recording: as a listener had them then."""

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.builders import x_of
from tests.recordings import (
    LATE_NS,
    at,
    described,
    gone,
    node,
    publisher,
    sent,
    statics,
    steadily,
    write,
)
from tfbus import Fleet, TimeoutException
from tfbus.frames.document import as_map
from tfbus.frames.moment import state
from tfbus.frames.recorded import RecordedFrames
from tfbus.recording.items import EventItem, EventKind, Item, TopicItem
from tfbus.recording.reader import RecordingReader

SIM, ARM = publisher("sim"), publisher("arm")
SIM_ROWS = (("world", "base", False), ("base", "laser", True))


def states(frames: RecordedFrames) -> dict[str, str]:
    tree = frames.tree()
    return {name: state(tree, frame) for name, frame in tree.frames.items()}


@pytest.fixture
def recording(tmp_path: Path) -> RecordingReader:
    """40 s: sim sends base at 10 Hz with a pause from 15 to 18 s, and laser once; arm is gone at
    12 s; another publisher of base is there from 20 to 26 s; late comes at 30 s.
    """
    bad, late = publisher("bad", 20.0), publisher("late", 30.0)
    path = write(
        tmp_path / "run.mcap",
        described(SIM, 0.0, *SIM_ROWS),
        statics(SIM, 0.001, ("base", "laser", 0.2)),
        steadily(SIM, 0.0, 40.0, ("world", "base"), pause=(15.0, 18.0)),
        described(ARM, 0.0, ("base", "arm", False)),
        steadily(ARM, 0.0, 12.0, ("base", "arm")),
        gone(ARM, 12.0),
        described(bad, 20.0, ("odom", "base", False)),
        steadily(bad, 20.05, 26.0, ("odom", "base")),
        gone(bad, 26.0),
        described(late, 30.0, ("base", "late", False)),
        steadily(late, 30.0, 40.0, ("base", "late")),
    )
    with RecordingReader(path) as reader:
        yield reader


@pytest.mark.parametrize(
    ("seconds", "expected"),
    [
        (1.0, {"world": "root", "base": "dynamic", "laser": "static", "arm": "dynamic"}),
        (14.0, {"world": "root", "base": "dynamic", "laser": "static", "arm": "gone"}),
        (16.5, {"world": "root", "base": "stale", "laser": "static", "arm": "gone"}),
    ],
)
def test_states_are_those_of_then(
    recording: RecordingReader, seconds: float, expected: dict[str, str]
) -> None:
    """A frame is dynamic, stale or gone as it was at the moment, not as it became."""
    frames = RecordedFrames(recording)
    frames.seek(at(seconds))
    assert states(frames) == expected


def test_a_conflict_is_one_while_both_publishers_are_there(recording: RecordingReader) -> None:
    """It begins with the second publisher, and ends when that is gone."""
    frames = RecordedFrames(recording)
    conflicts = {}
    for seconds in (19.0, 22.0, 27.0):
        frames.seek(at(seconds))
        conflicts[seconds] = frames.tree().conflicts
    assert conflicts == {19.0: frozenset(), 22.0: {"base"}, 27.0: frozenset()}


def test_a_frame_that_has_long_been_gone_is_still_shown(recording: RecordingReader) -> None:
    """Its last samples are looked for before the cache's time."""
    frames = RecordedFrames(recording)
    frames.seek(recording.end_ns)
    assert states(frames)["arm"] == "gone"
    assert frames.buffer.frame("arm").newest_ns == at(11.9)


def test_ages_and_delays_are_by_the_log_times(recording: RecordingReader) -> None:
    """An age is that at the moment, whenever the recording is looked at."""
    frames = RecordedFrames(recording)
    frames.seek(at(10.05))
    tree = frames.tree()
    assert tree.age_s(tree.frames["base"]) == pytest.approx(0.05)
    assert tree.streams["sim"].delay_s == pytest.approx(LATE_NS / 1e9)


@pytest.mark.parametrize("seconds", [0.5, 13.0, 17.0, 23.0, 30.02])
def test_to_go_on_to_a_moment_is_to_seek_it(recording: RecordingReader, seconds: float) -> None:
    """Frames and their states are the same, whether all before was gone through or not."""
    sought, played = RecordedFrames(recording), RecordedFrames(recording)
    sought.seek(at(seconds))
    played.seek(recording.start_ns)
    played.advance(at(seconds))
    assert states(sought) == states(played)
    assert [frame["newest_ns"] for frame in as_map(sought.tree())["frames"]] == [
        frame["newest_ns"] for frame in as_map(played.tree())["frames"]
    ]


# What becomes of frame `a` of sim, which sends it from 0 s on, and of its parent `world`.
OTHER = publisher("other")
DYNAMIC, STATIC = ("world", "a", False), ("world", "a", True)
AS_STATIC = [described(OTHER, 3.0, STATIC), statics(OTHER, 3.1, ("world", "a", 2.0))]
AS_DYNAMIC = [described(OTHER, 3.0, DYNAMIC), *steadily(OTHER, 3.1, 4.9, ("world", "a"))]
NO_STATICS = statics(OTHER, 5.0, seq=1)
SENT = [described(SIM, 0.0, DYNAMIC), *steadily(SIM, 0.0, 3.0, ("world", "a"))]
SET = [described(SIM, 0.0, STATIC), statics(SIM, 0.0, ("world", "a", 1.0))]
# Started again at 4 s.
AGAIN = replace(SIM, epoch_ns=at(4.0))
WITH_B = [
    described(AGAIN, 4.0, ("world", "b", True)),
    statics(AGAIN, 4.0, ("world", "b", 1.0)),
]
FATES: dict[str, tuple[list[Item], set[str]]] = {
    "left behind by a restart": ([*SET, *WITH_B], {"a", "b", "world"}),
    "left behind, and set again": (
        [*SET, *WITH_B, statics(AGAIN, 4.5, ("world", "a", 3.0), ("world", "b", 1.0), seq=1)],
        {"a", "b", "world"},
    ),
    "left behind, set again and removed": (
        [
            *SET,
            *WITH_B,
            statics(AGAIN, 4.5, ("world", "a", 3.0), ("world", "b", 1.0), seq=1),
            statics(AGAIN, 5.0, ("world", "b", 1.0), seq=2),
        ],
        {"b", "world"},
    ),
    "left behind, sent as dynamic and removed": (
        [
            *SET,
            described(AGAIN, 4.0, DYNAMIC, ("world", "b", True)),
            statics(AGAIN, 4.0, ("world", "b", 1.0)),
            *steadily(AGAIN, 4.0, 4.9, ("world", "a")),
            described(AGAIN, 5.0, ("world", "b", True)),
        ],
        {"b", "world"},
    ),
    "removed": ([*SENT, described(SIM, 4.0)], set()),
    "removed static": ([*SET, described(SIM, 4.0), statics(SIM, 4.0, seq=1)], set()),
    "moved": (
        [*SENT, described(SIM, 4.0, ("map", "a", False)), *steadily(SIM, 4, 50, ("map", "a"))],
        {"a"},
    ),
    "gone": ([*SENT, gone(SIM, 4.0)], {"a", "world"}),
    # Its publisher lists it, and does not send it again.
    "removed as a static of another": (
        [*SENT, *AS_STATIC, described(OTHER, 4.9), NO_STATICS],
        {"world"},
    ),
    "removed as a static of another before it says so": (
        [*SENT, *AS_STATIC, NO_STATICS, described(OTHER, 5.1)],
        {"world"},
    ),
    "removed by another": ([*SENT, *AS_DYNAMIC, described(OTHER, 5.0)], {"world"}),
    "gone, then removed by another": (
        [*SENT, gone(SIM, 3.05), *AS_STATIC, described(OTHER, 5.0), NO_STATICS],
        set(),
    ),
    "sent again before another removes it": (
        [*SENT, *AS_STATIC, sent(SIM, 4.0, ("world", "a", 0.0)), described(OTHER, 5.0), NO_STATICS],
        {"a", "world"},
    ),
    "static of two, removed by one": (
        [*SET, *AS_STATIC, described(OTHER, 5.0), NO_STATICS],
        {"a", "world"},
    ),
}


@pytest.mark.parametrize("has_index", [True, False])
@pytest.mark.parametrize("fate", FATES)
def test_a_moment_has_the_frames_of_a_listener_that_was_there_all_along(
    tmp_path: Path, fate: str, has_index: bool
) -> None:
    """Soon after, and after the cache's time; also in a file that was cut off."""
    items, shown = FATES[fate]
    map_ = publisher("map")
    path = write(
        tmp_path / "run.mcap",
        described(map_, 0.0, ("map", "base", False)),
        steadily(map_, 0.0, 50.0, ("map", "base")),
        items,
    )
    if not has_index:
        cut_off(path)
    with RecordingReader(path) as reader:
        assert reader.is_complete == has_index
        for seconds in (8.0, 30.0):
            sought, played = RecordedFrames(reader), RecordedFrames(reader)
            sought.seek(at(seconds))
            played.seek(reader.start_ns)
            played.advance(at(seconds))
            assert states(sought) == states(played)
            assert states(sought).keys() == {"map", "base"} | shown


def test_a_frame_silent_for_an_hour_is_shown_without_an_index(tmp_path: Path) -> None:
    """A file that was cut off gives the same answers as a whole one, however long ago it was."""
    map_ = publisher("map")
    path = write(
        tmp_path / "run.mcap",
        SENT,
        described(map_, 0.0, ("map", "base", False)),
        steadily(map_, 0.0, 3700.0, ("map", "base"), rate_hz=0.5),
    )
    cut_off(path)
    with RecordingReader(path) as reader:
        frames = RecordedFrames(reader)
        frames.seek(at(3650.0))
        assert not reader.is_complete
        assert states(frames)["a"] == "stale"


def cut_off(path: Path) -> None:
    """Take the end of a file away, with its index, as a power cut does."""
    with RecordingReader(path) as reader:
        last = max(chunk.offset + chunk.length for part in reader.parts for chunk in part.chunks)
    os.truncate(path, last)


def test_a_lookup_in_a_moment_waits_for_nothing(recording: RecordingReader) -> None:
    """The moment stands, whatever the time that the lookup would wait."""
    frames = RecordedFrames(recording)
    frames.seek(at(5.0))
    with pytest.raises(TimeoutException, match="late"):
        frames.buffer.lookup_transform("world", "late", timeout_s=1e6)


def test_to_go_back_is_to_seek(recording: RecordingReader) -> None:
    """An earlier moment knows nothing of what came later."""
    frames = RecordedFrames(recording)
    frames.seek(recording.end_ns)
    frames.advance(at(5.0))
    assert "late" not in frames.buffer.frames()
    assert states(frames)["arm"] == "dynamic"


def test_a_restart_voids_the_samples_before_it(tmp_path: Path) -> None:
    """As on a bus, samples of an earlier epoch are gone, and late ones of it do not count."""
    before, after = publisher("sim", -1.0), publisher("sim", 5.0)
    path = write(
        tmp_path / "run.mcap",
        described(before, 0.0, ("world", "base", False)),
        steadily(before, 0.0, 5.0, ("world", "base")),
        described(after, 5.0, ("world", "base", False)),
        steadily(after, 5.0, 6.0, ("world", "base")),
        sent(before, 5.5, ("world", "base", 99.0), stamp_ns=at(5.55)),
    )
    with RecordingReader(path) as reader:
        frames = RecordedFrames(reader)
        frames.seek(reader.end_ns)
    assert frames.buffer.frame("base").oldest_ns == at(5.0)
    assert frames.streams()[0].outdated == 1
    assert frames.streams()[0].epoch_ns == at(5.0)


def test_a_frame_that_is_no_longer_listed_is_removed(tmp_path: Path) -> None:
    """A description without a frame removes it, from then on."""
    path = write(
        tmp_path / "run.mcap",
        described(SIM, 0.0, ("world", "base", False), ("base", "cup", False)),
        steadily(SIM, 0.0, 2.0, ("world", "base"), ("base", "cup")),
        described(SIM, 2.0, ("world", "base", False)),
        steadily(SIM, 2.0, 3.0, ("world", "base")),
    )
    with RecordingReader(path) as reader:
        frames = RecordedFrames(reader)
        frames.seek(at(1.9))
        assert "base" in states(frames) and states(frames)["cup"] == "dynamic"
        frames.advance(reader.end_ns)
        assert frames.buffer.frame("base").children == ()


def test_the_last_static_set_before_the_moment_holds(tmp_path: Path) -> None:
    """Static transforms are those in force then, however long ago they came."""
    path = write(
        tmp_path / "run.mcap",
        described(SIM, 0.0, ("world", "mark", True)),
        statics(SIM, 0.0, ("world", "mark", 1.0), seq=0),
        statics(SIM, 50.0, ("world", "mark", 2.0), seq=1),
        steadily(ARM, 0.0, 100.0, ("world", "arm"), rate_hz=2.0),
    )
    with RecordingReader(path) as reader:
        frames = RecordedFrames(reader)
        found = []
        for seconds in (49.0, 51.0, 99.0):
            frames.seek(at(seconds))
            found.append(x_of(frames.buffer, source="mark"))
    assert found == [1.0, 2.0, 2.0]


@pytest.mark.parametrize("is_split", [False, True])
@pytest.mark.parametrize("seconds", [14.5, 19.5, 25.5, 33.5])
def test_the_last_to_send_counts_whatever_files_repeat(
    tmp_path: Path, seconds: float, is_split: bool
) -> None:
    """Of frames with two publishers, however long ago that was; a restarted publisher has what it
    sends again.
    """
    base, arm, old, new = (publisher(name) for name in ("base", "arm", "old", "clock"))
    again = publisher("old", 13.0)
    path = write(
        tmp_path / "run.mcap",
        described(arm, 0.0, ("map", "cup", True)),
        statics(arm, 0.1, ("map", "cup", 0.0)),
        described(base, 1.0, ("map", "camera", True)),
        statics(base, 1.0, ("map", "camera", 0.0)),
        described(
            arm, 3.0, ("map", "cup", True), ("odom", "camera", True), ("odom", "wheel", True)
        ),
        statics(
            arm, 3.0, ("map", "cup", 0.0), ("odom", "camera", 0.0), ("odom", "wheel", 0.0), seq=1
        ),
        described(base, 5.0, ("map", "camera", True), ("map", "wheel", False)),
        steadily(base, 5.0, 9.0, ("map", "wheel")),
        described(old, 0.0, ("map", "flag", True)),
        statics(old, 2.0, ("map", "flag", 0.0)),
        gone(old, 12.0),
        described(again, 13.1),
        described(new, 0.0, ("map", "hand", False)),
        steadily(new, 0.0, 40.0, ("map", "hand")),
    )
    paths = [path]
    if is_split:
        with RecordingReader(path) as whole:
            in_force = whole.state_at(at(20.0)).items(at(20.0))
            paths = [
                write(tmp_path / "first.mcap", whole.items(None, at(20.0))),
                write(tmp_path / "second.mcap", in_force, whole.items(at(20.0) + 1)),
            ]
    with RecordingReader(*paths) as reader:
        seeking, going = RecordedFrames(reader), RecordedFrames(reader)
        seeking.seek(at(seconds))
        going.seek(at(0.0))
        for second in range(1, 1 + int(seconds)):
            going.advance(at(second))
        for frames in (seeking, going):
            found = {each.name: each for each in frames.buffer.all_frames()}
            assert {name: found[name].authority for name in ("cup", "camera", "wheel", "flag")} == {
                **{"cup": "arm", "camera": "arm", "wheel": "base", "flag": "old"}
            }
            assert [name for name, each in found.items() if each.gone] == ["flag"]


def test_going_on_in_small_steps_begins_to_read_once(
    recording: RecordingReader, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To begin costs a chunk; after a jump it begins anew, with the same frames as a seek."""
    begun: list[int | None] = []
    items = recording.items

    def counted(from_ns: int | None = None, *others: Any) -> Iterator[Item]:
        begun.append(from_ns)
        return items(from_ns, *others)

    going, seeking = RecordedFrames(recording), RecordedFrames(recording)
    for start_s in (1.0, 20.0):
        going.seek(at(start_s))
        monkeypatch.setattr(recording, "items", counted)
        for step in range(1, 101):
            going.advance(at(start_s + step / 10))
        monkeypatch.undo()
        seeking.seek(at(start_s + 10.0))
        assert states(going) == states(seeking)
    assert begun == [at(1.0) + 1, at(20.0) + 1]


def test_a_namespace_sees_its_own_streams_and_a_fleet_all(tmp_path: Path) -> None:
    """Names are as a listener there has them, and a hint says where others are."""
    path = write(
        tmp_path / "run.mcap",
        described(SIM, 0.0, ("map", "base", False)),
        steadily(SIM, 0.0, 1.0, ("map", "base")),
        *(
            each
            for name in ("robot7/sim", "robot8/sim")
            for each in (
                described(publisher(name), 0.0, ("map", "wheel", False)),
                steadily(publisher(name), 0.0, 1.0, ("map", "wheel")),
            )
        ),
    )
    with RecordingReader(path) as reader:
        seen = {}
        for name, options in {
            "": {},
            "robot7": {"namespace": "robot7"},
            "fleet": {"fleet": Fleet(["map"])},
        }.items():
            frames = RecordedFrames(reader, **options)
            frames.seek(reader.end_ns)
            seen[name] = (sorted(frames.buffer.frames()), [each.name for each in frames.streams()])
        hint = RecordedFrames(reader).hint("wheel")
    assert seen[""] == (["base", "map"], ["sim"])
    assert seen["robot7"] == (["map", "wheel"], ["sim"])
    assert seen["fleet"] == (
        ["base", "map", "robot7/wheel", "robot8/wheel"],
        ["robot7/sim", "robot8/sim", "sim"],
    )
    assert "--namespace robot7" in hint


def test_the_only_namespace_is_looked_at(tmp_path: Path) -> None:
    """A recording of one robot in a namespace needs no --namespace."""
    robot = publisher("robot7/sim")
    path = write(
        tmp_path / "run.mcap",
        described(robot, 0.0, ("map", "base", False)),
        steadily(robot, 0.0, 1.0, ("map", "base")),
    )
    with RecordingReader(path) as reader:
        frames = RecordedFrames(reader)
        frames.seek(reader.end_ns)
    assert states(frames) == {"map": "root", "base": "dynamic"}


def test_without_descriptions_a_stream_lists_what_it_sends(tmp_path: Path) -> None:
    """An imported recording has no tokens: its streams are there, and can be in conflict."""
    path = write(
        tmp_path / "run.mcap",
        steadily(SIM, 0.0, 2.0, ("world", "base")),
        steadily(ARM, 0.0, 2.0, ("world", "base")),
        statics(SIM, 0.0, ("base", "laser", 0.2)),
    )
    with RecordingReader(path) as reader:
        frames = RecordedFrames(reader)
        frames.seek(reader.end_ns)
    assert states(frames) == {"world": "root", "base": "conflict", "laser": "static"}
    assert [stream.alive for stream in frames.streams()] == [True, True]


def test_ages_are_by_a_recorded_clock_that_all_follow(tmp_path: Path) -> None:
    """Under simulated time an age is the difference to the clock's last message."""
    clock = "clock"
    path = write(
        tmp_path / "run.mcap",
        node("/clock", publishes={clock: "Clock"}),
        node("/sim", subscribes={clock: "Clock"}, streams=["sim"]),
        described(SIM, 0.0, ("world", "base", False)),
        [
            sent(SIM, number / 10, ("world", "base", 0.0), stamp_ns=number * 10**8)
            for number in range(50)
        ],
        [
            TopicItem(
                at(number / 10),
                clock,
                "Clock",
                {"stamp_ns": number * 10**8, "rate": 1.0, "paused": False},
            )
            for number in range(50)
        ],
    )
    with RecordingReader(path) as reader:
        frames, system = RecordedFrames(reader), RecordedFrames(reader, sim_time=False)
        frames.seek(at(3.05))
        system.seek(at(3.05))
    assert frames.now_ns() == 3 * 10**9
    tree = frames.tree()
    assert tree.is_simulated and tree.age_s(tree.frames["base"]) == 0.0
    assert system.now_ns() == at(3.05)
    assert [problem.kind for problem in system.tree().problems()] == ["clock"]


def test_a_pause_of_the_recorder_is_known(tmp_path: Path) -> None:
    """Between "paused" and "resumed" nothing was recorded."""
    path = write(
        tmp_path / "run.mcap",
        steadily(SIM, 0.0, 10.0, ("world", "base"), pause=(3.0, 6.0)),
        EventItem(at(3.0), "paused"),
        EventItem(at(6.0), "resumed"),
    )
    with RecordingReader(path) as reader:
        frames = RecordedFrames(reader)
        paused = []
        for seconds in (2.0, 4.0, 7.0):
            frames.seek(at(seconds))
            paused.append(frames.pause is not None)
    assert paused == [False, True, False]


@pytest.mark.parametrize(("kinds", "missed"), [((), 20), (("paused", "resumed"), 0)])
def test_what_came_in_a_pause_is_not_missing(
    tmp_path: Path, kinds: tuple[EventKind, ...], missed: int
) -> None:
    """Messages are numbered: those between 1 s and 3 s are missing, unless it was paused."""
    path = write(
        tmp_path / "run.mcap",
        [sent(SIM, n / 10, ("world", "base", 0.0), seq=n) for n in range(50) if not 10 <= n < 30],
        [EventItem(at(seconds), kind) for seconds, kind in zip((1.0, 3.0), kinds, strict=False)],
    )
    with RecordingReader(path) as reader:
        frames = RecordedFrames(reader)
        frames.seek(at(4.9))
        [stream] = frames.streams()
    assert stream.missed == missed


def test_a_hint_says_when_a_frame_comes(recording: RecordingReader) -> None:
    """A frame that comes later is named with the time that --at takes."""
    frames = RecordedFrames(recording)
    frames.seek(at(3.0))
    assert frames.hint("late").startswith("'late' comes at +30.000s")
    assert frames.hint("base") == ""


def test_each_frame_of_a_lost_publisher_stays_however_long_it_was_silent(tmp_path: Path) -> None:
    """Also one that stopped long before the others of its stream."""
    path = write(
        tmp_path / "run.mcap",
        described(ARM, 0.0, ("base", "gripper", False), ("base", "camera", False)),
        steadily(ARM, 0.0, 3.0, ("base", "gripper")),
        steadily(ARM, 3.0, 18.0, ("base", "camera")),
        gone(ARM, 18.0),
        steadily(SIM, 0.0, 40.0, ("world", "base")),
    )
    with RecordingReader(path) as reader:
        frames = RecordedFrames(reader)
        frames.seek(at(35.0))
        now = states(frames)
    assert now["gripper"] == now["camera"] == "gone"


def test_a_frame_is_stale_until_it_comes_again_in_the_same_chunk(tmp_path: Path) -> None:
    """Its last sample is in an earlier chunk than the moment, which its next sample is in too."""
    path = write(
        tmp_path / "run.mcap",
        described(SIM, 0.0, *SIM_ROWS[:1]),
        steadily(SIM, 0.0, 50.0, ("world", "base"), pause=(5.0, 40.0)),
        described(ARM, 0.0, ("base", "arm", False)),
        steadily(ARM, 0.0, 50.0, ("base", "arm")),
        new_chunk_s=20.0,
    )
    with RecordingReader(path) as reader:
        frames = RecordedFrames(reader)
        frames.seek(at(35.0))
        assert states(frames)["base"] == "stale"
