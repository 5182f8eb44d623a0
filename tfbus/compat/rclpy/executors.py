"""ROS's rclpy.executors: they run the callbacks of nodes while a thread spins them."""

import logging
import math
import os
import time
from collections import deque
from collections.abc import Callable, Coroutine
from typing import Any

from tfbus.base.executor import Executor as Threads
from tfbus.base.signals import Wakeup
from tfbus.compat.rclpy import context
from tfbus.compat.rclpy.node import Node
from tfbus.compat.rclpy.task import Future, Job, Work

__all__ = [
    "Executor",
    "ExternalShutdownException",
    "MultiThreadedExecutor",
    "SingleThreadedExecutor",
]

# Transforms come without a callback, and in ROS they end a `spin_once`: it looks so often.
_LOOKS_FOR_TRANSFORMS_EVERY_S = 0.02


class ExternalShutdownException(Exception):
    """`rclpy.shutdown()` was called while an executor was spinning."""

    def __init__(self) -> None:
        super().__init__("rclpy.shutdown() was called while spinning")


class Executor:
    """Runs callbacks of its nodes one at a time, in the thread that spins it.

    Lookups, services and sleeps in a callback hold up other callbacks, but not the transforms and
    answers of other processes that they wait for.
    """

    def __init__(self, **_: Any) -> None:
        self._nodes: list[Node] = []
        self._work = Work()  # of the executor itself
        self._is_shut_down = False

    def add_node(self, node: "Node") -> bool:
        """Run the callbacks of this node too; whether it is new here."""
        if node in self._nodes:
            return False
        self._nodes.append(node)
        return True

    def remove_node(self, node: "Node") -> None:
        """Run its callbacks no longer."""
        if node in self._nodes:
            self._nodes.remove(node)

    def get_nodes(self) -> "list[Node]":
        """The nodes that were added."""
        return list(self._nodes)

    def spin(self) -> None:
        """Run callbacks until Ctrl-C or SIGTERM, which raise KeyboardInterrupt.

        Raises ExternalShutdownException if `rclpy.shutdown()` is called meanwhile, and the
        exceptions of callbacks.
        """
        here = self._begin()
        while here.ok() and not self._is_shut_down:
            self._run_one(here, None)

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Run one callback, if one is ready within that time (None: for ever).

        Of a node with a TransformListener it returns without one once transforms have come.
        """
        here = self._begin()
        if not any(node.work.listeners for node in self._nodes):
            self._run_one(here, timeout_sec)
            return
        deadline = math.inf if timeout_sec is None else time.monotonic() + timeout_sec
        slice_s = 0.0
        while not self._run_one(here, slice_s):
            left_s = deadline - time.monotonic()
            has_heard = [node.work.has_heard() for node in self._nodes]
            if any(has_heard) or left_s <= 0 or self._is_shut_down:
                return
            slice_s = min(left_s, _LOOKS_FOR_TRANSFORMS_EVERY_S)

    def spin_until_future_complete(self, future: Future, timeout_sec: float | None = None) -> None:
        """Run callbacks until the future has ended, at most `timeout_sec` s (None: for ever)."""
        here = self._begin()
        deadline = None if timeout_sec is None else time.monotonic() + timeout_sec
        future.when_ended(self.wake)
        while here.ok() and not future.done() and not self._is_shut_down:
            left_s = None if deadline is None else deadline - time.monotonic()
            if left_s is not None and left_s <= 0:
                return
            self._run_one(here, left_s)

    def create_task(
        self, callback: Callable[..., Any] | Coroutine[Any, Any, Any], *args: Any, **kwargs: Any
    ) -> Future:
        """Run a function, or a coroutine to its end, while it spins: a future of the result."""
        future = Future(run=self._work.submit)

        async def run() -> None:
            try:
                answer = callback(*args, **kwargs) if callable(callback) else callback
                future.set_result(await answer if hasattr(answer, "send") else answer)
            except Exception as error:
                future.set_exception(error)

        self._work.submit(run)
        return future

    def shutdown(self, timeout_sec: float | None = None) -> bool:
        """End `spin` in another thread, and forget the nodes."""
        self._is_shut_down = True
        self.wake()
        self._nodes = []
        return True

    def wake(self) -> None:
        """Let the thread that spins look for callbacks again."""
        self._work.submit(_nothing)

    def _begin(self) -> context.Context:
        here = context.current()
        for node in self._nodes:
            node.tfbus_node.ready()
        return here

    def _run_one(self, here: context.Context, timeout_s: float | None) -> bool:
        """Run the next callback; whether there was one in time."""
        taken = self._next(here, timeout_s)
        if taken is not None:
            self._run(*taken)
        return taken is not None

    def _run(self, work: Work, job: Job) -> None:
        work.run(job)

    def _next(self, here: context.Context, timeout_s: float | None) -> tuple[Work, Job] | None:
        taken = self._take()
        if taken is not None or timeout_s == 0.0:
            return taken
        works = self._works()
        with Wakeup() as wakeup:
            for work in works:
                work.wake_by(wakeup)
            try:
                taken = self._take()
                if taken is None and here.signals.wait(timeout_s, wakeup):
                    raise ExternalShutdownException if here.is_shut_down else KeyboardInterrupt
            finally:
                for work in works:
                    work.no_longer_wake(wakeup)
        return taken or self._take()

    def _works(self) -> list[Work]:
        return [self._work, *(node.work for node in self._nodes)]

    def _take(self) -> tuple[Work, Job] | None:
        for work in self._works():
            job = work.take()
            if job is not None:
                # The nodes behind it come first next time.
                for number, node in enumerate(self._nodes):
                    if node.work is work:
                        self._nodes = [*self._nodes[:number], *self._nodes[number + 1 :], node]
                        break
                return work, job
        return None


class SingleThreadedExecutor(Executor):
    """Runs callbacks one at a time, in the thread that spins it."""


class MultiThreadedExecutor(Executor):
    """Runs callbacks in `num_threads` threads, by default as many as there are processors, and at
    least two; callbacks of a mutually exclusive group one at a time.

    A callback without a group is in its node's default group, which is mutually exclusive. An
    exception of a callback ends `spin` in the thread that spins.
    """

    def __init__(self, num_threads: int | None = None, **_: Any) -> None:
        super().__init__()
        if num_threads is None:
            num_threads = max(2, os.cpu_count() or 2)
        self._raised: deque[BaseException] = deque()
        self._threads = Threads(
            "MultiThreadedExecutor", logging.getLogger(__name__), threads=num_threads
        )

    def shutdown(self, timeout_sec: float | None = None) -> bool:
        """End `spin` in another thread, and forget the nodes; callbacks that run have 2 s."""
        super().shutdown(timeout_sec)
        self._threads.close()
        return True

    def _run(self, work: Work, job: Job) -> None:
        self._threads.submit("callback", lambda: self._run_in_thread(work, job))
        if self._raised:
            raise self._raised.popleft()

    def _run_in_thread(self, work: Work, job: Job) -> None:
        try:
            work.run(job)
        except BaseException as error:
            self._raised.append(error)
            self.wake()


def _nothing() -> None:
    """For a spin that is to look again."""
