"""A recording that is damaged in the middle: all around the damage is read, and it is said."""

import logging
import threading
from pathlib import Path
from typing import Any

import pytest

from tests.builders import S, at, in_recording
from tfbus import Recording
from tfbus.recording import part
from tfbus.recording.edit import Span, cut
from tfbus.recording.items import TopicItem, TransformItem
from tfbus.recording.layout import topic_metadata
from tfbus.recording.reader import RecordingReader, in_order
from tfbus.recording.records import FOOTER_FIELDS, MAGIC, Damage, united
from tfbus.recording.writer import RecordingWriter
from tfbus.ros.definitions import Definition
from tfbus.ros.tf_message import TFMessageReader, read_many

T0 = 1_700_000_000 * S
CHUNKS, IN_CHUNK = 10, 20


def moment(number: int) -> int:
    """The log time of a message, which is also its stamp."""
    return T0 + number * S // 10


def write(path: Path) -> None:
    """Ten chunks of twenty messages, ten a second, and static transforms in the first."""
    with RecordingWriter(path, statics_every_s=1000) as writer:
        writer.write(in_recording(T0, [at(1, "laser", T0)], static=True, seq=0))
        for number in range(CHUNKS * IN_CHUNK):
            now = moment(number)
            writer.write(in_recording(now, [at(number, "base", now)], seq=number))
            if number % IN_CHUNK == IN_CHUNK - 1:
                writer.flush()


def spoil(path: Path, *chunks: int) -> None:
    """Flip a byte in the messages of these chunks."""
    with RecordingReader(path) as reader:
        places = [reader.chunks[number].chunk for number in chunks]
    data = bytearray(path.read_bytes())
    for place in places:
        data[place.offset + place.length - 3] ^= 255
    path.write_bytes(data)


def without_summary(path: Path) -> None:
    """Cut the file where its summary begins, as a power failure may."""
    data = path.read_bytes()
    start, _, _ = FOOTER_FIELDS.unpack_from(data, len(data) - len(MAGIC) - FOOTER_FIELDS.size)
    path.write_bytes(data[:start])


def numbers(reader: RecordingReader) -> list[int]:
    """The numbers of the dynamic messages."""
    return [
        item.seq
        for item in reader.items()
        if isinstance(item, TransformItem) and not item.static and item.seq is not None
    ]


ALL = list(range(CHUNKS * IN_CHUNK))


@pytest.mark.parametrize("is_complete", [True, False])
def test_what_is_around_the_damage_is_read(tmp_path: Path, is_complete: bool) -> None:
    """With the summary and without; it is met once, with its times and messages."""
    path = tmp_path / "a.mcap"
    write(path)
    spoil(path, 3)
    if not is_complete:
        without_summary(path)
    met: list[Damage] = []
    with RecordingReader(path, on_damage=lambda _, damage: met.append(damage)) as reader:
        assert reader.is_complete == is_complete
        assert numbers(reader) == numbers(reader) == ALL[:60] + ALL[80:]
        assert reader.is_damaged
        [text] = [each.text(reader.start_ns) for each in reader.damage]
    [damage] = met
    assert (damage.from_ns, damage.to_ns, damage.messages) == (moment(60), moment(79), 20)
    assert text.endswith("with 20 messages from +6.00s to +7.90s")


def test_damage_side_by_side_is_one(tmp_path: Path) -> None:
    """A line says all of it."""
    path = tmp_path / "a.mcap"
    write(path)
    spoil(path, 3, 4, 7)
    with RecordingReader(path, on_damage=lambda *_: None) as reader:
        reader.check()
        texts = [each.text(reader.start_ns) for each in reader.damage]
    assert [text.partition(" with ")[2] for text in texts] == [
        "40 messages from +6.00s to +9.90s",
        "20 messages from +14.00s to +15.90s",
    ]


def test_damage_whose_messages_are_not_known_hides_their_number() -> None:
    """A number would be too small."""
    first, second = Damage(10, 5, "a", 1, 2, 3), Damage(15, 5, "b")
    assert united([second, first]) == [Damage(10, 10, "a", 1, 2, None)]


