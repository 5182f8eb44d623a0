"""Waiting for a transform, in threads and in asyncio: woken by changes of its path alone."""

import asyncio
import sys
import threading
from typing import Any

import pytest

from tests.builders import S, moved, store_of
from tests.buses import DEADLINE_S, eventually, lookups_wait
from tests.fakes import InAThread
from tfbus.base.errors import (
    ExtrapolationException,
    FutureExtrapolationException,
    LookupException,
    PastExtrapolationException,
    TimeoutException,
)
from tfbus.buffer.buffer import Buffer
from tfbus.buffer.explain import LATER, LATEST, Freshness
from tfbus.buffer.lookup import Lookup as Question
from tfbus.buffer.store import Waiter


def waiting(buffer: Buffer, count: int = 1) -> None:
    """Return when `count` lookups wait in the buffer."""
    eventually(lambda: buffer.waiting >= count)


def test_a_lookup_waits_for_the_future():
    """It returns when the edges of its path have come to its time."""
    buffer = Buffer()
    buffer.set_transform(moved(0, "world", "robot"))
    lookup = InAThread(lambda: buffer.lookup_transform("world", "robot", 10, timeout_s=DEADLINE_S))
    waiting(buffer)
    buffer.set_transform(moved(5, "world", "robot"))
    buffer.set_transform(moved(15, "world", "robot", 2.0))
    assert lookup.result().transform.x == 1.0


def test_a_lookup_waits_for_unknown_frames():
    """Unknown frames, and trees that are not joined, may come."""
    buffer = Buffer()
    lookup = InAThread(lambda: buffer.lookup_transform("world", "hand", timeout_s=DEADLINE_S))
    waiting(buffer)
    buffer.set_transform(moved(1, "robot", "hand", 1.0))
    buffer.set_transform(moved(1, "world", "map", 1.0))
    buffer.set_transform(moved(1, "map", "robot", 1.0))
    assert lookup.result().transform.x == 3.0


def test_time_travel_waits_too():
    """lookup_transform_full waits for both of its times."""
    buffer = Buffer()
    for i in range(3):
        buffer.set_transform(moved(i, "world", "robot", float(i)))
    answers: list[float] = []

    def ask() -> None:
        answer = buffer.lookup_transform_full("robot", 5, "robot", 1, "world", timeout_s=DEADLINE_S)
        answers.append(answer.transform.x)

    thread = threading.Thread(target=ask)
    thread.start()
    waiting(buffer)
    buffer.set_transform(moved(5, "world", "robot", 5.0))
    thread.join(DEADLINE_S)
    assert answers == [-4.0]


def test_after_the_timeout_the_error_says_what_was_missing():
    """TimeoutException carries the error that there was without waiting."""
    buffer = Buffer()
    buffer.set_transform(moved(0, "world", "robot"))
    buffer.set_transform(moved(S, "world", "robot"))
    with pytest.raises(TimeoutException) as caught:
        buffer.lookup_transform("world", "robot", 2 * S, timeout_s=0.01)
    assert isinstance(caught.value.reason, FutureExtrapolationException)
    assert not buffer.can_transform("world", "robot", 2 * S, timeout_s=0.01)
    assert buffer.waiting == 0


def test_the_past_is_not_waited_for():
    """A time older than the oldest sample fails at once, whatever the timeout."""
    buffer = Buffer()
    buffer.set_transform(moved(S, "world", "robot"))
    buffer.set_transform(moved(2 * S, "world", "robot"))
    with pytest.raises(PastExtrapolationException):
        buffer.lookup_transform("world", "robot", 0, timeout_s=600.0)


