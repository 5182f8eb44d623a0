"""ROS's rclpy.task: futures, which callbacks, coroutines and asyncio can wait for."""

import asyncio
import threading
import time
from collections import deque
from collections.abc import Callable, Generator
from typing import Any, NamedTuple

from tfbus.base.callbacks import SLOW_S, CallbackGroup, Delays, Ran
from tfbus.base.signals import Wakeup
from tfbus.compat.rclpy.type_support import TakesTypes

__all__ = ["Future"]

Run = Callable[[Callable[[], None]], None]


def _at_once(callback: Callable[[], None]) -> None:
    callback()


class Future(TakesTypes):
    """A result that comes later.

    `await` it in a callback that is a coroutine, or in asyncio; or wait for it with
    `rclpy.spin_until_future_complete(node, future)`. Callbacks of a future that belongs to a node
    run while the node is spun; other ones at once, in the thread that sets the result.
    """

    def __init__(self, *, run: Run = _at_once) -> None:
        self._run = run
        self._lock = threading.Lock()
        self._done = False
        self._cancelled = False
        self._result: Any = None
        self._exception: BaseException | None = None
        self._when_ended: list[Callable[[], None]] = []

    def done(self) -> bool:
        """Whether it has a result or an exception, or was cancelled."""
        return self._done

    def cancelled(self) -> bool:
        """Whether it was cancelled."""
        return self._cancelled

    def cancel(self) -> None:
        """Wait for it no longer; its result is None then."""
        self._end(cancelled=True)

    def result(self) -> Any:
        """The result, None if there is none yet; raises the exception that was set."""
        if self._exception is not None:
            raise self._exception
        return self._result

    def exception(self) -> BaseException | None:
        """The exception that was set."""
        return self._exception

    def set_result(self, result: Any) -> None:
        """End it, unless it has ended."""
        self._end(result=result)

    def set_exception(self, exception: BaseException) -> None:
        """End it, unless it has ended."""
        self._end(exception=exception)

    def add_done_callback(self, callback: Callable[[Any], object]) -> None:
        """Call `callback(future)` when it has ended."""
        self.when_ended(lambda: self._run(lambda: _ignored(callback(self))))

    def when_ended(self, wake: Callable[[], None]) -> None:
        """Call `wake()` in the thread that ends it, or now; it must return at once."""
        with self._lock:
            if not self._done:
                self._when_ended.append(wake)
                return
        wake()

    def __await__(self) -> Generator[Any, None, Any]:
        if not self.done():
            loop = _running_loop()
            if loop is not None:
                yield from self._in_asyncio(loop).__await__()
        while not self.done():
            yield self
        return self.result()

    def _in_asyncio(self, loop: asyncio.AbstractEventLoop) -> "asyncio.Future[None]":
        ended: asyncio.Future[None] = loop.create_future()

        def end() -> None:
            if not ended.done():
                ended.set_result(None)

        self.when_ended(lambda: _call_in(loop, end))
        return ended

    def _end(
        self, result: Any = None, exception: BaseException | None = None, cancelled: bool = False
    ) -> None:
        with self._lock:
            if self._done:
                return
            self._result, self._exception, self._cancelled = result, exception, cancelled
            self._done = True
            wakes, self._when_ended = self._when_ended, []
        for wake in wakes:
            wake()


class Task(Future):
    """A coroutine that a node runs: a step whenever the future that it awaits has ended."""

    def __init__(self, coroutine: Any, run: Run) -> None:
        super().__init__(run=run)
        self._coroutine = coroutine

    def step(self) -> None:
        """Run it up to its next `await` of a future. Raises the coroutine's exception."""
        try:
            awaited = self._coroutine.send(None)
        except StopIteration as end:
            self.set_result(end.value)
            return
        except BaseException as error:
            self.set_exception(error)
            raise
        if not isinstance(awaited, Future):
            self._coroutine.close()
            mistake = TypeError(
                f"a callback awaited a {type(awaited).__name__}: under rclpy.spin it can await "
                "futures of rclpy only, as of call_async and wait_for_transform_async"
            )
            self.set_exception(mistake)
            raise mistake
        awaited.when_ended(lambda: self._run(self.step))


def _running_loop() -> asyncio.AbstractEventLoop | None:
    try:
        return asyncio.get_running_loop()
    except RuntimeError:
        return None


def _call_in(loop: asyncio.AbstractEventLoop, callback: Callable[[], None]) -> None:
    if not loop.is_closed():
        loop.call_soon_threadsafe(callback)


def _ignored(value: object) -> None:
    """For functions whose value has no meaning."""


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
        """Run a callback that was taken. Raises its exception."""
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
