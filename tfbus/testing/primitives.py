"""Locks, events, queues and event loops of simulated tasks, by the names of base/scheduler.py.

Each has the methods of Python's own that tfbus uses, with the same meaning.
"""

import asyncio
import queue
import signal
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, NoReturn, TypeVarTuple

from tfbus.testing.tasks import SimulationError, Task, Tasks

if TYPE_CHECKING:
    from tfbus.testing.processes import Process


Given = TypeVarTuple("Given")


class Waiting:
    """The tasks that wait for one thing, woken one by one or all."""

    def __init__(self, tasks: Tasks) -> None:
        self.tasks = tasks
        self._waiting: list[Task] = []

    def wait(self, waits_for: str, timeout_s: float | None) -> bool:
        """Wait until woken, at most this long; whether it was woken."""
        task = self.tasks.current
        self._waiting.append(task)
        try:
            return self.tasks.wait(waits_for, timeout_s)
        finally:
            if task in self._waiting:
                self._waiting.remove(task)

    def wake_one(self) -> None:
        """Wake one of them, by choice of the seed."""
        if not self._waiting:
            return
        living = [task for task in self._waiting if not task.place.is_dead]
        if living:
            task = living[int(self.tasks.random.random() * len(living))]
            self._waiting.remove(task)
            self.tasks.wake(task)

    def wake_all(self) -> None:
        """Wake all of them."""
        waiting, self._waiting = self._waiting, []
        for task in waiting:
            self.tasks.wake(task)


class Lock:
    """A lock of simulated tasks; `reentrant` ones may be taken again by their holder."""

    def __init__(self, tasks: Tasks, *, reentrant: bool = False) -> None:
        self._tasks = tasks
        self._waiting = Waiting(tasks)
        self._is_reentrant = reentrant
        self.holder: Task | None = None
        self._depth = 0

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        tasks = self._tasks
        tasks.steps_left -= 1
        if not tasks.steps_left:
            tasks.interleave()
        if self.holder is None:
            self.holder = tasks.current
            self._depth = 1
            return True
        return self._acquire_held(blocking, timeout)

    __enter__ = acquire

    def _acquire_held(self, blocking: bool, timeout: float) -> bool:
        """Take a lock that is held: again, or after a wait."""
        tasks = self._tasks
        me = tasks.current
        if self._is_reentrant and self.holder is me:
            self._depth += 1
            return True
        deadline_ns = None if timeout < 0 else tasks.end_ns(timeout)
        while self.holder is not None and not tasks.is_over:
            if not blocking:
                return False
            left_s = None if deadline_ns is None else (deadline_ns - tasks.now_ns) / 1e9
            if left_s is not None and left_s <= 0:
                return False
            self._waiting.wait(f"a lock that {self.holder.name!r} holds", left_s)
        self.holder = me
        self._depth = 1
        return True

    def release(self) -> None:
        tasks = self._tasks
        if self.holder is None:
            if tasks.is_over:
                return
            raise RuntimeError("release unlocked lock")
        if self._is_reentrant and not (self._is_owned() or tasks.is_over):
            raise RuntimeError("cannot release un-acquired lock")
        self._depth -= 1
        if self._depth and self._is_reentrant:
            return
        self.holder = None
        self._waiting.wake_one()
        tasks.steps_left -= 1
        if not (tasks.steps_left or tasks.is_over):
            tasks.interleave()

    def __exit__(self, *_: object) -> None:
        self.release()

    def locked(self) -> bool:
        return self.holder is not None

    def _is_owned(self) -> bool:
        # As Python's RLock, whose holder the interpreted kernel asks for.
        return self.holder is self._tasks.current


class Event:
    """A flag that tasks wait for."""

    def __init__(self, tasks: Tasks) -> None:
        self._tasks = tasks
        self._waiting = Waiting(tasks)
        self._is_set = False

    def is_set(self) -> bool:
        return self._is_set

    def set(self) -> None:
        self._is_set = True
        self._waiting.wake_all()
        self._tasks.step()

    def clear(self) -> None:
        self._is_set = False

    def wait(self, timeout: float | None = None) -> bool:
        if not self._is_set:
            self._waiting.wait("an event", timeout)
        else:
            self._tasks.step()
        return self._is_set


class Condition:
    """A condition, with a lock of its own or a given one."""

    def __init__(self, tasks: Tasks, lock: Lock | None = None) -> None:
        self._tasks = tasks
        self._lock = lock or Lock(tasks, reentrant=True)
        self._waiting = Waiting(tasks)
        self.acquire = self._lock.acquire
        self.release = self._lock.release

    def __enter__(self) -> bool:
        return self._lock.acquire()

    def __exit__(self, *_: object) -> None:
        self._lock.release()

    def wait(self, timeout: float | None = None) -> bool:
        lock = self._lock
        self._check_owned("wait on")
        depth, lock._depth = lock._depth, 1
        lock.holder, me = None, lock.holder
        lock._waiting.wake_one()
        try:
            return self._waiting.wait("a condition", timeout)
        finally:
            if not self._tasks.is_over:
                lock.acquire()
            lock.holder, lock._depth = me, depth

    def wait_for(self, predicate: Callable[[], Any], timeout: float | None = None) -> Any:
        deadline_ns = None if timeout is None else self._tasks.end_ns(timeout)
        result = predicate()
        while not result:
            left_s = None if deadline_ns is None else (deadline_ns - self._tasks.now_ns) / 1e9
            if left_s is not None and left_s <= 0:
                break
            self.wait(left_s)
            result = predicate()
        return result

    def notify(self, n: int = 1) -> None:
        self._check_owned("notify on")
        for _ in range(n):
            self._waiting.wake_one()

    def notify_all(self) -> None:
        self._check_owned("notify on")
        self._waiting.wake_all()

    def _check_owned(self, what: str) -> None:
        if not (self._lock._is_owned() or self._tasks.is_over):
            raise RuntimeError(f"cannot {what} un-acquired lock")


