"""ROS's rclpy.task: futures, which callbacks, coroutines and asyncio can wait for."""

import asyncio
import threading
from collections.abc import Callable, Generator
from typing import Any

from tfbus.compat.rclpy.type_support import TakesTypes

__all__ = ["Future"]

Run = Callable[[Callable[[], None]], None]


def _at_once(callback: Callable[[], None]) -> None:
    callback()


class Future(TakesTypes):
    """A result that comes later.

    `await` it in a callback that is a coroutine, or in asyncio; or wait for it with
    `rclpy.spin_until_future_complete(node, future)`. Callbacks of a future that belongs to a node
    run while the node is spun; those of another one at once, in the thread that sets the result.
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
        """End it; what ended already stays as it is."""
        self._end(result=result)

    def set_exception(self, exception: BaseException) -> None:
        """End it; what ended already stays as it is."""
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
    """A coroutine that a node runs: a step whenever what it waits for has ended."""

    def __init__(self, coroutine: Any, run: Run) -> None:
        super().__init__(run=run)
        self._coroutine = coroutine

    def step(self) -> None:
        """Run it up to its next `await` of a future. Raises what the coroutine raises."""
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
