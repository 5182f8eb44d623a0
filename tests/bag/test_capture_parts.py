"""The parts between the bus and the file: the queue, gaps, conditions, names of files."""

from array import array
from itertools import islice
from pathlib import Path
from typing import Any

import pytest

from tests.builders import at, description, payload
from tests.fakes import Clock
from tfbus.bag.keeping import MissedMessages, existing_parts, part_paths, path_of_recording
from tfbus.bag.raw_queue import (
    EVENTS,
    OVERHEAD_BYTES,
    FullNames,
    RawQueue,
    TopicSource,
    TransformSource,
)
from tfbus.bag.recorder import SnapshotCondition, Triggers
from tfbus.base.errors import DecodeError, InvalidArgumentException
from tfbus.recording.items import EventItem, RecordedStream
from tfbus.wire.codec import as_map, encode_map
from tfbus.wire.descriptions import StreamDescription
from tfbus.wire.numbered import FrameNumbers
from tfbus.wire.transforms import NumberedEncoder, TransformMessage, TransformReader


def source(
    described: dict[str, StreamDescription] | None = None, *, static: bool = False
) -> TransformSource:
    return TransformSource("sim", "", described or {}, TransformReader(), static=static)


class TestQueue:
    def test_messages_come_out_as_they_went_in_with_their_times(self) -> None:
        """Each message has the time at which it came, and the order stays."""
        clock = Clock(5)
        queue = RawQueue(10_000, clock)
        queue.put(EVENTS, EventItem(0, "paused"))
        clock.now_ns = 7
        queue.put(TopicSource("pose", {}), b"x")
        assert [(raw.log_ns, raw.source.kind) for raw in queue.drain(0)] == [
            (5, "events"),
            (7, "topics"),
        ]
        assert queue.drain(0) == []

    def test_beyond_its_room_messages_are_dropped_and_counted_by_kind(self) -> None:
        """A full queue drops what comes; what was taken out counts until the next is taken."""
        queue = RawQueue(2 * (OVERHEAD_BYTES + 100))
        for _ in range(3):
            queue.put(source(), bytes(100))
        assert queue.dropped == {"transforms": 1}
        assert len(queue.drain(0)) == 2
        queue.put(TopicSource("pose", {}), bytes(100))
        assert queue.dropped == {"transforms": 1, "topics": 1}
        queue.drain(0)
        queue.put(source(), bytes(100))
        assert len(queue.drain(0)) == 1

    def test_what_is_essential_finds_room_where_transforms_do_not(self) -> None:
        """Events and statics have as much room again."""
        queue = RawQueue(OVERHEAD_BYTES + 100)
        queue.put(source(), bytes(100))
        queue.put(source(static=True), bytes(100))
        queue.put(source(static=True), bytes(100))
        assert queue.dropped == {"statics": 1}

    def test_descriptions_count_by_what_they_say(self) -> None:
        """A large description finds no room where a small one does."""
        queue = RawQueue(2_000)
        queue.put(EVENTS, streams("small", "turtle1"))
        queue.put(EVENTS, streams("large", *(f"frame{number}" for number in range(1_000))))
        assert queue.dropped == {"events": 1}
        assert [raw.payload.name for raw in queue.drain(0)] == ["small"]

    def test_what_its_taker_still_holds_counts(self) -> None:
        """Until it says that less of it waits."""
        size = OVERHEAD_BYTES + 100
        queue = RawQueue(2 * size)
        queue.put(source(), bytes(100))
        queue.drain(0)
        queue.drain(0, held_bytes=size)
        for _ in range(2):
            queue.put(source(), bytes(100))
        assert queue.dropped == {"transforms": 1}
        queue.drain(0)
        queue.drain(0)
        queue.put(source(), bytes(100))
        assert queue.dropped == {"transforms": 1}

    def test_while_paused_only_what_is_in_force_is_taken(self) -> None:
        """A pause leaves out dynamic transforms and topics, and counts nothing as dropped."""
        queue = RawQueue(10_000)
        queue.is_paused = True
        for each in (source(), source(static=True), TopicSource("pose", {})):
            queue.put(each, b"")
        assert [raw.source.kind for raw in queue.drain(0)] == ["statics"]
        assert not queue.dropped


