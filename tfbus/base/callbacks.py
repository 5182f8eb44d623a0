"""Callbacks: which of them may run at once, the threads that run them, and which held up others.

A few threads run the jobs that may block, in the background.
"""

import logging
import threading
from collections import defaultdict, deque
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, TypeVarTuple

from tfbus.base import scheduler
from tfbus.base.log import LogOnce
from tfbus.base.structs import Struct
from tfbus.base.wording import duration

Given = TypeVarTuple("Given")

Job = Callable[[], object]


class Workers:
    """Runs jobs on at most `threads` threads; at most `waiting` further ones wait for a thread.

    Threads exist only while they have jobs, and do not hold up the end of the process. Jobs
    handle their exceptions themselves.
    """

    def __init__(self, name: str, *, threads: int, waiting: int) -> None:
        self._name = name
        self._most_threads = threads
        self._most_waiting = waiting
        self._lock = scheduler.Lock()
        # In the order of their starts, in which `close` joins them.
        self._threads: dict[scheduler.Thread, None] = {}
        self._waiting: deque[Job] = deque()
        self._closed = False

    def do(self, job: Callable[[*Given], object], *given: *Given) -> bool:
        """Run `job(*given)` soon. False if too many wait already, or after `close`: then it does
        not run.
        """
        with self._lock:
            if self._closed:
                return False
            if len(self._threads) < self._most_threads:
                thread = scheduler.Thread(
                    target=self._run, args=(partial(job, *given),), name=self._name, daemon=True
                )
                thread.start()
                self._threads[thread] = None
            elif len(self._waiting) < self._most_waiting:
                self._waiting.append(partial(job, *given))
            else:
                return False
        return True

    def close(self, patience_s: float) -> None:
        """Drop the jobs that wait, and wait at most `patience_s` seconds for running ones."""
        with self._lock:
            self._closed = True
            self._waiting.clear()
            here = scheduler.current_thread()
            running = [thread for thread in self._threads if thread is not here]
        deadline = scheduler.monotonic() + patience_s
        for thread in running:
            thread.join(max(deadline - scheduler.monotonic(), 0.0))

    def _run(self, job: Job | None) -> None:
        while job is not None:
            job()
            job = self._next()

    def _next(self) -> Job | None:
        with self._lock:
            if self._waiting:
                return self._waiting.popleft()
            self._threads.pop(scheduler.current_thread(), None)
            return None


class AllAtOnce:
    """The tasks of a group that may run now: all of them.

    Each `enter` that returns a task, and each `leave` that does, is followed by a `leave` when that
    task has run. Safe from any thread, and from a signal handler in the middle of a call.
    """

    def enter(self, task: Any) -> Any:
        """Take a task; the one that may run now, None if it has to wait."""
        return task

    def leave(self) -> Any:
        """Note that a task has run; the next that may run now, None if there is none."""
        return None

    def waiting(self) -> list[Any]:
        """The tasks that wait for others to end, in order."""
        return []


class OneAtATime(AllAtOnce):
    """A task after the other, in their order."""

    def __init__(self) -> None:
        # Each step below is a single operation.
        self._runs = scheduler.Lock()  # held while a task runs
        self._waiting: deque[Any] = deque()

    def enter(self, task: Any) -> Any:
        self._waiting.append(task)
        return self._next()

    def leave(self) -> Any:
        self._runs.release()
        return self._next()

    def waiting(self) -> list[Any]:
        return list(self._waiting)

    def _next(self) -> Any:
        while self._waiting and self._runs.acquire(blocking=False):
            try:
                return self._waiting.popleft()
            except IndexError:  # another thread took it: look again, as one may have come meanwhile
                self._runs.release()
        return None


class CallbackGroup:
    """A group of callbacks of one node, which run on other threads than its further callbacks.

    Give it to `create_subscription`, `create_timer`, `create_service` and others. A callback
    without a group is in the node's own, which is mutually exclusive and has the node's thread.
    """

    def __init__(self) -> None:
        self.admission = AllAtOnce()
        # The full name of the node that it is of.
        self.owner: str | None = None


class MutuallyExclusiveCallbackGroup(CallbackGroup):
    """Callbacks that run one at a time, in the order in which they became due, beside the node's
    other groups.

    Give one group to `create_subscription`, `create_timer`, `create_service` and others of a node.
    """

    def __init__(self) -> None:
        super().__init__()
        self.admission = OneAtATime()