def test_a_program_is_told_by_the_log(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Once for a file."""
    path = tmp_path / "a.mcap"
    write(path)
    spoil(path, 3, 7)
    with caplog.at_level(logging.WARNING), Recording(path) as recording:
        assert len(list(recording.items())) == len(ALL) - 2 * IN_CHUNK + 1
    [line] = caplog.messages
    assert "a.mcap is damaged: " in line and "20 messages from +6.00s to +7.90s" in line


def test_lookups_are_between_what_is_around(tmp_path: Path) -> None:
    """Two chunks are damaged: the samples before and behind both are used."""
    path = tmp_path / "a.mcap"
    write(path)
    spoil(path, 3, 4)
    with Recording(path) as recording:
        for stamp, expected in ((moment(50), 50.0), (moment(80), 80.0), (moment(110), 110.0)):
            found = recording.lookup_transform("world", "base", stamp).transform.xyz[0]
            assert found == pytest.approx(expected)
        assert len(recording.trajectory("world", "base")) == len(ALL) - 2 * IN_CHUNK
        assert recording.lookup_transform("world", "laser").transform.xyz[0] == 1.0


@pytest.mark.parametrize("chunk", range(CHUNKS))
def test_whichever_chunk_is_damaged_the_tools_go_on(tmp_path: Path, chunk: int) -> None:
    """A part of it, what is in force, lookups and a buffer."""
    path = tmp_path / "a.mcap"
    write(path)
    spoil(path, chunk)
    with RecordingReader(path, on_damage=lambda *_: None) as reader:
        reader.state_at(T0 + 10 * S)
        list(cut(reader, [Span(T0 + S, T0 + 10 * S)]))
    with Recording(path) as recording:
        assert recording.buffer().frames()
        assert recording.can_transform("world", "base", moment(100))
        assert {frame.name for frame in recording.frames()} == {"base", "laser"}


def test_messages_that_are_not_what_they_say_are_left_out(tmp_path: Path) -> None:
    """The first of a topic is said; other topics, and transforms, are read."""
    path = tmp_path / "a.mcap"
    wrong = Definition("own_msgs/msg/Point", "float64 x\nfloat64 y\n")
    with RecordingWriter(path) as writer:
        for number in range(10):
            now = moment(number)
            item = TopicItem(now, "wrong", "Point", {}, (wrong, b"\0\1\0\0short"))
            writer.write(item)
            writer.write(TopicItem(now, "right", "Own", {"x": number}))
            writer.write(in_recording(now, [at(number, "base", now)], seq=number))
            writer.flush()
    met: list[Damage] = []
    with RecordingReader(path, on_damage=lambda _, damage: met.append(damage)) as reader:
        topics = [item.topic for item in reader.items() if isinstance(item, TopicItem)]
        assert numbers(reader) == list(range(10))
    assert topics == ["right"] * 10
    assert [damage.what for damage in met] == ["topic 'wrong'"]
    assert topic_metadata(item)["tfbus.topic"] == "wrong"


def test_what_waits_for_its_turn_is_bounded_by_its_real_size() -> None:
    """Each item counts, however small its message: the index of a file is not believed."""
    groups = ((0, [1] * 100_000, 0) for _ in range(20))
    given = 0
    with pytest.raises(ValueError, match="overlap in time"):
        for _ in in_order(groups, lambda item: item):
            given += 1
    assert given == 0


def test_items_may_be_read_in_several_threads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What reads transforms is not safe from several threads: each iterator has its own."""
    path = tmp_path / "a.mcap"
    write(path)
    users: dict[TFMessageReader, set[int]] = {}

    def watched(tf: TFMessageReader, *rest: Any) -> Any:
        users.setdefault(tf, set()).add(threading.get_ident())
        return read_many(tf, *rest)

    monkeypatch.setattr(part, "read_many", watched)
    found: list[int] = []
    with Recording(path) as recording:
        iterators = [recording.items() for _ in range(3)]
        threads = [
            threading.Thread(target=lambda items=items: found.append(len(list(items))))
            for items in iterators
        ]
        for thread in threads:
            thread.start()
        recording.lookup_transform("world", "base", moment(50))
        for thread in threads:
            thread.join()
    assert found == [len(ALL) + 1] * 3
    assert [len(threads) for threads in users.values()] == [1] * len(users)
    assert len(users) == 4
