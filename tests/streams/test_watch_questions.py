"""When a watch asks for the description of a stream, and when it stops, on a clock of the test."""

import heapq
import itertools
from collections.abc import Callable
from functools import partial
from typing import Any, cast

import pytest

from tests.streams.received import questions_for
from tfbus.base import scheduler
from tfbus.base.executor import Executor
from tfbus.base.own_pauses import OwnPauses
from tfbus.base.structs import replace
from tfbus.bus.query import Answer
from tfbus.bus.session import Session
from tfbus.bus.settings import LAN, NodeSettings
from tfbus.streams import description_queries, owners, watch
from tfbus.streams.info import StreamState
from tfbus.streams.watch import StreamWatch
from tfbus.wire.codec import encode_message
from tfbus.wire.descriptions import StreamDescription

KEY = "@tfbus/stream/sim"


def description(epoch_ns: int) -> StreamDescription:
    return StreamDescription(1, "/sim", epoch_ns, ())


class Questions:
    """A watch, and in the place of the bus questions that take `takes_s` seconds each."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *, only_wanted: bool = False) -> None:
        self.network = LAN
        self.takes_s = 0.0
        self.answers: list[bytes] = []
        # What comes to a question for all streams, by key, and when those were asked.
        self.answers_together: dict[str, bytes] = {}
        self.asked_together_at_s: list[float] = []
        self.asked_at_s: list[float] = []
        self.asked_keys: list[str] = []
        self.changed: list[StreamState] = []
        # The questions which streams list a frame: their keys, and the frames.
        self.sought: list[tuple[str, set[str]]] = []
        # The tokens that are there, whatever has been told of them.
        self.living: list[str] = []
        self.now_s = 0.0
        self._order = itertools.count()
        self._due: list[tuple[float, int, Callable[[], None]]] = []
        self.token: Callable[[str, bool], None]
        self.describe: Callable[..., None]
        self.settings = NodeSettings("listener")
        monkeypatch.setattr(scheduler, "monotonic", lambda: self.now_s)
        monkeypatch.setattr(watch, "own_pauses", OwnPauses)
        monkeypatch.setattr(owners, "description_question", questions_for(self.ask))
        monkeypatch.setattr(description_queries, "description_question", questions_for(self.ask))
        together = questions_for(self.ask_together)
        monkeypatch.setattr(description_queries, "descriptions_question", together)
        monkeypatch.setattr(watch, "declare_signed_subscriber", self.subscribe)
        monkeypatch.setattr(description_queries, "listing_question", questions_for(self.seek))
        self.watch = StreamWatch(
            cast(Session, self),
            self.changed.append,
            executor=cast(Executor, self),
            only_wanted=only_wanted,
        )

    def subscribe(
        self, session: Session, key: str, callback: Callable[..., None], *, only_new: bool
    ) -> None:
        self.describe = callback

    def watch_living(self, key: str, callback: Callable[[str, bool], None]) -> None:
        self.token = callback

    def living_later(self, key: str, on_end: Callable[[list[str]], None]) -> None:
        self.after(self.takes_s, lambda: on_end(self.living))

    def ask(self, session: Session, key: str, turn: int, on_answer: Any, on_end: Any) -> None:
        self.asked_at_s.append(self.now_s)
        self.asked_keys.append(key)
        for answer in self.answers:
            on_answer(Answer(key, answer))
        self.after(self.takes_s, on_end)

    def ask_together(self, session: Session, keys: str, on_answer: Any, on_end: Any) -> None:
        self.asked_together_at_s.append(self.now_s)
        for key, answer in self.answers_together.items():
            on_answer(Answer(key, answer))
        self.after(self.takes_s, on_end)

    def seek(self, session: Session, keys: str, children: Any, on_answer: Any, on_end: Any) -> None:
        self.sought.append((keys, {*children}))
        for key, answer in self.answers_together.items():
            on_answer(Answer(key, answer))
        self.after(self.takes_s, on_end)

    def submit(self, what: str, job: Callable[..., None], *given: Any, limit: int = 0) -> None:
        self.after(0.0, job, *given)

    def after(self, delay_s: float, job: Callable[..., None], *given: Any) -> None:
        due_s = self.now_s + delay_s
        heapq.heappush(self._due, (due_s, next(self._order), partial(job, *given)))

    def every(self, period_s: float, job: Callable[[], None]) -> None:
        def tick() -> None:
            job()
            self.every(period_s, job)

        self.after(period_s, tick)

    def run(self, end_s: float) -> None:
        """Let the time go by until then."""
        while self._due and self._due[0][0] <= end_s:
            self.now_s, _, job = heapq.heappop(self._due)
            job()
        self.now_s = end_s

    def run_late(self, end_s: float) -> None:
        """Let the time go by until then, while the thread does nothing."""
        self.now_s = end_s
        self._due = [(max(due_s, end_s), order, job) for due_s, order, job in self._due]

    def is_alive(self) -> bool:
        return self.watch.streams()["sim"].alive

    def epoch_ns(self) -> int | None:
        now = self.watch.streams()["sim"].description
        return None if now is None else now.epoch


@pytest.fixture
def questions(monkeypatch: pytest.MonkeyPatch) -> Questions:
    questions = Questions(monkeypatch)
    questions.token(KEY, True)
    questions.describe(KEY, encode_message(description(7)))
    questions.run(0.0)
    assert (questions.is_alive(), questions.epoch_ns()) == (True, 7)
    # No session has signed it.
    assert not questions.watch.streams()["sim"].confirmed
    return questions


def test_an_answer_of_another_epoch_does_not_settle_the_wanted_one(questions: Questions) -> None:
    """The other process may answer first, while the question is open."""
    questions.takes_s = 2.0
    questions.answers = [encode_message(description(7))]
    questions.watch.ask_again(KEY, 5)
    questions.run(3.0)
    assert questions.epoch_ns() == 7
    questions.answers.append(encode_message(description(5)))
    questions.run(20.0)
    assert questions.epoch_ns() == 5
    asked = len(questions.asked_at_s)
    questions.run(100.0)
    assert len(questions.asked_at_s) == asked


def test_descriptions_that_come_together_are_all_read(questions: Questions) -> None:
    """Descriptions that come while one is to be read begin no other reading, and wait for none."""
    for number in range(5):
        key = f"@tfbus/stream/s{number}"
        questions.describe(key, encode_message(description(number)))
    questions.run(0.0)
    found = questions.watch.streams()
    assert [state.description and state.description.epoch for state in found.values()] == [
        7,
        *range(5),
    ]


def test_an_answer_of_another_session_confirms_no_epoch(questions: Questions) -> None:
    """Nor does one that cannot be read: the publisher's own word is waited for."""
    other = replace(description(9), session="another session")
    questions.run(50.0)
    questions.answers = [b"no description", encode_message(other)]
    questions.watch.ask_for_epoch("sim", 9)
    questions.run(100.0)
    assert questions.epoch_ns() == 7
    questions.answers.append(encode_message(description(9)))
    questions.watch.ask_for_epoch("sim", 9)
    questions.run(200.0)
    assert questions.epoch_ns() == 9


