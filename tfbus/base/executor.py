"""Executors: threads that run callbacks, one at a time unless a group says otherwise."""

import heapq
import itertools
import logging
import sys
from collections import deque
from collections.abc import Callable, Coroutine
from functools import partial
from typing import TYPE_CHECKING, Any

from tfbus.base import scheduler
from tfbus.base.callbacks import (
    SLOW_S,
    CallbackGroup,
    Delays,
    ExecutorEnd,
    Failures,
    Given,
    Ran,
    here,
)
from tfbus.base.clock import Bell, SimulatedClock, Timer
from tfbus.base.errors import TfbusError
from tfbus.base.lazy_exports import imported
from tfbus.base.wording import counted

if TYPE_CHECKING:
    from tfbus.base.event_loop import EventLoop  # asyncio takes long to load

# A callback; a coroutine that it returns is run, too.
Callback = Callable[[], Any]

# A callback's name in the log, itself, and its group.
_Task = tuple[str, Callback, CallbackGroup | None]

# The end of a node waits at most this long for a callback.
_LAST_CALLBACK_S = 2.0

# So often at most, beside slow callbacks, a thread reads how long it has waited for a CPU: to read
# it takes longer than most callbacks do.
_READ_WAIT_EVERY_S = 0.25


class _Worker:
    """A thread: the name of its callback, "" while it waits, and since when it runs."""

    __slots__ = ("began_s", "bell", "read_s", "ring", "thread", "waited_s", "what")

    def __init__(self) -> None:
        self.what = ""
        self.began_s = 0.0
        self.bell = Bell()
        self.ring = self.bell.ring
        self.thread = scheduler.current_thread()
        # For how long it had waited for a CPU in all, when that was last read.
        self.waited_s, self.read_s = scheduler.waited_for_cpu_s(), scheduler.monotonic()

    def wait_since_read_s(self, now_s: float) -> float:
        """For how long the thread has waited for a CPU since the last call."""
        before_s, self.waited_s = self.waited_s, scheduler.waited_for_cpu_s()
        self.read_s = now_s
        return self.waited_s - before_s


def _failures() -> tuple[type[BaseException], ...]:
    """The errors of a callback; of the last two the thread would end without a word."""
    asyncio = sys.modules.get("asyncio")  # which few callbacks need
    cancelled = () if asyncio is None else (asyncio.CancelledError,)
    return (Exception, SystemExit, *cancelled)


# Of fewer timers the cancelled ones stay until they are due.
_LEAST_DUE = 64