class WaiterLock:
    """The lock by which a condition of Python's own waits, such as that of an event which was made
    before the simulation: its second `acquire` waits for the `release`.

    It never gives the turn away: the condition holds a real lock.
    """

    def __init__(self, tasks: Tasks) -> None:
        self._waiting = Waiting(tasks)
        self._is_held = False

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        if not self._is_held:
            self._is_held = True
            return True
        return blocking and self._waiting.wait("a condition", None if timeout < 0 else timeout)

    def release(self) -> None:
        self._is_held = False
        self._waiting.wake_all()


class Queue:
    """A queue; `maxsize` of 0 is without bound."""

    def __init__(self, tasks: Tasks, maxsize: int = 0) -> None:
        self._tasks = tasks
        self._items: deque[Any] = deque()
        self._most = maxsize
        self._getting, self._putting = Waiting(tasks), Waiting(tasks)

    def put(self, item: Any, block: bool = True, timeout: float | None = None) -> None:
        self._tasks.step()
        while self._most and len(self._items) >= self._most:
            if not block or not self._putting.wait("room in a queue", timeout):
                raise queue.Full
        self._items.append(item)
        self._getting.wake_one()

    def put_nowait(self, item: Any) -> None:
        self.put(item, block=False)

    def get(self, block: bool = True, timeout: float | None = None) -> Any:
        self._tasks.step()
        while not self._items:
            if not block or not self._getting.wait("a queue", timeout):
                raise queue.Empty
        item = self._items.popleft()
        self._putting.wake_one()
        return item

    def get_nowait(self) -> Any:
        return self.get(block=False)

    def qsize(self) -> int:
        return len(self._items)

    def empty(self) -> bool:
        return not self._items


class _WaitingSelector:
    """Stands in for the files of a loop, of which a simulated process has none."""

    def __init__(self, tasks: Tasks) -> None:
        self.event = Event(tasks)

    def select(self, timeout: float | None = None) -> list[Any]:
        if timeout is None or timeout > 0:
            self.event.wait(timeout)
        self.event.clear()
        return []


class SimulatedEventLoop(asyncio.BaseEventLoop):
    """An event loop of one simulated task; others may call `call_soon_threadsafe`."""

    def __init__(self, tasks: Tasks) -> None:
        super().__init__()
        self._tasks = tasks
        self._selector = _WaitingSelector(tasks)
        self._clock_resolution = 1e-9

    def time(self) -> float:
        """The virtual time, in seconds."""
        return self._tasks.now_ns / 1e9

    def add_signal_handler(
        self, sig: int, callback: Callable[[*Given], object], *args: *Given
    ) -> None:
        """Call this in the loop at a signal to its process."""

        def handle(*_: object) -> None:
            self.call_soon_threadsafe(callback, *args)

        self._process.set_handler(sig, handle)

    def remove_signal_handler(self, sig: int) -> bool:
        """Whether there was a handler, which is called no more."""
        default = signal.default_int_handler if sig == signal.SIGINT else signal.SIG_DFL
        return bool(self._process.set_handler(sig, default) != default)

    @property
    def _process(self) -> "Process":
        process: Process = self._tasks.current.place
        return process

    def _process_events(self, event_list: list[Any]) -> None:
        pass

    def _write_to_self(self) -> None:
        self._selector.event.set()


def _refusal(name: str) -> Callable[..., NoReturn]:
    def refuse(*_: object, **__: object) -> NoReturn:
        raise SimulationError(
            f"{name} of asyncio cannot be simulated: files, pipes, sockets and programs are in "
            "real time. Use a topic or a service, or give the node an object in its place"
        )

    return refuse


for _name, _internal in {
    "subprocess": "_make_subprocess_transport",
    "connect_read_pipe": "_make_read_pipe_transport",
    "connect_write_pipe": "_make_write_pipe_transport",
    "add_reader": "add_reader",
    "add_writer": "add_writer",
    "create_unix_connection": "create_unix_connection",
    "create_unix_server": "create_unix_server",
}.items():
    setattr(SimulatedEventLoop, _internal, _refusal(_name))


def scheduler_names(tasks: Tasks) -> dict[str, Any]:
    """All names that a simulation replaces."""

    def process() -> "Process":
        found: Process = tasks.current.place
        return found

    not_a_main_thread = object()

    def main_thread() -> Any:
        main = process().main
        return not_a_main_thread if main is None else main.thread

    def sleep(seconds: float) -> None:
        tasks.wait("the end of a sleep", max(seconds, 0.0))

    def monotonic_ns() -> int:
        return tasks.now_ns + 1000 * 10**9 - process().host.suspended_ns

    return {
        "monotonic": lambda: monotonic_ns() / 1e9,
        "monotonic_ns": monotonic_ns,
        "boot_time": lambda: tasks.now_ns / 1e9 + 2000.0,
        "time_ns": lambda: process().host.time_ns(),
        "sleep": sleep,
        "Lock": partial(Lock, tasks),
        "RLock": partial(Lock, tasks, reentrant=True),
        "Event": partial(Event, tasks),
        "Condition": partial(Condition, tasks),
        "Queue": partial(Queue, tasks),
        "SimpleQueue": partial(Queue, tasks),
        "main_thread": main_thread,
        "of_process": lambda kind: process().object_of(kind),
        "getpid": lambda: process().pid,
        "new_event_loop": lambda: SimulatedEventLoop(tasks),
        "urandom": lambda size: process().urandom(size),
    }
