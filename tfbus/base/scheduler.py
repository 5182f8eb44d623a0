"""Time, threads and waiting: all of tfbus takes them from here, so that a simulation can stand in.

Use the names through the module, `scheduler.Lock()`, and never bind them at import: a simulation
replaces them while it runs (`replaced_by`). Outside of one they are Python's own, at no cost.
"""

import os
import queue
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    import asyncio

T = TypeVar("T")

# The readings of clocks.
monotonic = time.monotonic
monotonic_ns = time.monotonic_ns
time_ns = time.time_ns
sleep = time.sleep

# On Linux and macOS `time.monotonic` stands still while the system is suspended.
_BOOT_CLOCK = getattr(time, "CLOCK_BOOTTIME", getattr(time, "CLOCK_MONOTONIC", None))


def boot_time() -> float:
    """A clock that never goes back, in s, and goes on while the system is suspended."""
    return time.monotonic() if _BOOT_CLOCK is None else time.clock_gettime(_BOOT_CLOCK)


# Threads, and their locks and events.
Condition = threading.Condition
Event = threading.Event
Lock = threading.Lock
RLock = threading.RLock
SimpleQueue = queue.SimpleQueue
Queue = queue.Queue
Thread = threading.Thread
Timer = threading.Timer
current_thread = threading.current_thread
main_thread = threading.main_thread
Empty = queue.Empty
Full = queue.Full
TIMEOUT_MAX = threading.TIMEOUT_MAX


def new_event_loop() -> "asyncio.AbstractEventLoop":
    """An event loop of asyncio's, for one thread."""
    import asyncio  # slow to import, and most processes do not need it

    return asyncio.new_event_loop()


def waited_for_cpu_s() -> float:
    """For how long this thread has been ready to run in all while others had the CPUs, in s.

    0.0 if the system does not tell, and in a simulation, in which computing takes no time.
    """
    return 0.0 if is_simulated else _waited_s("/proc/thread-self/schedstat")


def _waited_s(of_thread: str) -> float:
    try:
        with open(of_thread, "rb") as file:
            return int(file.read().split()[1]) / 1e9
    except (OSError, IndexError, ValueError):
        return 0.0


def longest_wait_for_cpu_s() -> float:
    """As `waited_for_cpu_s`, of the thread of this process that has waited the longest."""
    waits_s = [0.0]
    try:
        for thread in os.listdir("/proc/self/task"):
            waits_s.append(_waited_s(f"/proc/self/task/{thread}/schedstat"))
    except OSError:
        pass
    return 0.0 if is_simulated else max(waits_s)


# These differ from process to process.
getpid = os.getpid
urandom = os.urandom

_of_process: dict[type, Any] = {}


def of_process(kind: type[T]) -> T:
    """The one object of this class that the process has, made the first time."""
    found: T | None = _of_process.get(kind)
    return _of_process.setdefault(kind, kind()) if found is None else found


# Whether a simulation stands in for all of these.
is_simulated = False


@contextmanager
def replaced_by(names: dict[str, Any]) -> Iterator[None]:
    """Until the end of the `with`, these names of this module are a simulation's."""
    ours = globals()
    former = {name: ours[name] for name in names}
    ours.update(names, is_simulated=True)
    try:
        yield
    finally:
        ours.update(former, is_simulated=False)
