"""Written items come back, bit by bit, in order of time, from any moment on."""

import errno
import math
import os
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.builders import S, as_values, at, examples, in_recording
from tfbus.base.errors import DecodeError, InvalidArgumentException
from tfbus.base.file_lock import is_held
from tfbus.geometry.columns import Columns
from tfbus.recording.items import (
    EventItem,
    Item,
    RecordedStream,
    Selection,
    TopicItem,
    TransformItem,
)
from tfbus.recording.layout import IndexBuilder, event_of
from tfbus.recording.reader import RecordingReader
from tfbus.recording.state import BusState
from tfbus.recording.writer import RecordingWriter

T0 = 1_700_000_000 * S

STAMPS = st.integers(-(2**31) * S, (2**31 - 1) * S)
NAMES = st.text(st.characters(codec="utf-8"), min_size=1, max_size=20)


@st.composite
def columns(draw: st.DrawFn) -> Columns:
    """Transforms with any numbers, also some that are not finite."""
    frames = tuple(draw(st.lists(NAMES, min_size=2, max_size=4, unique=True)))
    count = draw(st.integers(0, 4))
    index = st.integers(0, len(frames) - 1)
    edges = draw(st.lists(st.tuples(index, index), min_size=count, max_size=count))
    stamps = draw(st.lists(STAMPS, min_size=count, max_size=count))
    poses = draw(st.binary(min_size=56 * count, max_size=56 * count))
    return Columns.of_bytes(
        frames,
        np.array(edges, np.uint32).tobytes(),
        np.array(stamps, np.int64).tobytes(),
        poses,
    )


STREAMS = st.builds(
    RecordedStream,
    st.sampled_from(["a", "robot7/b"]),
    st.sampled_from(["", "/n"]),
    st.sampled_from(["", "robot7"]),
    st.integers(0, 3),
    st.booleans(),
)
LOG_TIMES = st.integers(T0, T0 + 20 * S)
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats(allow_nan=False)
    | st.text(st.characters(codec="utf-8"), max_size=5) | st.binary(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(NAMES, inner, max_size=3),
    max_leaves=6,
)  # fmt: skip
FACTS = st.dictionaries(NAMES, VALUES, max_size=3)
TOPICS = st.sampled_from(["t", "a/b"])
TYPES = st.sampled_from(["", "Own"])
KINDS = st.sampled_from(["paused", "resumed", "dropped"])
ITEMS = st.one_of(
    st.builds(
        TransformItem,
        LOG_TIMES,
        STREAMS,
        columns(),
        st.just(False),
        st.none() | st.integers(0, 2**32 - 1),
    ),
    st.builds(TopicItem, LOG_TIMES, TOPICS, TYPES, FACTS),
    st.builds(EventItem, LOG_TIMES, KINDS, NAMES, FACTS),
)  # fmt: skip


def written(path: Path, items: Iterable[Item], **arguments: object) -> Path:
    """The path of a new file with these items."""
    with RecordingWriter(path, **arguments) as writer:
        for item in items:
            writer.write(item)
    return path


def read(*paths: Path) -> list[tuple[object, ...]]:
    """The values of all items."""
    with RecordingReader(*paths) as reader:
        return [as_values(item) for item in reader.items()]


@settings(max_examples=examples(40), deadline=None)
@given(st.lists(ITEMS, max_size=12), st.sampled_from(["zstd", "lz4", "none"]))
def test_what_is_written_comes_back(
    tmp_path_factory: pytest.TempPathFactory, items: list[Item], compression: str
) -> None:
    """Every item, bit by bit, in order of the log times; of equal ones events come first."""
    path = tmp_path_factory.mktemp("bag") / "a.mcap"
    written(path, items, compression=compression)
    expected = sorted(items, key=lambda item: (item.log_ns, not isinstance(item, EventItem)))
    assert read(path) == [as_values(item) for item in expected]


def described(log_ns: int, name: str = "sim", kind: str = "stream", **facts: object) -> EventItem:
    """An event of a stream."""
    return EventItem(log_ns, kind, name, facts)