class TestSources:
    def test_a_message_of_transforms_names_its_stream_and_node(self) -> None:
        """What the message does not say comes from the description of the stream."""
        described = {"sim": description([("world", "turtle1", False)], split=True)}
        item = source(described).item(3, payload([at(1.5)], epoch_ns=9, seq=4))
        assert item.stream == RecordedStream("sim", "/node", "", 9, split=True)
        assert (item.log_ns, item.seq, item.static) == (3, 4, False)
        assert list(item.rows) == [at(1.5)]

    def test_a_stream_that_was_never_described_has_no_node(self) -> None:
        """A message counts without a description too."""
        plain = source()
        assert not plain.is_described(b"")
        assert plain.item(0, payload([at()])).stream == RecordedStream("sim", epoch_ns=1)

    def test_a_message_of_a_topic_has_its_fields_and_type(self) -> None:
        """The type is that which its node says."""
        pose = TopicSource("pose", {"pose": "Pose"})
        item = pose.item(1, encode_map({"x": 2.5}))
        assert (item.topic, item.type_name, item.values) == ("pose", "Pose", {"x": 2.5})

    def test_a_message_that_waited_for_names_is_read_once(self) -> None:
        """To see whether its names are there, and to write it."""

        class Counting(TransformReader):
            reads = 0

            def read(self, payload: bytes, numbers: FrameNumbers | None = None) -> TransformMessage:
                self.reads += 1
                return super().read(payload, numbers)

        origins = array("d", [0, 0, 0, 0, 0, 0, 1]).tobytes()
        numbered: dict[str, Any] = {
            "numbered": ((0, "world", "arm"),),
            "next_number": 1,
            "origins": origins,
        }
        described = {"sim": description([], poses="compact", **numbered)}
        reader = Counting()
        of = TransformSource("sim", "", described, reader, static=False)
        encoder = NumberedEncoder(1, [0], origins, is_short=False)
        data = encoder.encode(0, bytes(8), origins)
        assert of.is_described(data)
        assert [row.child_frame_id for row in of.item(0, data).rows] == ["arm"]
        assert reader.reads == 1

    def test_what_is_no_message_is_refused(self) -> None:
        """Bytes that are no message raise DecodeError."""
        for each in (source(), TopicSource("pose", {})):
            with pytest.raises(DecodeError):
                each.item(0, b"\xc1")

    def test_names_are_as_without_a_namespace(self) -> None:
        """Relative names get the namespace in front, absolute ones lose their slash."""
        names = FullNames("robot7")
        assert names.full("turtle1/pose") == "robot7/turtle1/pose"
        assert names.full("/map") == "map"
        assert names.namespace("arm") == "robot7/arm"
        assert (names.namespace(""), FullNames("").namespace("")) == ("robot7", "")


class TestMissed:
    def test_numbers_that_are_missing_are_counted(self) -> None:
        """A gap in the numbers of an epoch counts; a new epoch begins anywhere."""
        missed, of = MissedMessages(), source()
        for epoch, seq in ((1, 4), (1, 5), (1, 9), (2, 3), (2, 4)):
            missed.add(of, of.item(0, payload([at()], epoch, seq)))
        assert missed.count == 3

    def test_what_comes_late_is_not_missed(self) -> None:
        """Numbers in another order, or twice, are no gap."""
        missed, of = MissedMessages(), source()
        counts = []
        for seq in (1, 2, 5, 3, 3, 4, 6):
            missed.add(of, of.item(0, payload([at()], 1, seq)))
            counts.append(missed.count)
        assert counts == [0, 0, 2, 1, 1, 0, 0]

    def test_what_a_pause_left_out_is_not_missed(self) -> None:
        """After a pause the numbers begin anywhere."""
        missed, of = MissedMessages(), source()
        missed.add(of, of.item(0, payload([at()], 1, 0)))
        missed.add(EVENTS, EventItem(0, "resumed"))
        missed.add(of, of.item(0, payload([at()], 1, 50)))
        assert missed.count == 0


def streams(name: str, *children: str) -> EventItem:
    described = description([("map", child, False) for child in children])
    facts = {**as_map(described), "node": f"/{name}"}
    return EventItem(0, "stream", name, facts)


