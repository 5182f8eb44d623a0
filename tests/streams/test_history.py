"""Transforms sent before a listener met their streams: how long lookups of the past wait."""

import heapq
import itertools
from collections.abc import Callable
from functools import partial
from random import Random
from types import SimpleNamespace
from typing import Any, cast

import pytest

from tests.builders import at, store_of
from tests.buses import eventually, send_until
from tests.simulated_bus import Bus
from tfbus import Buffer, Node, TransformBroadcaster, TransformListener
from tfbus.base import scheduler
from tfbus.base.executor import Executor
from tfbus.buffer.trajectories import samples
from tfbus.bus.query import Answer
from tfbus.bus.session import Session
from tfbus.streams.history import AskedHistory, AskPages, PagesInTurn
from tfbus.streams.reception import StreamReception
from tfbus.wire.pages import Page, encode_page


def test_minutes_without_a_link_come_back_behind_what_is_sent_now(bus: Bus) -> None:
    """The gap comes by pages on a narrow link that is cut again meanwhile: all of it, while what is
    sent now is as fresh as ever.
    """
    network = bus.network
    robot, base = network.host("robot"), network.host("base")
    # The gap takes half a minute on this link.
    network.path(robot, base, delay_s=0.05, bytes_a_second=6_000.0)
    with network.process(robot, "sim"):
        node = Node("sim")
        broadcaster = TransformBroadcaster(node, history_s=3600.0)
    sent: list[int] = []
    frames = ["robot", *(f"link{number}" for number in range(5))]
    random = Random(1).random

    def send() -> None:
        sent.append(node.now_ns())
        broadcaster.send_transform([at(random(), frame, sent[-1]) for frame in frames])

    node.create_timer(0.4, send)
    buffer = Buffer(cache_time_s=3600.0)
    with network.process(base, "listener"):
        listener = TransformListener(buffer, Node("listener"), history_s=3600.0)

    def missing() -> int:
        return len({*sent[:-10]} - {*samples(buffer, "robot").stamps_ns.tolist()})

    network.run(until=lambda: "robot" in buffer.frames())
    for away_s in (900.0, 20.0):
        network.partition(robot, base)
        network.run(away_s)
        network.heal()
        network.run(until=lambda: listener.streams()[0].alive)
        for _ in range(12):
            network.run(0.5)
            age_ns = node.now_ns() - buffer.lookup_transform("world", "robot").stamp_ns
            assert age_ns < 1.0e9
        came = len(sent) - missing()
        assert missing() > 100 and came > 100
    for _ in range(60):
        network.run(5.0)
    assert not missing()


def stamps_of(buffer: Buffer) -> set[int]:
    """The stamps of the samples of `robot`, if there are any."""
    return {*samples(buffer, "robot").stamps_ns.tolist()} if "robot" in buffer.frames() else set()


class Past:
    """A history of ten seconds, and in the place of the bus questions that the test answers."""

    name = "sim"

    def __init__(self, history_s: float = 10.0) -> None:
        self.buffer = Buffer()
        self.questions: list[tuple[str, Callable[[Answer], None], Callable[[], None]]] = []
        self.kept: list[bytes] = []
        self._now_s = 0.0
        self._order = itertools.count()
        self._due: list[tuple[float, int, Callable[[], None]]] = []
        here: Any = self
        self.history = AskedHistory(
            cast(Session, here), self.buffer, cast(Executor, here), history_s
        )

    def ask(self, key: str = "tf/sim") -> None:
        self.history.ask(key, cast(StreamReception, self))

    def ask_later(
        self, key: str, _: None, answer: Any, end: Any, *, timeout_s: float, priority: str
    ) -> None:
        assert priority == "background"
        self.questions.append((key, answer, end))

    def answer(self, page: Page) -> None:
        """Answer the last question about the stream."""
        _, answer, end = [each for each in self.questions if each[0].startswith("tf/sim")][-1]
        answer(Answer("tf/sim", encode_page(page)))
        end()

    def receive_kept(self, payload: bytes) -> None:
        self.kept.append(payload)

    def submit(self, what: str, job: Callable[..., None], *given: Any) -> None:
        self.after(0.0, job, *given)

    def after(self, delay_s: float, job: Callable[..., None], *given: Any) -> Any:
        due_s = self._now_s + delay_s
        heapq.heappush(self._due, (due_s, next(self._order), partial(job, *given)))
        return SimpleNamespace(cancel=lambda: None)

    def run(self, end_s: float) -> None:
        while self._due and self._due[0][0] <= end_s:
            self._now_s, _, job = heapq.heappop(self._due)
            job()
        self._now_s = end_s

    @property
    def is_expected(self) -> bool:
        """Whether lookups of the past wait."""
        return bool(store_of(self.buffer).expected_pasts)


