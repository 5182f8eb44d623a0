"""Python's own clocks, threads and signals, as the code of a simulated process finds them.

A program under test reads `time.time()`, starts a `threading.Thread` or waits for a `queue.Queue`:
in a simulated process these are the simulation's, also if they were bound before
(`from time import sleep`).
Outside of its tasks, and for locks and programs of a module that is being imported, they stay
Python's own: matplotlib asks a program for the fonts. Locks that modules have made before are the
simulation's, too. Any other call that cannot be simulated is
refused.
`datetime.now()` tells the real time.
"""

import _thread
import asyncio
import atexit
import os
import queue
import random
import select
import selectors
import shlex
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from multiprocessing.process import BaseProcess
from typing import Any, NoReturn

import zenoh

from tfbus.testing import primitives
from tfbus.testing.bound_names import Replaced, locks_of_modules, rebind
from tfbus.testing.processes import ProcessTable
from tfbus.testing.tasks import SimulationError, Tasks, task_of


def refusals() -> Iterator[tuple[Any, str, Callable[..., NoReturn]]]:
    """The owner and name of each function that is refused, and the function that refuses it."""
    yield socket.socket, "__init__", _socket
    yield subprocess.Popen, "__init__", _program
    yield BaseProcess, "start", _fork
    for owner, names, refusal in (
        (
            os,
            ("execv", "execve", "fork", "forkpty", "posix_spawn", "posix_spawnp", "system"),
            _fork,
        ),
        (os, ("abort", "killpg"), _end),
        (signal, ("pthread_kill",), _end),
        (signal, ("alarm", "setitimer"), _alarm),
        (signal, ("pause", "sigtimedwait", "sigwait", "sigwaitinfo"), _signal_wait),
        (select, ("devpoll", "epoll", "kqueue", "poll", "select"), _file_wait),
        (selectors._BaseSelectorImpl, ("__init__",), _file_wait),
        (_thread, ("start_new_thread",), _thread_start),
        (zenoh, ("open", "scout"), _session),
    ):
        for name in names:
            if hasattr(owner, name):
                yield owner, name, refusal


def _refusing(sentence: str) -> Callable[..., NoReturn]:
    def refuse(*_: object, **__: object) -> NoReturn:
        raise SimulationError(sentence)

    return refuse


_LOOKS_INTO_FILES = ("doctor", "foxglove", "view")


def _socket(*_: object, **__: object) -> NoReturn:
    # In a program these are its own.
    command = next((word for word in sys.argv[1:] if not word.startswith("-")), "")
    if sys.modules["__main__"].__name__ == "tfbus.__main__" and command in _LOOKS_INTO_FILES:
        raise SimulationError(
            f"tfbus {command} needs sockets, which cannot be simulated: run tfbus bag record -o "
            f"run.mcap in the simulated network, and then, outside of it, tfbus {command} --bag "
            "run.mcap"
        )
    raise SimulationError(
        "a socket cannot be simulated: its other end is in real time. Use a topic or a service, or "
        "give the node an object in its place that the test makes"
    )


def _program(_: object, args: Any = "", *__: object, **___: object) -> NoReturn:
    words = args if isinstance(args, str | bytes) else shlex.join(map(os.fsdecode, args))
    raise SimulationError(
        f"program {os.fsdecode(words)!r} cannot be simulated: it runs in real time. Run its main "
        "function by network.program(host, main), or give the node its output"
    )


_fork = _refusing(
    "a process of the system cannot be simulated: it runs in real time. Run its main function "
    "by network.program(host, main)"
)

_end = _refusing(
    "a signal to threads or groups of processes cannot be simulated: it would end the test. "
    "Use os.kill(os.getpid(), number)"
)

_alarm = _refusing(
    "an alarm of the system cannot be simulated: it comes in real time, and would end the "
    "test. Use a timer of the node, or threading.Timer"
)

_signal_wait = _refusing(
    "a wait for a signal of the system cannot be simulated: it takes real time. Let "
    "node.spin() wait, or threading.Event().wait()"
)

_file_wait = _refusing(
    "a wait for files or sockets cannot be simulated: it takes real time. Use time.sleep, a topic "
    "or a service"
)