def run(seconds: int = 30) -> list[Item]:
    """A stream of 10 Hz with one static frame, which moves after 17 s, and a topic."""
    items: list[Item] = [
        described(T0, epoch=1, frames=[["world", "turtle1", False]]),
        in_recording(T0, [at(1, "laser", T0)], static=True, seq=0),
    ]
    for i in range(10 * seconds):
        now = T0 + i * S // 10
        items.append(in_recording(now, [at(i, "turtle1", now)], seq=i))
        if i == 170:
            items.append(in_recording(now, [at(2, "laser", now)], static=True, seq=1))
        if i % 10 == 0:
            items.append(TopicItem(now, "pose", "Own", {"x": i / 7}))
    return items


def test_what_repeats_is_left_out(tmp_path: Path) -> None:
    """Static transforms are in the file every few seconds, and come once."""
    path = written(tmp_path / "a.mcap", run(), statics_every_s=2.0)
    assert read(path) == [as_values(item) for item in run()]
    with RecordingReader(path) as reader:
        assert reader.streams[0].static_messages > 12


@pytest.mark.parametrize("seconds", [0.0, 5.05, 16.9, 17.0, 29.9])
def test_the_state_at_a_moment(tmp_path: Path, seconds: float) -> None:
    """It is what the items up to then add up to."""
    path = written(tmp_path / "a.mcap", run())
    moment = T0 + int(seconds * S)
    expected = BusState()
    for item in run():
        if item.log_ns <= moment:
            expected.apply(item)
    with RecordingReader(path) as reader:
        found = reader.state_at(moment)
    values = [as_values(item) for item in found.items(0)]
    assert values == [as_values(item) for item in expected.items(0)]


