"""The callbacks of a node that are ready to run, for the executor that spins it."""

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from tfbus.compat.rclpy.task import Task
from tfbus.runtime.callback_groups import CallbackGroup
from tfbus.runtime.delays import SLOW_S, Delays, Ran
from tfbus.runtime.signals import Wakeup


class Job(NamedTuple):
    """A callback, its group, and its name in the log; "" for one that is part of another."""

    callback: Callable[[], object]
    group: CallbackGroup | None = None
    what: str = ""


class Work:
    """The callbacks of a node that are ready to run, in the order in which they became so.

    Callbacks of a mutually exclusive group become ready one after the other; a coroutine holds its
    group until it ends, as in ROS.
    """

    def __init__(self, delays: Delays | None = None) -> None:
        # How many messages of transforms each listener of the node has received, and how many each
        # had when that was asked last.
        self.listeners: list[Callable[[], int]] = []
        self._heard: dict[Callable[[], int], int] = {}
        self._delays = delays
        # Changed by single operations, which threads and signal handlers may mix.
        self._ready: deque[Job] = deque()
        self._wakes: dict[int, Callable[[], None]] = {}
        self._running: dict[int, tuple[str, float]] = {}

    def submit(
        self, callback: Callable[[], object], group: CallbackGroup | None = None, what: str = ""
    ) -> None:
        """Run `callback()` in a thread that spins the node; a coroutine that it returns is run to
        its end.
        """
        job = Job(callback, group, what)
        self._add(job if group is None else group.admission.enter(job))

    def take(self) -> Job | None:
        """The next callback, if one is ready; then `run` it."""
        try:
            return self._ready.popleft()
        except IndexError:
            return None

    def run(self, job: Job) -> None:
        """Run a callback that was taken. Raises what it raises."""
        thread, began_s = threading.get_ident(), time.monotonic()
        if job.what:
            self._running[thread] = job.what, began_s
        awaits = False
        try:
            answer = job.callback()
            if hasattr(answer, "send"):
                task = Task(answer, self.submit)
                task.when_ended(lambda: self._leave(job))
                awaits = True
                task.step()
        finally:
            self._running.pop(thread, None)
            self._note(job.what, began_s)
            if not awaits:
                self._leave(job)

    def has_heard(self) -> bool:
        """Whether transforms have come since the last call."""
        before, self._heard = self._heard, {count: count() for count in [*self.listeners]}
        return any(heard != before.get(count, 0) for count, heard in self._heard.items())

    def wake_by(self, wakeup: Wakeup) -> None:
        """Wake it at each submit, until `no_longer_wake`."""
        self._wakes[id(wakeup)] = wakeup.wake

    def no_longer_wake(self, wakeup: Wakeup) -> None:
        """Take it back."""
        self._wakes.pop(id(wakeup), None)

    def late(self, what: str, since_s: float, ticks: int) -> None:
        """Note that a timer lost so many ticks, as others ran since its tick was due."""
        if self._delays is not None:
            self._delays.late(what, since_s, ticks, self._others())

    def dropped(self, what: str, pending: int) -> None:
        """Note that a topic dropped a message, as so many wait already."""
        if self._delays is not None:
            self._delays.dropped(what, pending, self._others())

    def _add(self, job: Job | None) -> None:
        if job is not None:
            self._ready.append(job)
            for wake in list(self._wakes.values()):
                wake()

    def _leave(self, job: Job) -> None:
        if job.group is not None:
            self._add(job.group.admission.leave())

    def _note(self, what: str, began_s: float) -> None:
        now_s = time.monotonic()
        if self._delays is not None and what and now_s - began_s >= SLOW_S:
            self._delays.ran(what, began_s, now_s)

    def _others(self) -> list[Ran]:
        here, now_s = threading.get_ident(), time.monotonic()
        running = list(self._running.items())
        return [Ran(what, began, now_s) for thread, (what, began) in running if thread != here]
