"""Names of runtime/scheduler.py as a simulation has them: its clocks, threads and queues."""

from functools import partial
from typing import Any

from tfbus.testing import primitives
from tfbus.testing.event_loop import SimulatedEventLoop
from tfbus.testing.processes import Process
from tfbus.testing.tasks import Tasks


def scheduler_names(tasks: Tasks) -> dict[str, Any]:
    """All names that a simulation replaces."""

    def process() -> Process:
        return tasks.current.place  # type: ignore[return-value]

    not_a_main_thread = object()

    def main_thread() -> Any:
        main = process().main
        return not_a_main_thread if main is None else main.thread

    def sleep(seconds: float) -> None:
        tasks.wait("the end of a sleep", max(seconds, 0.0))

    return {
        "monotonic": lambda: tasks.now_ns / 1e9 + 1000.0,
        "monotonic_ns": lambda: tasks.now_ns + 1000 * 10**9,
        "time_ns": lambda: process().host.time_ns(),
        "sleep": sleep,
        "Lock": partial(primitives.Lock, tasks),
        "RLock": partial(primitives.Lock, tasks, reentrant=True),
        "Event": partial(primitives.Event, tasks),
        "Condition": partial(primitives.Condition, tasks),
        "Queue": partial(primitives.Queue, tasks),
        "SimpleQueue": partial(primitives.Queue, tasks),
        "main_thread": main_thread,
        "of_process": lambda kind: process().object_of(kind),
        "getpid": lambda: process().pid,
        "new_event_loop": lambda: SimulatedEventLoop(tasks),
        "urandom": lambda size: process().urandom(size),
    }
