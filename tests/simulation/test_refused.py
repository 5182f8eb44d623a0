"""A node's own uses of Python: virtual in a simulated process, or refused with a sentence."""

import _thread
import asyncio
import multiprocessing
import os
import queue
import random
import sched
import secrets
import select
import selectors
import signal
import socket
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from time import perf_counter, sleep
from types import ModuleType
from typing import Any

import numpy
import pytest
import zenoh

from tfbus.testing import Network, SimulationError, tasks

REFUSED: dict[str, tuple[Callable[[], object], str]] = {
    "socket": (socket.socket, "a socket .* Use a topic"),
    "connection": (lambda: socket.create_connection(("127.0.0.1", 9)), "a socket .* Use a topic"),
    "program": (lambda: subprocess.run(["ls", "-l"]), "program 'ls -l' .* network.program"),
    "shell": (lambda: subprocess.run("ls -l", shell=True), "program 'ls -l' .* network.program"),
    "system": (lambda: os.system("true"), "a process of the system .* network.program"),
    "fork": (lambda: os.fork(), "a process of the system .* network.program"),
    "multiprocessing": (
        lambda: multiprocessing.Process(target=print).start(),
        "a process of the system .* network.program",
    ),
    "exec": (lambda: os.execvp("true", ["true"]), "a process of the system .* network.program"),
    "abort": (lambda: os.abort(), "would end the test. Use os.kill"),
    "process group": (lambda: os.killpg(os.getpgrp(), 15), "would end the test. Use os.kill"),
    "signal to a thread": (
        lambda: signal.pthread_kill(threading.get_ident(), 15),
        "would end the test. Use os.kill",
    ),
    "alarm": (lambda: signal.alarm(1), "an alarm .* threading.Timer"),
    "interval timer": (
        lambda: signal.setitimer(signal.ITIMER_REAL, 1.0),
        "an alarm .* threading.Timer",
    ),
    "pause": (lambda: signal.pause(), "a wait for a signal .* node.spin"),
    "sigwait": (lambda: signal.sigwait([15]), "a wait for a signal .* node.spin"),
    "select": (lambda: select.select([], [], [], 1.0), "a wait for files .* time.sleep"),
    "poll": (lambda: select.poll().poll(1000), "a wait for files .* time.sleep"),
    "selectors": (
        lambda: selectors.DefaultSelector().select(1.0),
        "a wait for files .* time.sleep",
    ),
    "a bound system": (lambda: _system(), "a process of the system .* network.program"),
    "bare thread": (
        lambda: _thread.start_new_thread(print, ()),
        "a thread of _thread.start_new_thread .* threading.Thread",
    ),
    "zenoh": (lambda: zenoh.open(zenoh.Config()), "a session of Zenoh's own .* topics"),
    "asyncio's programs": (
        lambda: asyncio.run(asyncio.create_subprocess_exec("ls")),
        "subprocess of asyncio .* a topic",
    ),
    "asyncio's files": (
        lambda: asyncio.new_event_loop().add_reader(0, print),
        "add_reader of asyncio .* a topic",
    ),
    "scouting": (lambda: zenoh.scout(print), "a session of Zenoh's own .* topics"),
}


@pytest.mark.parametrize(("use", "sentence"), REFUSED.values(), ids=REFUSED)
def test_it_is_refused_with_a_sentence(
    network: Network, use: Callable[[], object], sentence: str
) -> None:
    """The error says what cannot be simulated, why, and what to do."""
    network.start(network.host("robot"), "node", use)
    with pytest.raises(SimulationError, match=sentence):
        network.run(1.0)