def test_a_description_that_comes_after_the_token_is_gone_brings_nothing_back(
    questions: Questions,
) -> None:
    """Though the token was back in between, and the description was waited for."""
    for alive in (False, True, False):
        questions.token(KEY, alive)
    questions.describe(KEY, encode_message(description(8)))
    questions.run(0.0)
    assert (questions.is_alive(), questions.epoch_ns()) == (False, 8)


def test_a_description_from_before_the_token_was_back_is_not_the_new_process(
    questions: Questions,
) -> None:
    """Where the thread is late it is read after the tokens, and another process may be there."""
    for number in range(3):
        questions.describe(f"@tfbus/stream/s{number}", encode_message(description(1)))
    questions.describe(KEY, encode_message(description(8)))
    questions.run_late(1.0)
    questions.token(KEY, False)
    questions.token(KEY, True)
    questions.run(1.5)
    assert (questions.is_alive(), questions.epoch_ns()) == (False, 7)
    questions.describe(KEY, encode_message(description(9)))
    questions.run(1.5)
    assert (questions.is_alive(), questions.epoch_ns()) == (True, 9)


def test_the_end_of_a_process_that_is_told_late_is_not_that_of_the_next(
    questions: Questions,
) -> None:
    """Two threads of Zenoh bring the news of a token, and the later one may be the first to get
    its turn: the stream stays alive.
    """
    came_s = questions.now_s
    questions.now_s = came_s + 0.04
    questions.token(KEY, True)
    questions.run(questions.now_s)
    questions.now_s = came_s
    questions.token(KEY, False)
    questions.run(1.5)
    assert questions.is_alive()
    assert questions.watch.has_token(KEY)


