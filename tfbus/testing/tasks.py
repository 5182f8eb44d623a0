"""Simulated threads in virtual time: one runs at a time, chosen from a seed.

Each task is a thread of Python's that waits for its turn. It gives the turn back if it waits for
something, and now and then if it could go on, so that the seed also decides how tasks
interleave. Time stands while any task can run, then jumps to the next moment at which one can.
"""

import _thread
import itertools
import math
import os
import random
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from heapq import heappop, heappush
from typing import Any, Protocol

from tfbus.base.errors import TfbusError

# A task may run for this long in real time before the simulation calls it stuck.
_STUCK_AFTER_S = 60.0

# A test may wait without a bound for what takes hours, but not for ever.
_PATIENCE_NS = 24 * 3600 * 1_000_000_000

# As many turns without any time passing are an endless loop.
_MOST_TURNS_AT_ONCE = 2_000_000

# A task that has rested so often, while no other could run, and has not waited for anything, takes
# this time.
_MOST_RESTS_ALONE = 50
_WORK_S = 0.001

_STACK_BYTES = 512 * 1024

# A simulation refuses it to others.
_start_new_thread = _thread.start_new_thread


@contextmanager
def on_one_cpu() -> Iterator[None]:
    """Keep this thread, and the threads that it starts, on the CPU that it has, if Linux lets it,
    and let none interrupt the one that wakes it.

    The turn goes from thread to thread; from CPU to CPU that takes two to three times as long, and
    twice as long where the next thread begins before the former one waits.
    """
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    allowed = os.sched_getaffinity(0)
    with suppress(OSError, ValueError, IndexError), open("/proc/thread-self/stat") as file:
        # Its 39th field; the second, a name, may have spaces.
        os.sched_setaffinity(0, {int(file.read().rpartition(")")[2].split()[36])})
    is_batch = _change_policy(os.SCHED_OTHER, os.SCHED_BATCH)
    try:
        yield
    finally:
        if is_batch:
            _change_policy(os.SCHED_BATCH, os.SCHED_OTHER)
        with suppress(OSError):  # the machine has others by now
            os.sched_setaffinity(0, allowed)


def _change_policy(former: int, policy: int) -> bool:
    """Let Linux schedule this thread by another policy, if it has the former one; whether it is so
    now.
    """
    with suppress(OSError):  # a C library without it, or a container that forbids it
        if os.sched_getscheduler(0) == former:
            os.sched_setscheduler(0, policy, os.sched_param(0))
            return True
    return False


class SimulationError(TfbusError):
    """The simulation cannot go on: all tasks wait for ever, or a task makes a call that cannot be
    simulated.
    """


class SimulationOver(BaseException):
    """Ends a task whose simulation is over, or whose process was killed."""


class TaskPlace(Protocol):
    """The place of a task: a process, which may be stopped or killed."""

    name: str
    is_stopped: bool
    is_dead: bool
    parked: "list[Task]"

    def enter(self) -> None:
        """A task of it has the turn now, after one of another place."""

    def leave(self) -> None:
        """A task of another place has the turn next."""


class Task:
    """A simulated thread."""

    def __init__(self, name: str, place: TaskPlace) -> None:
        self.name = name
        # The process that the caller of `start` has given, whatever its class.
        self.place: Any = place
        self.turn = _thread.allocate_lock()
        self.turn.acquire()
        self.is_over = False
        self.thread_id = 0
        # The thing that it waits for, "" while it can run; and whether the wait has ended in time.
        self.waits_for = ""
        self.was_woken = False
        # Counts the waits, so that an alarm of an earlier one wakes nothing.
        self.wait_number = 0
        self.joiners: list[Task] = []
        # Signals: the calls in it at its next turn, and whether it gets that turn for them.
        self.interrupts: list[Callable[[], object]] = []
        self.is_called = False
        # The object that stands for this thread, as `current_thread()` gives it.
        self.thread: Any = None