class TestTriggers:
    def test_a_frame_that_is_gone_fulfils_its_condition(self) -> None:
        """The end of the stream that sends the frame counts, of another stream not."""
        triggers = Triggers((SnapshotCondition.parse("gone base_link"),))
        events = [
            streams("arm", "hand"),
            streams("base", "base_link", "wheel"),
            EventItem(0, "stream gone", "arm"),
            EventItem(0, "stream gone", "base"),
        ]
        *others, reason = [triggers.fulfilled_by(event) for event in events]
        assert others == ["", "", ""]
        assert "'base' is gone" in reason and reason.endswith("base_link")

    def test_two_publishers_of_a_frame_fulfil_its_condition(self) -> None:
        """A second living stream with the frame counts."""
        triggers = Triggers((SnapshotCondition.parse("conflict"),))
        assert not triggers.fulfilled_by(streams("one", "base"))
        said = triggers.fulfilled_by(streams("two", "base"))
        assert "'one' and 'two'" in said and said.endswith("send base")

    @pytest.mark.parametrize("name", ["base_link", "robot7/base_link", "fleet/robot7/base_link"])
    def test_frames_have_the_names_of_a_fleet_too(self, name: str) -> None:
        """`robot7/base_link` is the frame base_link of the robot in the namespace robot7 alone."""
        triggers = Triggers((SnapshotCondition.parse(f"gone {name}"),))
        for robot in ("robot7", "robot17"):
            triggers.fulfilled_by(streams(f"fleet/{robot}/sim", "base_link", "old_base_link"))
        other = triggers.fulfilled_by(EventItem(0, "stream gone", "fleet/robot17/sim"))
        said = triggers.fulfilled_by(EventItem(0, "stream gone", "fleet/robot7/sim"))
        assert bool(other) == (name == "base_link")
        assert said.endswith("is gone, with fleet/robot7/base_link")

    def test_two_robots_may_have_frames_of_one_name(self) -> None:
        """That is no conflict."""
        triggers = Triggers((SnapshotCondition.parse("conflict"),))
        assert not triggers.fulfilled_by(streams("robot7/sim", "base_link"))
        assert not triggers.fulfilled_by(streams("robot8/sim", "base_link"))

    def test_without_a_frame_any_counts(self) -> None:
        """`gone` holds for each stream with frames."""
        triggers = Triggers((SnapshotCondition("gone"),))
        triggers.fulfilled_by(streams("one", "a"))
        assert triggers.fulfilled_by(EventItem(0, "stream gone", "one"))

    def test_another_condition_is_refused(self) -> None:
        """The error says which there are."""
        with pytest.raises(InvalidArgumentException, match=r"gone FRAME' .*'conflict FRAME"):
            SnapshotCondition.parse("lost base_link")


class TestNames:
    def test_parts_are_numbered(self) -> None:
        """The first file has the name itself."""
        parts = [path.name for path in islice(part_paths(Path("run.mcap")), 3)]
        assert parts == ["run.mcap", "run_1.mcap", "run_2.mcap"]

    def test_a_name_needs_no_ending(self, tmp_path: Path) -> None:
        """`run` and `run.mcap` are the same; a folder gets the default name."""
        assert path_of_recording(str(tmp_path / "run")) == tmp_path / "run.mcap"
        assert path_of_recording(str(tmp_path / "v1.2")) == tmp_path / "v1.2.mcap"
        assert path_of_recording("run.mcap") == Path("run.mcap")
        new = path_of_recording(f"{tmp_path}/new/")
        assert new.parent == tmp_path / "new" and new.name.startswith("tfbus_20")
        inside = path_of_recording(str(tmp_path))
        assert inside.parent == tmp_path and inside.name.startswith("tfbus_20")

    def test_files_of_other_recordings_are_none_of_it(self, tmp_path: Path) -> None:
        """Only the name itself, and the name with a number, are parts."""
        for name in ("run.mcap", "run_2.mcap", "run_b.mcap", "runs.mcap", "run.txt"):
            (tmp_path / name).touch()
        taken = [path.name for path in existing_parts(tmp_path / "run.mcap")]
        assert taken == ["run.mcap", "run_2.mcap"]
