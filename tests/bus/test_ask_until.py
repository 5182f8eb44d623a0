"""Questions that are asked again until an answer has come."""

from collections.abc import Callable
from functools import partial
from typing import Any, cast

import pytest

from tfbus.base.errors import BusError
from tfbus.base.executor import Executor
from tfbus.bus.query import AskUntil, OnEnd, Pauses


class Asked:
    """A question that is asked again, on an executor whose time the test sets."""

    def __init__(self, pauses: Pauses) -> None:
        self.ends: list[Callable[[], None]] = []
        self.waiting: list[tuple[float, Callable[[], None]]] = []
        self.unanswered: list[int] = []
        self.overs = 0
        self.is_settled = self.has_failed = False
        self.asking = AskedUntil(self, pauses)

    def submit(self, what: str, callback: Callable[..., None], *given: Any) -> None:
        callback(*given)

    def after(self, delay_s: float, callback: Callable[..., None], *given: Any) -> None:
        self.waiting.append((delay_s, partial(callback, *given)))

    def pass_time(self) -> list[float]:
        """Run what waits; for how long each waited."""
        waiting, self.waiting = self.waiting, []
        for _, callback in waiting:
            callback()
        return [delay_s for delay_s, _ in waiting]


class AskedUntil(AskUntil):
    """Notes its calls in an `Asked`."""

    def __init__(self, asked: Asked, pauses: Pauses) -> None:
        super().__init__(cast(Executor, asked), "a test", pauses)
        self.asked = asked

    def ask(self, turn: int, on_end: OnEnd) -> None:
        if self.asked.has_failed:
            raise BusError("the session is closed")
        assert turn == len(self.asked.ends)
        self.asked.ends.append(on_end)

    def is_settled(self) -> bool:
        return self.asked.is_settled

    def on_unanswered(self, turn: int) -> None:
        self.asked.unanswered.append(turn)

    def on_over(self) -> None:
        self.asked.overs += 1


def test_pauses_repeat_the_last_or_end() -> None:
    """After the last pause comes the same again, or no question."""
    assert [Pauses((1.0, 2.0), forever=True).after(turn) for turn in range(4)] == [1, 2, 2, 2]
    assert [Pauses((1.0, 2.0)).after(turn) for turn in range(4)] == [1, 2, None, None]


def test_a_question_without_an_answer_is_asked_again_after_each_pause() -> None:
    """The next question comes one pause after the end of the last, until the pauses end."""
    asked = Asked(Pauses((1.0, 2.0)))
    asked.asking.start()
    for pause_s in (1.0, 2.0):
        asked.ends[-1]()
        assert asked.pass_time() == [pause_s]
    assert (len(asked.ends), asked.overs) == (3, 0)
    asked.ends[-1]()
    assert (asked.unanswered, asked.pass_time()) == ([0, 1, 2], [])
    assert (asked.asking.is_over, asked.overs) == (True, 1)


@pytest.mark.parametrize("when", ["at the end", "in the pause"])
def test_what_is_settled_is_asked_no_further(when: str) -> None:
    """An answer ends the questions, whether it comes within one or in the pause after it."""
    asked = Asked(Pauses((1.0,), forever=True))
    asked.asking.start()
    asked.is_settled = when == "at the end"
    asked.ends[0]()
    asked.is_settled = True
    asked.pass_time()
    assert (len(asked.ends), asked.overs, asked.asking.is_over) == (1, 1, True)


def test_what_is_settled_before_is_not_asked() -> None:
    """Where the answer is there already no question is asked."""
    asked = Asked(Pauses((1.0,)))
    asked.is_settled = True
    asked.asking.start()
    assert (asked.ends, asked.overs) == ([], 1)


def test_a_lost_question_is_counted_once_and_may_still_be_answered() -> None:
    """The next question does not wait for a lost one, whose late end counts only if it settles."""
    asked = Asked(Pauses((1.0,), forever=True, lost_after_s=0.5))
    asked.asking.start()
    assert asked.pass_time() == [0.5]
    assert asked.pass_time() == [1.0]
    asked.ends[0]()
    assert (len(asked.ends), asked.unanswered) == (2, [0])
    asked.is_settled = True
    asked.ends[0]()
    assert asked.asking.is_over


def test_closed_questions_end() -> None:
    """After `close` nothing is asked; twice is fine."""
    asked = Asked(Pauses((1.0,)))
    asked.asking.start()
    asked.ends[0]()
    asked.asking.close()
    asked.asking.close()
    asked.pass_time()
    assert (len(asked.ends), asked.overs) == (1, 1)


def test_a_closed_session_ends_the_questions() -> None:
    """Where the session is closed nothing is raised, and nothing asked again."""
    asked = Asked(Pauses((1.0,), lost_after_s=0.5))
    asked.has_failed = True
    asked.asking.start()
    assert asked.waiting == []
