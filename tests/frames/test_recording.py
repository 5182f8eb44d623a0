"""`tfbus.Recording`: lookups at any stamp, as a listener would have answered them."""

import errno
import math
import os
import threading
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tfbus
from tests.builders import S, in_recording, moved
from tfbus import Buffer, Transform, TransformStamped
from tfbus.buffer import trajectories
from tfbus.geometry.columns import Columns
from tfbus.geometry.packed import pose_bytes
from tfbus.inspect import Recorded
from tfbus.recording.items import EventItem, EventKind, Item, TopicItem, TransformItem
from tfbus.recording.writer import RecordingWriter

T0 = 1_700_000_000 * S
MS = 1_000_000


def written(path: Path, items: Iterable[Item], flush_every: int = 40) -> Path:
    """The path of a new file with these items, in short chunks."""
    with RecordingWriter(path) as writer:
        for at, item in enumerate(items):
            writer.write(item)
            if at % flush_every == 0:
                writer.flush()
    return path


def turned(angle: float) -> Transform:
    """A pose on a circle."""
    half = angle / 2
    return Transform(
        (math.cos(angle), math.sin(angle), 0.1), (0, 0, math.sin(half), math.cos(half))
    )


def robot(seconds: int = 60) -> list[Item]:
    """Frames of 20 Hz and 1 Hz in one message each, one of every 20 s in its own stream, and a
    static one.
    """
    items: list[Item] = [in_recording(T0, [moved(T0, "fast", "laser", 3)], static=True)]
    for i in range(20 * seconds):
        stamp = T0 + i * 50 * MS
        items.append(
            in_recording(stamp + 7 * MS, [TransformStamped(stamp, "slow", "fast", turned(i / 9))])
        )
        if i % 20 == 3:
            items.append(in_recording(stamp + 8 * MS, [moved(stamp, "rare", "slow", i)]))
        if i % 400 == 11:
            items.append(in_recording(stamp + 9 * MS, [moved(stamp, "map", "rare", i)], stream="s"))
    return items


def filled(items: Iterable[Item]) -> Buffer:
    """A buffer with all transforms."""
    buffer = Buffer(math.inf)
    for item in items:
        if isinstance(item, TransformItem):
            buffer.set_transforms(item.rows, static=item.static, authority=item.stream.name)
    return buffer


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> tfbus.Recording:
    """The recording of the robot."""
    return tfbus.Recording(written(tmp_path_factory.mktemp("bag") / "a.mcap", robot()))


PAIRS = [("map", "laser"), ("laser", "map"), ("slow", "fast"), ("rare", "slow"), ("map", "rare")]


def answer(source: Buffer | tfbus.Recording, *question: object) -> object:
    """The transform, or the kind of the error and which edge it is about."""
    try:
        return source.lookup_transform(*question)
    except tfbus.ExtrapolationException as error:
        return type(error), error.child_frame_id, error.oldest_ns, error.newest_ns
    except tfbus.TransformException as error:
        return type(error)


@pytest.mark.parametrize("pair", PAIRS)
def test_lookups_are_those_of_a_buffer_of_all(bag: tfbus.Recording, pair: tuple[str, str]) -> None:
    """At any stamp, in any order; also where there is no answer."""
    buffer = filled(robot())
    rng = np.random.default_rng(1)
    stamps = rng.integers(T0 - S, T0 + 61 * S, 60).tolist()
    stamps += [T0, T0 + 50 * MS, T0 + 10 * S, T0 + 59 * S, T0 + 99 * S, 0]
    for stamp in stamps:
        assert answer(bag, *pair, stamp) == answer(buffer, *pair, stamp), stamp - T0


@pytest.mark.parametrize("pair", [*PAIRS, ("fast", "laser"), ("map", "nowhere")])
def test_the_latest_is_that_of_a_buffer_of_all(bag: tfbus.Recording, pair: tuple[str, str]) -> None:
    """Without a stamp."""
    assert answer(bag, *pair, None) == answer(filled(robot()), *pair, None)


