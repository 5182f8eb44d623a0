"""A recording as the page shows it: the frames at the cursor are as a listener had them then."""

import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from tests.builders import S
from tests.recordings import publisher, sent, write
from tests.view.recordings import at, record
from tfbus.frames.moment import state

pytest.importorskip("mcap", reason="needs mcap: the extra bag")

from tfbus.messages import LaserScan, Marker, MarkerArray, PointCloud, PoseStamped, Vector3
from tfbus.recording.items import TopicItem
from tfbus.recording.reader import RecordingReader
from tfbus.recording.writer import RecordingWriter
from tfbus.view.data.layer import PlacedItem, TopicLayer
from tfbus.view.data.shapes import Points
from tfbus.view.replay import RecordedData, Replay
from tfbus.view.settings import TopicSettings, topic_of
from tfbus.wire.codec import decode_map, encode_message, type_name
from tfbus.wire.fleet import Fleet


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """The file."""
    return record(tmp_path / "arm.mcap")


@pytest.fixture
def replay(path: Path) -> Iterator[Replay]:
    """Held at the beginning."""
    with RecordingReader(path) as reader:
        yield Replay(reader, at_ns=0)


def shown(replay: Replay, frame: str = "base") -> tuple[str, float]:
    """The state of a frame, and how many metres it is from the map."""
    tree = replay.moment().tree
    pose = replay.buffer.lookup_transform("map", frame)
    return state(tree, tree.frames[frame]), round(pose.transform.xyz[0], 6)


# Time, state and place of the base. It is gone from 5 s to 6 s, and the twin lists it from 8 s on.
MOMENTS = [
    (0.0, "dynamic", 0.0),
    (1.99, "dynamic", 1.95),
    (2.9, "dynamic", 2.0),
    (3.5, "stale", 2.0),
    (4.0, "dynamic", 4.0),
    (5.0, "gone", 4.95),
    (5.9, "gone", 4.95),
    (6.0, "dynamic", 6.0),
    (8.5, "conflict", 8.5),
    (9.0, "dynamic", 9.0),
    (12.0, "dynamic", 12.0),
]


@pytest.mark.parametrize("moments", [MOMENTS, MOMENTS[::-1]], ids=["forward", "backward"])
def test_frames_are_as_they_were_at_the_cursor(
    replay: Replay, moments: list[tuple[float, str, float]]
) -> None:
    """From wherever the cursor comes."""
    for second, judged, x_m in moments:
        replay.playhead.seek(at(second))
        replay.move(0.0, is_watched=True)
        assert (second, *shown(replay)) == (second, judged, x_m)
        assert shown(replay, "lamp") == ("static", 2.0)
        assert replay.moment().now_ns == at(second)


def test_playing_shows_the_same_as_seeking(path: Path) -> None:
    """Picture by picture, thirty a second, until it ends and stops."""
    with RecordingReader(path) as reader, RecordingReader(path) as other:
        played = Replay(reader, at_ns=0, plays=True)
        sought = Replay(other, at_ns=0)
        for picture in range(400):
            played.move(picture / 30, is_watched=True)
            if picture % 20 == 0:
                sought.playhead.seek(played.playhead.progress.log_ns)
                sought.move(0.0, is_watched=True)
                assert shown(played) == shown(sought)
        progress = played.playhead.progress
        assert (progress.log_ns, progress.is_paused) == (at(12.0), True)
        assert shown(played) == ("dynamic", 12.0)


def test_it_waits_for_a_browser(replay: Replay) -> None:
    """A recording plays while it is watched only."""
    replay.playhead.resume()
    replay.move(10.0, is_watched=False)
    replay.move(10.1, is_watched=False)
    assert replay.moment().now_ns == at(0.0)
    replay.move(10.2, is_watched=True)
    assert replay.moment().now_ns == at(0.1)


def test_a_machine_that_slept_plays_on_where_it_was(replay: Replay) -> None:
    """A picture is never more than a quarter of a second after the one before."""
    replay.playhead.resume()
    replay.move(0.0, is_watched=True)
    replay.move(3600.0, is_watched=True)
    assert replay.moment().now_ns == at(0.25)


