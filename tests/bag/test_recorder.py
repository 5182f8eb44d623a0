"""The recorder: all messages of its queue are in its files, whatever happens."""

import errno
import logging
import os
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, cast
from unittest.mock import Mock

import pytest

from tests.builders import S, at, description, live_stream, payload
from tests.buses import eventually
from tests.fakes import Lines
from tfbus.bag.keeping import PartsWritten, Splits
from tfbus.bag.raw_queue import EVENTS, Past, Raw, RawQueue, TopicSource, TransformSource
from tfbus.bag.recorder import Recorder, SnapshotCondition, Snapshots, Triggers
from tfbus.base import scheduler
from tfbus.base.errors import TfbusError
from tfbus.base.structs import replace
from tfbus.bus.query import Answer
from tfbus.recording.items import ALL, EventItem, Item, Selection, TopicItem, TransformItem
from tfbus.recording.reader import RecordingReader
from tfbus.recording.writer import RecordingWriter
from tfbus.wire.codec import as_map, encode_map
from tfbus.wire.transforms import TransformReader

LOG = logging.getLogger("test")

DESCRIBED = {"sim": description([("world", "turtle1", False), ("world", "mast", True)])}


@pytest.fixture(autouse=True)
def _looks_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Recorders look at what came, and flush it, at once: no test is about these times."""
    monkeypatch.setattr("tfbus.bag.recorder._LOOK_EVERY_S", 0.01)
    monkeypatch.setattr("tfbus.bag.recorder._FLUSH_EVERY_S", 0.02)


def a_source(*, static: bool = False) -> TransformSource:
    return TransformSource("sim", "", DESCRIBED, TransformReader(), static=static)


DYNAMIC, STATIC = a_source(), a_source(static=True)
POSE = TopicSource("pose", {"pose": "Pose"})
ROBOT = TopicSource("robot", {"robot": "Robot"}, retained=True)
THERE = EventItem(0, "stream", "sim", as_map(DESCRIBED["sim"]))


class Run:
    """A recorder that writes into a folder."""

    def __init__(self, folder: Path, **given: Any) -> None:
        self.clock_ns: Callable[[], int] = time.time_ns
        self.queue = RawQueue(given.pop("most_bytes", 10_000_000), lambda: self.clock_ns())
        opening = given.pop("open_writer", RecordingWriter)
        self.parts = PartsWritten(
            folder / "run.mcap", opening, most_files=given.pop("most_files", None)
        )
        given = {"selection": ALL, **given}
        self.recorder = Recorder(self.queue, self.parts, LOG, **given)
        self.seq = 0

    def send(self, count: int = 1) -> None:
        """Messages of transforms come, numbered."""
        for _ in range(count):
            self.queue.put(DYNAMIC, payload([at(self.seq)], seq=self.seq))
            self.seq += 1

    def has_received(self, count: int) -> bool:
        """Whether it received this number of messages."""
        return self.recorder.received == count

    def items(self) -> list[Item]:
        """What the files hold, once the recorder has ended."""
        self.recorder.close()
        return read(*self.parts.paths)


def read(*paths: Path) -> list[Item]:
    with RecordingReader(*paths) as reader:
        return list(reader.items())


def numbers(items: list[Item]) -> list[int | None]:
    """The numbers of the dynamic messages."""
    return [each.seq for each in items if isinstance(each, TransformItem) and not each.static]


def kinds(items: list[Item]) -> list[str]:
    """The kinds of the events."""
    return [each.kind for each in items if isinstance(each, EventItem)]


@pytest.fixture
def run(tmp_path: Path) -> Iterator[Run]:
    """A recorder that records everything into one file."""
    run = Run(tmp_path)
    yield run
    run.recorder.close()


class TestAll:
    def test_what_came_is_in_the_file(self, run: Run) -> None:
        """Transforms, statics, topics and events come back as they came."""
        run.queue.put(EVENTS, THERE)
        run.queue.put(STATIC, payload([at(2.0, "mast")]))
        run.send(3)
        run.queue.put(POSE, encode_map({"x": 0.1}))
        items = run.items()
        assert kinds(items) == ["stream"]
        assert numbers(items) == [0, 1, 2]
        topics = [each for each in items if isinstance(each, TopicItem)]
        assert [(each.topic, each.type_name, each.values) for each in topics] == [
            ("pose", "Pose", {"x": 0.1})
        ]
        counts = run.recorder.counts
        assert (counts.messages, counts.transforms, counts.lost) == (5, 3, {})
        assert counts.statics == {("sim", "mast")}

    def test_what_came_is_on_the_disk_soon(self, run: Run) -> None:
        """A file that still grows can be read up to a moment ago."""
        run.send(5)
        eventually(lambda: numbers(read(run.parts.paths[0])) == [0, 1, 2, 3, 4])
        with RecordingReader(run.parts.paths[0]) as reader:
            assert not reader.is_complete

    def test_only_what_is_selected_is_written(self, tmp_path: Path) -> None:
        """A selection by topic leaves out the transforms."""
        run = Run(tmp_path, selection=Selection(topics=("pose",)))
        run.send()
        run.queue.put(POSE, encode_map({"x": 1}))
        assert [type(item) for item in run.items()] == [TopicItem]

    def test_unreadable_messages_are_counted_and_logged_once(self, run: Run) -> None:
        """What is no message is left out; the rest stays."""
        lines = Lines(LOG)
        run.queue.put(DYNAMIC, b"\xc1")
        run.queue.put(DYNAMIC, b"\xc1")
        run.send()
        assert numbers(run.items()) == [0]
        assert run.recorder.counts.lost == {"unreadable": 2}
        assert len(lines.lines) == 1 and "'sim'" in lines.lines[0]

    def test_what_the_file_cannot_hold_is_counted(self, run: Run) -> None:
        """A stamp after the year 2038 does not stop the recording."""
        run.queue.put(DYNAMIC, payload([at(stamp_ns=3 * 10**18)]))
        run.send()
        assert numbers(run.items()) == [0]
        assert run.recorder.counts.lost == {"refused": 1}

    def test_a_static_that_the_file_cannot_hold_ends_no_split(self, run: Run) -> None:
        """The next file begins without it, and the recording goes on."""
        run.queue.put(STATIC, payload([at(1.0, "mast", stamp_ns=3 * 10**18)]))
        eventually(lambda: run.recorder.counts.lost == {"refused": 1})
        run.recorder.split()
        run.send()
        assert numbers(run.items()) == [0]
        assert (run.recorder.failure, run.recorder.counts.lost) == ("", {"refused": 1})

    def test_what_was_dropped_becomes_an_event(self, tmp_path: Path) -> None:
        """The recording itself says how many messages it lacks."""
        run = Run(tmp_path)
        run.queue.dropped["transforms"] += 7
        events = [each for each in run.items() if isinstance(each, EventItem)]
        assert [(each.kind, each.facts) for each in events] == [
            ("dropped", {"messages": 7, "transforms": 7})
        ]
        assert run.recorder.counts.lost == {"transforms": 7}

    def test_numbers_that_never_came_are_counted(self, run: Run) -> None:
        """A gap in the numbers counts as lost."""
        run.send()
        run.seq = 5
        run.send()
        run.items()
        assert run.recorder.counts.lost == {"missing": 4}

    def test_what_is_not_selected_is_not_missing(self, tmp_path: Path) -> None:
        """Of frames that come in turns only one is recorded, and none is lost."""
        run = Run(tmp_path, selection=Selection(frames=("turtle1",)))
        for seq, child in enumerate(["turtle1", "turtle2"] * 5):
            run.queue.put(DYNAMIC, payload([at(1.0, child)], seq=seq))
        assert numbers(run.items()) == [0, 2, 4, 6, 8]
        assert run.recorder.counts.lost == {}

    def test_a_pause_leaves_out_all_but_what_is_in_force(self, run: Run) -> None:
        """Statics that come in a pause are recorded; pause and resumption are events."""
        run.send()
        run.recorder.pause()
        run.send()
        run.queue.put(STATIC, payload([at(1.0, "mast")]))
        assert run.recorder.is_paused
        run.recorder.resume()
        run.send()
        items = run.items()
        assert numbers(items) == [0, 2]
        assert kinds(items) == ["paused", "resumed"]
        assert any(isinstance(each, TransformItem) and each.static for each in items)
        assert not run.recorder.counts.lost

    def test_a_message_while_it_resumes_makes_no_gap(
        self, run: Run, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """What the pause left out is not missing, whatever comes at that moment."""
        run.send()
        run.recorder.pause()
        run.send(5)
        put = run.queue.put

        def put_late(source: Any, data: Any) -> Any:
            if source is EVENTS:
                put(DYNAMIC, payload([at()], seq=6))
            return put(source, data)

        monkeypatch.setattr(run.queue, "put", put_late)
        run.recorder.resume()
        run.items()
        assert run.recorder.counts.lost == {}


class TestSplits:
    def test_a_new_file_begins_with_what_is_in_force(self, run: Run) -> None:
        """Each file can be read alone: streams and statics stand at its beginning."""
        run.queue.put(EVENTS, THERE)
        run.queue.put(STATIC, payload([at(2.0, "mast")]))
        run.send()
        eventually(lambda: run.recorder.counts.messages == 2)
        written = run.recorder.split()
        run.send()
        run.items()
        path = run.parts.paths[-1]
        assert (written.path, written.size) == (run.parts.paths[0], written.path.stat().st_size)
        assert path.name == "run_1.mcap"
        assert numbers(read(run.parts.paths[0])) == [0]
        second = read(path)
        assert numbers(second) == [1]
        assert kinds(second) == ["stream"]
        assert [item.rows.count for item in second if getattr(item, "static", False)] == [1]

    def test_a_new_file_begins_with_retained_messages(self, run: Run) -> None:
        """What is retained is in each file, and comes once where files are read together."""
        run.queue.put(ROBOT, encode_map({"urdf": "<one/>"}))
        run.queue.put(ROBOT, encode_map({"urdf": "<two/>"}))
        eventually(lambda: run.recorder.received == 2)
        run.recorder.split()
        run.items()
        [item] = read(run.parts.paths[-1])
        assert isinstance(item, TopicItem)
        assert item.retained and item.values == {"urdf": "<two/>"}
        with RecordingReader(*run.parts.paths) as whole:
            assert len([*whole.items()]) == 2

    def test_files_end_at_their_size(self, tmp_path: Path) -> None:
        """No message is lost between two files."""
        run = Run(tmp_path, splits=Splits(most_bytes=3_000))
        run.send(100)
        assert numbers(run.items()) == list(range(100))
        assert len(run.parts.paths) > 2

    def test_what_is_in_force_may_be_larger_than_a_file(self, tmp_path: Path) -> None:
        """Then not each message gets a file of its own."""
        run = Run(tmp_path, splits=Splits(most_bytes=3_000))
        statics = [at(1.0, f"{number * 7919:x}") for number in range(500)]
        run.queue.put(STATIC, payload(statics))
        run.send(100)
        assert numbers(run.items()) == list(range(100))
        assert len(run.parts.paths) < 20

    def test_only_the_last_files_stay(self, tmp_path: Path) -> None:
        """The oldest are deleted, and counted."""
        run = Run(tmp_path, splits=Splits(most_bytes=3_000), most_files=2)
        run.send(100)
        kept = numbers(run.items())
        assert sorted(tmp_path.iterdir()) == sorted(run.parts.paths)
        assert [part.path for part in run.parts.written] == run.parts.paths
        assert len(run.parts.paths) == 2 and run.parts.deleted > 0
        assert kept == list(range(100))[-len(kept) :]

    def test_a_file_tells_how_long_it_is(self, run: Run) -> None:
        """From the first message to the last."""
        times = iter((5 * S, 6 * S, 9 * S))
        run.clock_ns = lambda: next(times)
        run.send(3)
        eventually(lambda: run.recorder.counts.messages == 3)
        assert run.recorder.split().seconds == 4.0

    def test_what_comes_later_is_later_where_the_clock_is_set_back(self, run: Run) -> None:
        """An hour back, ahead, back once more: nothing stops, the order stays, and it is said."""
        lines = Lines(LOG, logging.WARNING)
        run.queue.put(EVENTS, THERE)
        start_ns = time.time_ns()
        offsets = [0, 0, -3600, -3600, -3600, 7200, 7200, 0, 0]
        for number, offset in enumerate(offsets):
            clock_ns = start_ns + offset * S + number * S // 100
            run.clock_ns = lambda at_ns=clock_ns: at_ns
            run.send()
        items = [item for item in run.items() if isinstance(item, TransformItem)]
        log_ns = [item.log_ns for item in items]
        assert numbers(items) == list(range(len(offsets)))
        assert log_ns == sorted(log_ns)
        assert log_ns[4] - log_ns[2] == 2 * S // 100 * 9 // 10
        assert [line for line in lines.lines if "clock was set back" in line]

    def test_log_times_are_those_of_the_clock_again_once_it_has_caught_up(self, run: Run) -> None:
        """Ten times as long as it was set back."""
        start_ns = time.time_ns()
        offsets_ns = [0, -S, 4 * S, 8 * S, 10 * S, 11 * S]
        run.clock_ns = iter([start_ns + offset_ns for offset_ns in offsets_ns]).__next__
        run.send(len(offsets_ns))
        items = [item for item in run.items() if isinstance(item, TransformItem)]
        came_ns = [0, 0, 4.5 * S, 8.1 * S, 10 * S, 11 * S]
        assert [item.log_ns - start_ns for item in items] == came_ns
        assert run.queue.set_back_ns == 0

    def test_files_end_after_their_time(self, tmp_path: Path) -> None:
        """The time is that between messages."""
        run = Run(tmp_path, splits=Splits(most_s=1e-9))
        run.send(3)
        assert numbers(run.items()) == [0, 1, 2]
        assert len(run.parts.paths) == 3

    def test_a_file_of_another_recording_is_passed_over(self, run: Run) -> None:
        """A part never takes the place of a file that is there."""
        taken = run.parts.paths[0].with_name("run_1.mcap")
        taken.write_text("mine")
        run.recorder.split()
        assert run.parts.paths[-1].name == "run_2.mcap"
        assert taken.read_text() == "mine"


class TestSnapshots:
    def snapshots(self, last_s: float = 60.0, *conditions: SnapshotCondition) -> Snapshots:
        return Snapshots(last_s, 1_000_000, Triggers(conditions))

    def test_the_last_seconds_are_written_when_asked(self, tmp_path: Path) -> None:
        """Nothing is written before, and nothing twice."""
        run = Run(tmp_path, snapshots=self.snapshots())
        run.send(3)
        eventually(lambda: run.recorder.received == 3)
        assert not list(tmp_path.iterdir())
        assert numbers(read(run.recorder.split().path)) == [0, 1, 2]
        run.send()
        eventually(lambda: run.recorder.received == 4)
        assert numbers(read(run.recorder.split().path)) == [3]
        run.recorder.close()

    def test_older_messages_are_forgotten_but_what_is_in_force_stays(self, tmp_path: Path) -> None:
        """A snapshot begins with the streams and statics of before."""
        run = Run(tmp_path, snapshots=self.snapshots(1.0))
        clock_ns = time.time_ns()
        run.clock_ns = lambda: clock_ns - 60 * S
        run.queue.put(EVENTS, THERE)
        run.queue.put(STATIC, payload([at(2.0, "mast")]))
        run.send()
        run.clock_ns = lambda: clock_ns
        run.send()
        eventually(lambda: run.recorder.received == 3)
        items = read(run.recorder.split().path)
        run.recorder.close()
        assert numbers(items) == [1]
        assert kinds(items) == ["stream"]
        assert [item.rows.count for item in items if getattr(item, "static", False)] == [1]

    def test_one_leaves_out_what_the_file_cannot_hold(self, tmp_path: Path) -> None:
        """A static that came before the last seconds is counted then, and the recorder lives."""
        run = Run(tmp_path, snapshots=self.snapshots(1.0))
        clock_ns = time.time_ns()
        run.clock_ns = lambda: clock_ns - 60 * S
        run.queue.put(STATIC, payload([at(2.0, "mast", stamp_ns=3 * 10**18)]))
        run.clock_ns = lambda: clock_ns
        run.send()
        eventually(lambda: run.recorder.received == 2)
        run.recorder.split_later()
        run.recorder.close()
        assert numbers(run.items()) == [0]
        assert (run.recorder.failure, run.recorder.counts.lost) == ("", {"refused": 1})

    def test_memory_is_limited(self, tmp_path: Path) -> None:
        """Beyond it the oldest messages go."""
        run = Run(tmp_path, snapshots=Snapshots(60.0, 2_000, Triggers(())))
        run.send(50)
        eventually(lambda: run.recorder.received == 50)
        kept = numbers(read(run.recorder.split().path))
        run.recorder.close()
        assert 1 <= len(kept) < 20 and kept[-1] == 49
        assert run.recorder.window is not None and run.recorder.window.short_s is not None

    def test_a_condition_writes_one_by_itself(self, tmp_path: Path) -> None:
        """The event stands at its end."""
        wrote: list[str] = []
        run = Run(
            tmp_path,
            snapshots=self.snapshots(60.0, SnapshotCondition("gone", "turtle1")),
            on_file=lambda path, written, why: wrote.append(why),
        )
        run.queue.put(EVENTS, THERE)
        run.send(2)
        run.queue.put(EVENTS, EventItem(0, "stream gone", "sim"))
        eventually(lambda: wrote)
        items = run.items()
        [reason] = wrote
        assert "'sim' is gone" in reason and "turtle1" in reason
        assert numbers(items) == [0, 1]
        assert kinds(items)[-1] == "stream gone"

    def test_only_the_last_snapshots_stay(self, tmp_path: Path) -> None:
        """The oldest is deleted for each further one."""
        run = Run(tmp_path, snapshots=self.snapshots(), most_files=2)
        for count in range(1, 5):
            run.send()
            eventually(partial(run.has_received, count))
            run.recorder.split()
        assert numbers(run.items()) == [2, 3]
        assert sorted(tmp_path.iterdir()) == run.parts.paths

    def test_nothing_makes_no_file(self, tmp_path: Path) -> None:
        """Asked for before anything came, it says so."""
        run = Run(tmp_path, snapshots=self.snapshots())
        with pytest.raises(TfbusError, match="nothing has come"):
            run.recorder.split()
        run.recorder.close()
        assert not list(tmp_path.iterdir())


class NearlyFull(RecordingWriter):
    """Writes until its disk is full."""

    room = 3

    def flush(self) -> None:
        """Fails from the third time on."""
        self.room -= 1
        if self.room < 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        super().flush()


class TestFailures:
    def test_a_full_disk_ends_the_recording(self, tmp_path: Path) -> None:
        """The recorder says why, and what was flushed before can be read."""
        run = Run(tmp_path, open_writer=NearlyFull)

        def sends_until_full() -> bool:
            run.send()
            return not run.recorder.is_running

        eventually(sends_until_full)
        assert run.recorder.failure == os.strerror(errno.ENOSPC)
        kept = numbers(run.items())
        assert kept == list(range(len(kept))) and kept

    def test_after_the_end_questions_are_refused(self, run: Run) -> None:
        """A service that comes late gets a sentence."""
        run.recorder.close()
        with pytest.raises(TfbusError, match="the recorder has ended"):
            run.recorder.split()

    def test_before_a_disk_is_full_the_file_is_ended(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Its summary needs room too: so the file is whole."""
        monkeypatch.setattr(PartsWritten, "free_bytes", 0)
        run = Run(tmp_path)
        run.send()
        eventually(lambda: not run.recorder.is_running)
        run.recorder.close()
        assert run.recorder.failure == "the disk is full"
        with RecordingReader(*run.parts.paths) as reader:
            assert reader.is_complete