def test_the_past_is_expected_from_the_first_message_until_it_has_come() -> None:
    """It is asked for once, and comes in any number of answers."""
    past = Past()
    past.history.meet("sim")
    assert past.is_expected
    past.ask()
    past.ask()
    ((selector, answer, end),) = past.questions
    assert selector == "tf/sim?last_s=10;page=4000"
    answer(Answer("tf/sim", b"first"))
    answer(Answer("tf/sim", b"second"))
    past.run(1.0)
    assert past.is_expected
    end()
    past.run(1.0)
    assert not past.is_expected
    assert past.kept == [b"first", b"second"]


def test_all_questions_to_a_stream_have_to_end() -> None:
    """As those for the keys of a split one; and what is not answered is asked again."""
    past = Past()
    for key in ("tf/sim/a", "tf/sim/b"):
        past.ask(key)
    (_, answer, end), (_, _, end_unanswered) = past.questions
    answer(Answer("tf/sim/a", b"first"))
    end()
    end_unanswered()
    past.run(1.0)
    assert past.is_expected
    (again,) = past.questions[2:]
    assert again[0].startswith("tf/sim/b")
    again[1](Answer("tf/sim/b", b"second"))
    again[2]()
    past.run(1.0)
    assert not past.is_expected


def test_the_past_is_expected_for_five_seconds() -> None:
    """Where no description comes, and so no question is asked."""
    past = Past()
    past.history.meet("sim")
    past.run(4.9)
    assert past.is_expected
    past.run(5.1)
    assert not past.is_expected


def test_a_question_that_is_open_for_longer_still_has_its_answer() -> None:
    """Lookups no longer wait for it."""
    past = Past()
    past.ask()
    past.run(6.0)
    assert not past.is_expected
    past.questions[0][1](Answer("tf/sim", b"late"))
    past.questions[0][2]()
    past.run(7.0)
    assert past.kept == [b"late"]


def test_nothing_is_expected_of_a_stream_that_keeps_nothing() -> None:
    """Unless it is asked all the same, as for a stream of before."""
    past = Past()
    past.history.meet("sim")
    past.history.keeps_nothing("sim")
    assert not past.is_expected
    past.ask()
    past.history.keeps_nothing("sim")
    assert past.is_expected


@pytest.mark.parametrize("is_closed", [False, True])
def test_without_a_history_and_after_the_end_nothing_is_expected(is_closed: bool) -> None:
    """Nor is anything asked where no history is wanted."""
    past = Past(10.0 if is_closed else 0.0)
    if is_closed:
        past.history.meet("other")
        past.history.close()
    past.history.meet("sim")
    if not is_closed:
        past.ask()
    assert not past.is_expected
    assert past.questions == []


def test_an_answer_after_the_end_is_expected_by_none() -> None:
    """A question may be on its way when the listener is closed."""
    past = Past()
    past.history.close()
    past.ask()
    past.questions[0][1](Answer("tf/sim", b"late"))
    past.questions[0][2]()
    past.run(1.0)
    assert not past.is_expected


def test_a_stream_that_is_back_is_asked_again() -> None:
    """Answers to the former question are no longer taken."""
    past = Past()
    past.ask()
    past.history.leave(["tf/sim", "tf/unknown"], "sim")
    past.ask()
    (_, former, _), (_, present, _) = past.questions
    former(Answer("tf/sim", b"former"))
    present(Answer("tf/sim", b"present"))
    assert past.kept == [b"present"]


def test_messages_that_are_missing_are_asked_for_though_the_stream_never_left() -> None:
    """They are the messages of the silence before the one that came."""
    past = Past()
    past.history.miss("tf/sim", cast(StreamReception, past), 2.0)
    assert not past.questions
    past.ask()
    past.history.miss("tf/sim", cast(StreamReception, past), 2.0)
    assert len(past.questions) == 1
    past.answer(Page(()))
    past.run(1.0)
    past.history.miss("tf/sim", cast(StreamReception, past), 2.0)
    past.run(2.0)
    _, (selector, *_) = past.questions
    last_s = selector.removeprefix("tf/sim?last_s=").partition(";")[0]
    # And some seconds before, whose messages may be lost too.
    assert float(last_s) >= 5.0


def test_a_gap_that_is_found_while_a_question_is_under_way_is_asked_for_next() -> None:
    """The question knows nothing of it: it was sent before."""
    past = Past()
    past.ask()
    past.history.miss("tf/sim", cast(StreamReception, past), 2.0)
    past.history.miss("tf/sim", cast(StreamReception, past), 1.0)
    assert len(past.questions) == 1
    past.answer(Page(()))
    past.run(1.0)
    assert len(past.questions) == 2
    past.answer(Page(()))
    past.run(1.0)
    assert len(past.questions) == 2