def test_many_lookups_at_once(bag: tfbus.Recording) -> None:
    """They are those of single lookups, in the order of the stamps given."""
    stamps = np.random.default_rng(2).integers(T0 + 2 * S, T0 + 40 * S, 200)
    found = bag.lookup_transforms("map", "laser", stamps)
    assert found == filled(robot()).lookup_transforms("map", "laser", stamps)


def test_no_stamps_no_transforms(bag: tfbus.Recording) -> None:
    """As of a buffer."""
    assert len(bag.lookup_transforms("map", "laser", [])) == 0


def test_one_of_many_that_cannot_be_answered(bag: tfbus.Recording) -> None:
    """It is the error of its lookup."""
    with pytest.raises(tfbus.FutureExtrapolationException):
        bag.lookup_transforms("map", "laser", [T0 + 5 * S, T0 + 90 * S])


def test_two_times(bag: tfbus.Recording) -> None:
    """`lookup_transform_full` is that of a buffer of all."""
    question = ("laser", T0 + 5 * S, "laser", T0 + 33 * S, "map")
    assert bag.lookup_transform_full(*question) == filled(robot()).lookup_transform_full(*question)


def test_a_trajectory(bag: tfbus.Recording) -> None:
    """All of it, and a part of it."""
    whole = trajectories.trajectory(filled(robot()), "map", "laser")
    assert bag.trajectory("map", "laser") == whole
    first, last = T0 + 10 * S, T0 + 20 * S
    part = whole[(whole.stamps_ns >= first) & (whole.stamps_ns <= last)]
    assert bag.trajectory("map", "laser", first, last) == part


def test_samples(bag: tfbus.Recording) -> None:
    """What was sent of a frame, dynamic or static."""
    buffer = filled(robot())
    assert bag.samples("slow") == trajectories.samples(buffer, "slow")
    assert bag.samples("laser") == trajectories.samples(buffer, "laser")
    with pytest.raises(tfbus.LookupException, match="did you mean 'slow'"):
        bag.samples("slov")


def test_samples_that_no_buffer_takes_are_left_out(tmp_path: Path) -> None:
    """Files have what came: one that is not finite, or no rotation, does not spoil the others."""
    items = [in_recording(T0 + i, [moved(T0 + i, "a", "b", i)]) for i in range(5)]
    for i, pose in ((1, (math.nan, 0, 0, 0, 0, 0, 1)), (3, (3, 0, 0, 0, 0, 0, 2))):
        rows = items[i].rows
        spoilt = Columns.of_bytes(
            rows.frames, rows.edges_bytes(), rows.stamps_bytes(), pose_bytes(pose)
        )
        items[i] = replace(items[i], rows=spoilt)
    bag = tfbus.Recording(written(tmp_path / "a.mcap", items))
    assert bag.samples("b").stamps_ns.tolist() == [T0, T0 + 2, T0 + 4]


def test_frames(bag: tfbus.Recording) -> None:
    """Their parents, streams, how many samples and of which stamps."""
    frames = {frame.name: frame for frame in bag.frames()}
    assert sorted(frames) == ["fast", "laser", "rare", "slow"]
    assert frames["laser"].is_static and not frames["fast"].is_static
    rare = frames["rare"]
    assert (rare.parent, rare.streams, rare.samples) == ("map", ("s",), 3)
    assert (rare.first_ns, rare.last_ns) == (T0 + 550 * MS, T0 + 40 * S + 550 * MS)


def test_names_that_are_wrong(bag: tfbus.Recording) -> None:
    """An unknown frame is named with the nearest; a malformed stamp refused."""
    with pytest.raises(tfbus.LookupException, match="did you mean 'laser'"):
        bag.lookup_transform("map", "lazer", T0)
    with pytest.raises(tfbus.LookupException, match="did you mean 'laser'"):
        bag.lookup_transforms("map", "lazer", [T0])
    with pytest.raises(tfbus.LookupException, match="did you mean 'laser'"):
        bag.trajectory("map", "lazer")
    with pytest.raises(tfbus.InvalidArgumentException):
        bag.lookup_transform("map", "laser", 1.5)