class ReentrantCallbackGroup(CallbackGroup):
    """Callbacks that may all run at once, also several calls of the same one: they need locks for
    shared data.
    """


def join(group: CallbackGroup, owner: str) -> None:
    """Let the group belong to the node of this name. Raises ValueError if it is of another."""
    if group.owner not in (None, owner):
        raise ValueError(
            f"this callback group is of node {group.owner}: make another for {owner}, "
            f"{type(group).__name__}()"
        )
    group.owner = owner


class ExecutorEnd:
    """The end of an executor, for callbacks that wait on its threads."""

    def __init__(self) -> None:
        self.has_begun = False
        # Changed by single operations only: a signal handler may close in the middle of a wait.
        self._wakes: dict[int, Callable[[], object]] = {}

    def begin(self) -> None:
        """Wake all that wait; twice is fine."""
        self.has_begun = True
        for wake in list(self._wakes.values()):
            wake()

    def wakes(self, waiter: object, wake: Callable[[], object]) -> None:
        """Call `wake()` when it begins, until `forget(waiter)`."""
        self._wakes[id(waiter)] = wake

    def forget(self, waiter: object) -> None:
        """Wake this one no longer."""
        self._wakes.pop(id(waiter), None)


def _nothing(stream: str) -> str:
    return ""


class _Here(threading.local):
    """Of the thread that reads it, if it runs the callbacks of an executor.

    `closing` is the end of that, None on all other threads. `held_up(stream)` names a callback that
    waits for the current one to return, if the same executor sends the stream; "" elsewhere.
    """

    closing: ExecutorEnd | None = None
    held_up: Callable[[str], str] = staticmethod(_nothing)


here = _Here()


# A callback that took less holds up nothing that anyone would notice.
SLOW_S = 0.001

# The names of timers begin with it that are not of a program: tfbus's own.
OWN = "tfbus's "

# So many of the last slow ones are remembered, and so many pairs are counted.
_MOST_REMEMBERED = 64
_MOST_PAIRS = 100
_LONGEST_ERROR = 300

_REMEDY = (
    ". A callback that waits is to be in a callback group of its own (callback_group=...), or an "
    "async def that awaits"
)


def _text_of(error: BaseException) -> str:
    kind = type(error).__name__
    try:
        return f"{kind}: {error}".removesuffix(": ")
    except Exception:  # of its own __str__
        return kind


class Failures:
    """Counts the exceptions of callbacks, by their names. From any thread; two exceptions of one
    name at the same instant may count as one.
    """

    def __init__(self) -> None:
        # How many, the last one as a text, and when that was.
        self._counts: dict[str, tuple[int, str, int]] = {}

    def note(self, what: str, error: BaseException) -> int:
        """Note an exception of a callback; how many it has had so far."""
        text = _text_of(error)[:_LONGEST_ERROR]
        count = self._counts.get(what, (0, "", 0))[0] + 1
        self._counts[what] = count, text, scheduler.time_ns()
        return count

    def described(self) -> list[dict[str, Any]]:
        """The fields of a FailureDescription for each callback, the last to fail first; the first
        few.
        """
        counts = sorted(self._counts.copy().items(), key=lambda each: -each[1][2])
        return [
            {"what": what, "count": count, "error": error, "last_ns": last_ns}
            for what, (count, error, last_ns) in counts[:_MOST_PAIRS]
        ]


class Ran(Struct):
    """A callback that ran, or still runs: its name, when, by scheduler.monotonic(), and how many
    seconds of that it waited for a CPU.
    """

    what: str
    began_s: float
    ended_s: float
    waited_s: float = 0.0


