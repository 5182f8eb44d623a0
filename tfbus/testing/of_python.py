"""Python's own clocks and threads, as the code of a simulated process finds them.

A program under test reads `time.time()` or sleeps by `time.sleep`: in a simulated process these are
virtual. A thread of its own cannot be simulated, and is refused.
"""

import _thread
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from tfbus.testing.tasks import SimulationError, Tasks


@contextmanager
def standing_in(tasks: Tasks, names: dict[str, Any]) -> Iterator[None]:
    """Until the end of the `with` the functions of `time` are virtual on the threads of tasks."""
    virtual: dict[str, Callable[..., Any]] = {
        name: names[name] for name in ("monotonic", "monotonic_ns", "time_ns", "sleep")
    }
    virtual["time"] = lambda: names["time_ns"]() / 1e9
    real = {name: getattr(time, name) for name in virtual}
    real_start = threading.Thread.start

    def chosen(name: str) -> Callable[..., Any]:
        return lambda *args: (
            virtual[name](*args) if _thread.get_ident() in tasks.thread_ids else real[name](*args)
        )

    def start(self: threading.Thread) -> None:
        if _thread.get_ident() in tasks.thread_ids:
            raise SimulationError(
                f"thread {self.name!r} cannot be simulated: its turns are not the simulation's. "
                "Use a timer or a callback group of the node in its place"
            )
        real_start(self)

    for name in virtual:
        setattr(time, name, chosen(name))
    threading.Thread.start = start  # type: ignore[method-assign]
    try:
        yield
    finally:
        for name, function in real.items():
            setattr(time, name, function)
        threading.Thread.start = real_start  # type: ignore[method-assign]
