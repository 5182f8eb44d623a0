"""Python's own clocks, waits and event loops, as the code of a simulated process finds them.

`time.time()`, `time.sleep`, `asyncio.run`, `threading.Event` and `queue.Queue` are virtual there,
also where a module has `from time import sleep`. What cannot be simulated is refused (refused.py).
`datetime.now()` is not replaced, and tells the real time.
"""

import _thread
import asyncio
import os
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import Any

from tfbus.testing.primitives import Waiting
from tfbus.testing.refused import refusals
from tfbus.testing.tasks import Tasks

# Modules that measure or wait in real time, whoever is running.
_REAL = frozenset(sys.stdlib_module_names) | {
    "_pytest",
    "execnet",
    "hypothesis",
    "pluggy",
    "pytest",
    "tfbus",
    "xdist",
    "zenoh",
}


@contextmanager
def standing_in(tasks: Tasks, names: dict[str, Any]) -> Iterator[None]:
    """Until the end of the `with` Python's functions are virtual, or refused, on tasks' threads."""
    is_in_force = True

    def is_simulated() -> bool:
        return is_in_force and _thread.get_ident() in tasks.thread_ids

    def chosen(virtual: Callable[..., Any], real: Callable[..., Any]) -> Callable[..., Any]:
        return lambda *args, **named: (virtual if is_simulated() else real)(*args, **named)

    replaced: dict[int, tuple[Any, Any]] = {}
    with ExitStack() as stack:
        for owner, name, virtual in _replacements(tasks, names):
            real = getattr(owner, name)
            wrapper = chosen(virtual, real)
            replaced[id(real)] = real, wrapper
            setattr(owner, name, wrapper)
            stack.callback(setattr, owner, name, real)
        _rebind(replaced)
        try:
            yield
        finally:
            is_in_force = False
            _rebind({id(wrapper): (wrapper, real) for real, wrapper in replaced.values()})


def _replacements(
    tasks: Tasks, names: dict[str, Any]
) -> Iterator[tuple[Any, str, Callable[..., Any]]]:
    """The owner and name of each function, and its replacement."""
    virtual: dict[str, Callable[..., Any]] = {
        name: names[name] for name in ("monotonic", "monotonic_ns", "time_ns", "sleep")
    }
    virtual["time"] = lambda: names["time_ns"]() / 1e9
    virtual["perf_counter"] = names["monotonic"]
    virtual["perf_counter_ns"] = names["monotonic_ns"]
    for name, function in virtual.items():
        yield time, name, function
    for module in (asyncio, asyncio.events):
        yield module, "new_event_loop", names["new_event_loop"]
    yield socket, "gethostname", lambda: tasks.current.place.host.name  # type: ignore[attr-defined]
    yield os, "getpid", names["getpid"]
    yield threading.Condition, "wait", partial(_wait, tasks)
    yield from refusals()


def _wait(tasks: Tasks, condition: Any, timeout: float | None = None) -> bool:
    """Wait as `Condition.wait`, on which Python's events, queues and semaphores are built."""
    if not condition._is_owned():
        raise RuntimeError("cannot wait on un-acquired lock")
    waiting = _Waiter(tasks)
    condition._waiters.append(waiting)
    saved = condition._release_save()
    was_woken = False
    try:
        was_woken = waiting.wait("a condition of Python's", timeout)
    finally:
        condition._acquire_restore(saved)
        if not was_woken and waiting in condition._waiters:
            condition._waiters.remove(waiting)
    return was_woken


class _Waiter(Waiting):
    """A task that waits for a condition; `notify` releases it as it does a lock."""

    release = Waiting.wake_all


def _rebind(replaced: dict[int, tuple[Any, Any]]) -> None:
    """Replace functions in modules that have bound them, as `from time import sleep` does."""
    for module in list(sys.modules.values()):
        name = getattr(module, "__name__", "")
        if not isinstance(name, str) or name.partition(".")[0] in _REAL:
            continue
        for attribute, value in list(getattr(module, "__dict__", {}).items()):
            if id(value) in replaced:
                setattr(module, attribute, replaced[id(value)][1])
