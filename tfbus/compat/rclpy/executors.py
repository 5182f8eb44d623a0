"""ROS's rclpy.executors: they run the callbacks of nodes, one at a time, in the calling thread."""

import math
import time
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from tfbus.compat.rclpy import context
from tfbus.compat.rclpy.task import Future, Task
from tfbus.runtime.signals import Wakeup

if TYPE_CHECKING:
    from tfbus.compat.rclpy.node import Node

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


class Work:
    """The callbacks of a node that are ready to run, in the order in which they became so."""

    def __init__(self) -> None:
        # How many messages of transforms each listener of the node has received, and how many each
        # had when that was asked last.
        self.listeners: list[Callable[[], int]] = []
        self._heard: dict[Callable[[], int], int] = {}
        # Both are changed by single operations, which threads and signal handlers may mix.
        self._ready: deque[Callable[[], object]] = deque()
        self._wakes: dict[int, Callable[[], None]] = {}

    def submit(self, callback: Callable[[], object]) -> None:
        """Run `callback()` in the thread that spins the node."""
        self._ready.append(callback)
        for wake in list(self._wakes.values()):
            wake()

    def call(self, callback: Callable[..., Any], *arguments: object) -> None:
        """Call it now; what it returns is run to its end, where it is a coroutine."""
        answer = callback(*arguments)
        if hasattr(answer, "send"):
            Task(answer, self.submit).step()

    def take(self) -> Callable[[], object] | None:
        """The next callback, if one is ready."""
        try:
            return self._ready.popleft()
        except IndexError:
            return None

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


class Executor:
    """Runs callbacks of its nodes one at a time, in the thread that spins it.

    Lookups, services and sleeps in a callback hold up other callbacks, but not the transforms and
    answers that they wait for.
    """

    def __init__(self, **_: Any) -> None:
        self._nodes: list[Node] = []
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

        Raises ExternalShutdownException where `rclpy.shutdown()` is called meanwhile, and what a
        callback raises.
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
        for node in self._nodes:
            future.when_ended(_poke(node.work))
        while here.ok() and not future.done() and not self._is_shut_down:
            left_s = None if deadline is None else deadline - time.monotonic()
            if left_s is not None and left_s <= 0:
                return
            self._run_one(here, left_s)

    def shutdown(self, timeout_sec: float | None = None) -> bool:
        """End `spin` in another thread, and forget the nodes."""
        self._is_shut_down = True
        for node in self._nodes:
            node.work.submit(lambda: None)
        self._nodes = []
        return True

    def _begin(self) -> context.Context:
        here = context.current()
        for node in self._nodes:
            node.tfbus_node.ready()
        return here

    def _run_one(self, here: context.Context, timeout_s: float | None) -> bool:
        """Run the next callback; whether there was one in time."""
        callback = self._next(here, timeout_s)
        if callback is not None:
            callback()
        return callback is not None

    def _next(self, here: context.Context, timeout_s: float | None) -> Callable[[], object] | None:
        callback = self._take()
        if callback is not None or timeout_s == 0.0:
            return callback
        works = [node.work for node in self._nodes]
        with Wakeup() as wakeup:
            for work in works:
                work.wake_by(wakeup)
            try:
                callback = self._take()
                if callback is None and here.signals.wait(timeout_s, wakeup):
                    raise ExternalShutdownException if here.is_shut_down else KeyboardInterrupt
            finally:
                for work in works:
                    work.no_longer_wake(wakeup)
        return callback or self._take()

    def _take(self) -> Callable[[], object] | None:
        for node in self._nodes:
            callback = node.work.take()
            if callback is not None:
                # Others come first next time.
                self._nodes = [*(each for each in self._nodes if each is not node), node]
                return callback
        return None


class SingleThreadedExecutor(Executor):
    """The executor."""


class MultiThreadedExecutor(Executor):
    """The same executor: callbacks run one at a time, which the log says once.

    In ROS a lookup that waits needs several threads; here it does not. A callback that waits for
    another callback of this executor waits for ever.
    """

    def __init__(self, num_threads: int | None = None, **_: Any) -> None:
        super().__init__()

    def add_node(self, node: "Node") -> bool:
        """Run the callbacks of this node too; whether it is new here."""
        node.say_once(
            "A MultiThreadedExecutor of tfbus.compat runs callbacks one at a time: none may wait "
            "for another one; lookups and services may be waited for",
        )
        return super().add_node(node)


def _poke(work: Work) -> Callable[[], None]:
    return lambda: work.submit(lambda: None)
