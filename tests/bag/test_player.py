"""The player: every item at its time, at any rate, paused, stepped and sought."""

import threading
from collections.abc import Iterator, Sequence
from typing import Any

import pytest

from tests.builders import S, at
from tests.buses import DEADLINE_S, eventually
from tests.fakes import InAThread, StandingClock, Tape, TapeState
from tfbus import InvalidArgumentException
from tfbus.bag.player import Player, ReadAhead
from tfbus.base.errors import DecodeError
from tfbus.geometry.columns import Columns
from tfbus.recording.items import Item, RecordedStream, TopicItem, TransformItem
from tfbus.recording.playhead import Pace, Progress

SIM = RecordedStream("sim", "/sim", epoch_ns=1)
MS = 1_000_000


def topic(log_ns: int, value: int = 0) -> TopicItem:
    """A message of a topic."""
    return TopicItem(log_ns, "count", "Count", {"value": value})


def numbered(count: int, apart_ns: int = S) -> Tape:
    """A recording of messages at 0, 1, 2 ... times `apart_ns`, each with its number."""
    return Tape([topic(number * apart_ns, number) for number in range(count)])


class Heard:
    """A stage that notes what it gets."""

    def __init__(self) -> None:
        self.taken: list[int] = []
        self.due_ns: list[int] = []
        self.begins: list[tuple[list[Item], int, bool]] = []
        self.news: list[Progress] = []

    def begin(self, state: Sequence[Item], pace: Pace, *, is_back: bool) -> None:
        """Note where it begins."""
        self.begins.append(([*state], pace.log_ns, is_back))

    def take(self, item: Item, pace: Pace) -> None:
        """Note the number in the item, and when it was due."""
        assert isinstance(item, TopicItem)
        self.due_ns.append(pace.real_at(item.log_ns))
        self.taken.append(item.values["value"])

    def follow(self, progress: Progress) -> None:
        """Note what changed."""
        self.news.append(progress)


class Playing:
    """A player that runs in a thread."""

    def __init__(self, tape: Any, stage: Heard | None = None, **given: Any) -> None:
        self.player = Player(tape, **given)
        self.stage = stage or Heard()
        self._run = InAThread(lambda: self.player.run(self.stage))

    def result(self) -> Any:
        """What `run` returned or raised, once it has."""
        return self._run.result()

    @property
    def taken(self) -> list[int]:
        """The numbers of the items so far."""
        return self.stage.taken

    def waits(self) -> bool:
        """Whether it runs."""
        return self._run.is_waiting


@pytest.fixture
def quick() -> Iterator[list[Playing]]:
    """The runs of a test, stopped at its end."""
    runs: list[Playing] = []
    yield runs
    for run in runs:
        run.player.stop()
        run.result()


class Sleepless(threading.Condition):
    """Passes the time of a clock at once, instead of waiting for it."""

    def __init__(self, clock: StandingClock) -> None:
        super().__init__()
        self._clock = clock

    def wait(self, timeout: float | None = None) -> bool:
        """Wait in truth only for what is to be notified."""
        if timeout is None:
            return super().wait()
        self._clock.at_ns += round(timeout * 1e9)
        return False


def times_of(tape: Tape, **given: Any) -> list[int]:
    """When each item came, by a clock that starts at 0."""
    clock = StandingClock()
    came_ns: list[int] = []

    class Timed(Heard):
        def take(self, item: Item, pace: Pace) -> None:
            came_ns.append(clock.at_ns)

    player = Player(tape, clock=clock, **given)
    player.changed = Sleepless(clock)
    player.run(Timed())
    return came_ns


def test_items_come_at_their_time() -> None:
    """Each item comes when its time has passed, counted from the first."""
    assert times_of(numbered(4, 30 * MS)) == [0, 30 * MS, 60 * MS, 90 * MS]


def test_a_rate_shortens_the_time() -> None:
    """At rate 100 ten seconds of the recording take 0.1 s."""
    assert times_of(numbered(11), rate=100.0) == [number * 10 * MS for number in range(11)]


def test_nothing_comes_while_it_is_paused(quick: list[Playing]) -> None:
    """Paused at the start it plays nothing, and stands at its beginning."""
    run = Playing(numbered(3), paused=True)
    quick.append(run)
    eventually(lambda: run.stage.begins)
    assert run.taken == []
    assert run.player.progress.log_ns == 0
    assert run.player.progress.is_paused