@pytest.mark.parametrize("is_there", [False, True])
def test_an_end_that_comes_soon_after_the_begin_counts_unless_the_token_is_there(
    questions: Questions, is_there: bool
) -> None:
    """It may be the end of the process before, on a thread of Zenoh that had no processor."""
    questions.living = [KEY] if is_there else []
    questions.run(1.0)
    questions.token(KEY, False)
    questions.answers = [encode_message(description(9))]
    questions.run(2.0)
    assert questions.is_alive() == questions.watch.has_token(KEY) == is_there
    # That of the process before describes it no more.
    assert questions.epoch_ns() == (9 if is_there else 7)


@pytest.mark.parametrize(("takes_s", "least_s", "most_s"), [(0.0, 1.0, 2.0), (2.0, 9.5, 12.5)])
def test_a_stream_that_is_back_has_time_to_describe_itself(
    questions: Questions, takes_s: float, least_s: float, most_s: float
) -> None:
    """Its old description stands only when several questions have ended without a new one."""
    questions.takes_s = takes_s
    questions.token(KEY, False)
    questions.token(KEY, True)
    questions.run(least_s)
    assert not questions.is_alive()
    # A lost question is not waited for.
    assert questions.asked_at_s[1] <= 0.6
    questions.run(most_s)
    assert questions.is_alive()


