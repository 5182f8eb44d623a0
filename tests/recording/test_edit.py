"""Parts of recordings, and several as one."""

from collections.abc import Iterable
from pathlib import Path

import pytest

from tests.builders import at
from tfbus.base.errors import InvalidArgumentException
from tfbus.geometry.columns import Columns
from tfbus.recording.edit import Span, conflicting_epochs, cut, in_namespace, joined, without
from tfbus.recording.items import (
    EventItem,
    Item,
    RecordedStream,
    Selection,
    TopicItem,
    TransformItem,
)
from tfbus.recording.reader import RecordingReader
from tfbus.recording.writer import RecordingWriter

S = 1_000_000_000
START_NS = 1_700_000_000 * S
SIM = RecordedStream("sim", "/sim", epoch_ns=5)
ARM = RecordedStream("robot/arm", "/robot/arm", "robot", epoch_ns=6)


def moment(seconds: float) -> int:
    """The log time so long after the beginning."""
    return START_NS + int(seconds * S)


def laser(x: float) -> Columns:
    """A static set."""
    return Columns.of_transforms([at(x, "laser", 1, parent="base")])


def run() -> list[Item]:
    """Half a minute of two streams and a topic; the static set changes in the middle, and one
    stream goes.
    """
    items: list[Item] = [
        EventItem(moment(0), "stream", "sim", {"node": "/sim", "epoch": 5}),
        EventItem(moment(0), "stream", "robot/arm", {"node": "/robot/arm", "epoch": 6}),
        TransformItem(moment(0), SIM, laser(1.0), static=True),
    ]
    for tick in range(60):
        now = moment(tick / 2 + 0.1)
        items.append(
            TransformItem(now, SIM, Columns.of_transforms([at(tick, "base", now)]), seq=tick)
        )
        items.append(TopicItem(now + 1, "pose", "Pose", {"x": float(tick), "names": ["a"]}))
        if tick < 44:
            # Twice the same: its publisher sent it so.
            arm = TransformItem(now + 2, ARM, Columns.of_transforms([at(0, "hand", 7)]))
            items += [arm, TransformItem(now + 3, ARM, arm.rows)]
        if tick == 30:
            items.append(TransformItem(now + 4, SIM, laser(2.0), static=True))
        if tick == 44:
            items.append(EventItem(now + 4, "stream gone", "robot/arm"))
    return items


RUN = run()


def told(items: Iterable[Item]) -> list[tuple[object, ...]]:
    """The items as values to compare."""
    found: list[tuple[object, ...]] = []
    for item in items:
        if isinstance(item, TransformItem):
            rows = [repr(row) for row in item.rows]
            found.append((item.log_ns, item.stream, item.static, item.seq, rows))
        elif isinstance(item, TopicItem):
            found.append((item.log_ns, item.topic, item.type_name, item.values))
        else:
            found.append((item.log_ns, item.kind, item.name, item.facts))
    return found


def recorded(path: Path, items: Iterable[Item]) -> RecordingReader:
    """A recording of these items, open."""
    with RecordingWriter(path) as writer:
        for item in items:
            writer.write(item)
    return RecordingReader(path)


def test_a_part_begins_with_what_is_in_force(tmp_path: Path) -> None:
    """Streams, and static transforms of long before; then all that came in the span."""
    with recorded(tmp_path / "a.mcap", RUN) as reader:
        found = told(cut(reader, [Span(moment(20), moment(25))]))
    begin = moment(20)
    assert found[:3] == [
        (begin, "stream", "sim", {"node": "/sim", "epoch": 5}),
        (begin, "stream", "robot/arm", {"node": "/robot/arm", "epoch": 6}),
        *told([TransformItem(begin, SIM, laser(2.0), static=True)]),
    ]
    assert found[3:] == told(item for item in RUN if begin <= item.log_ns <= moment(25))