def test_a_step_plays_one_message(quick: list[Playing]) -> None:
    """Each step plays the next message and moves to its time, and it stays paused."""
    run = Playing(numbered(5), paused=True)
    quick.append(run)
    run.player.step()
    eventually(lambda: run.taken == [0])
    run.player.step(2)
    eventually(lambda: run.taken == [0, 1, 2])
    assert run.player.progress.log_ns == 2 * S
    assert run.player.progress.is_paused


def test_the_last_step_ends_it() -> None:
    """Where nothing is left after a step, it is at its end."""
    run = Playing(numbered(2), paused=True)
    run.player.step(2)
    assert run.result() is None
    assert run.taken == [0, 1]


def test_resumed_it_goes_on_where_it_was(quick: list[Playing]) -> None:
    """Nothing is left out or played twice by a pause."""
    run = Playing(numbered(40, 10 * MS))
    eventually(lambda: len(run.taken) > 3)
    run.player.pause()
    eventually(lambda: run.stage.news)
    assert run.stage.news[-1].is_paused
    run.player.resume()
    run.result()
    assert run.taken == [*range(40)]


def test_seek_ahead_leaves_out_what_lies_between(quick: list[Playing]) -> None:
    """A seek ahead begins with the state there, and is no way back."""
    run = Playing(numbered(100), paused=True)
    quick.append(run)
    run.player.seek(90 * S)
    eventually(lambda: len(run.stage.begins) == 2)
    assert run.stage.begins[1] == ([], 90 * S, False)
    run.player.step()
    eventually(lambda: run.taken == [90])


def test_seek_back_says_so(quick: list[Playing]) -> None:
    """After a seek back the same items come again, and the stage knows it."""
    run = Playing(numbered(100), paused=True)
    quick.append(run)
    run.player.step(50)
    eventually(lambda: len(run.taken) == 50)
    run.player.seek_by(-9.0)
    eventually(lambda: len(run.stage.begins) == 2)
    assert run.stage.begins[1][1:] == (40 * S, True)
    run.player.step()
    eventually(lambda: run.taken[50:] == [40])