def test_a_waiter_fails_as_soon_as_its_time_has_fallen_out():
    """While it waits for one edge, its time leaves the history of another: it gives up then."""
    buffer = Buffer(1.0)
    buffer.set_transform(moved(0, "world", "robot"))
    buffer.set_transform(moved(S, "world", "robot"))
    buffer.set_transform(moved(0, "robot", "arm"))
    lookup = InAThread(lambda: buffer.lookup_transform("world", "arm", S // 2, timeout_s=600.0))
    waiting(buffer)
    # At once: of a single sample the reason would be another.
    buffer.set_transforms([moved(9 * S, "world", "robot"), moved(10 * S, "world", "robot")])
    assert isinstance(lookup.result(), PastExtrapolationException)


def watched(buffer: Buffer, *question: Any) -> tuple[list[int], Waiter]:
    """A waiter with this question, and what gets a number whenever it is woken."""
    woken: list[int] = []
    waiter = Waiter(lambda: woken.append(1))
    store_of(buffer).waiters.add(waiter)
    Question(store_of(buffer), (question,)).watch(waiter)
    return woken, waiter


def test_only_edges_of_the_path_wake_a_waiter():
    """Samples of other edges, and of a time before its own, leave it asleep."""
    buffer = Buffer()
    for child in ("robot", "other"):
        buffer.set_transform(moved(0, "world", child))
        buffer.set_transform(moved(S, "world", child))
    woken, _ = watched(buffer, "world", "robot", 5 * S)
    buffer.set_transform(moved(6 * S, "world", "other"))
    buffer.set_transform(moved(4 * S, "world", "robot"))
    buffer.set_transform(moved(6 * S, "robot", "new"))
    assert woken == []
    buffer.set_transform(moved(5 * S, "world", "robot"))
    assert woken == [1]


def test_a_frame_that_comes_as_a_parent_wakes_a_waiter():
    """It was unknown, and is above the frame that was known."""
    buffer = Buffer()
    buffer.set_transform(moved(0, "base", "arm"))
    woken, _ = watched(buffer, "map", "arm", None)
    buffer.set_transform(moved(0, "map", "base"))
    assert woken == [1]


def test_a_sample_wakes_whoever_waits_after_it_no_more():
    """Neither later changes bring it up again, nor is it kept while nobody waits."""
    buffer = Buffer()
    for stamp in (0, S):
        buffer.set_transform(moved(stamp, "world", "robot"))
    woken, waiter = watched(buffer, "world", "robot", 5 * S)
    assert woken == []
    buffer.set_transform(moved(4 * S, "world", "robot"))
    assert store_of(buffer).tree.touched == []
    store_of(buffer).waiters.discard(waiter)
    buffer.set_transform(moved(5 * S, "world", "robot"))
    assert store_of(buffer).tree.touched is None


def test_a_waiter_that_one_edge_wakes_over_and_over_takes_no_more_memory():
    """The other edges of its path, whose publisher is silent, keep it once."""
    buffer = Buffer()
    buffer.set_transform(moved(0, "map", "odom"))
    _, waiter = watched(buffer, "map", "base", None)
    question = Question(store_of(buffer), (("map", "base", None),), fresh=Freshness(1.0))
    references = []
    for stamp in range(1000):
        buffer.set_transform(moved(stamp, "odom", "base"))
        question.watch(waiter)
        references.append(sys.getrefcount(waiter))
    assert references[-1] == references[0]


def test_the_past_is_waited_for_until_all_who_expect_it_have_it():
    """Two listeners may fill one buffer."""
    buffer = Buffer()
    for stamp_ns in (5 * S, 6 * S):
        buffer.set_transform(moved(stamp_ns, "world", "robot", 1.0), authority="sim")
    ends = [buffer.expect_past("sim") for _ in range(2)]
    lookup = InAThread(lambda: buffer.lookup_transform("world", "robot", S, timeout_s=600.0))
    waiting(buffer)
    ends[0]()
    assert store_of(buffer).expected_pasts == {"sim": 1}
    buffer.set_transform(moved(S, "world", "robot", 7.0), authority="sim")
    ends[1]()
    assert lookup.result().transform.x == 7.0
    assert store_of(buffer).expected_pasts == {}


def test_a_new_parent_on_the_path_wakes_a_waiter():
    """A path may become another one: who waits looks again."""
    buffer = Buffer()
    buffer.set_transform(moved(0, "world", "robot"))
    buffer.set_transform(moved(0, "map", "table", 7.0))
    lookup = InAThread(lambda: buffer.lookup_transform("map", "robot", 10, timeout_s=DEADLINE_S))
    waiting(buffer)
    buffer.set_transform(moved(0, "table", "robot", 1.0), static=True)
    waiting(buffer)
    buffer.set_transform(moved(10, "map", "table", 7.0))
    assert lookup.result().transform.x == 8.0


def test_thousands_wait_at_once():
    """Each of many waiters is woken when its own time comes."""
    buffer = Buffer(1e6)
    buffer.set_transform(moved(0, "world", "robot"))

    async def all_answers() -> list[float]:
        tasks = [
            asyncio.create_task(buffer.wait_for_transform("world", "robot", i, timeout_s=60))
            for i in range(1, 3001)
        ]
        await lookups_wait(buffer, len(tasks))
        for i in range(1, 3001):
            buffer.set_transform(moved(i, "world", "robot", float(i)))
        return [(await task).transform.x for task in tasks]

    assert asyncio.run(all_answers()) == [float(i) for i in range(1, 3001)]
    assert buffer.waiting == 0


def test_awaiting_has_a_timeout_and_can_be_cancelled():
    """Neither leaves anything behind in the buffer."""
    buffer = Buffer()

    async def ask() -> None:
        with pytest.raises(TimeoutException) as caught:
            await buffer.wait_for_transform("world", "robot", timeout_s=0.01)
        assert isinstance(caught.value.reason, LookupException)
        task = asyncio.create_task(buffer.wait_for_transform("world", "robot"))
        await lookups_wait(buffer)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task

    asyncio.run(ask())
    assert buffer.waiting == 0


def test_an_insert_in_another_thread_wakes_the_event_loop():
    """Who awaits is answered although the data came in a thread."""
    buffer = Buffer()

    async def ask() -> float:
        task = asyncio.create_task(
            buffer.wait_for_transform("world", "robot", timeout_s=DEADLINE_S)
        )
        await lookups_wait(buffer)
        thread = threading.Thread(
            target=lambda: buffer.set_transform(moved(1, "world", "robot", 4.0))
        )
        thread.start()
        answer = await task
        thread.join()
        return answer.transform.x

    assert asyncio.run(ask()) == 4.0


def test_time_travel_waits_in_asyncio():
    """wait_for_transform_full waits for both of its times."""
    buffer = Buffer()
    buffer.set_transform(moved(1, "world", "robot", 1.0))

    async def ask() -> float:
        task = asyncio.create_task(
            buffer.wait_for_transform_full("robot", 5, "robot", 1, "world", timeout_s=DEADLINE_S)
        )
        await asyncio.sleep(0)
        assert not task.done()
        buffer.set_transform(moved(5, "world", "robot", 3.0))
        return (await task).transform.x

    assert asyncio.run(ask()) == -2.0


@pytest.mark.parametrize(
    ("stamps", "stamp_ns", "end"),
    [
        ((1 * S, 2 * S), 3 * S, "1.000 s earlier; query the latest (stamp_ns=None)"),
        ((1 * S,), 3 * S, "its only sample is 2.000 s earlier"),
    ],
)
def test_a_lookup_that_has_waited_is_not_advised_to_wait(
    stamps: tuple[int, ...], stamp_ns: int, end: str
) -> None:
    """The sentence of a timeout names what else helps; its reason keeps the whole advice."""
    buffer = Buffer()
    for stamp in stamps:
        buffer.set_transform(moved(stamp, "map", "robot"))
    with pytest.raises(TimeoutException) as raised:
        buffer.lookup_transform("map", "robot", stamp_ns, timeout_s=0.001)
    assert str(raised.value).endswith(end)
    assert raised.value.reason is not None and "wait" in raised.value.reason.waiting


@pytest.mark.parametrize(("stamp_ns", "advice"), [(0, LATER), (9 * S, LATEST)])
def test_a_tool_can_give_its_own_advice(stamp_ns: int, advice: str) -> None:
    """In the place of that to query another time, or none: the fact stands alone."""
    buffer = Buffer()
    for stamp in (4, 5):
        buffer.set_transform(moved(stamp * S, "map", "base", 1))
    with pytest.raises(ExtrapolationException) as raised:
        buffer.lookup_transform("map", "base", stamp_ns or 1 * S)
    error = raised.value
    assert error.advice == advice
    assert error.fact.endswith(f".000 s {'earlier' if stamp_ns else 'later'}")
    error.waiting, error.advice, error.advice_by = "", "give another --at", ""
    assert str(error) == f"{error.fact}; give another --at"
