"""asyncio between callbacks: the coroutines that callbacks of an executor have returned."""

import asyncio
from collections import Counter
from collections.abc import Callable, Coroutine, Generator
from typing import Any, Protocol

from tfbus.base import scheduler

# Cancelled coroutines have this long to end.
_LAST_STEPS_S = 1.0


class Observer(Protocol):
    """The executor, for which a step of a coroutine is like a callback."""

    def begin_step(self, what: str) -> None:
        """A step of the coroutine of this name begins."""

    def end_step(self) -> None:
        """It has ended, at an `await` or for good."""

    def note_failure(self, what: str) -> None:
        """The coroutine has raised the exception that is being handled."""


class EventLoop:
    """An event loop that one thread runs between its callbacks.

    So only an `await` lets other callbacks run, and callbacks and coroutines need no locks among
    them.
    """

    def __init__(self, observer: Observer) -> None:
        self._observer = observer
        self._loop = scheduler.new_event_loop()
        self._tasks: dict[asyncio.Task[None], None] = {}
        self._is_ending = False
        # By their names: coroutines that have not ended.
        self.living: Counter[str] = Counter()

    def start(self, what: str, coroutine: Coroutine[Any, Any, Any]) -> None:
        """Run a coroutine, from the next turn on; `what` names it in the log."""
        task = self._loop.create_task(self._run(what, coroutine), name=what)
        self._tasks[task] = None
        self.living[what] += 1
        task.add_done_callback(lambda task: self._forget(what, task))

    def turn(self) -> None:
        """Run the steps that are due now."""
        self._loop.call_soon(self._loop.stop)
        self._loop.run_forever()

    def run(self, timeout_s: float | None) -> None:
        """Run until `ring` is called, at most this long; None: for as long as it takes."""
        timer = None if timeout_s is None else self._loop.call_later(timeout_s, self._loop.stop)
        self._loop.run_forever()
        if timer is not None:
            timer.cancel()

    def ring(self) -> None:
        """End the `run` of now, or else the next one; from any thread."""
        self._loop.call_soon_threadsafe(self._stop)

    def _stop(self) -> None:
        # A ring that no `run` has heard must not end the last steps.
        if not self._is_ending:
            self._loop.stop()

    def close(self) -> None:
        """Cancel all coroutines; any that does not end within 1 s is left as it is."""
        self._is_ending = True
        for task in self._tasks:
            task.cancel()
        if self._tasks:
            # A copy: tasks that end at once are forgotten before the wait begins.
            ending = asyncio.wait(list(self._tasks), timeout=_LAST_STEPS_S)
            self._loop.run_until_complete(ending)
        self._loop.run_until_complete(self._loop.shutdown_asyncgens())
        self._loop.close()

    def _forget(self, what: str, task: "asyncio.Task[None]") -> None:
        self._tasks.pop(task, None)
        self.living[what] -= 1
        self.living = +self.living

    async def _run(self, what: str, coroutine: Coroutine[Any, Any, Any]) -> None:
        try:
            await _Observed(what, coroutine, self._observer)
        except (Exception, SystemExit):  # the latter would end the loop and its thread
            self._observer.note_failure(what)


class _Observed:
    """A coroutine of which each step is observed."""

    def __init__(self, what: str, coroutine: Coroutine[Any, Any, Any], observer: Observer) -> None:
        self._what = what
        self._coroutine = coroutine
        self._observer = observer

    def __await__(self) -> Generator[Any, Any, Any]:
        step: Callable[[Any], Any] = self._coroutine.send
        given: Any = None
        while True:
            self._observer.begin_step(self._what)
            try:
                awaited = step(given)
            except StopIteration as end:
                return end.value
            finally:
                self._observer.end_step()
            try:
                given = yield awaited
                step = self._coroutine.send
            except BaseException as error:
                given, step = error, self._coroutine.throw