class TestMemory:
    def test_what_waits_for_its_description_counts(self, tmp_path: Path) -> None:
        """However long messages wait, the queue takes only those that it has room for."""
        run = Run(tmp_path, past=a_past(is_complete=lambda: closing.is_set()), most_bytes=5_000)
        closing = threading.Event()

        def is_full() -> bool:
            run.send()
            return run.queue.dropped["transforms"] > 20

        eventually(is_full)
        sent, dropped = run.seq, run.queue.dropped["transforms"]
        message = Raw(0, DYNAMIC, payload([at(0)], seq=0))
        assert (sent - dropped) * message.size <= 5_000
        closing.set()
        assert len(numbers(run.items())) == sent - dropped
        assert run.recorder.counts.lost == {"transforms": dropped}

    def test_what_publishers_hold_is_taken_up_to_the_limit(self, tmp_path: Path) -> None:
        """Beyond it messages are counted, and said."""
        held = [payload([at(stamp_ns=S + seq)], seq=seq) for seq in range(10)]
        past = a_past(is_complete=lambda: True, held=held)
        assert 0 < past.dropped < 10
        lines = Lines(LOG)
        run = Run(tmp_path, past=past, source=lambda key: DYNAMIC)
        eventually(lambda: run.recorder.counts.messages == 10 - past.dropped)
        run.items()
        assert run.recorder.counts.lost == {"history": past.dropped}
        assert f"Dropped {past.dropped} messages " in lines.lines[0]


