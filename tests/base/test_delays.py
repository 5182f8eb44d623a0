"""Delays: late timers and full queues are told, with the culprit."""

import logging
import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from functools import partial

import pytest

from tests import needs
from tests.buses import DEADLINE_S, eventually
from tfbus.base import scheduler
from tfbus.base.callbacks import Delays
from tfbus.base.clock import SimulatedClock
from tfbus.base.executor import Executor
from tfbus.testing.network import Network

SECOND = 1_000_000_000


@pytest.fixture
def delays() -> Delays:
    return Delays(logging.getLogger("test"))


@pytest.fixture
def executor(network: Network, delays: Delays) -> Iterator[Executor]:
    executor = Executor("test", logging.getLogger("test"), delays=delays)
    yield executor
    executor.close()


def tick() -> None:
    """The callback of a timer."""


def spend(seconds: float) -> None:
    """Be busy for this time."""
    time.sleep(seconds)


def test_a_late_timer_names_the_callback_that_held_it_up(
    executor: Executor, delays: Delays, caplog: pytest.LogCaptureFixture
) -> None:
    """Once, with how late it was and how long that took; all are counted."""
    executor.every(0.01, tick)
    for _ in range(3):
        executor.submit("topic scan", lambda: spend(0.1))
    eventually(lambda: delays.described() and delays.described()[0]["lost"] >= 10)
    eventually(lambda: caplog.records)  # the line follows the count
    lines = [record.getMessage() for record in caplog.records]
    assert len(lines) == 1
    assert lines[0].startswith("Timer of 10 ms (tick) ") and " late by " in lines[0]
    assert "callback of topic scan" in lines[0]
    assert "callback_group=..." in lines[0]
    (described,) = delays.described()
    assert (described["what"], described["by"]) == ("timer of 10 ms (tick)", "topic scan")
    assert described["took_s"] >= 0.1


def test_a_timer_that_takes_longer_than_its_period_names_itself(
    executor: Executor, caplog: pytest.LogCaptureFixture
) -> None:
    """Its own callback is the culprit."""
    executor.every(0.01, lambda: spend(0.05))
    eventually(lambda: caplog.records)
    assert ": its own callback took " in caplog.records[0].getMessage()


def test_many_short_callbacks_are_one_culprit(delays: Delays) -> None:
    """Their times are added up by their name."""
    now_s = time.monotonic()
    for at in range(10):
        delays.ran("topic scan", now_s - 0.1 + at / 100, now_s - 0.09 + at / 100)
    delays.ran("topic image", now_s - 0.2, now_s - 0.17)
    delays.late("timer of 50 ms (tick)", now_s - 0.1, 2)
    (described,) = delays.described()
    assert (described["by"], described["lost"]) == ("topic scan", 2)
    assert described["took_s"] == pytest.approx(0.01)


def test_a_busy_machine_is_no_culprit(
    executor: Executor, delays: Delays, caplog: pytest.LogCaptureFixture
) -> None:
    """Where the node's callbacks were quick, nothing is said of them."""
    delays.ran("topic scan", time.monotonic() - 0.011, time.monotonic() - 0.001)
    delays.late("timer of 50 ms (tick)", time.monotonic() - 1.0, 20)
    assert not delays.described()
    assert not caplog.records


def test_a_busy_host_is_named_instead_of_the_callback_that_waited_for_a_cpu(
    network: Network, delays: Delays, caplog: pytest.LogCaptureFixture
) -> None:
    """Once; a callback that itself took the time is the culprit nevertheless."""
    for what, waited_s in (("topic image", 0.4), ("topic cloud", 0.3), ("topic scan", 0.1)):
        now_s = time.monotonic()
        delays.ran(what, now_s - 0.45, now_s, waited_s)
        delays.late("timer of 50 ms (tick)", now_s - 0.45, 8)
        time.sleep(1.0)
    busy, scan = [record.getMessage() for record in caplog.records]
    assert busy.startswith("Timer of 50 ms (tick) ") and "late by 450 ms: this host" in busy
    assert "waited 400 ms" in busy and "callback_group" not in busy
    assert busy.count("Further ones") == 1
    assert "topic scan took 350 ms" in scan
    assert [each["by"] for each in delays.described()] == ["topic scan"]


@pytest.mark.real
def test_a_thread_that_others_leave_no_cpu_has_waited_for_it() -> None:
    """With more threads than CPUs, the system tells how long each was ready to run in vain."""
    if not scheduler.waited_for_cpu_s():
        needs.skip("a system that tells how long a thread has waited for a CPU")
    others = [
        subprocess.Popen([sys.executable, "-c", "while True: pass"])
        for _ in range(os.cpu_count() or 1)
    ]
    try:
        before_s = scheduler.waited_for_cpu_s()
        eventually(lambda: sum(range(10**6)) and scheduler.waited_for_cpu_s() - before_s > 0.01)
    finally:
        for other in others:
            other.kill()
            other.wait()


def test_a_timer_of_tfbus_is_no_culprit(
    executor: Executor, delays: Delays, caplog: pytest.LogCaptureFixture
) -> None:
    """Whoever reads the log cannot change it; its name says whose it is."""
    own = partial(spend, 0.1)
    own.__module__ = "tfbus.bus.presence"
    timer = executor.every(10.0, own)
    assert timer.what.startswith("tfbus's timer of 10 s ")
    now_s = time.monotonic()
    delays.ran(timer.what, now_s - 0.1, now_s)
    delays.late("timer of 50 ms (tick)", now_s - 0.1, 2)
    assert not delays.described()
    assert not caplog.records


def test_a_simulated_timer_is_late_in_the_time_that_passed_meanwhile(
    executor: Executor, delays: Delays
) -> None:
    """A jump of the clock alone holds nothing up."""
    clock = SimulatedClock()
    clock.set(0)
    ticked = threading.Event()
    executor.every_simulated(clock, 1.0, ticked.set)
    clock.set(10 * SECOND)
    assert ticked.wait(DEADLINE_S)
    assert not delays.described()
    ticked.clear()
    executor.submit(
        "topic scan", lambda: (clock.set(11 * SECOND), spend(0.05), clock.set(20 * SECOND))
    )
    assert ticked.wait(DEADLINE_S)
    (described,) = delays.described()
    assert (described["by"], described["lost"]) == ("topic scan", 9)


def test_a_full_queue_names_the_callback_that_runs(
    executor: Executor, delays: Delays, caplog: pytest.LogCaptureFixture
) -> None:
    """A message that is dropped is told once for each culprit, and counted."""
    entered, go_on = threading.Event(), threading.Event()
    executor.submit("topic image", lambda: (entered.set(), go_on.wait(DEADLINE_S)))
    assert entered.wait(DEADLINE_S)
    spend(0.002)
    for _ in range(3):
        executor.dropped("topic scan", 10)
    go_on.set()
    (record,) = caplog.records
    assert re.match("Topic scan dropped .*topic image took", record.getMessage())
    (described,) = delays.described()
    assert (described["what"], described["by"], described["lost"]) == (
        "topic scan",
        "topic image",
        3,
    )


def test_messages_that_come_too_fast_have_no_culprit(
    delays: Delays, caplog: pytest.LogCaptureFixture
) -> None:
    """It is the topic itself."""
    delays.dropped("topic scan", 10)
    assert "come faster" in caplog.text
    assert delays.described()[0]["by"] == "topic scan"


def test_the_pairs_are_bounded(delays: Delays) -> None:
    """Whatever a program subscribes to."""
    for number in range(1000):
        delays.dropped(f"topic {number}", 10)
    assert len(delays.described()) == 100