def test_what_a_link_lost_in_a_silence_comes_from_the_history(
    bus: Bus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Though the token of its stream was there all the time."""
    is_silent, sent = [False], list[int]()
    take = TransformListener._on_message
    monkeypatch.setattr(
        TransformListener, "_on_message", lambda *given: is_silent[0] or take(*given)
    )
    node, buffer = bus.node("sim"), Buffer()
    broadcaster = TransformBroadcaster(node, history_s=60.0)

    def send() -> None:
        sent.append(node.now_ns())
        broadcaster.send_transform(at(1, "robot", sent[-1]))

    node.create_timer(0.1, send)
    with TransformListener(buffer, bus.node("listener"), history_s=60.0):
        eventually(lambda: len(sent) > 10 and {*sent[:-1]} <= stamps_of(buffer))
        is_silent[0] = True
        bus.network.run(3.0)
        is_silent[0] = False
        eventually(lambda: {*sent[:-2]} <= stamps_of(buffer))


def test_a_question_goes_on_though_its_key_made_room_for_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The missing times that are asked for next are not lost with the key."""
    monkeypatch.setattr("tfbus.streams.history._MOST_MISSING", 2)
    past = Past()
    past.ask()
    past.answer(Page((), next="here"))
    past.history.leave(["tf/sim"], "sim", silent_s=1.0)
    past.ask()
    past.ask("tf/second")
    past.ask("tf/third")
    count = len(past.questions)
    past.answer(Page(()))
    past.run(1.0)
    assert past.questions[count][0].startswith("tf/sim?")


def test_lookups_wait_for_no_past_of_a_stream_that_keeps_none(bus: Bus) -> None:
    """They wait until it has described itself, not for the five seconds of others."""
    broadcaster = TransformBroadcaster(bus.node("sim"), history_s=0.0)
    buffer = Buffer()
    with TransformListener(buffer, bus.node("listener"), history_s=10.0) as listener:
        send_until(
            lambda: broadcaster.send_transform(at(1, "robot")),
            lambda: bool(store_of(buffer).expected_pasts),
        )
        begun_s = scheduler.monotonic()
        eventually(lambda: not store_of(buffer).expected_pasts)
        assert scheduler.monotonic() - begun_s < 4.0
        assert [info.frames for info in listener.streams()] == [(("world", "robot", False),)]


class AskNoted(AskPages):
    """Notes the pages that come."""

    def __init__(self, pages: "Pages") -> None:
        super().__init__(cast(Session, pages.past), pages.executor, pages.turns)
        self._came = pages.came

    def selector(self) -> str:
        return "tf/sim"

    def on_page(self, page: Page) -> None:
        self._came.append(page)

    def on_over(self) -> None:
        pass


class Pages:
    """The pages of one key as they are asked for, all in turns of one question at a time."""

    def __init__(self) -> None:
        self.past = Past()
        self.executor = cast(Executor, self.past)
        self.turns = PagesInTurn(self.executor, most=1)
        self.came: list[Page] = []

    def ask(self, kind: type[AskNoted] = AskNoted) -> AskNoted:
        asking = kind(self)
        asking.start()
        return asking

    def answer(self, payload: bytes) -> None:
        """Answer the last question, which ends with that."""
        _, on_answer, on_end = self.past.questions[-1]
        on_answer(Answer("tf/sim", payload))
        on_end()
        self.past.run(0.0)


class AskMessages(AskNoted):
    """Takes answers that are no pages, too."""

    def on_message(self, answer: Answer) -> bool:
        return answer.payload == b"stray"


@pytest.mark.parametrize(("kind", "takes_messages"), [(AskNoted, False), (AskMessages, True)])
def test_a_stray_answer_completes_nothing_where_only_pages_are_taken(
    kind: type[AskNoted], takes_messages: bool
) -> None:
    """Where earlier versions answer with messages, it is all of them."""
    pages = Pages()
    asking = pages.ask(kind)
    pages.answer(b"stray")
    assert (asking.is_complete, asking.is_over) == (takes_messages, takes_messages)


def test_a_page_whose_next_is_itself_is_no_answer() -> None:
    """It would be asked for without end."""
    pages = Pages()
    asking = pages.ask()
    for _ in range(3):
        pages.answer(encode_page(Page([], "1.2")))
    assert len(pages.came) == 1
    assert not asking.is_complete and asking.place == "1.2"


def test_a_turn_ends_though_its_question_fails() -> None:
    """Others wait for it."""

    class AskFull(AskNoted):
        def selector(self) -> str:
            raise OSError("the disk is full")

    pages = Pages()
    with pytest.raises(OSError):
        pages.ask(AskFull)
    pages.ask()
    assert len(pages.past.questions) == 1