def test_several_parts_have_pauses_between_them(tmp_path: Path) -> None:
    """The recorder was paused there; what went meanwhile is said, and what is new is there."""
    with recorded(tmp_path / "a.mcap", RUN) as reader:
        found = list(cut(reader, [Span(moment(25), moment(26)), Span(moment(2), moment(3))]))
    events = [(item.log_ns, item.kind, item.name) for item in found if isinstance(item, EventItem)]
    assert events[2:] == [
        (moment(3), "paused", ""),
        (moment(25), "resumed", ""),
        (moment(25), "stream gone", "robot/arm"),
    ]
    statics = [item for item in found if isinstance(item, TransformItem) and item.static]
    assert [(item.log_ns, [row.transform.xyz[0] for row in item.rows]) for item in statics] == [
        (moment(2), [1.0]),
        (moment(25), [2.0]),
    ]


def test_nodes_and_streams_that_ended_in_between_end_in_their_order(tmp_path: Path) -> None:
    """That in which they came, in each run of Python."""
    names = [f"robot{number}" for number in range(20)]
    began = [EventItem(moment(1), kind, name) for kind in ("node", "stream") for name in names]
    ended = [
        EventItem(moment(5), f"{kind} gone", name) for kind in ("node", "stream") for name in names
    ]
    later = TopicItem(moment(9), "pose", "Pose", {})
    with recorded(tmp_path / "a.mcap", [*began, *ended, later]) as reader:
        found = list(cut(reader, [Span(moment(0), moment(2)), Span(moment(8), moment(9))]))
    gone = [(each.kind, each.name) for each in found if isinstance(each, EventItem)]
    assert [each for each in gone if each[0].endswith("gone")] == [
        (each.kind, each.name) for each in ended
    ]


def test_spans_that_overlap_are_one(tmp_path: Path) -> None:
    """Nothing comes twice."""
    spans = [Span(moment(1), moment(5)), Span(moment(4), moment(8))]
    with recorded(tmp_path / "a.mcap", RUN) as reader:
        assert told(cut(reader, spans)) == told(cut(reader, [Span(moment(1), moment(8))]))


def test_a_span_that_ends_before_it_begins_is_refused() -> None:
    """With both times."""
    with pytest.raises(InvalidArgumentException, match=r"from 2\.0+ s to 1\.0+ s"):
        Span(2 * S, S)


@pytest.mark.parametrize("overlap_s", [0, 4])
def test_the_parts_of_a_recording_are_the_whole_again(tmp_path: Path, overlap_s: int) -> None:
    """Whether they overlap or not; what a publisher sent twice stays twice."""
    ends = [(0, 11), (11 - overlap_s, 21), (21 - overlap_s, 30)]
    with recorded(tmp_path / "whole.mcap", RUN) as whole:
        readers = [
            recorded(
                tmp_path / f"{number}.mcap",
                cut(whole, [Span(moment(begin), moment(end))]),
            )
            for number, (begin, end) in enumerate(ends)
        ]
        assert told(joined(readers)) == told(whole.items())
        for reader in readers:
            reader.close()


def test_two_recorders_of_one_bus_are_one(tmp_path: Path) -> None:
    """A message comes once, at the time of the recorder that received it first."""
    late = [
        TransformItem(item.log_ns + 5, item.stream, item.rows, item.static, item.seq)
        for item in RUN
        if isinstance(item, TransformItem)
    ]
    with (
        recorded(tmp_path / "a.mcap", RUN) as first,
        recorded(tmp_path / "b.mcap", late) as second,
    ):
        assert told(joined([first, second])) == told(first.items())


def test_an_equal_message_is_a_new_one_where_the_other_recording_has_ended(tmp_path: Path) -> None:
    """A robot that repeats a command says it again, whatever a third recording has meanwhile."""

    def commands(begin: int, end: int) -> list[Item]:
        return [
            TopicItem(moment(second), "cmd_vel", "", {"x": 1.0}) for second in range(begin, end)
        ]

    whole = [item for item in RUN if isinstance(item, TransformItem)]
    readers = [
        recorded(tmp_path / "a.mcap", commands(1, 5)),
        recorded(tmp_path / "b.mcap", commands(5, 9)),
        recorded(tmp_path / "c.mcap", whole),
    ]
    topics = [item for item in joined(readers) if isinstance(item, TopicItem)]
    assert [item.log_ns for item in topics] == [moment(second) for second in range(1, 9)]
    for reader in readers:
        reader.close()