def test_a_module_may_run_a_program_while_it_is_imported(
    network: Network, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As matplotlib does where no list of fonts is cached yet, beside a timer."""
    (tmp_path / "lists_fonts.py").write_text(
        "import subprocess, threading\n"
        "timer = threading.Timer(60, print)\n"
        "timer.start()\n"
        "FONTS = subprocess.check_output(['echo', 'serif'], text=True)\n"
        "timer.cancel()\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    found: list[str] = []

    def use() -> None:
        import lists_fonts

        found.append(lists_fonts.FONTS)

    network.start(network.host("robot"), "node", use)
    network.run(1.0)
    assert found == ["serif\n"]


def _take_turns() -> None:
    """A queue and an event between two threads."""
    work: queue.Queue[int] = queue.Queue()
    done = threading.Event()

    def serve() -> None:
        work.get()
        sleep(2.0)
        done.set()

    threading.Thread(target=serve).start()
    work.put(1)
    assert not done.wait(1.0)
    assert done.wait(5.0)


def _use_executor() -> None:
    with ThreadPoolExecutor(2) as executor:
        list(executor.map(sleep, [2.0, 1.0]))


def _use_timer() -> None:
    timer = threading.Timer(2.0, print)
    timer.start()
    timer.join()
    assert not timer.is_alive()


def _sleep_asyncio() -> None:
    async def both() -> None:
        await asyncio.gather(asyncio.sleep(2.0), asyncio.sleep(1.0))

    asyncio.run(both())


def _turn_a_loop() -> None:
    loop = asyncio.new_event_loop()
    loop.run_until_complete(asyncio.sleep(2.0))
    loop.close()


# Made and bound as modules do it, before any simulation.
_GO = threading.Event()
_WORK: queue.Queue[int] = queue.Queue()
_LOCK, _AGAIN = threading.Lock(), threading.RLock()
_GATE = threading.Lock()
_GATE.acquire()
_CHANGED = threading.Condition(_LOCK)
_FLAG = threading.Condition()
_NAPS = {"long": time.sleep}
_nap = partial(time.sleep, 1.0)
_system = partial(os.system, "true")


class _OwnCondition(threading.Condition):
    """A class of the user's own."""


class _Arm:
    rest = partial(time.sleep, 1.0)

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.nap = time.sleep


_ARM = _Arm()


@dataclass
class _Sighting:
    at_s: float = field(default_factory=perf_counter)


class _Robot:
    nap = staticmethod(time.sleep)

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.clock = clock


def _wait_for_an_event_of_the_module() -> None:
    _GO.clear()
    threading.Thread(target=lambda: [sleep(2.0), _GO.set()]).start()
    assert not _GO.wait(1.0)
    assert _GO.wait()


def _wait_for_a_queue_of_the_module() -> None:
    threading.Thread(target=lambda: [sleep(2.0), _WORK.put(1)]).start()
    with pytest.raises(queue.Empty):
        _WORK.get(timeout=1.0)
    assert _WORK.get() == 1


def _wait_for_a_derived_condition() -> None:
    condition = _OwnCondition()
    with condition:
        assert not condition.wait(2.0)


def _use_bound_names() -> None:
    robot, begun_s = _Robot(), _Sighting().at_s
    began_s = robot.clock()
    robot.nap(2.0)
    assert robot.clock() - began_s == pytest.approx(2.0, abs=0.01)
    assert _Sighting().at_s - begun_s == pytest.approx(2.0, abs=0.01)


def _hold(lock: Any, seconds: float) -> None:
    """Another thread waits for a lock of a module as long as this one holds it."""

    def wait() -> None:
        assert not lock.acquire(timeout=0.5 * seconds)
        assert not lock.acquire(blocking=False)
        with lock:
            pass

    with lock:
        waiting = threading.Thread(target=wait)
        waiting.start()
        sleep(seconds)
    waiting.join()


def _pass_a_gate() -> None:
    threading.Thread(target=lambda: [sleep(2.0), _GATE.release()]).start()
    assert _GATE.locked()
    _GATE.acquire()


def _contend_for_a_condition(condition: threading.Condition, lock: Any) -> None:
    def change() -> None:
        with lock:
            sleep(1.0)
            condition.notify_all()

    threading.Thread(target=change).start()
    with condition:
        assert condition.wait()
        assert not condition.wait(1.0)


def _use_bound_naps(nap: Callable[[], object] = _nap) -> None:
    nap()
    _Arm.rest()


def _schedule() -> None:
    plan = sched.scheduler()
    plan.enter(2.0, 1, int)
    plan.run()


async def _until_a_signal() -> None:
    ended = asyncio.Event()
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, ended.set)
    threading.Thread(target=lambda: [sleep(2.0), os.kill(os.getpid(), signal.SIGTERM)]).start()
    await ended.wait()


VIRTUAL: dict[str, Callable[[], object]] = {
    "time.sleep": lambda: time.sleep(2.0),
    "sleep": lambda: sleep(2.0),
    "asyncio.run": _sleep_asyncio,
    "asyncio.new_event_loop": _turn_a_loop,
    "to_thread": lambda: asyncio.run(asyncio.to_thread(sleep, 2.0)),
    "threads": _take_turns,
    "executor": _use_executor,
    "timer": _use_timer,
    "an event of a module": _wait_for_an_event_of_the_module,
    "a queue of a module": _wait_for_a_queue_of_the_module,
    "a derived condition": _wait_for_a_derived_condition,
    "bound names": _use_bound_names,
    "a bound partial": _use_bound_naps,
    "a name in a dict": lambda: _NAPS["long"](2.0),
    "a name in an object": lambda: _ARM.nap(2.0),
    "a lock of a module": lambda: _hold(_LOCK, 2.0),
    "a reentrant lock of a module": lambda: _hold(_AGAIN, 2.0),
    "a lock of an object": lambda: _hold(_ARM.lock, 2.0),
    "a lock that a module has taken": _pass_a_gate,
    "a condition of a module": lambda: _contend_for_a_condition(_FLAG, _FLAG),
    "a condition by a lock of a module": lambda: _contend_for_a_condition(_CHANGED, _LOCK),
    "sched": _schedule,
    "a signal in asyncio": lambda: asyncio.run(_until_a_signal()),
}