def test_a_second_seek_back_is_one_too(
    quick: list[Playing], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It may come before the first one has begun, as of two keys one after the other."""
    end = ReadAhead.__exit__

    def end_late(ahead: ReadAhead, *error: Any) -> None:
        end(ahead, *error)
        if len(run.stage.begins) == 1:
            run.player.seek(40 * S)

    monkeypatch.setattr(ReadAhead, "__exit__", end_late)
    run = Playing(numbered(100), paused=True)
    quick.append(run)
    run.player.step(50)
    eventually(lambda: len(run.taken) == 50)
    run.player.seek(40 * S)
    eventually(lambda: len(run.stage.begins) == 2)
    assert run.stage.begins[1][1:] == (40 * S, True)


def test_a_step_back_plays_the_message_before_again(quick: list[Playing]) -> None:
    """It stays at the first; what comes next is the one after it."""
    run = Playing(numbered(100), paused=True)
    quick.append(run)
    run.player.step(4)
    eventually(lambda: run.taken == [0, 1, 2, 3])
    run.player.step(-2)
    eventually(lambda: run.taken[4:] == [1])
    assert run.player.progress.log_ns == S
    run.player.step(-9)
    eventually(lambda: run.taken[5:] == [0])
    run.player.step(-1)
    eventually(lambda: run.taken[6:] == [0])
    run.player.step()
    eventually(lambda: run.taken[7:] == [1])


def test_a_seek_is_where_it_goes_while_that_is_read(quick: list[Playing]) -> None:
    """Not where it was before: a service answers with it."""
    seen: list[int] = []

    class Slow(Tape):
        def state_at(self, log_ns: int, *given: Any) -> TapeState:
            seen.append(run.player.progress.log_ns if log_ns else 0)
            return super().state_at(log_ns, *given)

    run = Playing(Slow([topic(0), topic(9 * S, 9)]), paused=True)
    quick.append(run)
    eventually(lambda: run.stage.begins)
    run.player.seek(5 * S)
    eventually(lambda: len(run.stage.begins) == 2)
    assert seen == [0, 5 * S]


def test_a_seek_back_stays_one_with_another_rate(quick: list[Playing]) -> None:
    """A rate that is set before the seek has begun does not change where it was."""

    class Sought(Heard):
        def take(self, item: Item, pace: Pace) -> None:
            super().take(item, pace)
            if self.taken == [*range(9)]:
                run.player.seek(2 * S)
                run.player.set_rate(2.0)

    run = Playing(numbered(100), stage=Sought(), paused=True)
    quick.append(run)
    run.player.step(9)
    eventually(lambda: len(run.stage.begins) == 2)
    assert run.stage.begins[1][1:] == (2 * S, True)


def test_a_seek_begins_with_what_is_in_force(quick: list[Playing]) -> None:
    """Static transforms in force at a moment come before what follows it."""
    static = TransformItem(0, SIM, Columns.of_transforms([at(1.0, "drone")]), static=True)
    run = Playing(Tape([static, topic(5 * S, 5), topic(9 * S, 9)]), start_ns=4 * S, paused=True)
    quick.append(run)
    eventually(lambda: run.stage.begins)
    assert [item.log_ns for item in run.stage.begins[0][0]] == [4 * S]
    run.player.step()
    eventually(lambda: run.taken == [5])


def test_seeks_stay_within_what_is_played(quick: list[Playing]) -> None:
    """Before the start means the start, and after the end the end."""
    run = Playing(numbered(100), start_ns=10 * S, end_ns=20 * S, paused=True)
    quick.append(run)
    run.player.seek(0)
    assert run.player.progress.log_ns == 10 * S
    run.player.seek(99 * S)
    assert run.player.progress.log_ns == 20 * S


def test_a_span_is_played_alone() -> None:
    """Only what lies between start and end is played, both included."""
    run = Playing(numbered(100), start_ns=3 * S, end_ns=5 * S, rate=1000.0)
    run.result()
    assert run.taken == [3, 4, 5]


def test_a_loop_begins_again(quick: list[Playing]) -> None:
    """At the end of a loop the whole comes again, as after a seek back."""
    run = Playing(numbered(3, MS), at_end="loop")
    quick.append(run)
    eventually(lambda: len(run.taken) >= 7)
    assert run.taken[:7] == [0, 1, 2, 0, 1, 2, 0]
    assert [begin[1:] for begin in run.stage.begins[:3]] == [(0, False), (0, True), (0, True)]
    assert run.player.progress.loops >= 3


def test_the_first_round_of_a_loop_is_1(quick: list[Playing]) -> None:
    """Without a loop there is no round."""
    rounds = []
    for at_end in ("loop", "stop"):
        run = Playing(numbered(3), at_end=at_end, paused=True)
        quick.append(run)
        rounds.append(run.player.progress.loops)
    assert rounds == [1, 0]


def test_it_can_wait_at_the_end(quick: list[Playing]) -> None:
    """It stands still at the end, and a seek plays the end again."""
    run = Playing(numbered(3, MS), at_end="wait")
    quick.append(run)
    eventually(lambda: run.stage.news)
    assert run.stage.news[-1].is_at_end
    assert run.player.progress.is_paused
    run.player.seek(MS)
    run.player.resume()
    eventually(lambda: run.taken == [0, 1, 2, 1, 2])


def test_stopped_it_returns() -> None:
    """`stop` ends it from another thread, also while it is paused."""
    run = Playing(numbered(3), paused=True)
    eventually(lambda: run.stage.begins)
    run.player.stop()
    assert run.result() is None


def test_a_mistake_in_the_file_ends_it() -> None:
    """What reading raises, `run` raises, after what was read before."""

    class Broken(Tape):
        def items(self, *_: Any, **__: Any) -> Iterator[Item]:
            yield topic(0)
            raise DecodeError("a chunk is damaged")

        def state_at(self, *_: Any, **__: Any) -> TapeState:
            return TapeState([])

    run = Playing(Broken([topic(0), topic(S)]))
    assert str(run.result()) == "a chunk is damaged"
    assert run.taken == [0]


def test_a_slow_stage_delays_what_follows() -> None:
    """Where a machine is too slow, what follows comes later: not all at once."""
    clock = StandingClock(0)

    class Slow(Heard):
        def take(self, item: Item, pace: Pace) -> None:
            super().take(item, pace)
            clock.at_ns += S

    player = Player(numbered(5, MS), clock=clock)
    stage = Slow()
    player.run(stage)
    assert stage.taken == [0, 1, 2, 3, 4]
    assert player.progress.late_ns == 5 * S - 4 * MS
    assert stage.due_ns == [0, S, 2 * S, 3 * S, 4 * S]


def test_a_rate_without_a_meaning_is_refused() -> None:
    """0, less, and what is no number are refused in one sentence."""
    for rate in (0.0, -1.0, float("nan"), 1e9):
        with pytest.raises(InvalidArgumentException, match=r"from 0\.001 to 10,000"):
            Player(numbered(3), rate=rate)


def test_an_empty_span_is_refused() -> None:
    """Where the start lies behind the end, nothing could be played."""
    with pytest.raises(InvalidArgumentException, match=r"lasts 2\.000 s"):
        Player(numbered(3), start_ns=9 * S)


def test_at_rate_one_times_are_moved_by_one_number() -> None:
    """The time of a moment is exact to the nanosecond, years apart."""
    pace = Pace(log_ns=1_700_000_000_123_456_789, real_ns=5, wall_ns=7)
    assert pace.real_at(1_700_000_000_123_456_789 + 3) == 8
    assert pace.real_at(0) == 5 - 1_700_000_000_123_456_789


def test_at_another_rate_times_between_are_scaled() -> None:
    """At rate 4 four recorded seconds take one."""
    pace = Pace(log_ns=100 * S, real_ns=0, wall_ns=1000 * S, rate=4.0)
    assert pace.real_at(104 * S) == S
    assert pace.log_at(S) == 104 * S


def test_reading_ahead_stops_where_memory_is_used() -> None:
    """Long messages are not read ahead by the thousand."""
    read: list[int] = []

    def items() -> Iterator[Item]:
        for number in range(100):
            read.append(number)
            yield TopicItem(number, "image", "Image", {"data": bytes(16 * 2**20)})

    changed = threading.Condition()
    with ReadAhead(items(), changed) as ahead:
        with changed:
            assert changed.wait_for(lambda: ahead.first() is not None, DEADLINE_S)
        eventually(lambda: len(read) >= 4)
        with changed:
            assert ahead.pop().log_ns == 0
        assert len(read) <= 6


def test_reading_ahead_goes_on_when_half_is_played() -> None:
    """Not for each item, which would wake its thread as often as one is played."""
    read: list[int] = []

    def items() -> Iterator[Item]:
        for number in range(10_000):
            read.append(number)
            yield topic(number, number)

    changed = threading.Condition()
    with ReadAhead(items(), changed) as ahead:
        eventually(lambda: ahead._waits_for_room)
        so_far = len(read)
        with changed:
            assert [ahead.pop().log_ns for _ in range(900)] == [*range(900)]
        assert len(read) == so_far
        with changed:
            assert [ahead.pop().log_ns for _ in range(200)] == [*range(900, 1100)]
        eventually(lambda: len(read) >= 3000)


def test_what_was_read_before_a_mistake_is_played() -> None:
    """Then the mistake is raised."""

    def items() -> Iterator[Item]:
        for number in range(1000):
            yield topic(number, number)
        raise DecodeError("damaged")

    changed = threading.Condition()
    taken = []
    damaged = pytest.raises(DecodeError, match="damaged")
    with ReadAhead(items(), changed) as ahead, changed, damaged:
        while not ahead.is_at_end:
            if ahead.first() is None:
                assert changed.wait(DEADLINE_S)
            else:
                taken.append(ahead.pop().log_ns)
    assert taken == [*range(1000)]


def test_an_item_in_millennia_is_waited_for(quick: list[Playing]) -> None:
    """A log time may be any of 64 bits, and the rate a thousandth: no clock waits so long."""
    quick.append(Playing(Tape([topic(0), topic(2**63 - 1, 1)]), rate=0.001))
    eventually(lambda: quick[0].taken == [0])
    assert quick[0].waits()
    quick[0].player.stop()
    assert quick[0].result() is None
