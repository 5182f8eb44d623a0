"""A recording gives one answer: every door is asked the same, of recordings that are drawn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest

from tests.builders import Row, S, examples
from tests.recordings import T0, at, described, gone, publisher, sent, statics
from tfbus import NodeSettings
from tfbus.base.errors import ExtrapolationException, LookupException, TfbusError
from tfbus.command.recordings import BagChoice
from tfbus.command.types import Moment
from tfbus.frames.recorded import RecordedFrames
from tfbus.frames.recorded_poses import frames_of_bag, recorded_track, recorded_transform
from tfbus.frames.recorded_poses import recorded_transforms as echoed
from tfbus.frames.why import explain_recorded
from tfbus.geometry.columns import Columns
from tfbus.geometry.transform import Transform, TransformStamped
from tfbus.recording.items import EventItem, Item, RecordedStream, TransformItem

pytest.importorskip("mcap", reason="needs mcap: the extra bag")

from tfbus.frames.recorded_poses import poses_at
from tfbus.frames.recording import Recording
from tfbus.recording.reader import RecordingReader
from tfbus.recording.writer import RecordingWriter
from tfbus.view.replay import Replay

SETTINGS = NodeSettings("test")
LENGTH_S = 8.0
PAIRS = [("map", "base"), ("map", "tool"), ("arm", "laser"), ("laser", "map"), ("map", "lidar")]
STATIC = [("base", "laser"), ("base", "lidar")]

Pose = tuple[float, ...]


class Drawn:
    """The items of a robot that lives through what can happen on a bus, by a seed."""

    def __init__(self, seed: int, *, late: bool) -> None:
        self.random = Random(seed)
        self.is_late = late
        self.items: list[Item] = []
        self.turns: list[float] = []
        sim, arm = publisher("sim"), publisher("arm")
        self._live(sim, ("map", "base"), 0.1)
        self._live(arm, ("base", "arm"), self.random.choice([0.1, 0.25, 0.7]), spare="tool")
        self.is_described = self.random.random() < 0.7
        self._model(publisher("model"))
        # Then all that is known of a stamp was known when it came.
        self.is_plain = not late and self.random.random() < 0.5
        if not self.is_plain:
            self._twin(publisher("twin", 1.0))
        self._pause()

    def _live(
        self, stream: RecordedStream, edge: tuple[str, str], apart_s: float, spare: str = ""
    ) -> None:
        """A publisher that restarts, is gone for a while, or removes the spare frame below it."""
        rows = [(*edge, False), *([(edge[1], spare, False)] if spare else [])]
        turns = sorted(self.random.uniform(1.0, LENGTH_S) for _ in range(self.random.randrange(4)))
        begin_s = 0.0
        for end_s in [*turns, LENGTH_S]:
            self.items.append(described(stream, begin_s, *rows))
            self._send(stream, begin_s, end_s, apart_s, rows)
            match self.random.choice(["restart", "killed", "removed", "away"]):
                case "restart":
                    stream = replace(stream, epoch_ns=at(end_s))
                case "killed":
                    self.items.append(gone(stream, end_s))
                    stream = replace(stream, epoch_ns=at(end_s))
                case "away":
                    self.items.append(gone(stream, end_s))
                case "removed" if spare:
                    rows = rows[:1] if len(rows) > 1 else [*rows, (edge[1], spare, False)]
            self.turns.append(end_s)
            begin_s = end_s + self.random.choice([0.0, 0.02, 0.5])

    def _send(
        self, stream: RecordedStream, begin_s: float, end_s: float, apart_s: float, rows: list[Row]
    ) -> None:
        stamp_s, number = begin_s, 0
        while stamp_s < end_s - 0.01:
            item = sent(stream, stamp_s, *((*row[:2], 0.0) for row in rows), seq=number)
            item = replace(item, rows=self._turned(item.rows))
            if self.is_late and self.random.random() < 0.1:
                item = replace(item, log_ns=item.log_ns + self.random.randrange(S))
            self.items.append(item)
            stamp_s, number = stamp_s + apart_s * self.random.uniform(0.5, 1.5), number + 1

    def _turned(self, rows: Columns) -> Columns:
        """The same edges with poses of their own."""
        turned = []
        for each in rows:
            roll, yaw, x = (self.random.uniform(-3.0, 3.0) for _ in range(3))
            pose = Transform.from_rpy(roll, 0.4, yaw, (x, 0.0, 1.0))
            frames = each.frame_id, each.child_frame_id
            turned.append(TransformStamped(each.stamp_ns, *frames, pose))
        return Columns.of_transforms(turned)

    def _model(self, stream: RecordedStream) -> None:
        """Static frames, which may come late, be moved, or be others after a restart."""
        first_s = self.random.choice([0.0, 3.0])
        times = [first_s, *([self.random.uniform(4.0, 7.0)] if self.random.random() < 0.5 else [])]
        frames = ["laser", "lidar"][: self.random.randrange(1, 3)]
        for number, time_s in enumerate(times):
            rows = [("base", frame, number + 1.0) for frame in frames]
            if self.is_described:
                listed = [(*row[:2], True) for row in rows]
                self.items.append(described(stream, time_s, *listed))
            self.items.append(statics(stream, time_s, *rows, seq=number))
            self.turns.append(time_s)
            if self.random.random() < 0.5:
                # Its clock may be behind after it was killed.
                is_behind = self.is_described and self.random.random() < 0.5
                if is_behind:
                    self.items.append(gone(stream, time_s + 0.4))
                    self.turns.append(time_s + 0.4)
                began_s = -2.0 - number if is_behind else time_s + 0.5
                stream = replace(stream, epoch_ns=at(began_s))
                frames = self.random.choice([["laser"], ["lidar"], ["laser", "lidar"]])

    def _twin(self, stream: RecordedStream) -> None:
        """A second publisher of base, with stamps of its own and some that are equal."""
        begin_s, end_s = 4.0, self.random.uniform(5.0, 7.0)
        self.items.append(described(stream, begin_s, ("map", "base", False)))
        same = [
            item.rows.last_stamp_ns()
            for item in self.items
            if isinstance(item, TransformItem)
            and item.stream.name == "sim"
            and at(begin_s) < item.log_ns < at(end_s)
        ]
        for number, stamp_ns in enumerate(filter(None, same)):
            stamp_ns += self.random.choice([0, 0, 20_000_000])
            item = sent(stream, (stamp_ns - T0) / S, ("map", "base", -1.0), stamp_ns=stamp_ns)
            late_ns = self.random.choice([1_000_000, 30_000_000])
            self.items.append(replace(item, log_ns=stamp_ns + late_ns, seq=number))
        self.items.append(gone(stream, end_s))

    def _pause(self) -> None:
        if self.random.random() < 0.5:
            from_ns = at(self.random.uniform(2.0, 6.0))
            to_ns = from_ns + self.random.randrange(2 * S)
            self.turns += [(each - T0) / S for each in (from_ns, to_ns)]
            self.items = [
                item
                for item in self.items
                if not from_ns < item.log_ns < to_ns or isinstance(item, EventItem)
            ]
            self.items += [EventItem(from_ns, "paused"), EventItem(to_ns, "resumed")]

    def written(self, path: Path, *, damaged: bool) -> Path:
        """A file of them in chunks of some messages, one of which may be damaged."""
        with RecordingWriter(path) as writer:
            for item in sorted(self.items, key=lambda item: item.log_ns):
                writer.write(item)
                if self.random.random() < 0.05:
                    writer.flush()
        if damaged:
            with RecordingReader(path) as reader:
                chunk = self.random.choice(reader.chunks)
            data = bytearray(path.read_bytes())
            data[chunk.offset + chunk.length - 3] ^= 255
            path.write_bytes(data)
        return path

    def is_turning(self, log_ns: int) -> bool:
        """Whether something happens then, or so near that stamps do not tell which is first."""
        return any(abs(at(turn) - log_ns) < S // 10 for turn in self.turns)

    def stamps(self, count: int) -> list[int]:
        """Some at random, and some just before and after what happened."""
        near = [turn + self.random.uniform(-1.2, 0.3) for turn in self.turns]
        anywhere = [self.random.uniform(-0.5, LENGTH_S + 0.5) for _ in range(count)]
        return [at(each) for each in (*near, *anywhere)]


def asked(door: Callable[..., TransformStamped], *question: Any) -> Any:
    """The pose and its stamp, or which error it was, and of which frame."""
    try:
        found = door(*question)
    except TfbusError as error:
        known = error.__cause__ if isinstance(error.__cause__, TfbusError) else error
        if isinstance(known, ExtrapolationException):
            return type(known), known.child_frame_id, known.oldest_ns, known.newest_ns
        return type(known), known.frame if isinstance(known, LookupException) else ""
    return found.stamp_ns, found.transform.as_pose()


def exported(recording: Recording, pair: tuple[str, str], stamp_ns: int) -> TransformStamped:
    """As `bag export` at given stamps."""
    return poses_at(recording, *pair, np.array([stamp_ns]))[0]


# One of each kind comes first. In 16 and 35 static frames are left behind by a restart.
SEEDS = (0, 4, 9, 16, 1, 5, 10, 35, 2, 6, 11, 3, 7, 8)
DRAWS = [
    (seed, {"late": 3 < seed < 12, "damaged": 8 < seed < 12}) for seed in SEEDS[: examples(14)]
]


@pytest.fixture(params=DRAWS, ids=lambda draw: f"{draw[0]}")
def drawn(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Drawn, BagChoice]:
    """A robot and its recording."""
    seed, options = request.param
    robot = Drawn(seed, late=options["late"])
    path = robot.written(tmp_path / "run.mcap", damaged=options["damaged"])
    return robot, BagChoice((path,), statics="always")


def test_a_lookup_at_a_stamp_has_one_answer(drawn: tuple[Drawn, BagChoice]) -> None:
    """`Recording`, many stamps at once, `bag export` at stamps, `echo --at` and `why --at`."""
    robot, bag = drawn
    stamps = robot.stamps(4)
    stamps = robot.random.sample(stamps, min(len(stamps), examples(60)))
    with Recording(*bag.paths) as recording, bag.opened() as opened:
        frames = frames_of_bag(opened, SETTINGS, None)
        for stamp_ns in stamps:
            if not opened.reader.start_ns <= stamp_ns <= opened.reader.end_ns:
                continue
            moment = replace(bag, at=Moment(stamp_ns))
            frames.seek(stamp_ns)
            for pair in PAIRS:
                answer = asked(recording.lookup_transform, *pair, stamp_ns)
                many = asked(exported, recording, pair, stamp_ns)
                assert many == answer, (pair, stamp_ns - T0)
                echo = asked(recorded_transform, moment, SETTINGS, None, *pair)
                assert echo == answer, (pair, stamp_ns - T0)
                said = explain_recorded(frames, *pair, ["run.mcap"], at_moment=True)
                if frames.pause is None:
                    assert (said.answer is None) == (not isinstance(answer[0], int))


def test_a_path_has_one_answer(drawn: tuple[Drawn, BagChoice]) -> None:
    """`bag export`, `plot` and `echo` have the same stamps and poses, those of single lookups."""
    robot, bag = drawn
    frames = {
        frame
        for item in robot.items
        if isinstance(item, TransformItem)
        for frame in item.rows.frames
    }
    with Recording(*bag.paths) as recording:
        for pair in [each for each in PAIRS if frames.issuperset(each)]:
            path = recording.trajectory(*pair)
            track = recorded_track(bag, SETTINGS, None, *pair)
            assert track.stamps_ns.tolist() == path.stamps_ns.tolist()
            assert track.xyz.tolist() == path.xyz.tolist()
            assert track.quat_xyzw.tolist() == path.quat_xyzw.tolist()
            found = list(echoed(bag, SETTINGS, None, *pair))
            assert found == [recording.lookup_transform(*pair, each.stamp_ns) for each in found]
            assert [each.stamp_ns for each in found] == path.stamps_ns.tolist()


@pytest.mark.real
def test_foxglove_shows_the_same_moment(drawn: tuple[Drawn, BagChoice]) -> None:
    """A client that seeks while it stands gets the latest transforms, those of the buffer."""
    pytest.importorskip("websockets", reason="needs websockets: pip install websockets")
    from tests.foxglove.playing import watching_transforms
    from tfbus.foxglove.front import Serving
    from tfbus.foxglove.playback import PlaybackBridge
    from tfbus.foxglove.topics import present

    robot, bag = drawn
    with Recording(*bag.paths) as recording, RecordingReader(*bag.paths) as reader:
        span = reader.start_ns, reader.end_ns
        stamps = [each for each in robot.stamps(6) if span[0] <= each <= span[1]]
        sent = [each.log_ns for each in robot.items if isinstance(each, TransformItem)]
        stamps += robot.random.sample(sent, 4)  # exactly when a message came
        with watching_transforms(PlaybackBridge(bag.paths, span, Serving(port=0))) as client:
            for number, stamp_ns in enumerate([*stamps, span[1]]):
                client.control(play=False, seek_ns=stamp_ns, request=str(number))
        for stamp_ns in stamps:
            whole = recording.buffer(None, stamp_ns)
            for topic, static in (("/tf", False), ("/tf_static", True)):
                wanted = {shown(each) for each in present(whole, static=static)}
                found = client.transforms_at(topic, stamp_ns)
                assert {shown(each) for each in found} == wanted, (topic, stamp_ns - T0)


def shown(transform: TransformStamped) -> tuple[Any, ...]:
    """A transform as a value."""
    frames = transform.frame_id, transform.child_frame_id
    return (*frames, transform.stamp_ns, transform.transform.as_pose())


def test_a_moment_has_one_answer(drawn: tuple[Drawn, BagChoice]) -> None:
    """`frames`, which seeks, `monitor` and `doctor`, which play, `view` and
    `Recording.buffer` have the same latest transforms, which are those of the stamp.
    """
    robot, bag = drawn
    with Recording(*bag.paths) as recording, RecordingReader(*bag.paths) as reader:
        frames, played = RecordedFrames(reader), RecordedFrames(reader)
        always = RecordedFrames(reader, statics="always")
        brief = RecordedFrames(reader, statics="always", cache_time_s=0.5)
        for each in (played, always):
            each.seek(reader.start_ns)
        for stamp_ns in sorted(robot.stamps(6)):
            if not reader.start_ns <= stamp_ns <= reader.end_ns:
                continue
            frames.seek(stamp_ns)
            played.advance(stamp_ns)
            always.advance(stamp_ns)
            shown = Replay(reader, at_ns=stamp_ns)
            whole = recording.buffer(None, stamp_ns)
            for pair in PAIRS:
                answers = [
                    asked(buffer.lookup_transform, *pair)
                    for buffer in (frames.buffer, played.buffer, shown.buffer, whole)
                ]
                assert answers == answers[:1] * 4, (pair, stamp_ns - T0)
                if robot.is_plain and pair == ("map", "base") and isinstance(answers[0][0], int):
                    assert asked(recording.lookup_transform, *pair, answers[0][0]) == answers[0]
            brief.seek(stamp_ns)
            if robot.is_plain and not robot.is_turning(stamp_ns):
                for pair in STATIC:
                    # A lookup knows the static frames of the whole recording.
                    then = asked(always.buffer.lookup_transform, *pair)[1:]
                    assert asked(brief.buffer.lookup_transform, *pair)[1:] == then
                    assert asked(recording.lookup_transform, *pair, stamp_ns)[1:] == then