class Delays:
    """Notes slow callbacks, and finds which of them was the culprit if a timer was late or a
    topic had to drop a message.

    The first of each culprit is logged; all are counted. Safe from any thread.
    """

    def __init__(self, log: logging.Logger) -> None:
        self._log_once = LogOnce(log)
        self._lock = scheduler.Lock()
        self._slow: deque[Ran] = deque(maxlen=_MOST_REMEMBERED)
        # By culprit and the timer or topic: how much was lost, and how long the culprit took.
        self._pairs: dict[tuple[str, str], tuple[int, float]] = {}

    def ran(self, what: str, began_s: float, ended_s: float, waited_s: float = 0.0) -> None:
        """Remember a callback that took at least `SLOW_S`."""
        self._slow.append(Ran(what, began_s, ended_s, min(waited_s, ended_s - began_s)))

    def late(self, what: str, since_s: float, ticks: int, running: Iterable[Ran] = ()) -> None:
        """Note that a timer left out so many ticks, since its tick was due at `since_s`."""
        late_s = scheduler.monotonic() - since_s
        found = self._culprit(since_s, running)
        # Where its callbacks did not take that time, the machine is busy with other programs.
        if found is None or sum(found[1]) < late_s / 2:
            waited_s = sum(ran.waited_s for ran in self._slow.copy() if ran.ended_s > since_s)
            if waited_s >= late_s / 2:
                self._log_once.warning(
                    "busy",
                    "%s was late by %s: this host is too busy, and its callbacks waited %s for a "
                    "CPU",
                    what[:1].upper() + what[1:],
                    duration(late_s),
                    duration(waited_s),
                )
            return
        by, calls_s = found
        self._count(by, what, ticks, max(calls_s))
        self._log_once.warning(
            ("late", by),
            "%s was late by %s: %s%s",
            what[:1].upper() + what[1:],
            duration(late_s),
            _told(by, calls_s, own=by == what),
            _REMEDY,
        )

    def dropped(self, what: str, pending: int, running: Iterable[Ran] = ()) -> None:
        """Note that a topic dropped a message, as so many wait already."""
        now_s = scheduler.monotonic()
        found = self._culprit(now_s - 1.0, running)
        by, calls_s = found or (what, [0.0])
        self._count(by, what, 1, max(calls_s))
        why = "they come faster than its callback returns"
        self._log_once.warning(
            ("dropped", by),
            "%s dropped a message, as %d wait already: %s%s",
            what[:1].upper() + what[1:],
            pending,
            _told(by, calls_s, own=by == what) if found else why,
            _REMEDY if found else "",
        )

    def described(self, overdue: Iterable[tuple[str, int, Ran]] = ()) -> list[dict[str, Any]]:
        """The fields of a DelayDescription for each pair, the most lost first.

        `overdue` are timers with how many ticks they have left out so far, as a callback has not
        returned.
        """
        with self._lock:
            pairs = dict(self._pairs)
        for what, ticks, ran in overdue:
            lost, longest_s = pairs.get((ran.what, what), (0, 0.0))
            pairs[ran.what, what] = lost + ticks, max(longest_s, ran.ended_s - ran.began_s)
        return [
            {"what": what, "lost": lost, "by": by, "took_s": took_s}
            for (by, what), (lost, took_s) in sorted(pairs.items(), key=lambda pair: -pair[1][0])
        ]

    def _count(self, by: str, what: str, lost: int, took_s: float) -> None:
        with self._lock:
            before = self._pairs.get((by, what))
            if before is None and len(self._pairs) >= _MOST_PAIRS:
                return
            count, longest_s = before or (0, 0.0)
            self._pairs[by, what] = count + lost, max(longest_s, took_s)

    def _culprit(self, since_s: float, running: Iterable[Ran]) -> tuple[str, list[float]] | None:
        """The name whose callbacks took the most time since then, and how long each of them took,
        without its waits for a CPU. Callbacks of tfbus's own timers are left out.
        """
        shares_s: defaultdict[str, float] = defaultdict(float)
        calls_s: defaultdict[str, list[float]] = defaultdict(list)
        for ran in (*self._slow.copy(), *running):
            within_s = ran.ended_s - max(ran.began_s, since_s) - ran.waited_s
            if within_s >= SLOW_S and not ran.what.startswith(OWN):
                shares_s[ran.what] += within_s
                calls_s[ran.what].append(ran.ended_s - ran.began_s - ran.waited_s)
        if not shares_s:
            return None
        by = max(shares_s, key=shares_s.__getitem__)
        return by, calls_s[by]


def _told(by: str, calls_s: list[float], *, own: bool) -> str:
    callback = "its own callback" if own else f"the callback of {by}"
    calls = f" in {len(calls_s)} calls" if len(calls_s) > 1 else ""
    return f"{callback} took {duration(sum(calls_s))}{calls}"
