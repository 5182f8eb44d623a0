"""Bags of real robots, imported: their contents are as rosbags reads them, lookups as tf2's."""

from pathlib import Path
from random import Random
from typing import Any

import pytest

from tests import needs
from tests.recording.foreign_files import write_bag
from tests.tf2 import recorded
from tests.tf2.steps import Insert, Lookup, Step
from tests.tf2.versus import CACHE_TIME_S, Oracle, as_tf2_takes
from tfbus import Buffer, Recording
from tfbus.recording.foreign_files import opened
from tfbus.recording.imported import Imported, imported
from tfbus.recording.items import TransformItem
from tfbus.recording.writer import RecordingWriter

pytestmark = pytest.mark.real

# In the other one a second publisher's clock is behind: the buffer of tf2 refuses what it sends,
# and a recording, which has no end that a stamp could be too old for, takes it.
OF_ONE_CLOCK = tuple(name for name in recorded.RECORDINGS if name != "two_publishers_may16")


def imported_recording(bag: Path) -> Path:
    """The recording that a bag becomes."""
    place = bag.with_suffix(".mcap")
    with opened(bag) as files, RecordingWriter(place) as writer:
        for item in imported(files.messages(), Imported()):
            writer.write(item)
    return place


@pytest.mark.parametrize("name", recorded.RECORDINGS)
def test_every_transform_is_what_rosbags_reads(tmp_path: Path, name: str) -> None:
    """Log times, names, stamps and numbers of a robot's bag, bit by bit, in the same order."""
    bag = write_bag(tmp_path / "robot.bag", recorded.sent(name))
    needs.module("rosbags.highlevel")
    from rosbags.highlevel import AnyReader

    expected = []
    statics = {}
    with AnyReader([bag]) as reader:
        for connection, log_ns, data in reader.messages():
            message: Any = reader.deserialize(data, connection.msgtype)
            for ts in message.transforms:
                stamp = ts.header.stamp
                t, q = ts.transform.translation, ts.transform.rotation
                row = (
                    ts.header.frame_id.lstrip("/"),
                    ts.child_frame_id.lstrip("/"),
                    stamp.sec * 10**9 + stamp.nanosec,
                    (t.x, t.y, t.z, q.x, q.y, q.z, q.w),
                )
                if connection.topic == "/tf":
                    expected.append((log_ns, *row))
                else:
                    statics[row[1]] = row
    found = []
    found_statics = {}
    with Recording(imported_recording(bag)) as recording:
        for item in recording.items():
            assert isinstance(item, TransformItem)
            rows = [
                (item.rows.frames[parent], item.rows.frames[child], stamp_ns, tuple(pose))
                for (parent, child), stamp_ns, pose in zip(
                    item.rows.pairs(),
                    item.rows.stamps_as_ints(),
                    item.rows.as_batch().poses.tolist(),
                    strict=True,
                )
            ]
            if item.static:
                found_statics = {row[1]: row for row in rows}
            else:
                found += [(item.log_ns, *row) for row in rows]
    assert found == expected
    assert found_statics == statics


@pytest.mark.parametrize("name", OF_ONE_CLOCK)
def test_lookups_of_an_imported_bag_are_those_of_tf2(
    tf2: Oracle, tmp_path: Path, name: str
) -> None:
    """What tf2 answers while it is fed with a robot's transforms, the recording answers later."""
    steps = _with_questions(recorded.inserts(name), Random(name))
    buffer = Buffer(CACHE_TIME_S)
    for_tf2 = as_tf2_takes(steps, [step.ask(buffer) for step in steps])
    theirs = dict(zip(for_tf2, tf2.ask(list(for_tf2.values())), strict=True))
    answered = 0
    with Recording(imported_recording(write_bag(tmp_path / "r.bag", recorded.sent(name)))) as bag:
        for index, step in for_tf2.items():
            if isinstance(step, Lookup) and theirs[index].word == "transform":
                # tf2 does not interpolate the smallest rotations.
                ours = step.ask(bag)
                assert ours.agrees(theirs[index], 5e-8), f"{step}: {ours}, tf2: {theirs[index]}"
                answered += 1
    assert answered > 50


def _with_questions(inserts: list[Insert], rng: Random) -> list[Step]:
    """The inserts, with questions about frames and times for which all has come."""
    steps: list[Step] = []
    names: dict[str, None] = {}
    newest: dict[str, int] = {}
    for at, insert in enumerate(inserts):
        steps.append(insert)
        names |= {insert.parent: None, insert.child: None}
        newest[insert.child] = insert.stamp_ns
        if at % (len(inserts) // 200) == 0:
            target, source = rng.choices(list(names), k=2)
            past_ns = min(newest.values()) if rng.random() < 0.2 else insert.stamp_ns
            steps.append(Lookup(target, source, max(1, past_ns - rng.randrange(500_000_000))))
    return steps