_thread_start = _refusing(
    "a thread of _thread.start_new_thread cannot be simulated: it runs in real time. Use "
    "threading.Thread"
)

_session = _refusing(
    "a session of Zenoh's own cannot be simulated: it has sockets. Use the topics and services "
    "of a node"
)


@contextmanager
def standing_in(table: ProcessTable, names: dict[str, Any]) -> Iterator[None]:
    """Until the end of the `with` Python's own names are the simulation's on threads of tasks, or
    refused; `names` are the scheduler's.
    """
    pairs: list[tuple[Any, Any]] = []
    with ExitStack() as stack:
        for owner, name, stand_in in _stand_ins(table, names):
            real = getattr(owner, name)
            pairs.append((real, stand_in))
            setattr(owner, name, stand_in)
            stack.callback(setattr, owner, name, real)
        replaced = Replaced(pairs, locks_of_modules(table.tasks))
        rebind(replaced)
        try:
            yield
        finally:
            rebind(replaced.undone())


def _stand_ins(table: ProcessTable, names: dict[str, Any]) -> Iterator[tuple[Any, str, Any]]:
    tasks = table.tasks

    def is_task() -> bool:
        return _thread.get_ident() in tasks.thread_ids

    def chosen(real: Any, simulated: Callable[..., Any]) -> Callable[..., Any]:
        return lambda *args, **named: (simulated if is_task() else real)(*args, **named)

    def made(real: Any, simulated: Callable[..., Any]) -> Callable[..., Any]:
        """As `chosen`, but a module that is imported outlives the simulation."""
        return lambda *args, **named: (simulated if is_task() and not is_importing() else real)(
            *args, **named
        )

    for name in ("monotonic", "monotonic_ns", "time_ns", "sleep"):
        yield time, name, chosen(getattr(time, name), names[name])
    yield time, "time", chosen(time.time, lambda: names["time_ns"]() / 1e9)
    for name in ("", "_ns"):
        counter = f"perf_counter{name}"
        yield time, counter, chosen(getattr(time, counter), names[f"monotonic{name}"])
    # As these modules have bound them, for their timeouts.
    for module, name in ((queue, "time"), (threading, "_time")):
        yield module, name, chosen(getattr(module, name), names["monotonic"])

    for name in ("Lock", "RLock"):
        yield threading, name, made(getattr(threading, name), names[name])
    # Conditions of Python's own wait by it: of an event that a module has made, say.
    own = threading._allocate_lock  # type: ignore[attr-defined]
    yield threading, "_allocate_lock", made(own, partial(primitives.WaiterLock, tasks))
    yield threading, "Event", _class_of(threading.Event, names["Event"], is_task)
    yield (
        threading,
        "Condition",
        _class_of(
            threading.Condition, _condition(names["Condition"], threading.Condition), is_task
        ),
    )
    yield queue, "SimpleQueue", _class_of(queue.SimpleQueue, names["SimpleQueue"], is_task)
    yield threading, "main_thread", chosen(threading.main_thread, names["main_thread"])
    threads = _Threads(tasks)
    yield threading.Thread, "start", threads.start
    yield threading.Thread, "join", threads.join
    yield threading.Thread, "is_alive", threads.is_alive
    new_event_loop = chosen(asyncio.new_event_loop, names["new_event_loop"])
    for module in (asyncio, asyncio.events):
        yield module, "new_event_loop", new_event_loop

    process = table.current_process
    yield signal, "signal", chosen(signal.signal, lambda *args: process().set_handler(*args))
    yield signal, "getsignal", chosen(signal.getsignal, lambda number: process().handler(number))
    yield (
        signal,
        "raise_signal",
        chosen(signal.raise_signal, lambda number: table.signal(process(), number)),
    )
    yield os, "urandom", chosen(os.urandom, names["urandom"])
    # A module that is imported, in the first simulation alone, draws nothing of it.
    own = random._urandom  # type: ignore[attr-defined]
    yield random, "_urandom", made(own, names["urandom"])
    yield random.Random, "seed", _seed
    yield socket, "gethostname", chosen(socket.gethostname, lambda: process().host.name)
    yield os, "getpid", chosen(os.getpid, names["getpid"])
    yield os, "kill", chosen(os.kill, table.signal_pid)
    yield os, "_exit", chosen(os._exit, table.exit_at_once)
    yield atexit, "register", chosen(atexit.register, lambda *a, **n: process().at_exit(*a, **n))
    yield atexit, "unregister", chosen(atexit.unregister, table.forget_at_exit)
    for owner, name, refusal in refusals():
        yield owner, name, made(getattr(owner, name), refusal)


