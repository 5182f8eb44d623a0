"""Groups of callbacks on several threads: which run at once, in which order, and until when."""

import logging
import threading
from collections.abc import Iterator

import pytest

from tests.buses import DEADLINE_S, eventually
from tfbus.base.callbacks import (
    CallbackGroup,
    MutuallyExclusiveCallbackGroup,
    ReentrantCallbackGroup,
    join,
)
from tfbus.base.clock import SimulatedClock
from tfbus.base.executor import Executor

THREADS = 4


@pytest.fixture
def executor() -> Iterator[Executor]:
    executor = Executor("groups", logging.getLogger("test"), threads=THREADS)
    yield executor
    executor.close()


def ran(executor: Executor, group: CallbackGroup | None = None) -> threading.Event:
    """Submit a callback to a group; what is set when it has run."""
    event = threading.Event()
    executor.submit("event", event.set, group=group)
    return event


class Blocked:
    """A callback that is in its middle until it is let go."""

    def __init__(self, executor: Executor, group: CallbackGroup | None, what: str = "x") -> None:
        self.go_on = threading.Event()
        entered = threading.Event()

        def block() -> None:
            entered.set()
            self.go_on.wait(DEADLINE_S)

        executor.submit(what, block, group=group)
        assert entered.wait(DEADLINE_S)


def test_never_two_of_an_exclusive_group_at_once(executor: Executor) -> None:
    """However many threads submit to it, and however many run beside it."""
    group, other = MutuallyExclusiveCallbackGroup(), ReentrantCallbackGroup()
    inside: list[int] = []
    most: list[int] = []
    count = 200

    def callback() -> None:
        inside.append(1)
        most.append(len(inside))
        inside.pop()

    def submit_many() -> None:
        for _ in range(count):
            executor.submit("exclusive", callback, group=group)
            executor.submit("other", lambda: None, group=other)

    submitters = [threading.Thread(target=submit_many) for _ in range(4)]
    for thread in submitters:
        thread.start()
    for thread in submitters:
        thread.join()
    eventually(lambda: len(most) == 4 * count)
    assert set(most) == {1}


def test_an_exclusive_group_keeps_the_order(executor: Executor) -> None:
    """Its callbacks run in the order of their submission, on whatever threads."""
    group = MutuallyExclusiveCallbackGroup()
    order: list[int] = []
    for number in range(500):
        executor.submit("number", lambda number=number: order.append(number), group=group)
    eventually(lambda: len(order) == 500)
    assert order == list(range(500))


def test_callbacks_of_a_reentrant_group_overlap(executor: Executor) -> None:
    """As many as there are threads meet in their middle."""
    group = ReentrantCallbackGroup()
    meeting = threading.Barrier(THREADS)
    met: list[int] = []
    for _ in range(THREADS):
        executor.submit("meet", lambda: met.append(meeting.wait(DEADLINE_S)), group=group)
    eventually(lambda: len(met) == THREADS)


def test_groups_run_beside_each_other(executor: Executor) -> None:
    """A callback that waits holds up its own exclusive group, and no other."""
    group, other = MutuallyExclusiveCallbackGroup(), MutuallyExclusiveCallbackGroup()
    blocked = Blocked(executor, group)
    held_up = ran(executor, group)
    assert ran(executor, other).wait(DEADLINE_S)
    assert not held_up.is_set()
    blocked.go_on.set()
    assert held_up.wait(DEADLINE_S)


def test_at_most_so_many_threads_run() -> None:
    """They start when they are needed, and further callbacks wait for one of them."""
    executor = Executor("two", logging.getLogger("test"), threads=2)

    def running() -> int:
        return [thread.name for thread in threading.enumerate()].count("two")

    assert running() == 0
    first = Blocked(executor, ReentrantCallbackGroup())
    assert running() == 1
    second = Blocked(executor, ReentrantCallbackGroup())
    third = ran(executor)
    assert running() == 2
    assert not third.is_set()
    first.go_on.set()
    assert third.wait(DEADLINE_S)
    second.go_on.set()
    executor.close()


def test_a_failure_does_not_hold_up_its_group(
    executor: Executor, caplog: pytest.LogCaptureFixture
) -> None:
    """The next of the group runs; the failure is logged."""
    group = MutuallyExclusiveCallbackGroup()
    executor.submit("bad", lambda: 1 / 0, group=group)
    assert ran(executor, group).wait(DEADLINE_S)
    assert "ZeroDivisionError" in caplog.text


@pytest.mark.parametrize("is_simulated", [False, True])
def test_a_timer_of_a_group_ticks_while_another_waits(
    executor: Executor, is_simulated: bool
) -> None:
    """Also where only one thread has been started so far."""
    group = MutuallyExclusiveCallbackGroup()
    ticks: list[int] = []
    clock = SimulatedClock()
    clock.set(1)
    if is_simulated:
        executor.every_simulated(clock, 1.0, lambda: ticks.append(1), group=group)
    else:
        executor.every(0.001, lambda: ticks.append(1), group=group)
    blocked = Blocked(executor, MutuallyExclusiveCallbackGroup())

    def ticked() -> bool:
        clock.set(clock.now_ns() + 1_000_000_000)
        return len(ticks) >= 5

    eventually(ticked)
    blocked.go_on.set()


def test_a_timer_started_while_all_are_asleep_is_in_time(executor: Executor) -> None:
    """A timer that is due before those that were known wakes a thread for itself."""
    executor.every(1000.0, lambda: None)
    assert ran(executor).wait(DEADLINE_S)
    ticked = threading.Event()
    executor.every(0.001, ticked.set)
    assert ticked.wait(DEADLINE_S)


def test_nothing_of_a_group_runs_after_close(executor: Executor) -> None:
    """The current callback ends; those that wait behind it never run."""
    group = MutuallyExclusiveCallbackGroup()
    blocked = Blocked(executor, group)
    behind = ran(executor, group)
    executor.end()
    blocked.go_on.set()
    executor.close()
    eventually(lambda: "groups" not in {thread.name for thread in threading.enumerate()})
    assert not behind.is_set()


def test_a_group_is_of_one_node() -> None:
    """Another one cannot use it, which its error says."""
    group = ReentrantCallbackGroup()
    join(group, "/robot")
    join(group, "/robot")
    with pytest.raises(ValueError, match=r"node /robot: .*for /arm"):
        join(group, "/arm")


def test_the_limit_of_a_name_counts_those_that_wait_in_the_group(executor: Executor) -> None:
    """A service that is busy refuses further requests."""
    group = MutuallyExclusiveCallbackGroup()
    blocked = Blocked(executor, group)
    taken = [executor.submit("y", lambda: None, limit=3, group=group) for _ in range(5)]
    assert taken == [True, True, True, False, False]
    blocked.go_on.set()
