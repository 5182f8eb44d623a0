"""Static transforms that are listed and have not come are requested until they come."""

import gc
import logging
import weakref
from collections.abc import Callable
from functools import partial
from typing import Any, cast

import pytest

from tests.builders import at, payload
from tests.streams.received import Received
from tfbus.base.executor import Executor
from tfbus.bus.query import Answer
from tfbus.bus.session import Session
from tfbus.streams.queries import StaticRecovery


class Asked:
    """Stands in for a session, and for the thread that asks."""

    def __init__(self) -> None:
        self.keys: list[str] = []
        self.pauses_s: list[float] = []
        self.later: Callable[[], None] | None = None
        # Called where a question takes long.
        self.impatient: Callable[[], None] = lambda: None
        self.impatiences = 0
        self._is_open = False
        self.on_answer: Callable[[Answer], None]
        self.on_end: Callable[[], None]
        self.recovery = StaticRecovery(
            cast(Session, self), logging.getLogger("test"), cast(Executor, self)
        )

    def ask_later(
        self,
        key: str,
        payload: bytes | None,
        on_answer: Callable[[Answer], None],
        on_end: Callable[[], None],
        *,
        timeout_s: float,
        answers_at: str = "",
        others: bool = False,
        priority: str = "usual",
    ) -> None:
        self.keys.append(key)
        self.on_answer, self.on_end = on_answer, on_end
        self._is_open = True

    def submit(self, what: str, callback: Callable[..., None], *given: Any) -> None:
        callback(*given)

    def after(self, delay_s: float, callback: Callable[..., None], *given: Any) -> None:
        if self._is_open:
            self.impatiences += 1
            self.impatient = partial(callback, *given)
        else:
            self.pauses_s.append(delay_s)
            self.later = partial(callback, *given)

    def no_answer_comes(self) -> None:
        """The question ends without an answer, and the pause after it."""
        self._ask_another(self.on_end)

    def nothing_is_heard(self) -> None:
        """The question takes long, and the pause after that has passed."""
        self._ask_another(self.impatient)

    def _ask_another(self, go_on: Callable[[], None]) -> None:
        self.pause(go_on)
        if self.later is not None:
            self.later()

    def pause(self, go_on: Callable[[], None]) -> None:
        """A question has ended, or takes long: then there is a pause."""
        self.later, self._is_open = None, False
        go_on()


@pytest.fixture
def asked() -> Asked:
    return Asked()


@pytest.fixture
def received() -> Received:
    return Received()


def list_static(received: Received, *children: str) -> None:
    received.stream.describe(1, frozenset(children), frozenset(children))


def check(asked: Asked, received: Received) -> None:
    asked.recovery.check("@tfbus/stream/sim", received.stream)


def test_a_publisher_is_asked_until_it_answers(
    asked: Asked, received: Received, caplog: pytest.LogCaptureFixture
) -> None:
    """On both keys in turn, less and less often; after 7 requests it is logged, once."""
    list_static(received, "post")
    check(asked, received)
    for _ in range(20):
        asked.no_answer_comes()
    assert asked.keys[:3] == [
        "tf_static/sim/@adv/pub/**",
        "tf_static/sim",
        "tf_static/sim/@adv/pub/**",
    ]
    assert asked.pauses_s[:7] == [0.1, 0.4, 1.0, 2.0, 4.0, 8.0, 8.0]
    assert len(asked.keys) == 21
    assert ["missing after 7 requests" in record.getMessage() for record in caplog.records] == [
        True
    ]
    asked.on_answer(Answer("tf_static/sim", payload([at(3, "post")])))
    asked.no_answer_comes()
    assert received.x_of("post") == 3
    assert len(asked.keys) == 21


def test_a_refusal_is_no_static_transform(asked: Asked, received: Received) -> None:
    """Nor is an answer that comes once nothing is asked any more."""
    list_static(received, "post")
    check(asked, received)
    refused = payload([at(3, "post")])
    asked.on_answer(Answer("tf_static/sim", refused, refusal="not now"))
    assert received.x_of("post") is None
    asked.recovery.close()
    asked.on_answer(Answer("tf_static/sim", refused))
    assert received.x_of("post") is None


def test_a_lost_question_is_not_waited_for(asked: Asked, received: Received) -> None:
    """Another is asked when one takes long, and the end of the first asks none."""
    list_static(received, "post")
    check(asked, received)
    end_of_the_first = asked.on_end
    asked.nothing_is_heard()
    assert len(asked.keys) == 2
    pauses = len(asked.pauses_s), asked.impatiences
    end_of_the_first()
    assert (len(asked.pauses_s), asked.impatiences) == pauses
    assert len(asked.keys) == 2
    asked.on_answer(Answer("tf_static/sim", payload([at(3, "post")])))
    asked.no_answer_comes()
    asked.impatient()
    assert len(asked.keys) == 2


def test_an_answer_in_the_pause_saves_the_next_question(asked: Asked, received: Received) -> None:
    """An answer may be late, and come before the next question."""
    list_static(received, "post")
    check(asked, received)
    asked.pause(asked.impatient)
    asked.on_answer(Answer("tf_static/sim", payload([at(3, "post")])))
    assert asked.later is not None
    asked.later()
    assert len(asked.keys) == 1


def test_statics_that_are_listed_while_a_question_ends_are_requested(
    asked: Asked, received: Received
) -> None:
    """Static transforms that are listed just when others have come are not forgotten."""
    list_static(received, "post")
    check(asked, received)
    asked.on_answer(Answer("tf_static/sim", payload([at(3, "post")])))
    list_static(received, "post", "wall")
    check(asked, received)
    asked.no_answer_comes()
    assert len(asked.keys) == 2
    asked.on_answer(Answer("tf_static/sim", payload([at(3, "post"), at(4, "wall")])))
    asked.no_answer_comes()
    list_static(received, "post", "wall", "door")
    check(asked, received)
    assert len(asked.keys) == 3


@pytest.mark.parametrize("end", ["gone", "left", "closed"])
def test_a_stream_that_is_gone_or_not_read_is_not_asked(
    asked: Asked, received: Received, end: str
) -> None:
    """Questions end with the publisher, with the subscription, and with the listener."""
    list_static(received, "post")
    check(asked, received)
    if end == "gone":
        received.stream.vanish()
    elif end == "left":
        asked.recovery.leave("sim")
    else:
        asked.recovery.close()
    asked.no_answer_comes()
    assert len(asked.keys) == 1


@pytest.mark.parametrize("end", ["answered", "gone", "left"])
def test_what_is_over_is_forgotten(asked: Asked, received: Received, end: str) -> None:
    """A listener holds nothing of streams whose questions have ended."""
    forgotten = weakref.ref(received.stream)
    list_static(received, "post")
    check(asked, received)
    if end == "answered":
        asked.on_answer(Answer("tf_static/sim", payload([at(3, "post")])))
    elif end == "gone":
        received.stream.vanish()
    else:
        asked.recovery.leave("sim")
    asked.no_answer_comes()
    del asked.on_answer, asked.on_end, received.stream, received.key
    asked.later, asked.impatient = None, lambda: None
    gc.collect()
    assert forgotten() is None