class Tasks:
    """All tasks of a simulation, its time and its choices.

    `interleaving` is the mean number of steps between two turns that are given away without need; 0
    for none.
    """

    def __init__(self, seed: int, first: TaskPlace, *, interleaving: int = 50) -> None:
        self.random = random.Random(seed)
        self.now_ns = 0
        self.is_over = False
        self.turns = 0
        self.failure: BaseException | None = None
        # One that does not give its turn back.
        self._stuck: Task | None = None
        # The chance of a task at each step to get no processor, and for how many seconds at most.
        self.stalls = (0.0, 0.0)
        self._interleaving = interleaving
        # How many steps of all tasks come before the next rest, and how many there were at first.
        self.steps_left = self._steps = 0
        self._turns_at_once = 0
        self._rests_alone = 0
        # When a wait of the test itself without a bound has lasted for too long.
        self._impatient_ns = math.inf
        self._ended = _thread.allocate_lock()
        self._order = itertools.count()
        self._alarms: list[tuple[int, int, Callable[[], object]]] = []
        self._able: list[Task] = []
        self.all: dict[Task, None] = {}
        self.main = self.current = Task("main", first)
        self._here = first
        self.main.thread_id = _thread.get_ident()
        self.thread_ids = {self.main.thread_id}
        self.all[self.main] = None
        self._draw_steps()

    # Calls of tasks

    def start(self, name: str, place: TaskPlace, run: Callable[[], object]) -> Task:
        """Start a task; it has its first turn later."""
        task = Task(name, place)
        self.all[task] = None

        def body() -> None:
            task.thread_id = _thread.get_ident()
            self.thread_ids.add(task.thread_id)
            task.turn.acquire()
            try:
                if not self.is_over:
                    run()
            except SimulationOver:
                pass
            except BaseException as error:
                # At the end tasks are torn out of their waits, and their errors say nothing.
                if not self.is_over:
                    self.failure = self.failure or error
                    sys.excepthook(type(error), error, error.__traceback__)
            finally:
                self._finish(task)

        former = threading.stack_size(_STACK_BYTES)
        try:
            _start_new_thread(body, ())
        finally:
            threading.stack_size(former)
        self._able.append(task)
        return task

    def step(self) -> None:
        """A place at which another task may have its turn."""
        self.steps_left -= 1
        if not self.steps_left:
            self.interleave()

    def interleave(self) -> None:
        """The last step before a rest: the task gives its turn away, or gets no processor."""
        steps = self._steps
        self._draw_steps()
        chance, most_s = self.stalls
        may_stall = chance and self.current is not self.main and not self.is_over
        if may_stall and self.random.random() < chance * steps:
            self.wait("the processor", most_s * self.random.random())
        self._rest()

    def _rest(self) -> None:
        """Let another task have its turn; if none can, the work of this one takes time."""
        if self.is_over:
            return
        if self._able:
            self._able.append(self.current)
            self._give_turn()
            return
        self._rests_alone += 1
        if self._rests_alone > _MOST_RESTS_ALONE:
            self._rests_alone = 0
            self.wait("its own work", _WORK_S)

    def wait(self, waits_for: str, timeout_s: float | None = None) -> bool:
        """Wait until `wake` is called for this task, at most this long; whether it was."""
        task = self.current
        if self.is_over:
            raise SimulationOver
        task.waits_for = waits_for
        task.was_woken = False
        task.wait_number += 1
        if task is self.main and timeout_s is None:
            self._impatient_ns = self.now_ns + _PATIENCE_NS
        if timeout_s is not None:
            self.call_at(self.end_ns(timeout_s), partial(self._give_up, task, task.wait_number))
        try:
            while task.waits_for:  # again where only a signal had to be handled
                self._give_turn()
        finally:
            task.waits_for = ""
            if task is self.main:
                self._impatient_ns = math.inf
        return task.was_woken

    def _give_up(self, task: Task, number: int) -> None:
        """The time of a wait is over, unless it has ended before."""
        if task.waits_for and task.wait_number == number:
            self._end_wait(task)

    def end_ns(self, timeout_s: float) -> int:
        """When a wait of this length ends; rounded up, as one that ends just before its time would
        be repeated at once.
        """
        return self.now_ns + (1 + int(min(timeout_s, 1e9) * 1e9) if timeout_s > 0 else 0)

    def join(self, task: Task, timeout_s: float | None = None) -> None:
        """Wait until a task has ended, at most this long."""
        if not task.is_over:
            task.joiners.append(self.current)
            try:
                self.wait(f"the end of {task.name!r}", timeout_s)
            except SimulationOver:
                if not self.is_over:
                    raise

    def join_all(self, place: TaskPlace) -> None:
        """Wait until the threads of a place have ended that Python waits for at its end."""
        while others := [
            task
            for task in self.all
            if task.place is place
            and task is not self.current
            and task.thread is not None
            and not task.thread.daemon
        ]:
            if self.is_over:
                raise SimulationOver
            self.join(others[0])

    def wake(self, task: Task) -> None:
        """End the wait of a task."""
        if task.waits_for:
            task.was_woken = True
            self._end_wait(task)

    def interrupt(self, task: Task, call: Callable[[], object]) -> None:
        """Make a call in a task at its next turn, also in the midst of a wait, which goes on after
        it; an exception of the call is raised there.
        """
        task.interrupts.append(call)
        if task.waits_for and not task.is_called:
            task.is_called = True
            self._able.append(task)

    def _end_wait(self, task: Task) -> None:
        task.waits_for = ""
        if not task.is_called:
            self._able.append(task)

    def call_at(self, due_ns: int, call: Callable[[], object]) -> None:
        """Call this at a time of the simulation, between two turns: it must not wait."""
        heappush(self._alarms, (due_ns, next(self._order), call))

    def call_after(self, delay_s: float, call: Callable[[], object]) -> None:
        """As `call_at`, after a delay."""
        self.call_at(self.now_ns + round(delay_s * 1e9), call)

    @contextmanager
    def within(self, place: TaskPlace) -> Iterator[None]:
        """The current task belongs to another place until the end of the `with`."""
        task = self.current
        former, task.place = task.place, place
        self._enter(place)
        try:
            yield
        finally:
            task.place = former
            self._enter(former)

    # Whose turn it is

    def _draw_steps(self) -> None:
        if self._interleaving:
            self._steps = self.random.randrange(1, 2 * self._interleaving + 1)
            self.steps_left = self._steps

    def _give_turn(self) -> None:
        """Let the next task run; returns when it is the turn of the current one again."""
        me = self.current
        self._rests_alone = 0
        task = self._next()
        self.turns += 1
        if task is not me:
            self._turn_to(task)
            task.turn.release()
            if me is self.main:
                self._wait_on_main()
            else:
                me.turn.acquire()
        if self.is_over and me is not self.main:
            raise SimulationOver
        if self.failure is not None and me is self.main:
            failure, self.failure = self.failure, None
            raise failure
        if me.interrupts:
            self._handle_interrupts(me)

    def _wait_on_main(self) -> None:
        """Wait for the turn of the main task, which names another one that is stuck."""
        turns = self.turns
        while not self.main.turn.acquire(timeout=_STUCK_AFTER_S):
            if turns == self.turns:
                self._name_stuck()
            turns = self.turns

    def _turn_to(self, task: Task) -> None:
        self.current = task
        if task.place is not self._here:
            self._enter(task.place)

    def _enter(self, place: TaskPlace) -> None:
        if place is not self._here:
            self._here.leave()
            self._here = place
            place.enter()

    def _handle_interrupts(self, me: Task) -> None:
        calls, me.interrupts = me.interrupts, []
        try:
            for call in calls:
                call()
        finally:
            me.is_called = False

    def _name_stuck(self) -> None:
        """The task whose turn it is has not given it back for long."""
        self._stuck = task = self.current
        self.is_over = True  # that one may still go on
        raise SimulationError(
            f"{_named(task)} has not given its turn back for {_STUCK_AFTER_S:g} s: it computes, or "
            "waits for something real, such as a lock, a file or a sleep of Python's own\n"
            f"{self._stack_of(task)}"
        )

    def _next(self) -> Task:
        """The next task to run; time passes if none can now."""
        able, alarms = self._able, self._alarms
        while True:
            while able:
                if len(able) == 1:
                    task = able.pop()
                else:
                    index = int(self.random.random() * len(able))
                    task = able[index]
                    able[index] = able[-1]
                    able.pop()
                place = task.place
                if place.is_dead:
                    continue
                if place.is_stopped:
                    place.parked.append(task)
                    continue
                self._turns_at_once += 1
                if self._turns_at_once > _MOST_TURNS_AT_ONCE:
                    self._turns_at_once = 0
                    return self._main_for(
                        self._error(f"{_named(task)} runs for ever without any time passing")
                    )
                return task
            if not alarms:
                return self._main_for(self._error("all tasks wait for ever"))
            if alarms[0][0] > self._impatient_ns:
                return self._main_for(
                    self._error(
                        "the test itself has waited for a day of this time: is there a call that "
                        "never returns? network.start and network.program want the function. For "
                        "longer waits there is network.run(until=..., timeout_s=...)"
                    )
                )
            due_ns, _, call = heappop(alarms)
            if due_ns > self.now_ns:
                self.now_ns = due_ns
                self._turns_at_once = 0
            call()

    def unpark(self, tasks: list[Task]) -> None:
        """Tasks of a place that goes on can run again."""
        self._able += tasks
        tasks.clear()

    def _main_for(self, error: BaseException) -> Task:
        self.failure = self.failure or error
        self.main.waits_for = ""
        if self.main in self._able:
            self._able.remove(self.main)
        return self.main

    def _error(self, why: str) -> SimulationError:
        rows = [
            f"  {_named(task)} waits for {task.waits_for}"
            for task in self.all
            if task.waits_for and not task.place.is_dead
        ]
        return SimulationError("\n".join([f"{why} ({self.now_ns / 1e9:.6f} s)", *rows]))

    def _stack_of(self, task: Task) -> str:
        frame = sys._current_frames().get(task.thread_id)
        return "".join(traceback.format_stack(frame)) if frame else ""

    # Its end

    def _finish(self, task: Task) -> None:
        task.is_over = True
        self.all.pop(task, None)
        for joiner in task.joiners:
            self.wake(joiner)
        if self.is_over:
            self._forget_thread(task)
            # `end` waits for each in turn.
            if self._ended.locked():
                self._ended.release()
            return
        # Alarms are called here, as on any thread of the simulation.
        following = self._next()
        self._forget_thread(task)
        self.turns += 1
        self._turn_to(following)
        following.turn.release()

    def _forget_thread(self, task: Task) -> None:
        # The system gives its number to a later thread, which must not be taken for this one.
        self.thread_ids.discard(task.thread_id)
        threading._active.pop(task.thread_id, None)  # type: ignore[attr-defined]
        # It is there yet if it had no turn.
        threading._limbo.pop(task.thread, None)  # type: ignore[attr-defined]

    def end(self) -> None:
        """End all tasks, on the main one; their further calls have no effect."""
        self.is_over = True
        self._ended.acquire(blocking=False)
        self.all.pop(self.main, None)
        for task in list(self.all):
            task.waits_for = ""
            self._turn_to(task)
            task.turn.release()
            if task is not self._stuck:
                self._ended.acquire(timeout=_STUCK_AFTER_S)
        self._turn_to(self.main)
        self._able.clear()
        self._alarms.clear()


def task_of(thread: threading.Thread) -> Task | None:
    """The task that a thread is; None for one of Python's own."""
    return getattr(thread, "_simulated_task", None)


def _named(task: Task) -> str:
    return f"{task.name!r} of {task.place.name!r}"