def test_steps_go_from_message_to_message(replay: Replay) -> None:
    """Across silence too, and at the ends they stay."""
    steps = [(1.9, 1, 1.95), (2.0, 1, 4.0), (4.0, -1, 2.0), (4.0, -2, 1.95), (4.95, 1, 6.0)]
    for start, by, end in [*steps, (0.0, -1, 0.0), (12.0, 1, 12.0)]:
        replay.playhead.seek(at(start))
        replay.playhead.step(by)
        replay.move(0.0, is_watched=True)
        assert (start, by, replay.moment().now_ns) == (start, by, at(end))


def test_browsers_follow_what_they_cannot_foresee(replay: Replay) -> None:
    """A jump, and the end of a play; not a picture of it."""
    replay.playhead.seek(at(11.9), paused=False)
    assert replay.move(0.0, is_watched=True)
    assert not replay.move(0.05, is_watched=True)
    assert replay.move(0.25, is_watched=True)


def test_a_trail_has_as_much_of_the_past_as_it_needs(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What was kept for less is read again."""
    monkeypatch.setattr("tfbus.view.replay._before_s", lambda reader: 1.0)
    with RecordingReader(path) as reader:
        replay = Replay(reader, at_ns=at(12.0))
        replay.move(0.0, is_watched=True)
        assert replay.buffer.frame("base").oldest_ns == at(11.0)
        assert replay.move(0.0, is_watched=True, trail_s=5.0)
        assert replay.buffer.frame("base").oldest_ns == at(7.0)


def test_a_part_of_a_recording_has_its_own_timeline(path: Path) -> None:
    """The cursor stays in it, and its frames are those of the whole."""
    with RecordingReader(path) as reader:
        replay = Replay(reader, at_ns=0, start_ns=at(5.5), end_ns=at(7.0))
        assert shown(replay) == ("gone", 4.95)
        assert [mark.kind for mark in replay.timeline.marks] == ["gone", "back"]
        replay.playhead.seek(at(100.0))
        replay.move(0.0, is_watched=True)
        assert replay.moment().now_ns == at(7.0)


def test_the_silences_come_when_they_have_been_measured(replay: Replay) -> None:
    """And with them where frames will be."""
    assert [mark.kind for mark in replay.timeline.marks].count("gap") == 0
    replay.measure()
    assert [mark.kind for mark in replay.timeline.marks].count("gap") == 1
    far_m = [buffer.lookup_transform("map", "base").transform.xyz[0] for buffer in replay.samples]
    assert max(far_m) == 12.0


def test_a_page_that_ends_waits_for_the_measuring(
    replay: Replay, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is told to end, and no thread is in the midst of the index when Python ends."""
    measured = []
    never = threading.Event()

    def measure(*arguments: object) -> None:
        is_ended = cast(Callable[[], bool], arguments[-1])
        while not is_ended():
            never.wait(0.001)
        measured.append(True)

    monkeypatch.setattr("tfbus.view.replay.whole_timeline", measure)
    with replay.until_signal():
        replay.measure_meanwhile()
    assert measured


def test_damage_is_said_while_the_cursor_is_in_it(
    path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """It goes on behind it, and the log has it once."""
    with RecordingReader(path) as reader:
        chunk = next(each for each in reader.parts[0].file.chunks if each.to_ns > at(7.0))
    spoilt = bytearray(path.read_bytes())
    middle = chunk.offset + chunk.length // 2
    spoilt[middle : middle + 8] = bytes(8)
    path.write_bytes(spoilt)
    with RecordingReader(path) as reader:
        replay = Replay(reader, at_ns=at(7.0))
        for second in (7.0, 7.0, 11.0, 7.0):
            replay.playhead.seek(at(second), paused=True)
            replay.move(second, is_watched=True)
            is_in_it = chunk.from_ns <= at(second) <= chunk.to_ns
            assert ("cannot be read" in replay.mistake) is is_in_it
        replay.playhead.seek(at(11.0), paused=True)
        replay.move(20.0, is_watched=True)
        assert (replay.mistake, shown(replay)) == ("", ("dynamic", 11.0))
    assert sum("is damaged" in each.getMessage() for each in caplog.records) == 1


def test_a_fleet_has_the_frames_of_all_robots(tmp_path: Path) -> None:
    """With their namespaces in front; without it no frames of several robots are mixed."""
    items = []
    for name in ("robot7/sim", "robot8/sim"):
        items += [sent(publisher(name), s / 10, ("world", "base", 1.0)) for s in range(20)]
    items.sort(key=lambda item: item.log_ns)
    path = write(tmp_path / "fleet.mcap", items)
    for fleet, frames in (
        (
            Fleet(),
            {f"{robot}/{frame}" for robot in ("robot7", "robot8") for frame in ("world", "base")},
        ),
        (None, set()),
    ):
        with RecordingReader(path) as reader:
            replay = Replay(reader, at_ns=reader.end_ns, fleet=fleet)
            assert set(replay.buffer.frames()) == frames


def drawn(replay: Replay, topic: str, **settings: float) -> dict[object, float]:
    """The items of a topic that a page draws at the cursor, and where along x of the map."""
    placed = placed_of(replay, topic, **settings)
    return {key: round(float(each.pose.xyz[0]), 2) for key, each in placed.items()}


def placed_of(replay: Replay, topic: str, **settings: float) -> dict[object, PlacedItem]:
    """The items of a topic that a page draws at the cursor."""
    data = RecordedData(replay)
    try:
        topics = data.topics()
        data.want({**topics, topic: topics.get(topic, topics[topic_of(topic)])})
        now_s = data.catch_up(0.0)
        waiting = data.waiting(topic)
        assert waiting is not None
        layer = TopicLayer(waiting)
        chosen = TopicSettings(topic, **settings)
        layer.recall(data.past(topic, chosen), "map", chosen)
        layer.step(replay.buffer, "map", now_s, chosen, pace_s=now_s)
        return layer.placed
    finally:
        data.close()


def cube(number: int, seconds: float, **values: Any) -> Marker:
    """A marker where the base is."""
    return Marker(at(seconds), "base", "some", number, scale=Vector3(1, 1, 1), **values)


def cloud_at(seconds: float) -> PointCloud:
    """A cloud of one point, where the base is."""
    return PointCloud.from_xyz(at(seconds), "base", np.zeros((1, 3)))


def scan_at(seconds: float, angle_rad: float) -> LaserScan:
    """A scan of one point in this direction, and two that were not measured."""
    ranges = np.array([1.0, np.inf, 0.0])
    return LaserScan(at(seconds), "base", angle_rad, range_max=9.0, ranges=ranges)


@pytest.fixture
def seen(path: Path, tmp_path: Path) -> Path:
    """The same file with a cloud at the base each half second from 0.5 s on, often a hundred times
    a second from 6 s to 8 s, when two scanners scan in step, and markers: one that stays, one of
    2 s, and at 8 s the end of all before another.
    """
    arrays: list[tuple[float, str, Any]] = [
        (tick / 2, "points", cloud_at(tick / 2))
        for tick in range(1, 23)
        if not (4 < tick < 8 or 10 <= tick < 12)
    ]
    arrays += [
        (1.0, "markers", MarkerArray((cube(1, 1.0), cube(2, 1.0, lifetime_ns=2 * S)))),
        (
            8.0,
            "markers",
            MarkerArray((Marker(at(8.0), "base", action=Marker.DELETEALL), cube(3, 8.0))),
        ),
        (1.5, "where", PoseStamped(at(1.5), "base")),
        *((tick / 100, "often", cloud_at(tick / 100)) for tick in range(600, 800)),
        *((6.0 + tick / 20, "scans", scan_at(6.0 + tick / 20, 0.0)) for tick in range(40)),
        *((6.004 + tick / 20, "scans", scan_at(6.004 + tick / 20, 3.0)) for tick in range(40)),
        # As no topic of the bus is called.
        (1.5, "where#2", PoseStamped(at(1.5), "base")),
    ]
    whole = tmp_path / "seen.mcap"
    with RecordingReader(path) as reader, RecordingWriter(whole) as writer:
        further = [
            TopicItem(at(second), name, type_name(type(each)), decode_map(encode_message(each)))
            for second, name, each in arrays
        ]
        for item in sorted([*reader.items(), *further], key=lambda item: item.log_ns):
            writer.write(item)
    return whole


# By second: the clouds of a second's decay, the markers, and the pose of 1.5 s.
SEEN: dict[float, tuple[list[float], set[object], list[float]]] = {
    0.2: ([], set(), []),
    1.6: ([1.0, 1.5], {("some", 1), ("some", 2)}, [1.5]),
    4.6: ([4.0, 4.5], {("some", 1)}, [1.5]),
    7.2: ([6.5, 7.0], {("some", 1)}, [1.5]),
    11.2: ([10.5, 11.0], {("some", 3)}, [1.5]),
}


@pytest.mark.parametrize("seconds", [[*SEEN], [*SEEN][::-1]], ids=["forward", "backward"])
def test_messages_are_drawn_as_they_were_at_the_cursor(seen: Path, seconds: list[float]) -> None:
    """Each at the place of its stamp, however long ago; from wherever the cursor comes."""
    with RecordingReader(seen) as reader:
        replay = Replay(reader, at_ns=0)
        for second in seconds:
            replay.playhead.seek(at(second))
            replay.move(second, is_watched=True)
            clouds, markers, poses = SEEN[second]
            for name in ("points", "points#2"):
                assert [*drawn(replay, name, decay_s=1.0).values()] == clouds
            assert {*drawn(replay, "markers")} == markers
            for name in ("where", "where#2"):
                assert [*drawn(replay, name).values()] == poses
            if ("some", 1) in markers:
                assert drawn(replay, "markers")["some", 1] == 1.0


def test_all_points_that_decay_are_there_after_a_jump(seen: Path) -> None:
    """However many messages they are of."""
    with RecordingReader(seen) as reader:
        replay = Replay(reader, at_ns=at(7.951))
        places = [
            round(float(x), 2)
            for each in placed_of(replay, "often", decay_s=1.8).values()
            for points in each.item.shapes
            if isinstance(points, Points)
            for x in each.pose.apply(points.xyz.astype(float))[:, 0]
        ]
        assert places[-180:] == [tick / 100 for tick in range(616, 796)]


def test_of_too_many_messages_that_decay_some_of_each_scanner_are_drawn(
    seen: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All, as long as they are few; no more are read than their points can stay, nor for a place
    that the cursor has left.
    """
    with RecordingReader(seen) as reader:
        replay = Replay(reader, at_ns=at(9.0))
        decaying = TopicSettings("scans", decay_s=5.0)
        sides: list[tuple[int, int]] = []
        for most, most_points in ((1000, 500_000), (20, 500_000), (20, 19)):
            monkeypatch.setattr("tfbus.view.replay._MOST_MESSAGES", most)
            monkeypatch.setattr("tfbus.view.replay.MOST_DECAYING_POINTS", most_points)
            data = RecordedData(replay)
            data.want(data.topics())
            data.catch_up(0.0)
            scans = [each for _, _, came in data.past("scans", decaying) for each in came]
            front = sum(each.angle_min == 0.0 for each in scans)
            sides.append((front, len(scans) - front))
        assert sides == [(40, 40), (9, 12), (10, 10)]
        past = data.past("scans", decaying)
        next(past)
        replay.playhead.seek(at(1.0))
        replay.move(0.0, is_watched=True)
        assert not [*past]
        data.close()


def test_playing_reads_on_and_a_jump_begins_anew(seen: Path) -> None:
    """The messages that come are those between the cursor's places, for each of two names of a
    topic.
    """
    with RecordingReader(seen) as reader:
        replay = Replay(reader, at_ns=at(0.2), plays=True)
        data = RecordedData(replay)
        points = data.topics()["points"]
        data.want({"points": points, "points#2": points})
        data.catch_up(0.0)
        waiting, again = data.waiting("points"), data.waiting("points#2")
        assert waiting is not None and again is not None
        for tick in range(9):
            replay.move(0.2 * tick, is_watched=True)
            data.catch_up(0.0)
        for came in (waiting.take(), again.take()):
            assert [each.stamp_ns for each in came] == [at(0.5), at(1.0), at(1.5)]
        replay.playhead.seek(at(9.0))
        replay.move(2.0, is_watched=True)
        data.catch_up(0.0)
        assert data.waiting("points") is not waiting
        data.close()
