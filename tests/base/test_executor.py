"""Executors: one thread, callbacks in order, whatever happens in them."""

import asyncio
import logging
import sys
import threading
from collections.abc import Iterator

import pytest

from tests.buses import DEADLINE_S, eventually
from tfbus.base.callbacks import ExecutorEnd, here
from tfbus.base.clock import SimulatedClock
from tfbus.base.executor import Executor
from tfbus.testing.network import Network

SECOND = 1_000_000_000


@pytest.fixture
def executor(network: Network) -> Iterator[Executor]:
    executor = Executor("test", logging.getLogger("test"))
    yield executor
    executor.close()


def finish(executor: Executor) -> None:
    """Wait until all that was submitted before has run."""
    done = threading.Event()
    executor.submit("end", done.set)
    assert done.wait(DEADLINE_S)


def test_callbacks_run_in_the_order_of_their_submission(executor: Executor) -> None:
    """What is submitted first runs first."""
    ran: list[int] = []
    for number in range(100):
        executor.submit("number", lambda number=number: ran.append(number))
    finish(executor)
    assert ran == list(range(100))


def test_callbacks_run_one_at_a_time_on_one_thread(executor: Executor) -> None:
    """However many threads submit, callbacks run on one, and never two together."""
    inside: list[int] = []
    threads: set[int] = set()

    def callback() -> None:
        inside.append(1)
        assert len(inside) == 1
        threads.add(threading.get_ident())
        inside.pop()

    def submit_many() -> None:
        for _ in range(50):
            executor.submit("callback", callback)

    submitters = [threading.Thread(target=submit_many) for _ in range(4)]
    for thread in submitters:
        thread.start()
    for thread in submitters:
        thread.join()
    finish(executor)
    assert len(threads) == 1
    assert threading.get_ident() not in threads


def test_a_timer_runs_until_it_is_cancelled(executor: Executor) -> None:
    """A timer runs again and again until it is cancelled."""
    ticks: list[int] = []
    timer = executor.every(0.001, lambda: ticks.append(1))
    eventually(lambda: len(ticks) >= 3)
    timer.cancel()
    timer.cancel()
    finish(executor)
    count = len(ticks)
    other: list[int] = []
    executor.every(0.001, lambda: other.append(1))
    eventually(lambda: len(other) >= 5)
    assert len(ticks) == count


def test_a_timer_may_cancel_itself(executor: Executor) -> None:
    """A timer that is cancelled in its own callback does not run again."""
    ticks: list[int] = []

    def tick() -> None:
        ticks.append(1)
        timer.cancel()

    timer = executor.every(0.01, tick)
    eventually(lambda: ticks)
    other: list[int] = []
    executor.every(0.02, lambda: other.append(1))
    eventually(lambda: len(other) >= 2)
    assert ticks == [1]


def test_after_runs_once(executor: Executor) -> None:
    """A callback put off by `after` runs once."""
    ran: list[int] = []
    executor.after(0.001, lambda: ran.append(1))
    others: list[int] = []
    executor.every(0.002, lambda: others.append(1))
    eventually(lambda: len(others) >= 5)
    assert ran == [1]


def test_cancelled_timers_are_forgotten_long_before_they_are_due(executor: Executor) -> None:
    """As many as are made and cancelled, fewer than a hundred of them stay; the others run."""
    ran = threading.Event()
    executor.after(0.05, ran.set)
    for _ in range(10_000):
        executor.after(1e6, ran.clear).cancel()
    _, timers = executor.waiting()
    assert timers < 100
    assert ran.wait(30.0)


def test_slow_timers_do_not_hold_up_other_callbacks(executor: Executor) -> None:
    """Where timers take longer than their periods, other callbacks still run between them."""
    started = threading.Event()
    busy = threading.Event()
    for _ in range(2):
        executor.every(0.001, lambda: (started.set(), busy.wait(0.01)))
    assert started.wait(DEADLINE_S)
    for _ in range(3):
        finish(executor)


def test_missed_ticks_are_not_made_up_for(executor: Executor) -> None:
    """Ticks that were missed while another callback took long are not made up for."""
    ticks: list[int] = []
    blocked = threading.Event()
    executor.every(0.005, lambda: ticks.append(1))
    executor.submit("long", lambda: blocked.wait(0.2))
    finish(executor)
    assert len(ticks) < 10


@pytest.mark.parametrize("period_s", [0, -1, float("nan"), float("inf")])
def test_an_invalid_period_is_refused(executor: Executor, period_s: float) -> None:
    """A timer's period is more than 0 s and finite."""
    with pytest.raises(ValueError, match="timer's period"):
        executor.every(period_s, lambda: None)


def test_a_failure_is_logged_once_and_the_thread_goes_on(
    executor: Executor, caplog: pytest.LogCaptureFixture
) -> None:
    """A callback that raises is logged with its traceback once, and the others go on."""
    ran: list[int] = []
    for _ in range(3):
        executor.submit("bad callback", lambda: 1 / 0)  # never returns
        executor.submit("good", lambda: ran.append(1))
    executor.submit("another bad one", lambda: [][0])
    finish(executor)
    assert ran == [1, 1, 1]
    bad, other = [record.getMessage() for record in caplog.records]
    assert "1 time " in bad and bad.endswith(" (bad callback)")
    assert "1 time " in other and other.endswith(" (another bad one)")
    assert "ZeroDivisionError" in caplog.text