class Executor:
    """Runs callbacks in the order of their submission; a timer is submitted when it is due.

    On one thread or, with `threads`, on at most so many, callbacks of one group as the group says.
    Each thread starts when it is first needed. Exceptions of a callback are counted; the first,
    tenth, hundredth ... is logged with its traceback, and the thread continues.

    A coroutine that a callback returns runs on an event loop between the callbacks: only an `await`
    lets others run. An executor of several threads leaves coroutines to `home`, one of one thread.
    """

    def __init__(
        self,
        name: str,
        log: logging.Logger,
        *,
        threads: int = 1,
        home: "Executor | None" = None,
        delays: Delays | None = None,
        failures: Failures | None = None,
    ):
        self._name = name
        self._log = log
        self._most_threads = threads
        self._home = home or self
        self.delays = delays
        # It may be entered again by a signal handler in the middle of a call.
        self._lock = scheduler.RLock()
        self._ready: deque[_Task] = deque()
        self._due: list[tuple[float, int, Timer]] = []
        self._most_due = _LEAST_DUE  # of this many timers the cancelled ones are taken out
        self._order = itertools.count()
        self._threads: list[scheduler.Thread] = []
        self._workers: list[_Worker] = []
        # Workers that wait for a task; one of them wakes for the next timer.
        self._asleep: list[_Worker] = []
        self._timekeeper: _Worker | None = None
        self._loop: EventLoop | None = None
        self._closing = ExecutorEnd()
        self._closed = False
        # The names of the streams that the node sends, from this executor's callbacks or others.
        self.streams: set[str] = set()
        self._failures = failures or Failures()

    def submit(
        self,
        what: str,
        callback: Callable[[*Given], Any],
        *given: *Given,
        limit: int | None = None,
        group: CallbackGroup | None = None,
    ) -> bool:
        """Run `callback(*given)` after the ones submitted before; `what` names it in the log.

        False if `limit` callbacks of this name wait already, or await something: then it does
        not run.
        """
        with self._lock:
            if limit is not None and self._count_waiting(what, group) >= limit:
                return False
            if not self._closed:
                self._enqueue((what, partial(callback, *given) if given else callback, group))
                self._wake()
            return True

    def every(
        self, period_s: float, callback: Callback, *, group: CallbackGroup | None = None
    ) -> Timer:
        """Run `callback` every `period_s` seconds, the first time after one period."""
        return self._start(Timer(period_s, callback, group=group))

    def every_simulated(
        self,
        clock: SimulatedClock,
        period_s: float,
        callback: Callback,
        *,
        group: CallbackGroup | None = None,
    ) -> Timer:
        """Run `callback` every `period_s` seconds of a simulated clock, as `every` does."""
        timer = Timer(period_s, callback, group=group)
        self._set_alarm(clock, clock.elapsed_ns() + timer.period_ns, timer)
        return timer

    def after(self, delay_s: float, callback: Callable[[*Given], Any], *given: *Given) -> Timer:
        """Run `callback(*given)` once, `delay_s` seconds from now."""
        return self._start(Timer(delay_s, callback, *given, once=True))

    def dropped(self, what: str, pending: int) -> None:
        """Note that a topic of this name dropped a message, as so many wait already."""
        if self.delays is not None:
            self.delays.dropped(what, pending, self._running())

    def waiting(self) -> tuple[int, int]:
        """How many callbacks wait for a thread, and how many timers for their time."""
        with self._lock:
            return len(self._ready), len(self._due)

    def overdue(self) -> list[tuple[str, int, Ran]]:
        """Timers that leave out ticks now, how many, and the callback that has not returned."""
        with self._lock:
            running, now_s = self._running()[:1], scheduler.monotonic()
            return [
                (timer.what, int((now_s - when_s) / timer.period_s), ran)
                for when_s, _, timer in self._due
                for ran in running
                if not timer.once and now_s - when_s >= timer.period_s
            ]

    def _held_up(self, stream: str) -> str:
        """In a callback: the name of another one that is due and waits for this one to return,
        if this node sends the stream; "" if none waits.
        """
        with self._lock:
            if self._most_threads > 1 or stream not in self.streams:
                return ""
            now_s = scheduler.monotonic()
            due = [entry for entry in self._due if entry[0] <= now_s and not entry[2].once]
            if due:
                return min(due)[2].what
            ready = (what for what, callback, _ in self._ready if not self._is_once(callback))
            return next(ready, "")

    def _is_once(self, callback: Callback) -> bool:
        """Whether it is the only tick of a timer: such ones are tfbus's own."""
        if isinstance(callback, partial) and callback.func == self._tick:
            return bool(callback.args[1].once)
        return False

    def end(self) -> None:
        """Run no further callbacks, and end the lookups that the current ones wait in."""
        with self._lock:
            self._closed = True
            self._ready.clear()
            while self._asleep:
                self._asleep.pop().ring()
        self._closing.begin()

    def close(self) -> None:
        """Run no further callbacks; the current ones have 2 s to finish. Lookups end at once, and
        coroutines are cancelled.
        """
        self.end()
        deadline_s = scheduler.monotonic() + _LAST_CALLBACK_S
        for thread in [*self._threads]:
            if thread is not scheduler.current_thread():
                thread.join(max(deadline_s - scheduler.monotonic(), 0.0))
        for worker in [*self._workers]:
            if worker.what and worker.thread is not scheduler.current_thread():
                self._log.warning("Closed while a callback still runs: %s", worker.what)

    # For its event loop

    def begin_step(self, what: str) -> None:
        """A step of a coroutine begins."""
        worker = self._workers[0]
        worker.what, worker.began_s = what, scheduler.monotonic()

    def end_step(self) -> None:
        """A step of a coroutine has ended."""
        worker = self._workers[0]
        self._record_slow(worker, scheduler.monotonic())
        worker.what = ""

    def note_failure(self, what: str) -> None:
        """Count the exception that is being handled, and log it unless it is one of many."""
        error = sys.exception()
        assert error is not None
        count = self._failures.note(what, error)
        if str(count).strip("0") == "1":  # a power of ten
            imported("tfbus.base.ros_names").add_note(error)
            self._log.exception("A callback failed, %s so far (%s)", counted(count, "time"), what)

    # Waiting tasks, with the lock held

    def _count_waiting(self, what: str, group: CallbackGroup | None) -> int:
        waiting: list[_Task] = [
            *self._ready,
            *(group.admission.waiting() if group is not None else ()),
        ]
        loop = self._home._loop
        awaited = 0 if loop is None else loop.living[what]
        return sum(task[0] == what for task in waiting) + awaited

    def _enqueue(self, task: _Task) -> None:
        group = task[2]
        if group is None or (task := group.admission.enter(task)) is not None:
            self._ready.append(task)

    def _wake(self) -> None:
        """Let a thread look for tasks, if one is idle or may be started."""
        if self._asleep:
            self._asleep.pop().ring()
        elif len(self._threads) < self._most_threads and not self._closed:
            thread = scheduler.Thread(target=self._run, name=self._name, daemon=True)
            self._threads.append(thread)
            thread.start()

    def _keep_time(self) -> None:
        """Let a thread look when the next timer is due, as one was added."""
        if self._timekeeper is None:
            self._wake()
        elif self._timekeeper in self._asleep:
            self._asleep.remove(self._timekeeper)
            self._timekeeper.ring()

    def _needs_another(self) -> bool:
        """Whether there is more to do while one thread runs a callback."""
        return bool(self._ready or (self._due and self._timekeeper is None))

    def _schedule(self, when_s: float, timer: Timer) -> None:
        if len(self._due) >= self._most_due:
            # Cancelled ones would stay until they are due, which may be in a year.
            self._due[:] = [entry for entry in self._due if not entry[2].cancelled]
            heapq.heapify(self._due)
            self._most_due = max(_LEAST_DUE, 2 * len(self._due))
        heapq.heappush(self._due, (when_s, next(self._order), timer))

    def _queue_due_timers(self, now_s: float) -> None:
        # Behind waiting tasks: a timer slower than its period does not hold up the rest.
        while self._due and self._due[0][0] <= now_s:
            when_s, _, timer = heapq.heappop(self._due)
            self._enqueue((timer.what, partial(self._tick, when_s, timer), timer.group))

    # On its threads

    def _run(self) -> None:
        worker = _Worker()
        self._workers.append(worker)
        here.closing, here.held_up = self._closing, self._held_up
        while (task := self._next(worker)) is not None:
            self._call(task)
        worker.what = ""
        if self._loop is not None:
            self._loop.close()

    def _next(self, worker: _Worker) -> _Task | None:
        """Wait for the next callback to run; None when closed."""
        now_s = scheduler.monotonic()
        if now_s - worker.began_s >= SLOW_S:
            self._record_slow(worker, now_s)
        if self._loop is not None and self._loop.living:
            worker.what = ""
            self._loop.turn()
            now_s = scheduler.monotonic()
        while True:
            with self._lock:
                if self._closed:
                    return None
                if self._due and self._due[0][0] <= now_s:
                    self._queue_due_timers(now_s)
                if self._ready:
                    task = self._ready.popleft()
                    worker.what, worker.began_s = task[0], now_s
                    if now_s - worker.read_s >= _READ_WAIT_EVERY_S:
                        worker.wait_since_read_s(now_s)
                    if self._most_threads > 1 and self._needs_another():
                        self._wake()
                    return task
                worker.what = ""
                timeout_s = self._begin_sleep(worker, now_s)
            if self._loop is not None and worker.ring == self._loop.ring:
                self._loop.run(timeout_s)
            else:
                worker.bell.wait(timeout_s)
            if worker is self._timekeeper or worker in self._asleep:
                with self._lock:
                    self._end_sleep(worker)
            now_s = scheduler.monotonic()

    def _begin_sleep(self, worker: _Worker, now_s: float) -> float | None:
        """Be found by `_wake`; for how long to sleep at most."""
        has_coroutines = self._loop is not None and self._loop.living
        worker.ring = self._loop.ring if self._loop and has_coroutines else worker.bell.ring
        self._asleep.append(worker)
        if not self._due or self._timekeeper is not None:
            return None
        self._timekeeper = worker
        return self._due[0][0] - now_s

    def _end_sleep(self, worker: _Worker) -> None:
        if worker in self._asleep:
            self._asleep.remove(worker)
        if self._timekeeper is worker:
            self._timekeeper = None

    def _call(self, task: _Task) -> None:
        what, callback, group = task
        try:
            answer = callback()
            if answer is not None and isinstance(answer, Coroutine):
                self._home._start_coroutine(what, answer)
        except _failures() as error:
            # An error by the end of the node is no failure.
            if not (self._closed and isinstance(error, TfbusError)):
                self.note_failure(what)
        if group is not None:
            with self._lock:
                if (task_of_group := group.admission.leave()) is not None and not self._closed:
                    self._ready.append(task_of_group)

    def _start_coroutine(self, what: str, coroutine: Coroutine[Any, Any, Any]) -> None:
        if here.closing is not self._closing:
            self.submit(what, lambda: coroutine)
            return
        if self._loop is None:
            from tfbus.base.event_loop import EventLoop

            self._loop = EventLoop(self)
        self._loop.start(what, coroutine)

    def _record_slow(self, worker: _Worker, now_s: float) -> None:
        if self.delays is not None and worker.what and now_s - worker.began_s >= SLOW_S:
            waited_s = worker.wait_since_read_s(now_s)
            self.delays.ran(worker.what, worker.began_s, now_s, waited_s)

    def _running(self) -> list[Ran]:
        now_s = scheduler.monotonic()
        return [
            Ran(worker.what, worker.began_s, now_s)
            for worker in [*self._workers]
            if worker.what and worker.thread is not scheduler.current_thread()
        ]

    # Timers

    def _start(self, timer: Timer) -> Timer:
        with self._lock:
            self._schedule(scheduler.monotonic() + timer.period_s, timer)
            self._keep_time()
        return timer

    def _set_alarm(self, clock: SimulatedClock, when_ns: int, timer: Timer) -> None:
        def ring() -> None:
            tick = partial(self._tick_simulated, clock, when_ns, scheduler.monotonic(), timer)
            self.submit(timer.what, tick, group=timer.group)

        clock.call_at(when_ns, ring)

    def _tick_simulated(
        self, clock: SimulatedClock, when_ns: int, rang_s: float, timer: Timer
    ) -> Any:
        # A clock that was closed rings for times that have not come.
        if timer.cancelled or clock.elapsed_ns() < when_ns:
            return None
        late_periods = (clock.elapsed_ns() - when_ns) // timer.period_ns
        self._set_alarm(clock, when_ns + (late_periods + 1) * timer.period_ns, timer)
        return self._fire(timer, rang_s, late_periods)

    def _tick(self, when_s: float, timer: Timer) -> Any:
        if timer.cancelled:
            return None
        late_periods = 0
        if timer.once:
            timer.cancel()
        else:
            late_periods = int((scheduler.monotonic() - when_s) / timer.period_s)
            with self._lock:
                self._schedule(when_s + (late_periods + 1) * timer.period_s, timer)
                if self._most_threads > 1:
                    self._keep_time()
        return self._fire(timer, when_s, late_periods)

    def _fire(self, timer: Timer, due_s: float, late_periods: int) -> Any:
        """Run a timer's callback, `late_periods` after its tick was due."""
        if late_periods and self.delays is not None:
            self.delays.late(timer.what, due_s, late_periods, self._running())
        return timer.fire()
