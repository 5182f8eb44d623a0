"""Workers: jobs on a few threads."""

import threading

from tests.buses import DEADLINE_S, eventually
from tfbus.base.callbacks import Workers
from tfbus.testing import Network


def test_jobs_beyond_what_can_wait_are_refused() -> None:
    """At most `threads` run and `waiting` wait; further ones are refused, accepted ones all run."""
    workers = Workers("test", threads=2, waiting=3)
    go_on = threading.Event()
    running: list[int] = []
    done: list[int] = []

    def job(number: int) -> None:
        running.append(number)
        go_on.wait()
        done.append(number)

    accepted = [workers.do(lambda number=number: job(number)) for number in range(7)]
    assert accepted == [True] * 5 + [False] * 2
    eventually(lambda: len(running) == 2)
    go_on.set()
    eventually(lambda: sorted(done) == [0, 1, 2, 3, 4])
    assert workers.do(lambda: job(7))
    eventually(lambda: len(done) == 6)


def test_threads_end_when_there_is_nothing_to_do() -> None:
    """Without jobs no thread is left."""
    workers = Workers("a worker of this test", threads=2, waiting=3)
    assert workers.do(lambda: None)
    eventually(lambda: all(each.name != "a worker of this test" for each in threading.enumerate()))


def test_close_waits_for_the_jobs_that_run_and_drops_the_others() -> None:
    """A job that takes longer than that is left alone; none is taken afterwards."""
    workers = Workers("test", threads=1, waiting=3)
    begun, go_on = threading.Event(), threading.Event()
    done: list[str] = []

    def first() -> None:
        begun.set()
        go_on.wait()
        done.append("first")

    assert workers.do(first)
    assert workers.do(lambda: done.append("second"))
    assert begun.wait(DEADLINE_S)
    workers.close(0.01)
    assert done == []
    go_on.set()
    workers.close(DEADLINE_S)
    assert done == ["first"]
    assert not workers.do(lambda: done.append("third"))


def test_close_joins_threads_in_the_order_of_their_starts(network: Network) -> None:
    """A seed takes the same turns wherever its threads lie in memory."""

    def turns_to_close() -> int:
        workers = Workers("test", threads=4, waiting=0)
        for number in range(4):
            workers.do(lambda number=number: network.run(0.1 * (4 - number)))
        network.run(0.01)
        former = network.tasks.turns
        workers.close(10.0)
        return network.tasks.turns - former

    assert len({turns_to_close() for _ in range(20)}) == 1