def test_threads_share_a_recording(bag: tfbus.Recording) -> None:
    """Each gets its own answers."""
    buffer, wrong = filled(robot()), []

    def look(seed: int) -> None:
        for stamp in np.random.default_rng(seed).integers(T0 + S, T0 + 40 * S, 30).tolist():
            if answer(bag, "map", "laser", stamp) != answer(buffer, "map", "laser", stamp):
                wrong.append(stamp)

    threads = [threading.Thread(target=look, args=(seed,)) for seed in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


def test_each_epoch_answers_for_its_stamps(tmp_path: Path) -> None:
    """No lookup is interpolated between two epochs, and each has its own samples."""
    items = [in_recording(T0 + i, [moved(T0 + i * S, "map", "a", i)], epoch_ns=1) for i in range(5)]
    items += [
        in_recording(T0 + i, [moved(T0 + i * S, "map", "a", 100 + i)], epoch_ns=2)
        for i in range(10, 15)
    ]
    bag = tfbus.Recording(written(tmp_path / "a.mcap", items))
    assert bag.lookup_transform("map", "a", T0 + 3 * S + S // 2).transform.xyz[0] == 3.5
    assert bag.lookup_transform("map", "a", T0 + 12 * S + S // 2).transform.xyz[0] == 112.5
    with pytest.raises(tfbus.FutureExtrapolationException):
        bag.lookup_transform("map", "a", T0 + 7 * S)
    assert bag.trajectory("map", "a").xyz[:, 0].tolist() == [0, 1, 2, 3, 4, 110, 111, 112, 113, 114]


def test_of_a_time_that_came_twice_the_second_counts(tmp_path: Path) -> None:
    """As of a simulation that was reset: stamps of the first run that the second one reaches are
    answered by the second, the latest is that of the second.
    """
    items = []
    for epoch, length in ((1, 20), (2, 10)):
        for i in range(length):
            sent = moved(i * S, "map", "a", 100 * epoch + i)
            items.append(in_recording(T0 + 1000 * epoch + i, [sent], epoch_ns=epoch))
    bag = tfbus.Recording(written(tmp_path / "a.mcap", items, flush_every=3))
    assert bag.lookup_transform("map", "a", 5 * S).transform.xyz[0] == 205
    assert bag.lookup_transform("map", "a", 15 * S).transform.xyz[0] == 115
    assert bag.lookup_transform("map", "a").transform.xyz[0] == 209


def test_static_transforms_are_those_in_force_then(tmp_path: Path) -> None:
    """Before a stream sets them for the first time, that first set holds."""
    items: list[Item] = []
    for i in range(100):
        stamp = T0 + i * S
        items.append(in_recording(stamp + 1, [moved(stamp, "map", "base", i)]))
        if i in (30, 60):
            items.append(in_recording(stamp + 2, [moved(stamp, "base", "laser", i)], static=True))
    bag = tfbus.Recording(written(tmp_path / "a.mcap", items, flush_every=7))
    for second, expected in ((10, 30), (30, 30), (59, 30), (60, 30), (61, 60), (99, 60)):
        found = bag.lookup_transform("base", "laser", T0 + second * S)
        assert found.transform.xyz[0] == expected, second
    seconds = [5, 59, 61, 90]
    many = bag.lookup_transforms("map", "laser", [T0 + second * S for second in seconds])
    assert many.xyz[:, 0].tolist() == [35, 89, 121, 150]


def test_a_recording_of_static_transforms(tmp_path: Path) -> None:
    """A lookup at any stamp, and without one."""
    path = written(tmp_path / "a.mcap", [in_recording(T0, [moved(T0, "a", "b", 1)], static=True)])
    bag = tfbus.Recording(path)
    assert bag.lookup_transform("a", "b").transform.xyz[0] == 1
    assert bag.lookup_transform("a", "b", 5).transform.xyz[0] == 1
    assert bag.can_transform("a", "b") and not bag.can_transform("a", "c")
    assert bag.latest_common_time("a", "b") is None


def test_arguments_that_no_lookup_takes_are_no_unknown_transforms(tmp_path: Path) -> None:
    """They are named, and so is a recording that is closed."""
    path = written(tmp_path / "a.mcap", [in_recording(T0, [moved(T0, "a", "b", 1)])])
    bag = tfbus.Recording(path)
    sampling: Any = "nearest"
    with pytest.raises(tfbus.InvalidArgumentException, match="sampling: expected"):
        bag.lookup_known_transforms("a", "b", [T0], sampling=sampling)
    stamp: Any = 1.5
    with pytest.raises(tfbus.InvalidArgumentException, match="a stamp must be an integer"):
        bag.can_transform("a", "b", stamp)
    bag.close()
    with pytest.raises(tfbus.InvalidArgumentException, match="is closed"):
        bag.can_transform("a", "b", T0)


def test_an_empty_recording(tmp_path: Path) -> None:
    """It has no frames."""
    bag = tfbus.Recording(written(tmp_path / "a.mcap", []))
    assert bag.frames() == () and bag.duration_s == 0
    with pytest.raises(tfbus.LookupException):
        bag.lookup_transform("a", "b")
    with pytest.raises(tfbus.LookupException):
        bag.trajectory("a", "b")


def test_a_file_cut_short_answers_what_it_has(tmp_path: Path) -> None:
    """Its index is made by reading it."""
    whole = written(tmp_path / "a.mcap", robot(20)).read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) * 2 // 3])
    bag, buffer = tfbus.Recording(tmp_path / "cut.mcap"), filled(robot(20))
    assert not bag.is_complete
    for second in range(1, 9):
        question = ("rare", "laser", T0 + second * S)
        assert answer(bag, *question) == answer(buffer, *question)


def test_the_buffer_of_a_span_is_a_listeners(tmp_path: Path) -> None:
    """Static transforms are there from before; a restart voids what was before; frames that were
    removed are not in it; those of a publisher that is gone are marked.
    """

    def told(log_ns: int, kind: EventKind, *frames: str) -> EventItem:
        listed = [["map", frame, False] for frame in frames]
        facts = {"v": 1, "node": "/s", "epoch": 1, "frames": listed}
        return EventItem(log_ns, kind, "s", facts)

    items: list[Item] = [
        in_recording(T0, [moved(T0, "a", "laser", 1)], static=True),
        in_recording(T0 + S, [moved(T0 + S, "map", "a", 1)], epoch_ns=1),
        told(T0 + S, "stream", "b", "c"),
        in_recording(T0 + S, [moved(T0 + S, "map", "b"), moved(T0 + S, "map", "c")], stream="s"),
        told(T0 + 2 * S, "stream", "b"),
        in_recording(T0 + 3 * S, [moved(T0 + 3 * S, "map", "a", 3)], epoch_ns=2),
        told(T0 + 4 * S, "stream gone"),
    ]
    bag = tfbus.Recording(written(tmp_path / "a.mcap", items))
    whole = bag.buffer()
    assert len(trajectories.samples(whole, "a")) == 1
    assert whole.frame("b").gone and "c" not in whole.frames()
    early = bag.buffer(T0 + S // 2, T0 + 2 * S - 1)
    assert early.lookup_transform("map", "laser", T0 + S).transform.xyz[0] == 2
    assert early.frame("c").parent == "map"
    assert bag.buffer(cache_time_s=0.5).cache_time_s == 0.5


def test_messages_of_a_topic(tmp_path: Path) -> None:
    """As maps, or as messages of their type, in a span."""
    pose = {"stamp_ns": 5, "x": 1.0, "y": 2.0, "theta": 0.5}
    pose |= {"linear_velocity": 0.0, "angular_velocity": 0.0}
    items = [TopicItem(T0 + i, "turtle1/pose", "Pose", pose | {"x": float(i)}) for i in range(5)]
    bag = tfbus.Recording(written(tmp_path / "a.mcap", items))
    assert list(bag.messages("turtle1/pose"))[3] == (T0 + 3, pose | {"x": 3.0})
    typed = list(bag.messages("turtle1/pose", tfbus.messages.Pose, from_ns=T0 + 1, to_ns=T0 + 2))
    assert [(log_ns, message.x) for log_ns, message in typed] == [(T0 + 1, 1.0), (T0 + 2, 2.0)]
    assert list(bag.messages("/turtle1/pose")) == list(bag.messages("turtle1/pose"))
    with pytest.raises(tfbus.LookupException, match="mean 'turtle1/pose'"):
        bag.messages("turtle/pose")


@pytest.mark.parametrize("topic", ["tf", "/tf_static", "robot7/tf"])
def test_transforms_are_no_messages_of_a_topic(tmp_path: Path, topic: str) -> None:
    """The error names what gives them."""
    with (
        tfbus.Recording(written(tmp_path / "a.mcap", robot(1))) as bag,
        pytest.raises(tfbus.InvalidArgumentException, match=r"samples\(frame\)"),
    ):
        bag.messages(topic)


def test_a_span_that_ends_before_it_begins_is_refused(tmp_path: Path) -> None:
    """A ValueError says so, at once."""
    begin, end = T0 + 2, T0 + 1
    with tfbus.Recording(written(tmp_path / "a.mcap", robot(1))) as bag:
        for ask in (
            lambda: bag.buffer(begin, end),
            lambda: bag.trajectory("slow", "fast", begin, end),
            lambda: bag.samples("fast", begin, end),
            lambda: bag.items(begin, end),
            lambda: bag.messages("pose", from_ns=begin, to_ns=end),
        ):
            with pytest.raises(ValueError, match="span ends before"):
                ask()


def test_no_error_advises_to_wait_for_what_was_recorded(tmp_path: Path) -> None:
    """Neither of the recording nor of its buffers."""
    with tfbus.Recording(written(tmp_path / "a.mcap", robot(5))) as bag:
        for lookup in (bag.lookup_transform, bag.buffer().lookup_transform):
            with pytest.raises(tfbus.ExtrapolationException) as late:
                lookup("slow", "fast", T0 + 9 * S)
            assert "wait" not in str(late.value) and "query the latest" in str(late.value)
            assert late.value.retry_after_s is None


def test_stamp_0_is_not_the_latest(tmp_path: Path) -> None:
    """As it is in tf2: the error of a recording, of its buffer and of any other says so."""
    with tfbus.Recording(written(tmp_path / "a.mcap", robot(5))) as bag:
        for lookup in (
            bag.lookup_transform,
            bag.buffer().lookup_transform,
            filled(robot(5)).lookup_transform,
        ):
            with pytest.raises(tfbus.ExtrapolationException, match="latest as in tf2"):
                lookup("slow", "fast", 0)


def test_a_recording_that_is_closed_says_so(tmp_path: Path) -> None:
    """What is still to be read of it cannot come."""
    with tfbus.Recording(written(tmp_path / "run.mcap", robot(5))) as bag:
        items = bag.items()
        next(items)
    with pytest.raises(tfbus.InvalidArgumentException, match=r"run\.mcap is closed"):
        list(bag.items())


@pytest.mark.parametrize("opened", [tfbus.Recording, Recorded])
def test_a_file_that_is_not_there_is_an_error_of_tfbus(
    tmp_path: Path, opened: Callable[[Path], object]
) -> None:
    """With the sentence of `--bag`, and the system's reason; Python's own error catches it too."""
    path = tmp_path / "run.mcap"
    with pytest.raises(tfbus.MissingFileError) as caught:
        opened(path)
    reason = os.strerror(errno.ENOENT)
    assert caught.value.fact.startswith(f"{path} ") and caught.value.fact.endswith(f": {reason}")
    assert (caught.value.errno, caught.value.filename) == (errno.ENOENT, str(path))
    assert isinstance(caught.value, FileNotFoundError)


def test_several_files_are_no_list(tmp_path: Path) -> None:
    """The error says how they are given."""
    path = written(tmp_path / "run.mcap", robot(1))
    with pytest.raises(tfbus.InvalidArgumentException, match=r"Recording\(first, second\)"):
        tfbus.Recording([path, path])


@pytest.mark.parametrize(("epoch_ns", "left"), [(1, []), (2, ["mast"])])
def test_a_static_set_replaces_the_one_before(
    tmp_path: Path, epoch_ns: int, left: list[str]
) -> None:
    """As at a listener: what a publisher that was started again does not send stays."""
    items = [
        in_recording(
            T0, [moved(T0, "base", "laser", 1), moved(T0, "base", "mast", 2)], static=True
        ),
        in_recording(T0 + S, [moved(T0, "base", "laser", 3)], static=True, epoch_ns=epoch_ns),
    ]
    with tfbus.Recording(written(tmp_path / "run.mcap", items)) as bag:
        buffer = bag.buffer()
    assert buffer.frames() == ["base", "laser", *left]
    assert buffer.lookup_transform("base", "laser").transform.x == 3.0


def test_a_static_set_of_a_new_epoch_voids_what_was_sent_before_it(tmp_path: Path) -> None:
    """As on the bus: a publisher that was started again has sent nothing else so far."""
    items = [
        in_recording(T0, [moved(T0, "map", "base", 1)], seq=0),
        in_recording(T0 + S, [moved(T0, "base", "laser", 3)], static=True, epoch_ns=2),
    ]
    with tfbus.Recording(written(tmp_path / "run.mcap", items)) as bag:
        buffer = bag.buffer()
    assert buffer.can_transform("base", "laser")
    assert not buffer.can_transform("map", "base")


def test_ages_in_a_buffer_are_those_at_its_end(bag: tfbus.Recording) -> None:
    """By the clock of today each sample is stale; there is no publisher to start."""
    buffer = bag.buffer()
    assert buffer.lookup_transform("slow", "fast", max_age_s=1.0).stamp_ns <= bag.end_ns
    buffer.mark_gone(["fast"], True, buffer.frame("fast").authority)
    with pytest.raises(tfbus.StaleException, match=r"its publisher is gone$"):
        buffer.lookup_transform("slow", "fast", living=True)


def test_a_trajectory_of_a_static_pair_names_what_gives_one(bag: tfbus.Recording) -> None:
    """There are no samples to go by."""
    with pytest.raises(tfbus.InvalidArgumentException, match=r"'fast' -> 'laser' .*stamps_ns"):
        bag.trajectory("fast", "laser")


def test_a_stamp_that_counts_from_the_beginning_is_answered(bag: tfbus.Recording) -> None:
    """Nothing in a recording can be given another clock."""
    with pytest.raises(tfbus.ExtrapolationException, match=r"recording\.start_ns \+") as found:
        bag.lookup_transform("slow", "fast", 5)
    assert "--sim-time" not in str(found.value)


def test_a_closed_recording_answers_nothing(tmp_path: Path) -> None:
    """Nor what it looked up before."""
    with tfbus.Recording(written(tmp_path / "a.mcap", robot(5))) as recording:
        recording.lookup_transform("slow", "fast", T0 + S)
        recording.lookup_transform("slow", "fast")
    for stamp_ns in (T0 + S, T0 + 3 * S, None):
        with pytest.raises(tfbus.InvalidArgumentException, match=r"a\.mcap is closed"):
            recording.lookup_transform("slow", "fast", stamp_ns)