def test_a_timer_that_fails_goes_on(executor: Executor) -> None:
    """A timer whose callback raises ticks again."""
    ticks: list[int] = []

    def tick() -> None:
        ticks.append(1)
        raise RuntimeError("bad tick")

    executor.every(0.001, tick)
    eventually(lambda: len(ticks) >= 3)


def test_close_finishes_what_runs_and_drops_the_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    """Closing waits for the callback that runs, and runs no other."""
    # On a busy machine its thread may not run for as long as that.
    monkeypatch.setattr("tfbus.base.executor._LAST_CALLBACK_S", DEADLINE_S)
    executor = Executor("finishing", logging.getLogger("test"))
    ran: list[str] = []
    entered, leave = threading.Event(), threading.Event()

    ends: list[ExecutorEnd | None] = []

    def first() -> None:
        ends.append(here.closing)
        entered.set()
        leave.wait(DEADLINE_S)
        ran.append("first")

    executor.submit("first", first)
    executor.submit("second", lambda: ran.append("second"))
    assert entered.wait(DEADLINE_S)
    closer = threading.Thread(target=executor.close)
    closer.start()
    eventually(lambda: ends[0] and ends[0].has_begun)
    leave.set()
    closer.join(DEADLINE_S)
    executor.submit("third", lambda: ran.append("third"))
    executor.every(0.001, lambda: ran.append("timer"))
    executor.close()
    assert ran == ["first"]
    assert not [thread for thread in threading.enumerate() if thread.name == "finishing"]


def test_close_from_a_callback_does_not_wait_for_itself() -> None:
    """A callback may close its executor."""
    executor = Executor("closing", logging.getLogger("test"))
    closed = threading.Event()
    executor.submit("close", lambda: (executor.close(), closed.set()))
    assert closed.wait(DEADLINE_S)
    eventually(lambda: not [thread for thread in threading.enumerate() if thread.name == "closing"])


def test_an_executor_that_is_never_used_has_no_thread() -> None:
    """No thread is started before there is something to run."""
    executor = Executor("idle", logging.getLogger("test"))
    assert "idle" not in {thread.name for thread in threading.enumerate()}
    executor.close()


def test_a_simulated_timer_ticks_with_its_clock(executor: Executor) -> None:
    """A timer of a simulated clock ticks once a period of that clock, and never between."""
    clock = SimulatedClock()
    ticks: list[int] = []
    timer = executor.every_simulated(clock, 1.0, lambda: ticks.append(clock.now_ns() // SECOND))
    for second in (10, 10, 11, 12):
        clock.set(second * SECOND)
        finish(executor)
    clock.set(12 * SECOND + SECOND // 2)
    clock.set(13 * SECOND)
    finish(executor)
    timer.cancel()
    clock.set(14 * SECOND)
    finish(executor)
    assert ticks == [11, 12, 13]


def test_missed_simulated_ticks_are_not_made_up_for(executor: Executor) -> None:
    """A jump forward is one tick; after a jump back the timer goes on a period later at most."""
    clock = SimulatedClock()
    ticks: list[int] = []
    executor.every_simulated(clock, 10.0, lambda: ticks.append(clock.now_ns() // SECOND))
    for second in (0, 3605, 3609, 3610, 5, 14, 15, 25):
        clock.set(second * SECOND)
        finish(executor)
    assert ticks == [3605, 3610, 15, 25]


def test_a_simulated_timer_does_not_tick_because_its_clock_is_closed(executor: Executor) -> None:
    """As a node closes its clock before its callbacks end."""
    clock = SimulatedClock()
    ticks: list[int] = []
    executor.every_simulated(clock, 10.0, lambda: ticks.append(clock.now_ns() // SECOND))
    for second in (100, 110, 115):
        clock.set(second * SECOND)
        finish(executor)
    clock.close()
    finish(executor)
    assert ticks == [110]


def test_a_cancelled_future_in_a_callback_is_a_failure(
    executor: Executor, caplog: pytest.LogCaptureFixture
) -> None:
    """It is logged, as other errors: its exception is of another kind."""

    def ask() -> None:
        raise asyncio.CancelledError

    executor.submit("asking", ask)
    eventually(lambda: "A callback failed, 1 time so far (asking)" in caplog.text)
    finish(executor)


@pytest.mark.parametrize("is_async", [False, True])
def test_an_exit_in_a_callback_is_a_failure(
    executor: Executor, caplog: pytest.LogCaptureFixture, is_async: bool
) -> None:
    """It is logged, and further callbacks run: the thread would end without a word."""

    def leave() -> None:
        sys.exit(3)

    async def leave_later() -> None:
        sys.exit(3)

    executor.submit("leaving", leave_later if is_async else leave)
    eventually(lambda: "A callback failed, 1 time so far (leaving)" in caplog.text)
    finish(executor)