class Holding:
    """A session on which the stream `sim` answers at once with the messages that it holds."""

    def __init__(self, held: Iterable[bytes]) -> None:
        self._held = held

    def ask_later(
        self, key: str, payload: None, on_answer: Callable[[Answer], None], *_: object, **__: object
    ) -> None:
        for data in self._held:
            on_answer(Answer("tf/sim", data))


def a_past(
    is_complete: Callable[[], bool], held: Iterable[bytes] = (), most_bytes: int = 1_500
) -> Past:
    """The history that one stream holds, all of which has come."""
    past: Any = Past(cast(Any, Holding(held)), cast(Any, Mock()), most_bytes)
    past.is_complete = is_complete
    past.meet(live_stream("sim", replace(DESCRIBED["sim"], history_s=10.0)))
    return past


class TestPast:
    @pytest.fixture
    def before(self, monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[Raw]]:
        """All that was held, each with when it came, before what came by itself."""

        def before(kept: list[tuple[bytes, int]], live: list[Raw]) -> list[Raw]:
            def held() -> Iterator[bytes]:
                for data, came_ns in kept:
                    monkeypatch.setattr(scheduler, "time_ns", lambda came_ns=came_ns: came_ns)
                    yield data

            past = a_past(lambda: True, held(), 1_000_000)
            return past.before(live, lambda key: DYNAMIC)

        return before

    def test_what_was_held_comes_first_with_the_delay_of_the_stream(
        self, before: Callable[..., list[Raw]]
    ) -> None:
        """Log times before the recording are the stamps and the delay that live messages have."""
        kept = [(payload([at(stamp_ns=(10 + k) * S)], seq=k), 90 * S) for k in range(3)]
        live = [Raw(13 * S + 5, DYNAMIC, payload([at(stamp_ns=13 * S)], seq=3))]
        merged = before(kept, live)
        assert [raw.log_ns for raw in merged] == [10 * S + 5, 11 * S + 5, 12 * S + 5, 13 * S + 5]

    def test_a_message_that_came_by_itself_is_not_taken_twice(
        self, before: Callable[..., list[Raw]]
    ) -> None:
        """Its number tells."""
        data = payload([at(stamp_ns=5 * S)], seq=7)
        assert len(before([(data, 9 * S)], [Raw(6 * S, DYNAMIC, data)])) == 1

    def test_what_is_in_force_goes_to_the_beginning(self, before: Callable[..., list[Raw]]) -> None:
        """Streams and statics that were met at first stand before what was held."""
        kept = [(payload([at(stamp_ns=2 * S)], seq=0), 8 * S)]
        live = [Raw(9 * S, EVENTS, THERE)]
        merged = before(kept, live)
        assert [raw.source.kind for raw in merged] == ["events", "transforms"]
        assert merged[0].log_ns == merged[1].log_ns == 8 * S