def test_tokens_without_end_are_asked_about_in_turns(
    questions: Questions, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of three hundred that never answer a few are asked at a time, and all have their turn."""
    monkeypatch.setattr(description_queries, "_MOST_ASKED", 10)
    keys = [f"@tfbus/stream/s{number}" for number in range(300)]
    for key in keys:
        questions.token(key, True)
    questions.asked_keys.clear()
    questions.run(1.0)
    assert set(questions.asked_keys) <= {KEY, *keys[:10]}
    questions.run(1000.0)
    assert set(questions.asked_keys) >= set(keys)
    # Those that are gone are not asked about.
    for key in keys:
        questions.token(key, False)
    questions.run(1001.0)
    asked = len(questions.asked_keys)
    questions.run(2000.0)
    assert len(questions.asked_keys) == asked


@pytest.mark.parametrize("takes_s", [0.2, 1.0])
def test_a_fleet_is_asked_for_by_one_question(questions: Questions, takes_s: float) -> None:
    """Of two hundred streams that appear at once a few are asked one by one, the others together,
    and afterwards those that have not answered.
    """
    questions.run(50.0)
    questions.asked_keys.clear()
    keys = [f"@tfbus/stream/s{number}" for number in range(200)]
    questions.answers_together = {key: encode_message(description(3)) for key in keys[:-5]}
    questions.takes_s = takes_s
    for key in keys:
        questions.token(key, True)
    questions.run(50.9)
    assert questions.asked_together_at_s == [50.1]
    few = {*questions.asked_keys}
    assert len(few) <= 25
    found = questions.watch.streams()
    assert {found[f"s{number}"].key for number in range(195) if keys[number] not in few} == {
        state.key for state in found.values() if state.description and state.name != "sim"
    }
    questions.run(60.0)
    assert {*questions.asked_keys} == few | {*keys[-5:]}
    assert len(questions.asked_together_at_s) == 1


def test_an_answer_to_all_is_not_of_a_token_that_came_since(questions: Questions) -> None:
    """It may describe the process before: the token is asked about again."""
    questions.takes_s = 1.0
    keys = [f"@tfbus/stream/s{number}" for number in range(100)]
    questions.answers_together = {key: encode_message(description(3)) for key in keys}
    for key in keys:
        questions.token(key, True)
    questions.run(0.3)
    questions.token(keys[-1], False)
    questions.token(keys[-1], True)
    questions.run(0.9)
    assert questions.watch.streams()["s98"].description is not None
    assert questions.watch.streams()["s99"].description is None
    questions.run(3.0)
    assert questions.watch.streams()["s99"].description is not None


def test_an_answer_is_no_newer_than_a_description_that_came_since_the_question(
    questions: Questions, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An answer waits for the link, where what a publisher sends by itself overtakes it."""
    asked: list[Callable[[Answer], None]] = []
    ask = questions_for(lambda *args: asked.append(args[3]))
    monkeypatch.setattr(owners, "description_question", ask)
    former = replace(description(1), session="a")
    removed = replace(description(2), session="b")
    listed = replace(removed, frames=(("world", "robot", False),))
    questions.describe(KEY, encode_message(former), "a")
    questions.run(1.0)
    questions.watch.ask_for_epoch("sim", 2)
    questions.run(1.01)
    questions.describe(KEY, encode_message(removed), "b")
    asked[-1](Answer(KEY, encode_message(listed), sender="b"))
    questions.run(2.0)
    assert questions.watch.streams()["sim"].description == removed


def test_an_answer_to_all_is_no_newer_than_a_description_that_came_since(
    questions: Questions, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As one about a single stream."""
    asked: list[Callable[[Answer], None]] = []
    ask = questions_for(lambda *args: asked.append(args[2]))
    monkeypatch.setattr(description_queries, "descriptions_question", ask)
    removed = replace(description(2), session="b")
    listed = replace(removed, frames=(("world", "robot", False),))
    keys = [f"@tfbus/stream/s{number}" for number in range(100)]
    for key in keys:
        questions.token(key, True)
    questions.run(0.2)
    questions.describe(keys[-1], encode_message(removed), "b")
    for key in keys[-2:]:
        asked[-1](Answer(key, encode_message(listed), sender="b"))
    questions.run(1.0)
    streams = questions.watch.streams()
    assert (streams["s98"].description, streams["s99"].description) == (listed, removed)


def robot_key(number: int) -> str:
    return f"robot{number}/@tfbus/stream/wheels"


def test_of_a_fleet_only_wanted_streams_are_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of all other robots no more than the token is known, and no change is reported: whether the
    token comes before they are wanted or afterwards, and whatever they send.
    """
    questions = Questions(monkeypatch, only_wanted=True)
    questions.answers = [encode_message(description(7))]
    for number in range(300):
        questions.token(robot_key(number), True)
    questions.describe(robot_key(8), encode_message(description(5)))
    questions.run(1.0)
    assert (questions.asked_keys, questions.changed) == ([], [])
    questions.watch.want({"", "robot7", "robot900"}, set())
    questions.token(robot_key(900), True)
    questions.run(2.0)
    assert questions.asked_keys == [robot_key(7), robot_key(900)]
    assert {state.name for state in questions.changed} == {"robot7/wheels", "robot900/wheels"}
    streams = questions.watch.streams()
    assert streams["robot7/wheels"].description == description(7)
    assert (streams["robot8/wheels"].alive, streams["robot8/wheels"].description) == (True, None)
    questions.watch.want({f"robot{number}" for number in range(100)}, set())
    questions.run(3.0)
    assert len(set(questions.asked_keys)) == 101
    assert (questions.asked_together_at_s, questions.sought) == ([], [])


def test_streams_that_list_a_wanted_frame_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """One question goes to all, and one to each that comes later; of many that come at once one
    again to all. A stream that answers or describes itself so is asked for.
    """
    questions = Questions(monkeypatch, only_wanted=True)
    everywhere = "**/@tfbus/stream/*"
    of_map = replace(description(7), frames=(("world", "map", True),))
    questions.answers = [encode_message(of_map)]
    questions.answers_together = {
        robot_key(1): encode_message(of_map),
        # Of an earlier version, which answers whatever it lists.
        robot_key(2): encode_message(description(7)),
    }
    for number in range(3):
        questions.token(robot_key(number), True)
    questions.run(1.0)
    questions.watch.want({""}, {"map"})
    questions.run(10.0)
    assert (*questions.sought[0], questions.asked_keys) == (everywhere, {"map"}, [robot_key(1)])
    assert questions.watch.streams()["robot1/wheels"].description == of_map
    questions.describe(robot_key(2), encode_message(of_map))
    questions.run(20.0)
    assert questions.asked_keys == [robot_key(1), robot_key(2)]
    asked = len(questions.sought)
    questions.token(robot_key(3), True)
    questions.run(20.2)
    assert questions.sought[asked:] == [(robot_key(3), {"map"})]
    questions.run(30.0)
    asked = len(questions.sought)
    for number in range(100, 200):
        questions.token(robot_key(number), True)
    questions.run(30.2)
    assert questions.sought[asked:] == [(everywhere, {"map"})]