@pytest.mark.parametrize("wait", VIRTUAL.values(), ids=VIRTUAL)
def test_a_wait_takes_virtual_time(network: Network, wait: Callable[[], object]) -> None:
    """Two seconds pass in the network, by all of its clocks."""
    begun_s = perf_counter()
    process = network.start(network.host("robot"), "node", wait)
    assert network.run(until=lambda: process.is_dead) == pytest.approx(2.0, abs=0.01)
    assert perf_counter() - begun_s == pytest.approx(2.0, abs=0.01)


def test_all_is_real_again_after_the_network() -> None:
    """All that a simulation replaces is Python's own before and after it."""

    def names() -> tuple[object, ...]:
        bound = sleep, _Robot.nap, _Robot.__init__.__defaults__, random.getstate(), _nap.func
        locks = _LOCK, _AGAIN, _ARM.lock, _CHANGED._lock, _FLAG._lock  # type: ignore[attr-defined]
        return *bound, *locks, time.time, asyncio.new_event_loop, threading.Thread.start, os.fork

    before = names()
    with Network():
        assert not {id(each) for each in before} & {id(each) for each in names()}
    assert names() == before
    thread = threading.Thread(target=print)
    thread.start()
    thread.join()
    with _FLAG:
        assert not _FLAG.wait(0.0)


def _draw() -> list[object]:
    return [random.random(), random.Random().random(), secrets.token_hex(), uuid.uuid4()]


class _Importing(ModuleType):
    """A module that imports another once it is looked at, and has one that is missing."""

    def __getattribute__(self, name: str) -> object:
        sys.modules.setdefault("_imported_meanwhile", ModuleType("_imported_meanwhile"))
        return super().__getattribute__(name)


class _Missing:
    """Stands for a package that is missing."""

    def __getattribute__(self, name: str) -> object:
        raise ModuleNotFoundError(name)


def test_modules_may_be_odd(monkeypatch: pytest.MonkeyPatch) -> None:
    """They import others while they are looked at, or hold names that raise if they are used."""
    importing = _Importing("_importing")
    vars(importing)["missing"] = _Missing()
    monkeypatch.setitem(sys.modules, "_importing", importing)
    try:
        for _ in range(2):
            with Network():
                pass
    finally:
        del sys.modules["_imported_meanwhile"]


def test_random_numbers_are_of_the_seed() -> None:
    """Two runs of a seed draw the same, and another seed others."""
    drawn = []
    for seed in (1, 1, 2):
        with Network(seed) as network, network.process(network.host("robot"), "node"):
            generator = numpy.random.default_rng()
            drawn.append([*_draw(), numpy.random.random(), generator.random()])
    first, second, other = drawn
    assert first == second
    assert not [one for one, two in zip(first, other, strict=True) if one == two]


def _release_on_another_thread(lock: Any) -> None:
    with lock, ThreadPoolExecutor(1) as executor:
        executor.submit(lock.release).result()


@pytest.mark.parametrize(
    "mistake",
    [
        lambda: threading.Condition().wait(1.0),
        lambda: threading.Condition().notify(),
        lambda: threading.Condition().notify_all(),
        lambda: threading.Lock().release(),
        lambda: _release_on_another_thread(threading.RLock()),
    ],
)
def test_a_mistake_with_a_lock_is_one_here_too(
    network: Network, mistake: Callable[[], object]
) -> None:
    """A node that Python refuses is no better in a simulation."""
    network.start(network.host("robot"), "node", mistake)
    with pytest.raises(RuntimeError, match="lock"):
        network.run(1.0)


def test_a_wait_for_something_real_is_named(
    network: Network, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A lock of Python's that nobody releases does not stop the test for ever."""
    monkeypatch.setattr(tasks, "_STUCK_AFTER_S", 0.2)
    lock = _thread.allocate_lock()
    lock.acquire()
    network.start(network.host("robot"), "node", lock.acquire)
    with pytest.raises(SimulationError, match="such as a lock"):
        network.run(1.0)
    lock.release()


def test_a_test_that_waits_without_end_is_ended(network: Network) -> None:
    """As one that calls a node's main function where it has to be given."""
    network.start(network.host("robot"), "beats", partial(_beat, 60.0))
    with pytest.raises(SimulationError, match="waited for a day of this time: is there a call"):
        threading.Event().wait()


def _beat(period_s: float) -> None:
    while True:
        time.sleep(period_s)


def test_an_error_names_the_seed_of_its_network() -> None:
    """One seed of many can be repeated so; and an error names a host that is no process."""
    with (
        pytest.raises(SimulationError, match=r"'robot' is a host, .* processes: robot/a") as caught,
        Network(7) as network,
        network.process(network.host("robot"), "a") as process,
    ):
        network.kill(process.host)  # type: ignore[arg-type]
    assert caught.value.__notes__ == ["again: Network(seed=7)"]