def test_a_span(tmp_path: Path) -> None:
    """The items from one log time to another, both included."""
    path = written(tmp_path / "a.mcap", run())
    first, last = T0 + 3 * S, T0 + 4 * S
    with RecordingReader(path) as reader:
        found = [item.log_ns for item in reader.items(first, last, Selection(streams=("sim",)))]
        assert (reader.start_ns, reader.end_ns) == (T0, T0 + 299 * S // 10)
    assert found[0] == first and found[-1] == last
    assert len([log_ns for log_ns in found if log_ns % (S // 10) == 0]) >= 11


def test_a_selection(tmp_path: Path) -> None:
    """Only what is meant comes."""
    path = written(tmp_path / "a.mcap", run())
    with RecordingReader(path) as reader:
        topics = list(reader.items(selection=Selection(topics=("pose",))))
        assert {type(item) for item in topics} == {TopicItem} and len(topics) == 30


def test_parts_are_one_recording(tmp_path: Path) -> None:
    """A part that begins with what is in force adds nothing twice; the order is not that of the
    files.
    """
    items = run()
    half = len(items) // 2
    state = BusState()
    for item in items[:half]:
        state.apply(item)
    written(tmp_path / "a.mcap", items[:half])
    written(tmp_path / "b.mcap", [*state.items(items[half].log_ns), *items[half:]])
    assert read(tmp_path) == read(tmp_path / "b.mcap", tmp_path / "a.mcap")
    assert read(tmp_path) == [as_values(item) for item in items]


@pytest.mark.real
@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_forked_child_that_closes_a_recording_leaves_it_to_its_parent(tmp_path: Path) -> None:
    """The file still grows, and has no summary of the child's in its midst."""
    items, path = run(), tmp_path / "a.mcap"
    half = len(items) // 2
    with RecordingWriter(path) as writer:
        for item in items[:half]:
            writer.write(item)
        writer.flush()
        written_bytes = path.stat().st_size
        child = os.fork()
        if child == 0:
            writer.close()
            os._exit(0)
        os.waitpid(child, 0)
        assert is_held(path)
        assert path.stat().st_size == written_bytes
        for item in items[half:]:
            writer.write(item)
    assert read(path) == [as_values(item) for item in items]


def test_a_heartbeat_is_not_a_repetition(tmp_path: Path) -> None:
    """Equal messages of a retained topic come as often as they were sent."""
    beats = [TopicItem(T0 + n * S, "beat", "Beat", {"ok": True}, retained=True) for n in range(3)]
    assert read(written(tmp_path / "a.mcap", beats)) == [as_values(beat) for beat in beats]


def test_a_heartbeat_that_a_further_file_begins_with_comes_once(tmp_path: Path) -> None:
    """What the recorder repeats there is left out; what was sent after it is not."""
    beats = [TopicItem(T0 + n * S, "beat", "Beat", {"ok": True}, retained=True) for n in range(4)]
    state = BusState()
    state.apply(beats[1])
    first = written(tmp_path / "a.mcap", beats[:2])
    second = written(tmp_path / "b.mcap", [*state.items(T0 + 2 * S - 1), *beats[2:]])
    assert read(first, second) == [as_values(beat) for beat in beats]
    assert len(read(second)) == 3


def test_equal_numbers_of_another_type_are_no_repetition(tmp_path: Path) -> None:
    """1, 1.0 and True are three messages."""
    values = [1, 1.0, True]
    paths = [
        written(
            tmp_path / f"{n}.mcap",
            [TopicItem(T0 + n, "t", "Own", {"x": x}, retained=True, repeated=True)],
        )
        for n, x in enumerate(values)
    ]
    with RecordingReader(*paths) as reader:
        items = [item for item in reader.items() if isinstance(item, TopicItem)]
    assert [repr(item.values["x"]) for item in items] == ["1", "1.0", "True"]


def test_a_topic_may_become_retained(tmp_path: Path) -> None:
    """Then its last retained message is in force."""
    items = [
        TopicItem(T0 + n, "t", "Own", {"x": n}, retained=retained)
        for n, retained in enumerate([False, True, False])
    ]
    path = written(tmp_path / "a.mcap", items)
    with RecordingReader(path) as reader:
        assert [item.retained for item in reader.items() if isinstance(item, TopicItem)] == [
            False,
            True,
            False,
        ]
        assert reader.state_at(T0 + S).retained == {"t": items[1]}
        assert [(topic.messages, topic.is_retained) for topic in reader.topics] == [(3, True)]


def test_statics_are_repeated_after_the_clock_was_set_back(tmp_path: Path) -> None:
    """At once, and then as often as ever."""
    laser = in_recording(T0 + 1000 * S, [at(1, "laser", parent="base")], static=True)
    later = [in_recording(T0 + n * S, [at(n)]) for n in range(12)]
    with RecordingReader(written(tmp_path / "a.mcap", [laser, *later])) as reader:
        times = [item.log_ns for chunk in reader.chunks for item, _ in chunk.statics()]
    assert times == [T0 + 1000 * S, T0, T0 + 5 * S, T0 + 10 * S]


def test_gone_and_back(tmp_path: Path) -> None:
    """A description after the token was lost comes again, though it says the same."""
    items = [described(T0 + i, kind=kind) for i, kind in enumerate(["stream", "stream gone"] * 2)]
    assert read(written(tmp_path / "a.mcap", items)) == [(item,) for item in items]


def test_what_the_file_says_of_itself(tmp_path: Path) -> None:
    """Who recorded it, the streams and the topics, without reading the items."""
    path = written(tmp_path / "a.mcap", run(), about={"host": "atlas\x1b"})
    with RecordingReader(path) as reader:
        assert reader.about["host"] == "atlas\\x1b"
        [stream] = reader.streams
        assert (stream.stream.name, stream.messages) == ("sim", 300)
        [topic] = reader.topics
        assert (topic.name, topic.type_name, topic.messages) == ("pose", "Own", 30)
        assert reader.is_complete


@pytest.mark.parametrize(
    "item",
    [
        in_recording(T0, [at(stamp_ns=2**31 * S)]),
        in_recording(-1, [at()]),
        in_recording(2**63, [at()]),
        TopicItem(T0, "t", "T", {"x": 2**64}),
        EventItem(T0, "node", "n", {"x": object()}),
        EventItem(T0, "node", "\ud800", {}),
    ],
    ids=["stamp", "before 1970", "after 2262", "integer", "fact", "name"],
)
def test_what_cannot_be_written_changes_nothing(tmp_path: Path, item: Item) -> None:
    """It is refused, and the file goes on."""
    with RecordingWriter(tmp_path / "a.mcap") as writer:
        writer.write(in_recording(T0, [at()]))
        with pytest.raises(InvalidArgumentException):
            writer.write(item)
        writer.write(in_recording(T0 + 1, [at()]))
    assert [values[0] for values in read(tmp_path / "a.mcap")] == [T0, T0 + 1]


def test_facts_that_json_has_not(tmp_path: Path) -> None:
    """Bytes, infinity and maps that look like their stand-ins come back."""
    facts = {"a": b"\0\xff", "b": [math.inf, -math.inf], "c": {"$bytes": "x"}, "d": {"$map": {}}}
    items = [EventItem(T0, "node", "n", facts)]
    assert read(written(tmp_path / "a.mcap", items)) == [(items[0],)]


@pytest.mark.parametrize("facts", ['{"a":{"$bytes":5}}', '{"a":{"$number":[]}}', "[]", "{"])
def test_facts_that_are_none_are_an_error_of_the_file(facts: str) -> None:
    """Whoever wrote them."""
    with pytest.raises(DecodeError, match="an event of kind 'node' cannot be read"):
        event_of({"log_time": "1", "kind": "node", "name": "/sim", "facts": facts})


def test_a_file_is_not_overwritten(tmp_path: Path) -> None:
    """An existing file is left as it is, whatever it is."""
    (tmp_path / "a.mcap").write_text("mine")
    with pytest.raises(FileExistsError):
        RecordingWriter(tmp_path / "a.mcap")
    assert (tmp_path / "a.mcap").read_text() == "mine"


def test_an_unknown_compression_makes_no_file(tmp_path: Path) -> None:
    """It is refused before the file is made."""
    with pytest.raises(InvalidArgumentException, match="zstd, lz4, none"):
        RecordingWriter(tmp_path / "a.mcap", compression="bzip2")
    assert not (tmp_path / "a.mcap").exists()


def test_what_was_flushed_is_in_the_file(tmp_path: Path) -> None:
    """Up to the flush all is there, though the writer is not closed, and the end is missing."""
    writer = RecordingWriter(tmp_path / "a.mcap")
    items = run(3)
    for item in items:
        writer.write(item)
    writer.flush()
    writer.write(in_recording(T0 + 9 * S, [at()]))
    with RecordingReader(tmp_path / "a.mcap") as reader:
        assert [as_values(item) for item in reader.items()] == [as_values(item) for item in items]
        assert not reader.is_complete
    writer.close()


def test_a_folder_without_recordings(tmp_path: Path) -> None:
    """It is said in a sentence."""
    with pytest.raises(DecodeError, match=r"folder without \.mcap"):
        RecordingReader(tmp_path)


def test_an_empty_recording(tmp_path: Path) -> None:
    """It has no items, and times of 0."""
    with RecordingReader(written(tmp_path / "a.mcap", [])) as reader:
        assert list(reader.items()) == [] and (reader.start_ns, reader.end_ns) == (0, 0)


def test_two_recordings_of_the_same_time_are_one(tmp_path: Path) -> None:
    """Their items come in order of time, as of two recorders on one bus."""
    items = run()
    for name, taken in (("a", items[::2]), ("b", items[1::2])):
        with RecordingWriter(tmp_path / f"{name}.mcap") as writer:
            for number, item in enumerate(taken):
                writer.write(item)
                if number % 9 == 0:
                    writer.flush()
    times = [values[0] if len(values) > 1 else values[0].log_ns for values in read(tmp_path)]
    assert times == sorted(times) and len(times) >= len(items)


def test_after_an_error_nothing_more_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What Python holds of the file stays out of it: the disk may have room again at its end."""
    writer = RecordingWriter(tmp_path / "a.mcap", compression="none")
    writer.write(in_recording(T0, [at(1, "base", T0)], seq=0))
    writer.flush()
    size = (tmp_path / "a.mcap").stat().st_size
    writer.write(EventItem(T0, "paused"))
    writer.write(in_recording(T0, [at(2, "base", T0)], seq=1))

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(IndexBuilder, "end_chunk", full)
    with pytest.raises(OSError, match="No space left"):
        writer.flush()
    writer.close()
    assert (tmp_path / "a.mcap").stat().st_size == size
