"""The CPU that a job takes in a process that does it a second time."""

import gc
import time
from collections.abc import Callable

from benchmarks.bus.place import say


def say_cost(job: Callable[[], object], warm: Callable[[], object] | None = None) -> None:
    """Say the CPU seconds of the job, after another like it that makes all imports."""
    (warm or job)()
    say(cpu_s(job))


def cpu_s(job: Callable[[], object]) -> float:
    """The CPU seconds of a job, of all threads of this process, and of the system for it."""
    gc.collect()
    began = time.process_time()
    job()
    return time.process_time() - began
