"""The selection of a part of a bus or of a recording."""

from pathlib import Path

import pytest

from tests.builders import S, at
from tfbus.geometry.columns import Columns
from tfbus.recording.items import RecordedStream, Selection, TransformItem
from tfbus.recording.reader import RecordingReader
from tfbus.recording.writer import RecordingWriter


def kinds(selection: Selection, stream: str = "sim") -> str:
    """Which transforms of a stream are taken: d for dynamic, s for static ones."""
    takes = selection.takes_transforms
    return "d" * takes(stream, static=False) + "s" * takes(stream, static=True)


@pytest.mark.parametrize(
    ("selection", "taken"),
    [
        (Selection(), "ds"),
        (Selection(topics=("tf",)), "d"),
        (Selection(topics=("tf_static",)), "s"),
        (Selection(topics=("tf", "tf_static", "pose")), "ds"),
        (Selection(topics=("pose",)), ""),
        (Selection(topics=("tf_static",), streams=("sim",)), "s"),
        (Selection(topics=("tf_static",), streams=("arm",)), ""),
        (Selection(topics=("tf",), frames=("base",)), "d"),
        (Selection(topics=("pose",), streams=("sim",)), "ds"),
        (Selection(topics=("tf",), exclude="sim"), ""),
        (Selection(exclude_topics=("tf_static",)), "d"),
        (Selection(exclude_topics=("tf", "tf_static")), ""),
        (Selection(exclude_topics=("pose",)), "ds"),
    ],
)
def test_tf_stands_for_dynamic_transforms_and_tf_static_for_static_ones(
    selection: Selection, taken: str
) -> None:
    """Both as in ROS, also where they are excluded."""
    assert kinds(selection) == taken
    assert selection.takes_stream("sim") is bool(taken)


def test_a_namespace_takes_the_transforms_below_it() -> None:
    """`robot7/tf` are the dynamic transforms of robot7, and none of robot8."""
    of_robot7 = Selection(topics=("robot7/tf",))
    assert kinds(of_robot7, "robot7/sim") == "d"
    assert not of_robot7.takes_stream("robot8/sim") and not of_robot7.takes_stream("sim")


def test_excluded_topics_are_left_out() -> None:
    """By their whole name."""
    selection = Selection(exclude_topics=("pose",))
    assert not selection.takes_topic("pose") and selection.takes_topic("pose2")


def test_a_reader_gives_the_kind_that_is_asked_for(tmp_path: Path) -> None:
    """Static and dynamic transforms of one stream come apart."""
    stream, path = RecordedStream("sim", epoch_ns=1), tmp_path / "run.mcap"
    with RecordingWriter(path) as writer:
        writer.write(
            TransformItem(1 * S, stream, Columns.of_transforms([at(2.0, "mast")]), static=True)
        )
        writer.write(TransformItem(2 * S, stream, Columns.of_transforms([at(1.0)]), seq=0))
    with RecordingReader(path) as reader:
        for topic, statics in (("tf", [False]), ("tf_static", [True])):
            found = reader.items(selection=Selection(topics=(topic,)))
            assert [item.static for item in found if isinstance(item, TransformItem)] == statics
            in_force = reader.state_at(9 * S, Selection(topics=(topic,))).statics
            assert bool(in_force) == statics[0]


def test_some_topics_are_always_taken() -> None:
    """Whatever else is chosen or excluded, and only their own messages."""
    some = Selection(topics=("tf",), exclude="clock", always=("clock",))
    assert some.takes_topic("clock") and not some.takes_topic("pose")
    assert some.takes_stream("sim") and not some.takes_stream("clock")