def _seed(generator: random.Random, a: Any = None, version: int = 2) -> None:
    """As `Random.seed`: without a seed of its own a generator has one of `random._urandom`."""
    drawn = random._urandom(16) if a is None else a  # type: ignore[attr-defined]
    _real_seed(generator, drawn, version)


_real_seed = random.Random.seed


@contextmanager
def random_numbers_of(seed: int) -> Iterator[None]:
    """Until the end of the `with` the generator of `random` has this seed, and numpy's."""
    import numpy.random as arrays  # slow: only where there is a network

    former, former_arrays = random.getstate(), arrays.get_state()
    random.seed(seed)
    arrays.seed(seed % 2**32)
    try:
        yield
    finally:
        random.setstate(former)
        arrays.set_state(former_arrays)


def is_importing() -> bool:
    """Whether a module is imported on this thread."""
    frame = sys._getframe(1)
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back  # type: ignore[assignment]
    return False


def _class_of(real: Any, simulated: Callable[..., Any], is_task: Callable[[], bool]) -> Any:
    """A class in the place of one of Python's: programs may inherit from it, or ask for it."""

    class Chosen(type):
        def __call__(cls, *args: Any, **named: Any) -> Any:
            if cls is not stand_in:
                return super().__call__(*args, **named)
            is_simulated = is_task() and not is_importing()
            return (simulated if is_simulated else real)(*args, **named)

        def __instancecheck__(cls, instance: Any) -> bool:
            is_ours = isinstance(instance, (real, getattr(simulated, "func", real)))
            return is_ours if cls is stand_in else super().__instancecheck__(instance)

    stand_in = Chosen(real.__name__, (real,), {})
    return stand_in


def _condition(simulated: Callable[..., Any], real: Callable[..., Any]) -> Callable[..., Any]:
    def condition(lock: Any = None) -> Any:
        is_ours = lock is None or isinstance(lock, primitives.Lock)
        return (simulated if is_ours else real)(lock)

    return condition


class _Threads:
    """Threads of Python's own that tasks start: each is a task."""

    def __init__(self, tasks: Tasks) -> None:
        real = threading.Thread
        real_start, real_join, real_is_alive = real.start, real.join, real.is_alive

        def start(thread: threading.Thread) -> None:
            if _thread.get_ident() not in tasks.thread_ids:
                real_start(thread)
                return
            if thread._started.is_set():  # type: ignore[attr-defined]
                raise RuntimeError("threads can only be started once")
            # Before the task is there: others may have their turns here, but it must not have its
            # first one until it is known as this thread, and as the main thread of its process.
            thread._started.set()  # type: ignore[attr-defined]
            threading._limbo[thread] = thread  # type: ignore[attr-defined]
            task = tasks.start(thread.name, tasks.current.place, lambda: _run(thread))
            task.thread = thread
            thread._simulated_task = task  # type: ignore[attr-defined]

        def join(thread: threading.Thread, timeout: float | None = None) -> None:
            task = task_of(thread)
            if task is None:
                real_join(thread, timeout)
            elif not task.is_over:
                tasks.join(task, timeout)

        def is_alive(thread: threading.Thread) -> bool:
            task = task_of(thread)
            return real_is_alive(thread) if task is None else not task.is_over

        self.start, self.join, self.is_alive = start, join, is_alive


def _run(thread: threading.Thread) -> None:
    """The body of a thread, which `threading.current_thread()` gives within."""
    thread._ident = _thread.get_ident()  # type: ignore[attr-defined]
    threading._active[thread._ident] = thread  # type: ignore[attr-defined]
    threading._limbo.pop(thread, None)  # type: ignore[attr-defined]
    try:
        with suppress(SystemExit):
            thread.run()
    finally:
        # Who joins it after the simulation is not to wait.
        if hasattr(thread, "_handle"):
            thread._handle._set_done()
        else:
            thread._is_stopped = True  # type: ignore[attr-defined]