def beats(*seconds: float) -> list[Item]:
    """Equal messages of a retained topic."""
    return [
        TopicItem(moment(each), "beat", "Beat", {"ok": True}, retained=True) for each in seconds
    ]


def test_the_parts_of_a_heartbeat_have_all_of_it(tmp_path: Path) -> None:
    """Also where a part begins with the one before it, which is then in force."""
    with recorded(tmp_path / "a.mcap", beats(0, 2, 4, 6)) as reader:
        found = told(cut(reader, [Span(moment(1), moment(4)), Span(moment(5), moment(6))]))
    assert [each for each in found if each[1] == "beat"] == told(beats(1, 2, 4, 6))


def test_a_recorder_that_began_later_repeats_no_heartbeat(tmp_path: Path) -> None:
    """It receives at first what was in force, which the other one has."""
    with (
        recorded(tmp_path / "a.mcap", beats(0, 10, 20, 30)) as first,
        recorded(tmp_path / "b.mcap", beats(5, 10.1, 20.1)) as second,
    ):
        assert told(joined([first, second])) == told(beats(0, 10, 20, 30))


def test_publishers_of_one_name_are_found(tmp_path: Path) -> None:
    """Two robots that each have a stream `sim` at the same time."""
    other = RecordedStream("sim", "/sim", epoch_ns=99)
    items = [TransformItem(moment(3), other, laser(1.0), seq=1)]
    with (
        recorded(tmp_path / "a.mcap", RUN) as ours,
        recorded(tmp_path / "b.mcap", items) as others,
        recorded(tmp_path / "c.mcap", in_namespace(iter(items), "robot2")) as renamed,
    ):
        assert conflicting_epochs([ours, others]) == ("sim",)
        assert conflicting_epochs([ours, renamed]) == ()


def test_names_are_dropped() -> None:
    """Of topics, streams and child frames."""
    left = list(without(iter(RUN), {"pose", "robot/arm", "laser"}))
    assert not [item for item in left if isinstance(item, TopicItem)]
    assert {item.stream.name for item in left if isinstance(item, TransformItem)} == {"sim"}
    children = {
        row.child_frame_id for item in left if isinstance(item, TransformItem) for row in item.rows
    }
    assert children == {"base"}
    assert [item.name for item in left if isinstance(item, EventItem)] == ["sim"]


def test_all_is_put_in_a_namespace() -> None:
    """Streams, their nodes, topics and events."""
    found = list(in_namespace(iter(RUN), "fleet"))
    streams = {item.stream for item in found if isinstance(item, TransformItem)}
    assert streams == {
        RecordedStream("fleet/sim", "/fleet/sim", "fleet", 5),
        RecordedStream("fleet/robot/arm", "/fleet/robot/arm", "fleet/robot", 6),
    }
    assert {item.topic for item in found if isinstance(item, TopicItem)} == {"fleet/pose"}
    first = found[0]
    assert isinstance(first, EventItem)
    assert (first.name, first.facts["node"]) == ("fleet/sim", "/fleet/sim")


def test_a_node_in_a_namespace_describes_itself_so() -> None:
    """By its full name, also within its description."""
    facts = {"name": "/sim", "streams": ["sim"], "publishes": {"pose": "Pose"}}
    items = [EventItem(0, "node", "/sim", facts), EventItem(1, "node gone", "/sim")]
    found = [item for item in in_namespace(iter(items), "robot7") if isinstance(item, EventItem)]
    assert [(item.name, item.facts) for item in found] == [
        ("/robot7/sim", {**facts, "name": "/robot7/sim"}),
        ("/robot7/sim", {}),
    ]


def test_a_selection_of_a_part(tmp_path: Path) -> None:
    """One stream, also in what is in force at the beginning."""
    with recorded(tmp_path / "a.mcap", RUN) as reader:
        found = list(cut(reader, [Span(moment(20), moment(21))], Selection(streams=("robot/arm",))))
    names = {item.stream.name for item in found if isinstance(item, TransformItem)}
    assert names == {"robot/arm"}
